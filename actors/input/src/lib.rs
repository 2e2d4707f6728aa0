//! Input without haptic devices: virtual trainees, scripted paths and manual control.
//!
//! [`autopilot::Autopilot`] plans the goals of two tips, [`motor_model::HandMotor`] models a hand's movement to a goal,
//! [`grasp_planner`] plans grasps of rings. [`autopilot_controller::AutopilotController`] reads the snapshot and writes
//! hand targets: like a person, it moves only its hands.
//!
//! [`path`] is a scripted movement, for reproducible scenarios.
//!
//! [`manual`] lets a person control the hands with pointer, keyboard or gamepad.
#![forbid(unsafe_code)]

pub mod autopilot;
pub mod autopilot_controller;
pub mod grasp_planner;
pub mod manual;
pub mod motor_model;
pub mod noise;
pub mod path;
pub mod path_controller;
mod pedals;
pub mod strategy;
pub mod trainee_view;

use trocar_scene::{RegistryBuilder, RegistryError};

pub use autopilot_controller::{AutopilotConfig, AutopilotController};
pub use manual::{ManualConfig, ManualController};
pub use motor_model::Skill;
pub use path_controller::{PathConfig, PathController};

/// Registers this crate's own components.
///
/// # Errors
/// When a name is already taken by another type.
pub fn register(builder: &mut RegistryBuilder) -> Result<(), RegistryError> {
    builder.register::<autopilot_controller::AutopilotState>()?;
    builder.register::<manual::ManualState>()?;
    Ok(())
}

//! Virtual trainees, and people without a haptic device.
//!
//! [`autopilot::Autopilot`] decides where two tips should go, [`motor_model::HandMotor`] how a hand gets
//! there, [`grasp_planner`] where a ring can be taken. [`autopilot_controller::AutopilotController`] reads
//! the snapshot and writes hand targets: like a person, it can move nothing but its hands.
//!
//! [`path`] is a movement that is written down, for scenarios that are to go the same way every time.
//!
//! [`manual`] lets a person do the same with pointer, keyboard or gamepad.
#![forbid(unsafe_code)]

pub mod autopilot;
pub mod autopilot_controller;
pub mod grasp_planner;
pub mod manual;
pub mod motor_model;
pub mod noise;
pub mod path;
pub mod path_controller;
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

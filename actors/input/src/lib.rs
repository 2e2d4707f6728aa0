//! Virtual trainees and other input.
//!
//! [`autopilot::Autopilot`] decides where two tips should go, [`motor_model::HandMotor`] how a hand gets
//! there, [`grasp_planner`] where a ring can be taken. [`autopilot_controller::AutopilotController`] reads
//! the snapshot and writes hand targets: like a person, it can move nothing but its hands.
#![forbid(unsafe_code)]

pub mod autopilot;
pub mod autopilot_controller;
pub mod grasp_planner;
pub mod motor_model;
pub mod noise;
pub mod strategy;
pub mod trainee_view;

pub use autopilot_controller::{AutopilotConfig, AutopilotController, register};
pub use motor_model::Skill;

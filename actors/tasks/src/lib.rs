//! Exercises: goals, errors, scores.
//!
//! [`peg_transfer::PegTransfer`] is the exercise as a state machine driven by observations;
//! [`peg_transfer_controller::PegTransferController`] reads them from the scene and writes `TaskState`. [`outcome`]
//! judges any scene by the simulators' measurements. [`fls_score`] and [`motion_metrics`] are shared by all exercises.
//! The score of the peg transfer is FLS-*style*: no clinical validity is claimed for any score.
#![forbid(unsafe_code)]

pub mod fls_score;
pub mod motion_metrics;
pub mod outcome;
pub mod peg_bench;
pub mod peg_geometry;
pub mod peg_rules;
pub mod peg_transfer;
pub mod peg_transfer_controller;

use trocar_scene::{RegistryBuilder, RegistryError};

pub use outcome::{OutcomeConfig, OutcomeController};
pub use peg_transfer_controller::{PegTransferConfig, PegTransferController};

/// Registers this crate's own components.
///
/// # Errors
/// When a name is already taken by another type.
pub fn register(builder: &mut RegistryBuilder) -> Result<(), RegistryError> {
    builder.register::<peg_transfer_controller::PegTransferState>()?;
    builder.register::<outcome::OutcomeState>()?;
    Ok(())
}

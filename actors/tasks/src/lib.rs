//! Exercises: goals, errors, scores.
//!
//! [`peg_transfer::PegTransfer`] is the exercise as a state machine that is fed with observations;
//! [`peg_transfer_controller::PegTransferController`] reads them from the scene and writes `TaskState`.
//! [`fls_score`] and [`motion_metrics`] serve every exercise. Scores are FLS-*style*: no clinical validity is
//! claimed for any of them.
#![forbid(unsafe_code)]

pub mod fls_score;
pub mod motion_metrics;
pub mod peg_geometry;
pub mod peg_rules;
pub mod peg_transfer;
pub mod peg_transfer_controller;

pub use peg_transfer_controller::{PegTransferConfig, PegTransferController, register};

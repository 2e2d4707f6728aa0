//! Virtual trainees and other input.
#![forbid(unsafe_code)]
pub mod motor_model;
pub mod noise;

//! Virtual trainees.
//!
//! All of these tests run beside each other.

mod autopilot;
mod physics;
mod ranking;
mod support;

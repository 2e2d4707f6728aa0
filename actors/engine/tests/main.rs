//! Worlds of rigid bodies, and the engine's soft ones.
//!
//! All of these tests run beside each other.
#![allow(clippy::duplicate_mod, reason = "the cases are held against each of the worlds")]

mod held_back;
mod impulse_world;
mod rapier_world;
mod sliding;
mod soft_bodies;
#[path = "../../simulator/tests/support/stage/mod.rs"]
mod stage;

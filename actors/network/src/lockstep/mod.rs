//! The driver in virtual time: links inside the process, with the same luck for the same seed.

pub mod wire;

pub use wire::{End, Wire};

//! Couplings between bodies of different controllers: exchanged components, and the slower side.

pub mod components;
pub mod slow_side;

pub use components::{CoupledBody, CoupledWith, CouplingGiven, CouplingTaken, Joined, Lies};

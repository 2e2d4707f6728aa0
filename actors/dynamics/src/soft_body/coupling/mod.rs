//! Bodies of different controllers that are coupled: what both sides tell, and the slower side.

pub mod components;
pub mod slow_side;

pub use components::{CoupledBody, CoupledWith, CouplingGiven, CouplingTaken, Joined, Lies};

//! What a world of rigid bodies and instruments does, whoever computes it.

pub(crate) mod error;
pub mod mass_properties;
pub(crate) mod world;
pub(crate) mod wrench;

pub use error::WorldError;
pub use world::{FLOOR, Inertia, Scheduling, ToolView, World, check};
pub use wrench::{Wrench, most_across};

//! Interface of a world of rigid bodies and instruments, independent of its solver.

pub(crate) mod error;
pub mod mass_properties;
pub(crate) mod world;
pub(crate) mod wrench;

pub use error::WorldError;
pub use world::{FLOOR, Inertia, Scheduling, ToolView, World, check};
pub use wrench::{Wrench, most_across};

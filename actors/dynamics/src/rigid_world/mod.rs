//! Interface of a world of rigid bodies and instruments, independent of its solver.

pub(crate) mod error;
pub mod mass_properties;
pub(crate) mod mobility;
pub(crate) mod settings;
pub(crate) mod world;

pub use error::WorldError;
pub use mobility::tangential_mobility_max;
pub use settings::{WorldSettings, check_setting};
pub use world::{BodyJoint, FLOOR, FLOOR_HALF_EXTENTS, Inertia, Scheduling, ToolView, World, check};

//! What any world of rigid bodies and instruments has to do.

// The world under test: whoever includes these cases says which one.
use super::{GIVES_WAY, JOINT_BOUNDS, TOOLS_MAX, W, settings};

mod bodies;
mod common;
mod controller;
mod grasping;
mod instruments;
pub mod joints;
mod surfaces;

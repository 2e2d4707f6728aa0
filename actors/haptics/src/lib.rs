//! Force rendering, and the controller that serves a haptic device.

pub mod energy;
pub mod felt_stiffness;
pub mod renderer;

// The kinematics live in the scene (scene/src/kinematics/), so that virtual trainees share them.
pub use trocar_scene::kinematics::{coupling, fulcrum, registration, spatial};

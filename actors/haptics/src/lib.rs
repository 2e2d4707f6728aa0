//! Force rendering, and the controller that serves a haptic device.
//!
//! The algorithms are plain types, each in a file of its own:
//!
//! - [`renderer`]: force rendering from a simulation slower than the haptic rate ([`renderer::ZeroOrderHold`],
//!   [`renderer::VirtualCoupling`], [`renderer::Proxy`]);
//! - [`virtual_fixture`]: forces that a behaviour adds;
//! - [`felt_stiffness`]: online estimate of the rendered stiffness;
//! - the kinematics (registration, fulcrum, wrenches) live in [`trocar_scene::kinematics`], so that virtual
//!   trainees share them.
//!
//! [`HapticsController`] schedules them at 1–10 kHz for one hand. A tick allocates nothing.
//!
//! What is absent here: threads, clocks, device protocols, physics.
#![forbid(unsafe_code)]

pub mod config;
pub mod controller;
pub mod felt_stiffness;
pub mod playout;
pub mod renderer;
pub mod virtual_fixture;

pub use config::{HapticsConfig, HapticsError};
pub use controller::{HapticsController, pressed};
pub use trocar_scene::kinematics::{coupling, fulcrum, hand_rig, registration, spatial};

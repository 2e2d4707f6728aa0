//! Manual control of both hands, in turn, with pointer, keyboard or gamepad.
//!
//! ```text
//! keys, pointer, pad ─▶ Controls (bindings) ─▶ person_input ─▶ ManualController (mapping) ─▶ hand_target
//!      a window, a test                         the scene           every hand's own rate
//! ```
//!
//! [`Controls`] maps pressed controls to actions, by [`Bindings`]: each window owns one, and writes its
//! [`PersonInput`](trocar_scene::PersonInput) into the session as an operator. [`ManualController`] converts these
//! totals to targets of the hands: [`mapping`] is the geometry, [`follower`] the smoothing.

pub mod bindings;
pub mod control;
pub mod controller;
pub mod controls;
pub mod follower;
mod lent_hand;
pub mod mapping;

pub use bindings::{Bindings, BindingsError};
pub use control::Control;
pub use controller::{ManualConfig, ManualController, ManualState, NoHands};
pub use controls::Controls;

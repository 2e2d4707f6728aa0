//! A person who drives both hands, in turn, with pointer, keyboard or gamepad.
//!
//! ```text
//! keys, pointer, pad ─▶ Controls (bindings) ─▶ person_input ─▶ ManualController (mapping) ─▶ hand_target
//!      a window, a test                         the scene           every hand's own rate
//! ```
//!
//! [`Controls`] turns what is pressed into what is meant, by [`Bindings`]: whoever has a window keeps one, and writes
//! its [`PersonInput`](trocar_scene::PersonInput) into the session as an operator. [`ManualController`] turns the
//! totals that stand there into targets of the hands: [`mapping`] is the geometry, [`follower`] the smoothing.

pub mod bindings;
pub mod control;
pub mod controller;
pub mod controls;
pub mod follower;
pub mod mapping;

pub use bindings::{Bindings, BindingsError};
pub use control::Control;
pub use controller::{ManualConfig, ManualController, ManualState, NoHands};
pub use controls::Controls;

//! Force rendering, and the controller that serves a haptic device.

pub mod coupling;
pub mod fulcrum;
pub mod registration;
pub mod spatial;

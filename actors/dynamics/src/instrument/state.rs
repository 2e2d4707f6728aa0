//! Pose and velocity of an instrument, and the opening of its jaws.

use nalgebra::Isometry3;
use trocar_scene::Velocity;

/// Opening of the jaws.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct JawOpening {
    /// Full opening \[rad\].
    pub angle: f64,
    /// Its rate \[rad/s\].
    pub rate: f64,
    /// Angle between the jaws' bisector and the shaft's axis, about +y \[rad\].
    pub tilt: f64,
    /// Its rate \[rad/s\].
    pub tilt_rate: f64,
}

/// The state by which another world can continue with an instrument.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct InstrumentState {
    /// `world_from_instrument`.
    pub tip_in_world: Isometry3<f64>,
    /// Velocity of the tip.
    pub velocity: Velocity,
    /// Jaws.
    pub opening: JawOpening,
    /// Current set point of the jaw drive \[rad\].
    pub drive_reference: f64,
}

//! Where an instrument is, how it moves, and how far its jaws are open.

use nalgebra::Isometry3;
use trocar_scene::Velocity;

/// Opening of the jaws.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct JawOpening {
    /// Full opening \[rad\].
    pub angle: f64,
    /// Its rate \[rad/s\].
    pub rate: f64,
    /// How far the bisector of the jaws is off the shaft's axis, about +y \[rad\].
    pub tilt: f64,
    /// Its rate \[rad/s\].
    pub tilt_rate: f64,
}

/// What suffices to continue with an instrument where another world left it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct InstrumentState {
    /// `world_from_instrument`.
    pub tip_in_world: Isometry3<f64>,
    /// Velocity of the tip.
    pub velocity: Velocity,
    /// Jaws.
    pub opening: JawOpening,
    /// Where the drive of the jaws is on its way to its target \[rad\].
    pub drive_reference: f64,
}

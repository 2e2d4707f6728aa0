//! The jaws of an instrument: how many, where their blades are, and the drive that opens and closes them.

use nalgebra::{Isometry3, Vector3};
use trocar_scene::Instrument;

/// A jaw reaches its largest force when its target lies this far inside of the actual opening \[rad\].
pub const SATURATION_ANGLE: f64 = 0.1;
/// Share of the instrument's mass that each jaw carries, its part of the drive included.
///
/// A jaw is heavy in the directions in which the hinge guides it and light in the one in which it turns, with its
/// centre at the hinge: a push on its tip is then nearly a pure turn, and the solver's sweeps over hinge and
/// contact converge in a few iterations instead of creeping.
pub const JAW_MASS_SHARE: f64 = 0.25;
/// Moment about the hinge, in units of mass times length squared.
pub const TURNING_MOMENT: f64 = 0.1;
/// The blades touch at their tips first, as those of real graspers do: their pads are parallel on a body as thick
/// as this many blades, so that closing does not push it out of the mouth.
const PARALLEL_AT_THICKNESSES: f64 = 2.0;
/// The blades begin this far before the hinge, so that they do not touch each other around it \[m\].
const HINGE_CLEARANCE: f64 = 0.002;

/// How many jaws the instrument has.
#[must_use]
pub fn jaw_count(instrument: &Instrument) -> usize {
    if instrument.kind.has_jaws() { usize::from(instrument.jaws.min(2)) } else { 0 }
}

/// +1 for jaw A, −1 for jaw B: the sign of its turn about +y while opening.
#[must_use]
pub fn side(jaw: usize) -> f64 {
    if jaw == 0 { 1.0 } else { -1.0 }
}

/// `instrument_from_jaw` of a jaw turned by `angle` about the hinge \[rad\].
#[must_use]
pub fn instrument_from_jaw(jaw_length: f64, angle: f64) -> Isometry3<f64> {
    let hinge = Isometry3::translation(0.0, 0.0, -jaw_length);
    hinge * Isometry3::rotation(Vector3::y() * angle) * hinge.inverse()
}

/// The blade of a jaw as a box: `jaw_from_blade`, and half of its edges \[m\]. It is turned about the inner edge of the tip, so
/// that the closed tips meet at the origin.
#[must_use]
pub fn blade(instrument: &Instrument, jaw: usize) -> (Isometry3<f64>, Vector3<f64>) {
    let length = instrument.jaw_length;
    let half = Vector3::new(instrument.jaw_thickness, instrument.jaw_width, length - clearance(length)) / 2.0;
    let bow = -side(jaw) * bow(instrument);
    let centre = Vector3::new(side(jaw) * half.x, 0.0, -half.z);
    (Isometry3::rotation(Vector3::y() * bow) * Isometry3::from(centre), half)
}

/// Where the drive is after one more step of `step_secs` on its way to `target` \[rad\] at up to `rate_max` \[rad/s\], and how
/// fast it goes. What a squeezed body keeps open is not travelled again when the hand opens: there is no wind-up.
#[must_use]
pub fn drive_reference(before: f64, actual: f64, target: f64, rate_max: f64, step_secs: f64) -> (f64, f64) {
    let step = rate_max * step_secs;
    let slack = 1.5 * SATURATION_ANGLE;
    let reference = (before + (target - before).clamp(-step, step)).clamp(actual - slack, actual + slack);
    (reference, ((reference - before) / step_secs).clamp(-rate_max, rate_max))
}

/// Inclination of the pads of closed jaws to the shaft's axis \[rad\].
#[must_use]
pub fn bow(instrument: &Instrument) -> f64 {
    let gap = PARALLEL_AT_THICKNESSES * instrument.jaw_thickness;
    (0.5 * gap / instrument.jaw_length).min(0.25 * instrument.jaw_angle_max)
}

/// The blades of very short jaws keep most of their length.
fn clearance(length: f64) -> f64 {
    HINGE_CLEARANCE.min(0.2 * length)
}

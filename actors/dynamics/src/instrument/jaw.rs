//! Jaws of an instrument: their number, the blades' geometry, and the drive that opens and closes them.

use nalgebra::{Isometry3, Vector3};
use trocar_scene::Instrument;

/// How far the drive's target must lie inside the actual opening for the full jaw force \[rad\].
pub const SATURATION_ANGLE: f64 = 0.1;
/// Fraction of the instrument's mass that each jaw carries, with its part of the drive.
///
/// A jaw has a large inertia about the axes that the hinge locks and a small one about the hinge axis, with its centre
/// at the hinge: an impulse on its tip is then nearly a pure rotation, and the solver's sweeps over hinge and contact
/// converge in a few iterations instead of creeping.
pub const JAW_MASS_SHARE: f64 = 0.25;
/// Moment of inertia about the hinge, in units of mass times length squared.
pub const TURNING_MOMENT: f64 = 0.1;
/// The blades touch at their tips first, like those of real graspers: the pads are parallel on a body of this many
/// blade thicknesses, so that closing does not push it out.
const PARALLEL_AT_THICKNESSES: f64 = 2.0;
/// The blades begin this far in front of the hinge, so that they do not collide there \[m\].
const HINGE_CLEARANCE: f64 = 0.002;

/// Number of jaws of the instrument.
#[must_use]
pub fn jaw_count(instrument: &Instrument) -> usize {
    if instrument.kind.has_jaws() { usize::from(instrument.jaws.min(2)) } else { 0 }
}

/// +1 for jaw A, −1 for jaw B: the sign of its rotation about +y while opening.
#[must_use]
pub fn side(jaw: usize) -> f64 {
    if jaw == 0 { 1.0 } else { -1.0 }
}

/// `instrument_from_jaw` of a jaw rotated by `angle` about the hinge \[rad\].
#[must_use]
pub fn instrument_from_jaw(jaw_length: f64, angle: f64) -> Isometry3<f64> {
    let hinge = Isometry3::translation(0.0, 0.0, -jaw_length);
    hinge * Isometry3::rotation(Vector3::y() * angle) * hinge.inverse()
}

/// The blade of a jaw as a box: `jaw_from_blade`, and half of its edges \[m\]. It is rotated about the inner edge of
/// the tip, so that the closed tips meet at the origin.
#[must_use]
pub fn blade(instrument: &Instrument, jaw: usize) -> (Isometry3<f64>, Vector3<f64>) {
    let length = instrument.jaw_length;
    let half = Vector3::new(instrument.jaw_thickness, instrument.jaw_width, length - clearance(length)) / 2.0;
    let bow = -side(jaw) * bow(instrument);
    let centre = Vector3::new(side(jaw) * half.x, 0.0, -half.z);
    (Isometry3::rotation(Vector3::y() * bow) * Isometry3::from(centre), half)
}

/// Set point and rate of the drive after one more step of `step_secs` towards `target` \[rad\] at up to `rate_max`
/// \[rad/s\]. Anti-windup: the set point stays close to the actual opening, so that jaws open without delay after a
/// squeeze.
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

/// Clearance at the hinge; very short jaws keep most of their blade length.
fn clearance(length: f64) -> f64 {
    HINGE_CLEARANCE.min(0.2 * length)
}

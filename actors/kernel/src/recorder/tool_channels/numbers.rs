//! Numbers as short text: rounded to what matters, since text is all that these messages are made of.

use nalgebra::{Quaternion, Vector3};
use serde_json::{Value, json};
use trocar_scene::SimTime;

/// Places after the point of lengths \[m\] and of parts of a quaternion.
pub(super) const POSE: i32 = 6;
/// Of points of a surface \[m\].
pub(super) const SURFACE: i32 = 5;
/// Of forces \[N\], angles \[rad\] and seconds.
pub(super) const FORCE: i32 = 4;

/// Rounded to so many places after the point; never −0.
pub(super) fn rounded(value: f64, places: i32) -> f64 {
    let scale = 10_f64.powi(places);
    (value * scale).round() / scale + 0.0
}

/// Rounded to six significant digits.
pub(super) fn significant(value: f64) -> f64 {
    if value == 0.0 || !value.is_finite() {
        return 0.0;
    }
    let places = 5.0 - value.abs().log10().floor();
    // Beyond, powers of ten are no longer finite.
    if places.abs() > 290.0 { value } else { rounded(value, places as i32) }
}

pub(super) fn vector(vector: &Vector3<f64>, places: i32) -> Value {
    let [x, y, z] = [vector.x, vector.y, vector.z].map(|part| rounded(part, places));
    json!({"x": x, "y": y, "z": z})
}

pub(super) fn quaternion(rotation: &Quaternion<f64>, places: i32) -> Value {
    let [x, y, z, w] = [rotation.i, rotation.j, rotation.k, rotation.w].map(|part| rounded(part, places));
    json!({"x": x, "y": y, "z": z, "w": w})
}

/// A time as well-known types write it.
pub(super) fn stamp(time: SimTime) -> Value {
    json!({"sec": time.0 / 1_000_000_000, "nsec": time.0 % 1_000_000_000})
}

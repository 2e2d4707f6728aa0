//! Directors along a curve: parallel transport, and the twist between neighbouring edges (Bishop 1975; Bergou, Wardetzky,
//! Robinson, Audoly, Grinspun, *Discrete Elastic Rods*, 2008).

use nalgebra::Vector3;

/// Below this the two directions are numerically opposite and the transport between them is arbitrary.
const OPPOSITE: f64 = 1e-9;

/// `vector` turned by the smallest rotation that takes the unit direction `from` to the unit direction `to`.
#[inline]
#[must_use]
pub(crate) fn transport(from: &Vector3<f64>, to: &Vector3<f64>, vector: &Vector3<f64>) -> Vector3<f64> {
    let binormal = from.cross(to);
    let reach = 1.0 + from.dot(to);
    if reach < OPPOSITE {
        return *vector;
    }
    // Rodrigues' formula with sin and cos taken from the cross and the dot product.
    vector * (reach - 1.0) + binormal.cross(vector) + binormal * (binormal.dot(vector) / reach)
}

/// `vector`, perpendicular to the unit direction `axis`, turned about it by `angle` \[rad\].
#[inline]
#[must_use]
pub(crate) fn turn(vector: &Vector3<f64>, axis: &Vector3<f64>, angle: f64) -> Vector3<f64> {
    vector * angle.cos() + axis.cross(vector) * angle.sin()
}

/// The angle about `axis` from `from` to `to`, both perpendicular to it, in (−π, π] \[rad\].
#[inline]
#[must_use]
pub(crate) fn angle_about(from: &Vector3<f64>, to: &Vector3<f64>, axis: &Vector3<f64>) -> f64 {
    from.cross(to).dot(axis).atan2(from.dot(to))
}

/// Of all angles that differ from `angle` by whole turns, the one nearest to `near` \[rad\].
#[inline]
#[must_use]
pub(crate) fn unwrapped(angle: f64, near: f64) -> f64 {
    angle + ((near - angle) / std::f64::consts::TAU).round() * std::f64::consts::TAU
}

/// `vector` made perpendicular to the unit direction `axis` and normalised; any perpendicular unit vector where it is
/// parallel to `axis`.
#[must_use]
pub(crate) fn perpendicular(vector: &Vector3<f64>, axis: &Vector3<f64>) -> Vector3<f64> {
    let flat = vector - axis * axis.dot(vector);
    flat.try_normalize(1e-9).unwrap_or_else(|| {
        let other = if axis.x.abs() < 0.7 { Vector3::x() } else { Vector3::y() };
        (other - axis * axis.dot(&other)).normalize()
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn transport_carries_one_direction_to_the_other_and_keeps_angles() {
        let (from, to) = (Vector3::new(1.0, 2.0, -0.5).normalize(), Vector3::new(-0.3, 0.4, 1.0).normalize());
        assert!((transport(&from, &to, &from) - to).norm() < 1e-15);
        let across = perpendicular(&Vector3::new(0.1, 0.2, 0.9), &from);
        let carried = transport(&from, &to, &across);
        assert!(carried.dot(&to).abs() < 1e-15 && (carried.norm() - 1.0).abs() < 1e-15);
        assert!((angle_about(&carried, &turn(&carried, &to, 1.25), &to) - 1.25).abs() < 1e-15);
    }

    #[test]
    fn whole_turns_are_counted() {
        assert!((unwrapped(0.1, 12.6) - (0.1 + 2.0 * std::f64::consts::TAU)).abs() < 1e-12);
        assert_eq!(unwrapped(-3.0, 0.0), -3.0);
    }
}

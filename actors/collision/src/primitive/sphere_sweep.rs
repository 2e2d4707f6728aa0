//! Sweep of a sphere against a triangle (conservative advancement: Mirtich, *Impulse-based dynamic simulation of rigid
//! body systems*, 1996).
//!
//! The distance of a linearly moving point from a convex set is a convex function of time. So any tangent lies below
//! it: where the tangent reaches the radius, the sphere has not hit the triangle yet, and Newton's method approaches
//! the contact from before, never beyond it.

use nalgebra::{Point3, Vector3};

use super::{Triangle, closest_on_triangle};

/// Most steps of Newton's method; stopping early is safe.
const STEPS_MAX: usize = 48;
/// Tolerance of the contact, relative to the radius.
const NEAR_ENOUGH: f64 = 1e-6;

/// The share of `motion`, 0 to 1, that a sphere can safely move before it is nearer than `radius` \[m\]; also 1 if it
/// is already nearer and moves away, 0 if it is already nearer and approaches.
#[must_use]
pub fn sweep_sphere_triangle(
    center: &Point3<f64>,
    radius: f64,
    motion: &Vector3<f64>,
    triangle: &Triangle,
) -> f64 {
    let mut share = 0.0;
    for _ in 0..STEPS_MAX {
        if share >= 1.0 {
            return 1.0;
        }
        let place = center + motion * share;
        let away = place - closest_on_triangle(&place, triangle).point;
        let distance = away.norm();
        let room = distance - radius;
        let closing = -away.dot(motion);
        if distance > 0.0 && closing <= 0.0 {
            return 1.0;
        }
        // Also without a direction, or for NaN.
        if room.is_nan() || room <= NEAR_ENOUGH * radius {
            break;
        }
        share += room * distance / closing;
    }
    if share >= 1.0 { 1.0 } else { share.max(0.0) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::primitive::arbitrary::point;
    use proptest::prelude::*;

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(5_000))]
        /// Up to the result the sphere keeps its distance; a little further it does not, unless the whole motion is
        /// free.
        #[test]
        fn it_stops_where_it_meets_and_not_before(
            center in point(), end in point(), triangle in [point(), point(), point()], radius in 1e-3..0.5_f64
        ) {
            let motion = (end - center) * 2.0;
            let apart = |share: f64| {
                let place = center + motion * share;
                (closest_on_triangle(&place, &triangle).point - place).norm()
            };
            let radius = radius.min(0.9 * apart(0.0));
            // Below the resolution of coordinates there is no contact to stop at.
            prop_assume!(radius > 1e-9);
            let share = sweep_sphere_triangle(&center, radius, &motion, &triangle);
            let samples = (0..=200).map(|sample| share * f64::from(sample) / 200.0);
            let nearest = samples.map(apart).fold(f64::INFINITY, f64::min);
            prop_assert!(nearest >= radius - 1e-12, "{nearest}");
            if share < 1.0 {
                prop_assert!(apart(share) <= radius * (1.0 + 2e-6), "{share}");
            }
        }
    }

    #[test]
    fn through_beside_away_and_from_within() {
        let triangle = [Point3::origin(), Point3::new(1.0, 0.0, 0.0), Point3::new(0.0, 1.0, 0.0)];
        let sweep = |from: [f64; 3], by: [f64; 3], radius| {
            sweep_sphere_triangle(&Point3::from(from), radius, &Vector3::from(by), &triangle)
        };
        // Right through, however fast.
        assert!((sweep([0.2, 0.2, 1.0], [0.0, 0.0, -1e6], 0.25) - 0.75e-6).abs() < 1e-11);
        assert_eq!(sweep([0.2, 0.2, 1.0], [0.0, 0.0, -0.7], 0.25), 1.0);
        assert_eq!(sweep([0.2, 0.2, 0.3], [5.0, 0.0, 0.0], 0.25), 1.0);
        assert_eq!(sweep([0.2, 0.2, 0.1], [0.0, 0.0, 1.0], 0.25), 1.0);
        assert_eq!(sweep([0.2, 0.2, 0.1], [0.0, 0.0, -1.0], 0.25), 0.0);
        assert_eq!(sweep([0.2, 0.2, 0.0], [0.0, 0.0, -1.0], 0.25), 0.0);
        assert_eq!(sweep([f64::NAN, 0.2, 0.0], [0.0, 0.0, -1.0], 0.25), 0.0);
    }
}

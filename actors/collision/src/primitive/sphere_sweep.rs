//! How far a sphere can go before it meets a triangle (conservative advancement: Mirtich, *Impulse-based dynamic simulation
//! of rigid body systems*, 1996).
//!
//! The distance of a point that moves evenly from a convex set is a convex function of time. So the tangent at any time
//! lies below it: where the tangent meets the radius, the sphere has not met the triangle yet, and Newton's method comes to
//! the meeting from before, never beyond it.

use nalgebra::{Point3, Vector3};

use super::{Triangle, closest_on_triangle};

/// Steps of Newton's method at most; whatever is left is left undone, which is safe.
const STEPS_MAX: usize = 48;
/// Share of the radius to within which the meeting is found.
const NEAR_ENOUGH: f64 = 1e-6;

/// The share of `motion`, 0 to 1, that a sphere can surely go before it is nearer than `radius` \[m\]; 1 also where it is
/// nearer already and moves away, 0 where it is and comes nearer still.
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
        // Also where there is no direction, or no number.
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
        /// Up to there it keeps its distance; a little further it does not, unless it goes all the way.
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
            // Nearer than coordinates can tell there is nothing to stop at.
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

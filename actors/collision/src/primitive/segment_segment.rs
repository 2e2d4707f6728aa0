//! Nearest points of two segments (Ericson, *Real-Time Collision Detection*, 2004, §5.1.9; made robust for nearly
//! parallel segments by testing the four ends as well, as Eberly, *Robust Computation of Distance Between Line
//! Segments*, 2015, advises).

use nalgebra::Point3;

use super::{Segment, closest_on_segment};

/// The nearest points of two segments.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SegmentSegment {
    /// On each of them \[m\].
    pub points: [Point3<f64>; 2],
    /// Parameter along each, 0 at its first end to 1 at its second.
    pub along: [f64; 2],
    /// Distance, squared \[m²\].
    pub distance_squared: f64,
}

/// Squared sine of the angle between two segments below which the determinant of the 2 × 2 system has lost half its
/// digits; the cross product of the two has not.
const ALIKE: f64 = 1e-6;
/// The same below which two segments are parallel.
const PARALLEL: f64 = 1e-20;

/// Nearest points of `first` and `second`.
#[inline]
#[must_use]
pub fn closest_segments(first: &Segment, second: &Segment) -> SegmentSegment {
    let (d1, d2) = (first[1] - first[0], second[1] - second[0]);
    let (a, e, b) = (d1.norm_squared(), d2.norm_squared(), d1.dot(&d2));
    let determinant = a * e - b * b;
    let r = first[0] - second[0];
    let (c, f) = (d1.dot(&r), d2.dot(&r));
    let s = if determinant > ALIKE * a * e {
        (b * f - c * e) / determinant
    } else {
        let normal = d1.cross(&d2);
        let square = normal.norm_squared();
        if square <= PARALLEL * a * e {
            return closest_parallel(first, second);
        }
        d2.cross(&r).dot(&normal) / square
    };
    let t = ((b * s.clamp(0.0, 1.0) + f) / e).clamp(0.0, 1.0);
    // The second is clamped to its end, or not at all: the first follows either way.
    let s = ((b * t - c) / a).clamp(0.0, 1.0);
    at(first, second, s, t)
}

#[cold]
fn closest_parallel(first: &Segment, second: &Segment) -> SegmentSegment {
    // Parallel, or points: one of the four ends is among the nearest.
    let ends = [
        at(first, second, 0.0, closest_on_segment(&first[0], second)),
        at(first, second, 1.0, closest_on_segment(&first[1], second)),
        at(first, second, closest_on_segment(&second[0], first), 0.0),
        at(first, second, closest_on_segment(&second[1], first), 1.0),
    ];
    let mut best = ends[0];
    for other in &ends[1..] {
        if other.distance_squared < best.distance_squared {
            best = *other;
        }
    }
    best
}

fn at(first: &Segment, second: &Segment, s: f64, t: f64) -> SegmentSegment {
    let points = [first[0] + (first[1] - first[0]) * s, second[0] + (second[1] - second[0]) * t];
    SegmentSegment { points, along: [s, t], distance_squared: (points[1] - points[0]).norm_squared() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::primitive::arbitrary::point_with;
    use proptest::prelude::*;

    fn point() -> impl Strategy<Value = Point3<f64>> {
        point_with(1e-7)
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(20_000))]
        /// Two points of convex sets are nearest if moving either towards one of its ends does not bring them nearer.
        #[test]
        fn neither_can_come_nearer(first in [point(), point()], second in [point(), point()]) {
            let found = closest_segments(&first, &second);
            let towards = found.points[1] - found.points[0];
            let slack = 1e-6 * towards.norm() + 1e-12;
            for end in &first {
                prop_assert!(towards.dot(&(end - found.points[0])) <= slack, "{found:?}");
            }
            for end in &second {
                prop_assert!(-towards.dot(&(end - found.points[1])) <= slack, "{found:?}");
            }
        }
    }

    #[test]
    fn parallel_crossing_and_points() {
        let x = [Point3::origin(), Point3::new(1.0, 0.0, 0.0)];
        let shifted = [Point3::new(0.5, 1.0, 0.0), Point3::new(3.0, 1.0, 0.0)];
        assert_eq!(closest_segments(&x, &shifted).distance_squared, 1.0);
        let crossing = [Point3::new(0.25, -1.0, 0.5), Point3::new(0.25, 1.0, 0.5)];
        let found = closest_segments(&x, &crossing);
        assert_eq!((found.along, found.distance_squared), ([0.25, 0.5], 0.25));
        let dot = [Point3::new(0.5, 0.0, 2.0); 2];
        assert_eq!(closest_segments(&x, &dot).distance_squared, 4.0);
        assert_eq!(closest_segments(&dot, &dot).distance_squared, 0.0);
    }
}

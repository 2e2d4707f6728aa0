//! A plane between a segment and a triangle: a bound of their distance that costs next to nothing.

use nalgebra::{Point3, Vector3};

use crate::primitive::{Segment, SegmentTriangle, Triangle, closest_on_segment};

/// A plane before which the segment was and behind which a triangle was when they were last measured: it says how near they
/// can be now without measuring again, and does not mind how the segment slides along it.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Support {
    /// Unit normal towards the segment; zero where there was no telling.
    normal: Vector3<f64>,
    offset: f64,
    /// Motion of the surface up to then \[m\].
    motion: f64,
}

impl Support {
    /// Between the nearest points.
    pub(super) fn new(nearest: &SegmentTriangle, triangle: &Triangle, motion: f64) -> Self {
        Self::along(&(nearest.on_segment - nearest.on_triangle), triangle, motion)
    }

    /// Along the way from the middle of the triangle to the nearest point of the segment: for a start, and without
    /// measuring.
    pub(super) fn guess(segment: &Segment, triangle: &Triangle, motion: f64) -> Self {
        let middle = Point3::from((triangle[0].coords + triangle[1].coords + triangle[2].coords) / 3.0);
        let along = closest_on_segment(&middle, segment);
        let away = segment[0] + (segment[1] - segment[0]) * along - middle;
        Self::along(&away, triangle, motion)
    }

    /// Any direction will do: the plane is put where the triangle ends in it.
    fn along(direction: &Vector3<f64>, triangle: &Triangle, motion: f64) -> Self {
        let size = direction.norm();
        if size <= 0.0 {
            return Self::default();
        }
        let normal = direction / size;
        let [a, b, c] = triangle.map(|corner| normal.dot(&corner.coords));
        Self { normal, offset: a.max(b).max(c), motion }
    }

    pub(super) fn is_empty(&self) -> bool {
        self.normal == Vector3::zeros()
    }

    /// A distance that they have at least \[m\].
    pub(super) fn at_least(&self, segment: &Segment, motion: f64) -> f64 {
        let heights = segment.map(|end| self.normal.dot(&end.coords));
        heights[0].min(heights[1]) - self.offset - (motion - self.motion)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::primitive::arbitrary::point;
    use crate::primitive::closest_segment_triangle;
    use proptest::prelude::*;

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(5_000))]
        /// Whatever the segment has done since, and however far the triangle has moved within what is told.
        #[test]
        fn a_support_never_tells_too_much(
            first in [point(), point()], later in [point(), point()], triangle in [point(), point(), point()],
            shift in point()
        ) {
            let exact = |segment: &Segment, triangle: &Triangle| {
                closest_segment_triangle(segment, triangle).distance_squared.sqrt()
            };
            let nearest = closest_segment_triangle(&first, &triangle);
            let moved = triangle.map(|corner| corner + shift.coords);
            for support in [
                Support::new(&nearest, &triangle, 1.0),
                Support::guess(&first, &triangle, 1.0),
            ] {
                prop_assert!(support.at_least(&first, 1.0) <= exact(&first, &triangle) + 1e-9);
                prop_assert!(support.at_least(&later, 1.0) <= exact(&later, &triangle) + 1e-9);
                let told = support.at_least(&later, 1.0 + shift.coords.norm());
                prop_assert!(told <= exact(&later, &moved) + 1e-9);
            }
        }
    }
}

//! Separating plane between a segment and a triangle: a cheap lower bound of their distance.

use nalgebra::{Point3, Vector3};

use crate::primitive::{Segment, SegmentTriangle, Triangle, closest_on_segment};

/// A plane that separated the segment and a triangle at their last measurement. It bounds their current distance
/// without a new measurement, and is unaffected by sliding along it.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Support {
    /// Unit normal towards the segment; zero if undefined.
    normal: Vector3<f64>,
    offset: f64,
    /// Accumulated motion of the surface at that time \[m\].
    motion: f64,
}

impl Support {
    /// The plane between the nearest points.
    pub(super) fn new(nearest: &SegmentTriangle, triangle: &Triangle, motion: f64) -> Self {
        Self::along(&(nearest.on_segment - nearest.on_triangle), triangle, motion)
    }

    /// Initial guess without measurement: normal from the triangle's centroid to the nearest point of the segment.
    pub(super) fn guess(segment: &Segment, triangle: &Triangle, motion: f64) -> Self {
        let middle = Point3::from((triangle[0].coords + triangle[1].coords + triangle[2].coords) / 3.0);
        let along = closest_on_segment(&middle, segment);
        let away = segment[0] + (segment[1] - segment[0]) * along - middle;
        Self::along(&away, triangle, motion)
    }

    /// Any direction is valid: the plane is placed at the triangle's support in it.
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

    /// Lower bound of their distance \[m\].
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
        /// Tests the bound for any motion of the segment, and motion of the triangle within the stated amount.
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

//! Nearest points of a segment and a triangle: the crossing, else an end above the triangle or an edge.

use nalgebra::{Point3, Vector3};

use super::{Segment, Triangle, closest_segments};

/// The nearest points of a segment and a triangle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SegmentTriangle {
    /// On the segment \[m\].
    pub on_segment: Point3<f64>,
    /// On the triangle; the same point where the segment crosses it \[m\].
    pub on_triangle: Point3<f64>,
    /// Parameter along the segment, 0 at its first end to 1 at its second.
    pub along: f64,
    /// Weights of `on_triangle` on the three corners: each in \[0, 1\], their sum 1.
    pub weights: [f64; 3],
    /// Distance, squared \[m²\]; 0 where it crosses.
    pub distance_squared: f64,
}

/// Squared area, relative to the longest edges, below which a triangle's interior cannot be distinguished from its
/// edges.
const THIN: f64 = 1e-16;
/// Squared slope of a segment against a triangle below which their crossing is not a unique point.
const NEARLY_IN_PLANE: f64 = 1e-20;

/// Nearest points of `segment` and `triangle`.
#[must_use]
pub fn closest_segment_triangle(segment: &Segment, triangle: &Triangle) -> SegmentTriangle {
    let [a, b, c] = triangle;
    let (ab, ac) = (b - a, c - a);
    let normal = ab.cross(&ac);
    let area_squared = normal.norm_squared();
    let (ab_squared, ac_squared) = (ab.norm_squared(), ac.norm_squared());
    let mut best = None;
    if area_squared > THIN * ab_squared.max(ac_squared).max((c - b).norm_squared()).powi(2) {
        let direction = segment[1] - segment[0];
        let heights = segment.map(|end| normal.dot(&(end - a)));
        let slope = heights[0] - heights[1];
        let in_plane = NEARLY_IN_PLANE * direction.norm_squared() * ab_squared * ac_squared;
        if heights[0] * heights[1] <= 0.0 && slope * slope > in_plane {
            let along = heights[0] / slope;
            let point = segment[0] + direction * along;
            if let Some(weights) = inside(&point, a, &ab, &ac, &normal, area_squared) {
                return SegmentTriangle {
                    on_segment: point,
                    on_triangle: point,
                    along,
                    weights,
                    distance_squared: 0.0,
                };
            }
        }
        // An end straight above the interior is nearest, or the interior is irrelevant.
        let ends = if heights[0].abs() <= heights[1].abs() { [0, 1] } else { [1, 0] };
        for end in ends {
            let off_plane = normal * (heights[end] / area_squared);
            let foot = segment[end] - off_plane;
            let Some(weights) = inside(&foot, a, &ab, &ac, &normal, area_squared) else { continue };
            let found = SegmentTriangle {
                on_segment: segment[end],
                on_triangle: foot,
                along: end as f64,
                weights,
                distance_squared: off_plane.norm_squared(),
            };
            if heights[0] * heights[1] > 0.0 && end == ends[0] {
                // No other point of the segment is nearer to the plane.
                return found;
            }
            best = Some(found);
            break;
        }
    }
    nearest_edge(segment, triangle, best)
}

/// The weights of a point of the plane that lies within the triangle.
#[inline]
fn inside(
    point: &Point3<f64>,
    a: &Point3<f64>,
    ab: &Vector3<f64>,
    ac: &Vector3<f64>,
    normal: &Vector3<f64>,
    area_squared: f64,
) -> Option<[f64; 3]> {
    let from_a = point - a;
    let v = normal.dot(&from_a.cross(ac)) / area_squared;
    let w = normal.dot(&ab.cross(&from_a)) / area_squared;
    let u = 1.0 - v - w;
    (u >= 0.0 && v >= 0.0 && w >= 0.0).then_some([u, v, w])
}

/// Squared sine of the angle between two segments below which the solution of the 2 × 2 system is dominated by
/// rounding.
const NEARLY_PARALLEL: f64 = 1e-10;
/// Edges in SIMD lanes, the last one twice, to fill whole registers.
const LANES: usize = 4;

#[inline]
fn within_unit(share: f64) -> f64 {
    let share = if share > 0.0 { share } else { 0.0 };
    if share < 1.0 { share } else { 1.0 }
}

/// The nearest points of the segment and the three edges, all edges at once: as in [`closest_segments`], which is
/// called itself for nearly parallel edges.
fn nearest_edge(segment: &Segment, triangle: &Triangle, other: Option<SegmentTriangle>) -> SegmentTriangle {
    const FROM: [usize; LANES] = [0, 1, 2, 2];
    const TO: [usize; LANES] = [1, 2, 0, 0];
    let direction = segment[1] - segment[0];
    let along_squared = direction.norm_squared();
    let (mut edge, mut between) = ([[0.0_f64; LANES]; 3], [[0.0_f64; LANES]; 3]);
    let (mut e, mut b, mut c, mut f) =
        ([0.0_f64; LANES], [0.0_f64; LANES], [0.0_f64; LANES], [0.0_f64; LANES]);
    for axis in 0..3 {
        for lane in 0..LANES {
            let from = triangle[FROM[lane]][axis];
            edge[axis][lane] = triangle[TO[lane]][axis] - from;
            between[axis][lane] = segment[0][axis] - from;
            e[lane] += edge[axis][lane] * edge[axis][lane];
            b[lane] += edge[axis][lane] * direction[axis];
            c[lane] += between[axis][lane] * direction[axis];
            f[lane] += between[axis][lane] * edge[axis][lane];
        }
    }
    let (mut s, mut t, mut apart) = ([0.0_f64; LANES], [0.0_f64; LANES], [0.0_f64; LANES]);
    let mut is_parallel = false;
    let inverse = 1.0 / along_squared;
    for lane in 0..LANES {
        let determinant = along_squared * e[lane] - b[lane] * b[lane];
        is_parallel |= determinant.is_nan() || determinant <= NEARLY_PARALLEL * along_squared * e[lane];
        let first = within_unit((b[lane] * f[lane] - c[lane] * e[lane]) / determinant);
        // The second is clamped to its end, or not at all: the first follows either way.
        t[lane] = within_unit((b[lane] * first + f[lane]) / e[lane]);
        s[lane] = within_unit((b[lane] * t[lane] - c[lane]) * inverse);
    }
    for axis in 0..3 {
        for lane in 0..LANES {
            let gap = between[axis][lane] + direction[axis] * s[lane] - edge[axis][lane] * t[lane];
            apart[lane] += gap * gap;
        }
    }
    if is_parallel {
        for lane in 0..3 {
            let nearest = closest_segments(segment, &[triangle[FROM[lane]], triangle[TO[lane]]]);
            (s[lane], t[lane], apart[lane]) = (nearest.along[0], nearest.along[1], nearest.distance_squared);
        }
    }
    let mut lane = usize::from(apart[1] < apart[0]);
    if apart[2] < apart[lane] {
        lane = 2;
    }
    let on_segment = segment[0] + direction * s[lane];
    let on_triangle = triangle[FROM[lane]] + (triangle[TO[lane]] - triangle[FROM[lane]]) * t[lane];
    let distance_squared = (on_triangle - on_segment).norm_squared();
    if let Some(other) = other
        && other.distance_squared <= distance_squared
    {
        return other;
    }
    let mut weights = [0.0; 3];
    weights[FROM[lane]] = 1.0 - t[lane];
    weights[TO[lane]] = t[lane];
    SegmentTriangle { on_segment, on_triangle, along: s[lane], weights, distance_squared }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::primitive::arbitrary::point;
    use proptest::prelude::*;

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(20_000))]
        /// Either the points coincide, or moving one towards any corner does not bring them nearer.
        #[test]
        fn neither_can_come_nearer(segment in [point(), point()], triangle in [point(), point(), point()]) {
            let found = closest_segment_triangle(&segment, &triangle);
            let [a, b, c] = triangle;
            let [u, v, w] = found.weights;
            let rebuilt = Point3::from(a.coords * u + b.coords * v + c.coords * w);
            prop_assert!((rebuilt - found.on_triangle).norm() < 1e-6, "{found:?}");
            let towards = found.on_triangle - found.on_segment;
            let slack = 1e-6 * towards.norm() + 1e-12;
            for end in &segment {
                prop_assert!(towards.dot(&(end - found.on_segment)) <= slack, "{found:?}");
            }
            for corner in &triangle {
                prop_assert!(-towards.dot(&(corner - found.on_triangle)) <= slack, "{found:?}");
            }
        }
    }

    #[test]
    fn through_beside_and_within_the_plane() {
        let triangle = [Point3::origin(), Point3::new(1.0, 0.0, 0.0), Point3::new(0.0, 1.0, 0.0)];
        let through = [Point3::new(0.25, 0.25, 1.0), Point3::new(0.25, 0.25, -3.0)];
        let found = closest_segment_triangle(&through, &triangle);
        assert_eq!((found.along, found.distance_squared), (0.25, 0.0));
        let above = [Point3::new(0.25, 0.25, 1.0), Point3::new(0.25, 0.25, 0.5)];
        assert_eq!(closest_segment_triangle(&above, &triangle).distance_squared, 0.25);
        let within = [Point3::new(-1.0, 0.25, 0.0), Point3::new(2.0, 0.25, 0.0)];
        assert_eq!(closest_segment_triangle(&within, &triangle).distance_squared, 0.0);
    }
}

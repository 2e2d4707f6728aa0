//! Nearest points of two triangles, as in PQP (Larsen, Gottschalk, Lin, Manocha, *Fast Proximity Queries with Swept
//! Sphere Volumes*, 1999).
//!
//! Two disjoint triangles are nearest at a pair of edges or at a corner and a face. The nearest points of two edges are
//! those of the triangles as soon as each triangle's third corner lies on the far side of the plane through its point
//! across the gap, so that most pairs end after a few of the nine edge pairs.

use nalgebra::{Point3, Vector3};

use super::{Triangle, closest_segments, common_segment, triangles_overlap};

/// The nearest points of two triangles.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TriangleTriangle {
    /// On each of them \[m\]; the same point twice where they overlap. For nearly degenerate overlapping triangles it
    /// may be off by 1e-7 of their size, otherwise by rounding.
    pub points: [Point3<f64>; 2],
    /// Distance, squared \[m²\]; 0 where they overlap.
    pub distance_squared: f64,
}

/// Relative gap below which rounding may dominate: the exact test decides.
const GAP_NOISE: f64 = 1e-6;

/// Squared gap, of the squared size of the triangles, below which its direction is too inaccurate to decide a corner's
/// side.
const CLEAR: f64 = 1e-12;

/// Nearest points of `first` and `second`.
#[must_use]
pub fn closest_triangles(first: &Triangle, second: &Triangle) -> TriangleTriangle {
    let mut best = TriangleTriangle {
        points: [first[0], second[0]],
        distance_squared: (second[0] - first[0]).norm_squared(),
    };
    let reach =
        (first[1] - first[0]).amax().max((second[1] - second[0]).amax()).max((second[0] - first[0]).amax());
    let clear = CLEAR * reach * reach;
    let mut apart = false;
    for i in 0..3 {
        let edge = [first[i], first[(i + 1) % 3]];
        let third = &first[(i + 2) % 3];
        for j in 0..3 {
            let other_edge = [second[j], second[(j + 1) % 3]];
            let found = closest_segments(&edge, &other_edge);
            if found.distance_squared > best.distance_squared {
                continue;
            }
            best = TriangleTriangle { points: found.points, distance_squared: found.distance_squared };
            let across = found.points[1] - found.points[0];
            let inwards = across.dot(&(third - found.points[0])).max(0.0);
            let other_inwards = across.dot(&(second[(j + 2) % 3] - found.points[1])).min(0.0);
            if inwards <= 0.0 && other_inwards >= 0.0 && found.distance_squared > clear {
                return best;
            }
            // The third corners reduce the gap by less than its width: the triangles are disjoint.
            let gap = found.distance_squared + other_inwards - inwards;
            apart |= found.distance_squared > clear
                && gap > GAP_NOISE * (found.distance_squared - other_inwards + inwards);
        }
    }
    let (faced, faces_apart) = corner_on_face(first, second);
    apart |= faces_apart;
    if let Some([corner, foot]) = faced {
        offer(&mut best, corner, foot);
    }
    let (faced, faces_apart) = corner_on_face(second, first);
    apart |= faces_apart;
    if let Some([corner, foot]) = faced {
        offer(&mut best, foot, corner);
    }
    if apart { best } else { overlapping(first, second).unwrap_or(best) }
}

fn offer(best: &mut TriangleTriangle, on_first: Point3<f64>, on_second: Point3<f64>) {
    let distance_squared = (on_second - on_first).norm_squared();
    if distance_squared < best.distance_squared {
        *best = TriangleTriangle { points: [on_first, on_second], distance_squared };
    }
}

fn overlapping(first: &Triangle, second: &Triangle) -> Option<TriangleTriangle> {
    triangles_overlap(first, second).then(|| {
        let [from, to] = common_segment(first, second);
        TriangleTriangle { points: [nalgebra::center(&from, &to); 2], distance_squared: 0.0 }
    })
}

/// The corner of `asked` that is nearest to the plane of `face` and its foot, when it lies above the inside of the
/// face, and whether all of `asked` lies on one side of the plane, by more than rounding.
fn corner_on_face(asked: &Triangle, face: &Triangle) -> (Option<[Point3<f64>; 2]>, bool) {
    let [a, b, c] = face;
    let (ab, ac) = (b - a, c - a);
    let normal: Vector3<f64> = ab.cross(&ac);
    let area_squared = normal.norm_squared();
    let longest = ab.norm_squared().max(ac.norm_squared()).max((c - b).norm_squared());
    // For a triangle this thin the edges suffice, and the normal is dominated by rounding.
    if area_squared <= 1e-16 * longest * longest {
        return (None, false);
    }
    let heights = asked.each_ref().map(|corner| normal.dot(&(corner - a)));
    let above = heights.iter().all(|&height| height > 0.0);
    if !above && !heights.iter().all(|&height| height < 0.0) {
        return (None, false);
    }
    let nearest = (0..3).fold(0, |best, i| if heights[i].abs() < heights[best].abs() { i } else { best });
    let corner = asked[nearest];
    let noise = 1e-14 * longest * (corner - a).norm();
    let apart = heights[nearest].abs() > noise;
    let inside = [(a, ab), (b, c - b), (c, a - c)]
        .iter()
        .all(|(from, edge)| normal.dot(&edge.cross(&(corner - **from))) >= 0.0);
    let foot = corner - normal * (heights[nearest] / area_squared);
    (inside.then_some([corner, foot]), apart)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::primitive::arbitrary::point_with;
    use crate::primitive::{closest_on_segment, closest_on_triangle, closest_segment_triangle};
    use proptest::prelude::*;

    fn triangle() -> impl Strategy<Value = Triangle> {
        let point = || point_with(1e-4);
        let thin = (point(), point(), 0.0..1.0_f64, prop_oneof![Just(0.0), -1e-4..1e-4_f64])
            .prop_map(|(a, b, share, aside)| [a, b, a + (b - a) * share + Vector3::new(0.0, aside, 0.0)]);
        prop_oneof![4 => [point(), point(), point()], 1 => thin]
    }

    /// All edges of each against the other.
    fn oracle(first: &Triangle, second: &Triangle) -> f64 {
        let edges = |t: &Triangle| [[t[0], t[1]], [t[1], t[2]], [t[2], t[0]]];
        let of = |edges: [[Point3<f64>; 2]; 3], face: &Triangle| {
            edges
                .iter()
                .map(|edge| closest_segment_triangle(edge, face).distance_squared)
                .fold(f64::INFINITY, f64::min)
        };
        of(edges(first), second).min(of(edges(second), first)).sqrt()
    }

    /// Distance of a point from a triangle; for a thin one the edges are more accurate than the face.
    fn beside(point: &Point3<f64>, triangle: &Triangle) -> f64 {
        let on_face = closest_on_triangle(point, triangle).point;
        (0..3).fold((on_face - point).norm(), |least, i| {
            let edge = [triangle[i], triangle[(i + 1) % 3]];
            let on_edge = edge[0] + (edge[1] - edge[0]) * closest_on_segment(point, &edge);
            least.min((on_edge - point).norm())
        })
    }

    fn resize(triangle: &Triangle, scale: f64, shift: &Vector3<f64>) -> Triangle {
        triangle.map(|corner| corner * scale + shift)
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(40_000))]
        #[test]
        fn the_distance_is_that_of_all_edges_and_faces(
            first in triangle(), second in triangle(),
            shift in prop_oneof![Just([0.0; 3]), [-2.0..2.0_f64, -2.0..2.0, -2.0..2.0]],
            scale in prop_oneof![Just(1.0), Just(1e-4)],
        ) {
            let (a, b) = (resize(&first, scale, &Vector3::zeros()), resize(&second, scale, &(Vector3::from(shift) * scale)));
            let found = closest_triangles(&a, &b);
            let wanted = oracle(&a, &b);
            let distance = found.distance_squared.sqrt();
            prop_assert!((distance - wanted).abs() <= 1e-9 * scale, "{distance} for {wanted}: {a:?} {b:?}");
            prop_assert!(((found.points[1] - found.points[0]).norm() - distance).abs() <= 1e-12 * scale);
            for (point, triangle) in found.points.iter().zip([&a, &b]) {
                prop_assert!(beside(point, triangle) <= 1e-7 * scale, "{point} is not on {triangle:?}");
            }
            prop_assert!((closest_triangles(&b, &a).distance_squared.sqrt() - wanted).abs() <= 1e-9 * scale);
        }
    }

    #[test]
    fn faces_edges_and_corners() {
        let flat = [Point3::new(0.0, 0.0, 0.0), Point3::new(4.0, 0.0, 0.0), Point3::new(0.0, 4.0, 0.0)];
        let above = [Point3::new(1.0, 1.0, 0.5), Point3::new(1.0, 1.0, 2.0), Point3::new(2.0, 1.0, 2.0)];
        let found = closest_triangles(&flat, &above);
        assert_eq!((found.distance_squared, found.points), (0.25, [Point3::new(1.0, 1.0, 0.0), above[0]]));
        let parallel = resize(&flat, 1.0, &Vector3::new(0.25, 0.25, 3.0));
        assert_eq!(closest_triangles(&flat, &parallel).distance_squared, 9.0);
        let through = [Point3::new(1.0, 1.0, -1.0), Point3::new(1.0, 1.0, 1.0), Point3::new(1.5, 1.0, 1.0)];
        assert_eq!(closest_triangles(&flat, &through).distance_squared, 0.0);
        let dot = [Point3::new(-3.0, 0.0, 4.0); 3];
        assert_eq!(closest_triangles(&flat, &dot).distance_squared, 25.0);
    }
}

//! Nearest point of a triangle to a point (Ericson, *Real-Time Collision Detection*, 2004, §5.1.5).

use nalgebra::Point3;

use super::{Triangle, closest_on_segment};

/// The nearest point of a triangle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PointTriangle {
    /// The point, in the frame of the input \[m\].
    pub point: Point3<f64>,
    /// Its weights on the three corners: each in \[0, 1\], their sum 1. A weight of exactly 0 means that it is on the
    /// opposite edge.
    pub weights: [f64; 3],
}

/// Squared height over length below which a triangle's interior cannot be distinguished from its edges: at the square
/// root of the rounding unit, weights and edges have equal errors.
const THIN: f64 = 1e-16;

/// The point of `triangle` nearest to `point`.
#[must_use]
pub fn closest_on_triangle(point: &Point3<f64>, triangle: &Triangle) -> PointTriangle {
    let [a, b, c] = triangle;
    let (ab, ac) = (b - a, c - a);
    let from_a = point - a;
    let (d1, d2) = (ab.dot(&from_a), ac.dot(&from_a));
    if d1 <= 0.0 && d2 <= 0.0 {
        return corner(triangle, 0);
    }
    let from_b = point - b;
    let (d3, d4) = (ab.dot(&from_b), ac.dot(&from_b));
    if d3 >= 0.0 && d4 <= d3 {
        return corner(triangle, 1);
    }
    let from_c = point - c;
    let (d5, d6) = (ab.dot(&from_c), ac.dot(&from_c));
    if d6 >= 0.0 && d5 <= d6 {
        return corner(triangle, 2);
    }
    let normal = ab.cross(&ac);
    let area_squared = normal.norm_squared();
    let longest = ab.norm_squared().max(ac.norm_squared()).max((c - b).norm_squared());
    if area_squared <= THIN * longest * longest {
        return nearest_edge(point, triangle);
    }
    // Projected to the plane first: otherwise the height's rounding error would be as large as a thin triangle's
    // height.
    let in_plane = from_a - normal * (normal.dot(&from_a) / area_squared);
    let v = normal.dot(&in_plane.cross(&ac)) / area_squared;
    let w = normal.dot(&ab.cross(&in_plane)) / area_squared;
    let u = 1.0 - v - w;
    if u > 0.0 && v > 0.0 && w > 0.0 {
        PointTriangle { point: a + ab * v + ac * w, weights: [u, v, w] }
    } else {
        nearest_edge(point, triangle)
    }
}

fn corner(triangle: &Triangle, which: usize) -> PointTriangle {
    let mut weights = [0.0; 3];
    weights[which] = 1.0;
    PointTriangle { point: triangle[which], weights }
}

fn nearest_edge(point: &Point3<f64>, triangle: &Triangle) -> PointTriangle {
    let mut best = corner(triangle, 0);
    let mut distance = f64::INFINITY;
    for first in 0..3 {
        let second = (first + 1) % 3;
        let edge = [triangle[first], triangle[second]];
        let along = closest_on_segment(point, &edge);
        let on_edge = edge[0] + (edge[1] - edge[0]) * along;
        let apart = (on_edge - point).norm_squared();
        if apart < distance {
            distance = apart;
            best.point = on_edge;
            best.weights = [0.0; 3];
            best.weights[first] = 1.0 - along;
            best.weights[second] = along;
        }
    }
    best
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::primitive::arbitrary::point_with;
    use nalgebra::Vector3;
    use proptest::prelude::*;

    fn point() -> impl Strategy<Value = Point3<f64>> {
        point_with(1e-9)
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(20_000))]
        /// The nearest point of a convex set is the one from which no point of the set lies towards the query point.
        #[test]
        fn nothing_of_it_is_nearer(asker in point(), triangle in [point(), point(), point()]) {
            let found = closest_on_triangle(&asker, &triangle);
            let [a, b, c] = triangle;
            let [u, v, w] = found.weights;
            prop_assert!(u >= 0.0 && v >= 0.0 && w >= 0.0 && (u + v + w - 1.0).abs() < 1e-12);
            let rebuilt = Point3::from(a.coords * u + b.coords * v + c.coords * w);
            prop_assert!((rebuilt - found.point).norm() < 1e-12);
            let towards: Vector3<f64> = asker - found.point;
            for corner in &triangle {
                // Two points whose squared distances differ by less than rounding are a tie: at most 1e-8 apart.
                prop_assert!(towards.dot(&(corner - found.point)) < 1e-8, "{found:?}");
            }
        }
    }

    #[test]
    fn a_triangle_without_area_is_its_edges() {
        let flat = [Point3::origin(), Point3::new(1.0, 0.0, 0.0), Point3::new(0.25, 0.0, 0.0)];
        let found = closest_on_triangle(&Point3::new(0.5, 1.0, 0.0), &flat);
        assert!((found.point - Point3::new(0.5, 0.0, 0.0)).norm() < 1e-15);
        let dot = [Point3::new(1.0, 2.0, 3.0); 3];
        assert_eq!(closest_on_triangle(&Point3::origin(), &dot).point, dot[0]);
    }
}

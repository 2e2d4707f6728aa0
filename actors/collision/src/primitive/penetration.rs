//! Penetration depth of two flat primitives: the minimum translation that separates them, by separating axes
//! (Gottschalk 1996; for the depth: Ericson, *Real-Time Collision Detection*, 2004, §5.2.1). The facets of their
//! Minkowski difference are normal to one of them or to an edge of each, so that no other axis needs a test.

use nalgebra::{Point3, Unit, Vector3};

use super::{Segment, Triangle, closest_segment_triangle};

/// The minimum translation that separates two primitives.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Penetration {
    /// Its length \[m\]; 0 for touching or coplanar primitives.
    pub depth: f64,
    /// Unit direction in which to move the second one.
    pub direction: Vector3<f64>,
}

/// Squared sine below which the common normal of two directions is dominated by rounding.
const PARALLEL: f64 = 1e-20;
/// Share of their size within which triangles without area touch.
const TOUCHING: f64 = 1e-12;

/// `None` if a plane separates the triangles. Touching ones have a depth of 0. Triangles without area that lie within
/// rounding of each other may count as touching.
#[must_use]
pub fn triangle_penetration(first: &Triangle, second: &Triangle) -> Option<Penetration> {
    let (edges, others) = (edges(first), edges(second));
    let (normal, other) = (edges[0].cross(&edges[1]), others[0].cross(&others[1]));
    let mut axes = Axes::new(first, second);
    let has_area = |normal: &Vector3<f64>, [a, b, _]: &[Vector3<f64>; 3]| {
        normal.norm_squared() > PARALLEL * a.norm_squared() * b.norm_squared()
    };
    if !has_area(&normal, &edges) || !has_area(&other, &others) {
        // Degenerate triangles have too few axes: nearest points decide whether they touch.
        let size = edges.iter().chain(&others).map(Vector3::amax).fold(0.0, f64::max);
        if !touch(first, second, TOUCHING * size) {
            return None;
        }
        axes.least = Some(Penetration { depth: f64::INFINITY, direction: Vector3::z() });
    }
    axes.ask(&normal, edges[0].norm_squared() * edges[1].norm_squared())?;
    axes.ask(&other, others[0].norm_squared() * others[1].norm_squared())?;
    for edge in &edges {
        for other in &others {
            axes.ask(&edge.cross(other), edge.norm_squared() * other.norm_squared())?;
        }
    }
    // Coplanar or without area: test axes within the plane as well.
    for (normal, edges) in [(normal, &edges), (other, &others), (normal, &others), (other, &edges)] {
        for edge in edges {
            axes.ask(&normal.cross(edge), normal.norm_squared() * edge.norm_squared())?;
        }
    }
    // Without any axis they are collinear, and a sideways step separates them.
    axes.least.map(|least| if least.depth.is_finite() { least } else { Penetration { depth: 0.0, ..least } })
}

fn touch(first: &Triangle, second: &Triangle, within: f64) -> bool {
    let one_way = |of: &Triangle, other: &Triangle| {
        (0..3).any(|corner| {
            let edge = [of[corner], of[(corner + 1) % 3]];
            closest_segment_triangle(&edge, other).distance_squared <= within * within
        })
    };
    one_way(first, second) || one_way(second, first)
}

/// `None` if a plane separates the segment (first) from the triangle (second).
#[must_use]
pub fn segment_triangle_penetration(segment: &Segment, triangle: &Triangle) -> Option<Penetration> {
    let along = segment[1] - segment[0];
    let edges = edges(triangle);
    let normal = edges[0].cross(&edges[1]);
    let mut axes = Axes::new(segment, triangle);
    axes.ask(&normal, edges[0].norm_squared() * edges[1].norm_squared())?;
    for edge in &edges {
        axes.ask(&along.cross(edge), along.norm_squared() * edge.norm_squared())?;
    }
    for edge in &edges {
        axes.ask(&normal.cross(edge), normal.norm_squared() * edge.norm_squared())?;
    }
    axes.ask(&normal.cross(&along), normal.norm_squared() * along.norm_squared())?;
    axes.least
}

fn edges([a, b, c]: &Triangle) -> [Vector3<f64>; 3] {
    [b - a, c - b, a - c]
}

struct Axes<'a> {
    first: &'a [Point3<f64>],
    second: &'a [Point3<f64>],
    least: Option<Penetration>,
}

impl<'a> Axes<'a> {
    fn new(first: &'a [Point3<f64>], second: &'a [Point3<f64>]) -> Self {
        Self { first, second, least: None }
    }

    /// `None` if the axis separates them. An axis much shorter than its product's factors is dominated by rounding.
    fn ask(&mut self, axis: &Vector3<f64>, product: f64) -> Option<()> {
        if axis.norm_squared() <= PARALLEL * product {
            return Some(());
        }
        let axis = Unit::new_normalize(*axis).into_inner();
        let origin = self.first[0];
        let extent = |points: &[Point3<f64>]| {
            points.iter().fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], point| {
                let along = axis.dot(&(point - origin));
                [low.min(along), high.max(along)]
            })
        };
        let ([low, high], [other_low, other_high]) = (extent(self.first), extent(self.second));
        let (forwards, backwards) = (high - other_low, other_high - low);
        if forwards < 0.0 || backwards < 0.0 {
            return None;
        }
        let (depth, direction) = if forwards <= backwards { (forwards, axis) } else { (backwards, -axis) };
        if self.least.is_none_or(|least| depth < least.depth) {
            self.least = Some(Penetration { depth, direction });
        }
        Some(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn point() -> impl Strategy<Value = Point3<f64>> {
        (-1.0..1.0_f64, -1.0..1.0_f64, -1.0..1.0_f64).prop_map(|(x, y, z)| Point3::new(x, y, z))
    }

    fn apart(first: &Triangle, second: &Triangle) -> f64 {
        let one_way = |a: &Triangle, b: &Triangle| {
            (0..3)
                .map(|i| closest_segment_triangle(&[a[i], a[(i + 1) % 3]], b).distance_squared)
                .fold(9.0, f64::min)
        };
        one_way(first, second).min(one_way(second, first)).sqrt()
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(5_000))]
        /// Moved by the depth they touch; moved by less in any direction, they still intersect.
        #[test]
        fn it_is_the_least_translation_that_parts_them(
            first in [point(), point(), point()], second in [point(), point(), point()], other in point(),
        ) {
            let Some(overlap) = triangle_penetration(&first, &second) else {
                prop_assert!(apart(&first, &second) > 0.0);
                return Ok(());
            };
            prop_assert!(apart(&first, &second) < 1e-9);
            let moved = |by: Vector3<f64>| second.map(|corner| corner + by);
            let parted = moved(overlap.direction * (overlap.depth + 1e-9));
            prop_assert!(triangle_penetration(&first, &parted).is_none());
            let less = other.coords.normalize() * (overlap.depth * 0.999);
            prop_assert!(triangle_penetration(&first, &moved(less)).is_some());
            let less = overlap.direction * (overlap.depth * 0.999);
            prop_assert!(apart(&first, &moved(less)) < 1e-9);
        }

        #[test]
        fn a_segment_too(first in [point(), point()], second in [point(), point(), point()], other in point()) {
            let crosses = closest_segment_triangle(&first, &second).distance_squared == 0.0;
            let found = segment_triangle_penetration(&first, &second);
            prop_assert_eq!(found.is_some(), crosses);
            if let Some(overlap) = found {
                let moved = |by: Vector3<f64>| second.map(|corner| corner + by);
                let parted = moved(overlap.direction * (overlap.depth + 1e-9));
                prop_assert!(closest_segment_triangle(&first, &parted).distance_squared > 0.0);
                let less = moved(other.coords.normalize() * (overlap.depth * 0.999));
                prop_assert!(closest_segment_triangle(&first, &less).distance_squared == 0.0);
            }
        }
    }

    #[test]
    fn analytic_depths_and_flat_ones() {
        let floor = [Point3::new(-9.0, -9.0, 0.0), Point3::new(9.0, -9.0, 0.0), Point3::new(0.0, 9.0, 0.0)];
        let tooth = [Point3::new(0.0, 0.0, -0.25), Point3::new(1.0, 0.0, 2.0), Point3::new(-1.0, 0.0, 2.0)];
        let overlap = triangle_penetration(&floor, &tooth).expect("crosses");
        assert!((overlap.depth - 0.25).abs() < 1e-12 && (overlap.direction - Vector3::z()).norm() < 1e-12);
        let pin = [Point3::new(0.1, 0.0, 3.0), Point3::new(0.0, 0.0, -0.5)];
        let overlap = segment_triangle_penetration(&pin, &floor).expect("crosses");
        assert!((overlap.depth - 0.5).abs() < 1e-12 && (overlap.direction + Vector3::z()).norm() < 1e-12);
        // In one plane: within, touching, beside.
        let shifted = |x: f64| floor.map(|corner| corner + Vector3::x() * x);
        assert_eq!(triangle_penetration(&floor, &shifted(1.0)).map(|overlap| overlap.depth), Some(0.0));
        assert!(triangle_penetration(&floor, &shifted(18.1)).is_none());
        let above = floor.map(|corner| corner + Vector3::z() * 1e-9);
        assert!(triangle_penetration(&floor, &above).is_none());
        // Without area: apart, in the plane, on a line, in one point.
        let needle = |x: f64, z: f64| {
            [Point3::new(x, 0.0, z), Point3::new(x + 1.0, 0.0, z), Point3::new(x + 0.5, 0.0, z)]
        };
        let dot = |x: f64, z: f64| [Point3::new(x, 0.0, z); 3];
        let depth = |first: &Triangle, second: &Triangle| {
            triangle_penetration(first, second).map(|overlap| overlap.depth)
        };
        for (other, expected) in [
            (dot(0.0, 1.0), None),
            (dot(0.0, 0.0), Some(0.0)),
            (needle(0.0, 1.0), None),
            (needle(0.0, 0.0), Some(0.0)),
            (needle(99.0, 0.0), None),
        ] {
            assert_eq!((depth(&floor, &other), depth(&other, &floor)), (expected, expected), "{other:?}");
        }
        assert_eq!(depth(&needle(0.0, 0.0), &needle(0.5, 0.0)), Some(0.0));
        assert_eq!(depth(&needle(0.0, 0.0), &needle(1.5, 0.0)), None);
        assert_eq!(depth(&dot(0.0, 0.0), &dot(0.0, 0.0)), Some(0.0));
        assert_eq!(depth(&dot(0.0, 0.0), &needle(-0.5, 0.0)), Some(0.0));
    }
}

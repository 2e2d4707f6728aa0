//! Triangles of a polygonal face in space: the polygon is laid flat on the plane of its Newell normal (I. Sutherland et al.,
//! "A characterization of ten hidden-surface algorithms", 1974), so that concave faces keep their notches.

use nalgebra::{Point2, Point3, Vector3};

use crate::polygon::triangulate;

/// Largest number of corners of one polygon.
pub(super) const CORNERS_MAX: usize = 4096;
/// Area over the square of the extent below which three points count as lying on a line.
const FLAT: f64 = 1e-12;

/// Triangles of a polygon, as positions in the list of its corners, in the sense of the polygon.
///
/// A convex polygon becomes the fan about its first corner. A polygon without area becomes a fan of triangles without
/// area, which validation reports. Corners that follow each other at one vertex must have been joined by the caller.
///
/// # Errors
/// When the polygon crosses itself.
pub(super) fn triangles_of(corners: &[Point3<f64>]) -> Result<Vec<[u32; 3]>, &'static str> {
    let count = corners.len();
    let fan = || (2..count as u32).map(|k| [0, k - 1, k]).collect();
    if count <= 3 {
        return Ok(fan());
    }
    let normal = newell(corners);
    let extent = corners.iter().map(|p| (p - corners[0]).norm_squared()).fold(0.0, f64::max);
    if normal.norm() <= FLAT * extent || !normal.norm().is_finite() {
        let lies_on_a_line = corners.windows(2).all(|pair| {
            let farthest = corners
                .iter()
                .max_by(|a, b| (*a - corners[0]).norm_squared().total_cmp(&(*b - corners[0]).norm_squared()));
            let axis = farthest.map_or_else(Vector3::zeros, |far| far - corners[0]);
            (pair[1] - corners[0]).cross(&axis).norm() <= FLAT.sqrt() * extent
        });
        return if lies_on_a_line { Ok(fan()) } else { Err(CROSSES) };
    }
    let flat = flattened(corners, &normal.normalize());
    if is_convex(&flat, extent) {
        return Ok(fan());
    }
    if crosses_itself(&flat, extent) {
        return Err(CROSSES);
    }
    triangulate(&flat, &[]).ok_or(CROSSES)
}

const CROSSES: &str = "the polygon crosses itself, seen along its normal";

/// Twice the area of a polygon in space times its unit normal.
fn newell(corners: &[Point3<f64>]) -> Vector3<f64> {
    let origin = corners[0];
    corners.windows(2).map(|pair| (pair[0] - origin).cross(&(pair[1] - origin))).sum()
}

/// Coordinates in the plane, in which the polygon is counter-clockwise.
fn flattened(corners: &[Point3<f64>], normal: &Vector3<f64>) -> Vec<Point2<f64>> {
    let least = normal.iamin();
    let across = normal.cross(&Vector3::ith(least, 1.0)).normalize();
    let up = normal.cross(&across);
    let origin = corners[0];
    corners.iter().map(|p| Point2::new((p - origin).dot(&across), (p - origin).dot(&up))).collect()
}

fn cross(a: Point2<f64>, b: Point2<f64>, c: Point2<f64>) -> f64 {
    (b - a).perp(&(c - a))
}

/// Whether every corner turns to the left, once around in all.
fn is_convex(flat: &[Point2<f64>], extent: f64) -> bool {
    let at = |k: usize| flat[k % flat.len()];
    let turns = (0..flat.len()).all(|k| cross(at(k), at(k + 1), at(k + 2)) > FLAT * extent);
    let rises = |k: usize| at(k + 1).y > at(k).y;
    turns && (0..flat.len()).filter(|&k| !rises(k) && rises(k + 1)).count() == 1
}

/// Whether two edges cross between their ends. Edges that touch or run along each other do not: a hole may be joined to
/// its polygon by a pair of them.
fn crosses_itself(flat: &[Point2<f64>], extent: f64) -> bool {
    let count = flat.len();
    let edge = |k: usize| [flat[k], flat[(k + 1) % count]];
    let mut by_left_end: Vec<usize> = (0..count).collect();
    let left = |k: usize| edge(k)[0].x.min(edge(k)[1].x);
    let right = |k: usize| edge(k)[0].x.max(edge(k)[1].x);
    by_left_end.sort_by(|&a, &b| left(a).total_cmp(&left(b)));
    let apart = |a: f64, b: f64| a.min(b) < -FLAT * extent && a.max(b) > FLAT * extent;
    by_left_end.iter().enumerate().any(|(n, &one)| {
        let [a, b] = edge(one);
        let near = by_left_end[n + 1..].iter().take_while(|&&other| left(other) <= right(one));
        near.into_iter().any(|&other| {
            let [c, d] = edge(other);
            apart(cross(a, b, c), cross(a, b, d)) && apart(cross(c, d, a), cross(c, d, b))
        })
    })
}

#[cfg(test)]
mod tests {
    use nalgebra::Rotation3;
    use proptest::prelude::*;

    use super::*;

    fn area_of(corners: &[Point3<f64>], triangles: &[[u32; 3]]) -> Vector3<f64> {
        let at = |v: u32| corners[v as usize];
        triangles.iter().map(|&[a, b, c]| (at(b) - at(a)).cross(&(at(c) - at(a)))).sum()
    }

    fn space(flat: &[[f64; 2]]) -> Vec<Point3<f64>> {
        let turn = Rotation3::from_euler_angles(0.3, -1.1, 2.0);
        flat.iter().map(|p| turn * Point3::new(p[0], p[1], 0.0) + Vector3::new(5.0, -3.0, 2.0)).collect()
    }

    proptest! {
        /// A star with a radius of its own at each angle is concave in most cases, and simple.
        #[test]
        fn a_polygon_is_covered_once_and_every_corner_is_used(
            radii in prop::collection::vec(0.2..1.0f64, 4..40),
            first in 0usize..40,
        ) {
            let count = radii.len();
            let flat: Vec<[f64; 2]> = (0..count).map(|k| {
                let angle = std::f64::consts::TAU * ((k + first) % count) as f64 / count as f64;
                [radii[k] * angle.cos(), radii[k] * angle.sin()]
            }).collect();
            let corners = space(&flat);
            let triangles = triangles_of(&corners).expect("it does not cross itself");
            prop_assert_eq!(triangles.len(), count - 2);
            let whole = newell(&corners);
            prop_assert!((area_of(&corners, &triangles) - whole).norm() < 1e-12);
            for triangle in &triangles {
                prop_assert!(area_of(&corners, &[*triangle]).dot(&whole) > -1e-12, "a triangle is turned over");
            }
            let mut used: Vec<u32> = triangles.iter().flatten().copied().collect();
            used.sort_unstable();
            used.dedup();
            prop_assert_eq!(used.len(), count);
        }
    }

    #[test]
    fn corners_on_a_straight_edge_stay() {
        let corners =
            space(&[[0., 0.], [1., 0.], [2., 0.], [3., 0.], [4., 0.], [4., 4.], [2., 4.], [0., 4.]]);
        let triangles = triangles_of(&corners).expect("a square");
        assert_eq!(triangles.len(), 6);
        for triangle in &triangles {
            assert!(area_of(&corners, &[*triangle]).norm() > 0.1, "{triangle:?} has no area");
        }
    }

    #[test]
    fn a_hole_that_is_joined_by_a_bridge_stays_a_hole() {
        let flat = [
            [0., 0.],
            [4., 0.],
            [4., 4.],
            [0., 4.],
            [0., 0.],
            [1., 1.],
            [1., 3.],
            [3., 3.],
            [3., 1.],
            [1., 1.],
        ];
        let corners = space(&flat);
        let triangles = triangles_of(&corners).expect("a frame");
        assert!((area_of(&corners, &triangles).norm() / 2.0 - 12.0).abs() < 1e-12);
    }

    #[test]
    fn a_polygon_that_crosses_itself_is_refused() {
        let bow_tie = [[0., 0.], [1., 1.], [1., 0.], [0., 1.]];
        let leaning = [[0., 0.], [2., 2.], [2., 0.], [0., 1.]];
        let pentagram = [0, 2, 4, 1, 3].map(|k| {
            let angle = std::f64::consts::TAU * f64::from(k) / 5.0;
            [angle.cos(), angle.sin()]
        });
        for flat in [&bow_tie[..], &leaning, &pentagram] {
            assert_eq!(triangles_of(&space(flat)), Err(CROSSES), "{flat:?}");
        }
    }

    #[test]
    fn a_quad_that_is_not_flat_is_cut_where_it_does_not_fold() {
        // The saddle about the short diagonal, and an arrow head bent out of its plane.
        let saddle = [[0., 0., 0.], [1., 0., 0.3], [1., 1., 0.], [0., 1., 0.3]].map(Point3::from);
        assert_eq!(triangles_of(&saddle), Ok(vec![[0, 1, 2], [0, 2, 3]]));
        let arrow = [[0., 2., 0.1], [-1., 0., 0.], [0., 0.5, 0.2], [1., 0., 0.]].map(Point3::from);
        let triangles = triangles_of(&arrow).expect("an arrow");
        assert!(triangles.iter().all(|t| t.contains(&0) && t.contains(&2)), "{triangles:?}");
    }

    #[test]
    fn a_polygon_on_a_line_becomes_triangles_without_area() {
        let corners = space(&[[0., 0.], [1., 0.], [2., 0.], [3., 0.]]);
        assert_eq!(triangles_of(&corners).expect("a fan").len(), 2);
        assert_eq!(triangles_of(&[Point3::origin(); 5]).expect("a fan").len(), 3);
    }

    #[test]
    fn a_polygon_of_a_thousand_corners_is_covered() {
        const COUNT: usize = 1024;
        let flat: Vec<[f64; 2]> = (0..COUNT)
            .map(|k| {
                let angle = std::f64::consts::TAU * k as f64 / COUNT as f64;
                let radius = if k % 2 == 0 { 1.0 } else { 0.99 };
                [radius * angle.cos(), radius * angle.sin()]
            })
            .collect();
        let corners = space(&flat);
        let triangles = triangles_of(&corners).expect("a cog wheel");
        assert!((area_of(&corners, &triangles) - newell(&corners)).norm() < 1e-9);
    }
}

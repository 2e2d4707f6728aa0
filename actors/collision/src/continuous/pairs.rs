//! First times of contact of primitive pairs.

use nalgebra::Point3;

use super::advancement::{Impact, Nearest, Sweep, advance};
use crate::primitive::{
    Segment, Triangle, closest_on_segment, closest_on_triangle, closest_segment_triangle, closest_segments,
};

/// First contact of a point, or a sphere of radius `separation` \[m\], with a triangle. Degenerate triangles are their
/// longest edge, or a point.
#[must_use]
pub fn vertex_face(vertex: &Sweep<Point3<f64>>, face: &Sweep<Triangle>, separation: f64) -> Option<Impact> {
    advance(&single(vertex), face, separation, |[vertex], face| {
        let found = closest_on_triangle(vertex, face);
        Nearest { points: [*vertex, found.point], weights: ([1.0], found.weights) }
    })
}

/// First contact of two edges, or two capsules whose radii add up to `separation` \[m\]. Edges without length are
/// points.
#[must_use]
pub fn edge_edge(first: &Sweep<Segment>, second: &Sweep<Segment>, separation: f64) -> Option<Impact> {
    advance(first, second, separation, |first, second| {
        let found = closest_segments(first, second);
        Nearest { points: found.points, weights: (ends(found.along[0]), ends(found.along[1])) }
    })
}

/// First time that a point and an edge are within `separation` \[m\]: a sphere and a capsule whose radii add up to it.
#[must_use]
pub fn vertex_edge(vertex: &Sweep<Point3<f64>>, edge: &Sweep<Segment>, separation: f64) -> Option<Impact> {
    advance(&single(vertex), edge, separation, |[vertex], edge| {
        let along = closest_on_segment(vertex, edge);
        Nearest { points: [*vertex, edge[0] + (edge[1] - edge[0]) * along], weights: ([1.0], ends(along)) }
    })
}

/// First time that two points are within `separation` \[m\]: two spheres whose radii add up to it.
#[must_use]
pub fn vertex_vertex(
    first: &Sweep<Point3<f64>>,
    second: &Sweep<Point3<f64>>,
    separation: f64,
) -> Option<Impact> {
    advance(&single(first), &single(second), separation, |[first], [second]| Nearest {
        points: [*first, *second],
        weights: ([1.0], [1.0]),
    })
}

/// First contact of a whole segment, or a capsule of radius `separation` \[m\], with a whole triangle: by an end, by
/// its side on an edge, or by a corner of the triangle. A segment that crosses the triangle at the beginning is
/// reported at time 0.
#[must_use]
pub fn segment_face(segment: &Sweep<Segment>, face: &Sweep<Triangle>, separation: f64) -> Option<Impact> {
    advance(segment, face, separation, |segment, face| {
        let found = closest_segment_triangle(segment, face);
        Nearest { points: [found.on_segment, found.on_triangle], weights: (ends(found.along), found.weights) }
    })
}

fn single(vertex: &Sweep<Point3<f64>>) -> Sweep<[Point3<f64>; 1]> {
    Sweep { from: [vertex.from], to: [vertex.to] }
}

fn ends(along: f64) -> [f64; 2] {
    [1.0 - along, along]
}

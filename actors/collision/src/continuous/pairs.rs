//! First times of contact of the primitives that surfaces and lines are made of.

use nalgebra::Point3;

use super::advancement::{Impact, Nearest, Sweep, advance};
use crate::primitive::{
    Segment, Triangle, closest_on_segment, closest_on_triangle, closest_segment_triangle, closest_segments,
};

/// When a point, or a sphere of radius `separation` \[m\], meets a triangle. Degenerate triangles are their longest
/// edge, or a point.
#[must_use]
pub fn vertex_face(vertex: &Sweep<Point3<f64>>, face: &Sweep<Triangle>, separation: f64) -> Option<Impact> {
    advance(&single(vertex), face, separation, |[vertex], face| {
        let found = closest_on_triangle(vertex, face);
        Nearest { points: [*vertex, found.point], weights: ([1.0], found.weights) }
    })
}

/// When two edges, or two capsules whose radii add up to `separation` \[m\], meet. Edges without length are points.
#[must_use]
pub fn edge_edge(first: &Sweep<Segment>, second: &Sweep<Segment>, separation: f64) -> Option<Impact> {
    advance(first, second, separation, |first, second| {
        let found = closest_segments(first, second);
        Nearest { points: found.points, weights: (ends(found.along[0]), ends(found.along[1])) }
    })
}

/// When a point and an edge come within `separation` \[m\]: a sphere and a capsule whose radii add up to it.
#[must_use]
pub fn vertex_edge(vertex: &Sweep<Point3<f64>>, edge: &Sweep<Segment>, separation: f64) -> Option<Impact> {
    advance(&single(vertex), edge, separation, |[vertex], edge| {
        let along = closest_on_segment(vertex, edge);
        Nearest { points: [*vertex, edge[0] + (edge[1] - edge[0]) * along], weights: ([1.0], ends(along)) }
    })
}

/// When two points come within `separation` \[m\]: two spheres whose radii add up to it.
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

/// When a whole segment, or a capsule of radius `separation` \[m\], meets a whole triangle: by an end, by its side on an
/// edge, or by a corner of the triangle. A segment that crosses the triangle at the beginning is reported at time 0.
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

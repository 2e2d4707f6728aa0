//! Contact of a segment's dynamic point: points, depth and direction, defined case by case.

use nalgebra::{Point3, Vector3};

use crate::moving_surface::MovingSurface;
use crate::primitive::{Segment, SegmentTriangle, closest_segment_triangle};
use crate::pseudonormal::{face, pseudonormal};

/// Most crossings of one segment that are considered.
pub(super) const CROSSINGS: usize = 16;
/// Smallest distance, relative to the surface's largest coordinate, that defines a direction.
const TELLABLE: f64 = 1e-10;

/// Side of the surface on which the shaft's axis is, which defines the depth.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LineContactKind {
    /// The nearest point of the axis is in front of the surface, at a distance d: the depth is radius − d, exactly the
    /// shaft's penetration; negative within the margin.
    Outside,
    /// It is behind the surface, without crossing it within this segment: the depth is radius + d, the distance to
    /// exit.
    Behind,
    /// The axis crosses the triangle: the depth is radius + the axis's largest depth behind the triangle's plane, up to
    /// its next crossing or its end. Of several crossings the shallowest is used. For a half-space this is the
    /// penetration of the segment's capsule.
    Crossing,
}

/// One contact of a segment of the line.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LineContact {
    /// Index of the segment, 0 at the first end of the line.
    pub segment: u32,
    /// Index of the triangle.
    pub triangle: u32,
    /// Kind of contact.
    pub kind: LineContactKind,
    /// The dynamic point: the nearest point of the axis, in the surface's frame \[m\].
    pub on_line: Point3<f64>,
    /// Its parameter along the whole line, 0 at the first end to 1 at the second.
    pub along: f64,
    /// The nearest point of the triangle \[m\].
    pub on_surface: Point3<f64>,
    /// Its barycentric weights: each in \[0, 1\], their sum 1.
    pub weights: [f64; 3],
    /// Distance from axis to surface \[m\]; 0 if it crosses.
    pub distance: f64,
    /// Penetration depth of the shaft \[m\]: see [`LineContactKind`].
    pub depth: f64,
    /// Unit exit direction of the shaft; outwards.
    pub direction: Vector3<f64>,
    /// Velocity of the surface there \[m/s\].
    pub surface_velocity: Vector3<f64>,
}

/// Geometry of a contact, without segment and triangle.
pub(super) struct ContactGeometry {
    pub(super) triangle: u32,
    pub(super) nearest: SegmentTriangle,
    pub(super) kind: LineContactKind,
    pub(super) depth: f64,
    pub(super) direction: Vector3<f64>,
}

/// The contact without crossing, by the side on which the axis is.
pub(super) fn beside(
    mesh: &MovingSurface,
    triangle: u32,
    nearest: &SegmentTriangle,
    radius: f64,
    scale: f64,
) -> ContactGeometry {
    let distance = nearest.distance_squared.sqrt();
    let away = nearest.on_segment - nearest.on_triangle;
    let outward = pseudonormal(&mesh.surface(), mesh.topology(), triangle, &nearest.weights);
    let is_behind = outward.is_some_and(|outward| outward.dot(&away) < 0.0);
    let direction = if distance > TELLABLE * scale {
        away / if is_behind { -distance } else { distance }
    } else {
        outward.map_or_else(Vector3::z, |outward| outward.normalize())
    };
    let (kind, depth) = if is_behind {
        (LineContactKind::Behind, radius + distance)
    } else {
        (LineContactKind::Outside, radius - distance)
    };
    ContactGeometry { triangle, nearest: *nearest, kind, depth, direction }
}

/// The crossings of one segment, in a fixed-size buffer.
pub(super) struct Crossings {
    list: [(u32, f64); CROSSINGS],
    count: usize,
}

impl Crossings {
    pub(super) fn none() -> Self {
        Self { list: [(0, 0.0); CROSSINGS], count: 0 }
    }

    /// Adds a crossing; surplus ones are dropped.
    pub(super) fn push(&mut self, triangle: u32, along: f64) {
        if self.count < CROSSINGS {
            self.list[self.count] = (triangle, along);
            self.count += 1;
        }
    }

    /// The shallowest of them.
    pub(super) fn shallowest(
        &mut self,
        mesh: &MovingSurface,
        segment: &Segment,
        radius: f64,
    ) -> Option<ContactGeometry> {
        let list = &mut self.list[..self.count];
        list.sort_unstable_by(|a, b| a.1.total_cmp(&b.1).then(a.0.cmp(&b.0)));
        let direction = segment[1] - segment[0];
        let mut best: Option<(u32, f64, Vector3<f64>)> = None;
        for &(triangle, along) in list.iter() {
            let normal = face(&mesh.surface(), triangle);
            let slope = normal.dot(&direction);
            if normal == Vector3::zeros() || slope == 0.0 {
                continue;
            }
            // The part behind the surface follows an entering crossing, and precedes an exiting one. A crossing at the
            // same point (an edge) is the same crossing.
            let same = |other: f64| (other - along).abs() <= 1e-9;
            let until = if slope < 0.0 {
                list.iter().map(|other| other.1).find(|&other| other > along && !same(other)).unwrap_or(1.0)
            } else {
                list.iter()
                    .rev()
                    .map(|other| other.1)
                    .find(|&other| other < along && !same(other))
                    .unwrap_or(0.0)
            };
            let depth = radius + slope.abs() * (until - along).abs();
            if best.is_none_or(|best| depth < best.1) {
                best = Some((triangle, depth, normal));
            }
        }
        let (triangle, depth, direction) = best?;
        let nearest = closest_segment_triangle(segment, &mesh.surface().triangle(triangle));
        Some(ContactGeometry { triangle, nearest, kind: LineContactKind::Crossing, depth, direction })
    }
}

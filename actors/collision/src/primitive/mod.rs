//! Primitive tests of points, segments and triangles, shared by all methods.
//!
//! Degenerate input is accepted: a segment of no length is a point, a triangle of no area is its longest edge. NaN in
//! gives NaN or an arbitrary corner out, never a panic.

#[cfg(test)]
pub(crate) mod arbitrary;
mod orientation;
mod penetration;
mod point_segment;
mod point_triangle;
mod segment_segment;
mod segment_triangle;
mod sphere_sweep;
mod triangle_distance;
mod triangle_overlap;

pub use orientation::{orientation, orientation_in_plane};
pub use penetration::{Penetration, segment_triangle_penetration, triangle_penetration};
pub use point_segment::closest_on_segment;
pub use point_triangle::{PointTriangle, closest_on_triangle};
pub use segment_segment::{SegmentSegment, closest_segments};
pub use segment_triangle::{SegmentTriangle, closest_segment_triangle};
pub use sphere_sweep::sweep_sphere_triangle;
pub use triangle_distance::{TriangleTriangle, closest_triangles};
pub use triangle_overlap::{common_segment, triangles_overlap};

use nalgebra::Point3;

/// Three corners, counter-clockwise seen from outside \[m\].
pub type Triangle = [Point3<f64>; 3];
/// Two end points \[m\].
pub type Segment = [Point3<f64>; 2];

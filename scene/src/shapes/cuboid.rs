//! The box.

use nalgebra::Vector3;

use super::builder::{Builder, Corner};
use super::{ShapeError, length};
use crate::mesh::SurfaceData;

/// A box about the origin with these half edge lengths \[m\]: 8 vertices, 12 triangles.
///
/// # Errors
/// When an edge has no length.
pub fn cuboid(half_extents: [f64; 3]) -> Result<SurfaceData, ShapeError> {
    for half in half_extents {
        length("half_extents", half)?;
    }
    let mut builder = Builder::default();
    let sign = |bit: usize| if bit == 0 { -1.0 } else { 1.0 };
    // Vertex number: x + 2 y + 4 z with 0 for the negative side.
    for k in 0..8usize {
        let [x, y, z] = [0, 1, 2].map(|axis| sign(k >> axis & 1) * half_extents[axis]);
        builder.vertex(x, y, z);
    }
    for axis in 0..3 {
        for side in 0..2usize {
            // (axis, u, v) is right-handed, so u × v points along +axis; the negative side runs the other way.
            let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
            let normal = Vector3::ith(axis, sign(side));
            let corner = |[a, b]: [usize; 2]| Corner {
                vertex: (side << axis | a << u | b << v) as u32,
                normal,
                uv: [a as f64, b as f64],
            };
            let mut corners = [[0, 0], [1, 0], [1, 1], [0, 1]].map(corner);
            if side == 0 {
                corners.reverse();
            }
            builder.quad(corners);
        }
    }
    Ok(builder.build())
}

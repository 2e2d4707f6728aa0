//! Procedural geometry: closed, manifold, outward-oriented surfaces with normals and texture coordinates.
//!
//! Axes of revolution are the local z axis, as in [`Shape`]. Curved surfaces are polygons whose
//! vertices lie on the ideal surface, so their volume approaches the ideal one from below (from either side for a
//! torus) with the square of the number of segments.

mod builder;
mod cuboid;
mod instrument;
mod lathe;
mod peg_board;
mod working_end;

use thiserror::Error;

pub use cuboid::cuboid;
pub use instrument::{InstrumentSurface, instrument_from_hinge, instrument_surface};
pub use lathe::{capsule, cylinder, sphere, torus};
pub use peg_board::{PegBoard, peg_board};
pub use working_end::{BentRod, working_end};

use crate::component::Component;
use crate::components::Shape;
use crate::mesh::SurfaceData;

/// Fewest and most segments of a circle.
pub const SEGMENTS: std::ops::RangeInclusive<usize> = 3..=4096;

/// A shape that cannot be made.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum ShapeError {
    /// A length that is not positive and finite, or out of proportion.
    #[error("{field}: {value} is out of range ({valid})")]
    OutOfRange {
        /// Which parameter.
        field: &'static str,
        /// Its value.
        value: f64,
        /// What would be valid.
        valid: &'static str,
    },
    /// A number of segments out of range.
    #[error("{segments} segments are out of range (3 to 4096)")]
    Segments {
        /// The number.
        segments: usize,
    },
    /// Two pegs overlap, or one reaches over the edge of its board.
    #[error("peg {peg} {problem}")]
    Peg {
        /// Which peg, counted from 0.
        peg: usize,
        /// What is wrong with it.
        problem: &'static str,
    },
    /// The component's own check refuses the shape.
    #[error("{0}")]
    Refused(String),
}

/// Tessellation detail of curves.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Detail {
    /// Segments of a full circle.
    pub segments: usize,
    /// Segments of a tube's circle, of a quarter of a sphere's meridian, of a peg.
    pub fine_segments: usize,
}

impl Default for Detail {
    fn default() -> Self {
        Self { segments: 48, fine_segments: 12 }
    }
}

/// The surface of a shape, for viewers and mesh-based collision detection.
///
/// # Errors
/// When the shape's own check refuses it, or its detail is out of range.
pub fn surface_of(shape: &Shape, detail: &Detail) -> Result<SurfaceData, ShapeError> {
    shape.check().map_err(|error| ShapeError::Refused(error.to_string()))?;
    match shape {
        Shape::Box { half_extents } => cuboid(*half_extents),
        Shape::Sphere { radius } => sphere(*radius, detail.segments, detail.fine_segments),
        Shape::Cylinder { radius, half_height } => cylinder(*radius, *half_height, detail.segments),
        Shape::Capsule { radius, half_height } => {
            capsule(*radius, *half_height, detail.segments, detail.fine_segments)
        }
        Shape::Torus { ring_radius, tube_radius } => {
            torus(*ring_radius, *tube_radius, detail.segments, detail.fine_segments)
        }
        Shape::PegBoard { half_extents, thickness, pegs, peg_radius, peg_height } => peg_board(&PegBoard {
            half_extents: *half_extents,
            thickness: *thickness,
            pegs: pegs.clone(),
            peg_radius: *peg_radius,
            peg_height: *peg_height,
            segments: detail.fine_segments,
        }),
    }
}

/// Checks that a length is positive and within limits.
fn length(field: &'static str, value: f64) -> Result<(), ShapeError> {
    if value > 0.0 && value <= 1e6 {
        return Ok(());
    }
    Err(ShapeError::OutOfRange { field, value, valid: "above 0, at most 1e6 m" })
}

fn segments(count: usize) -> Result<(), ShapeError> {
    if SEGMENTS.contains(&count) { Ok(()) } else { Err(ShapeError::Segments { segments: count }) }
}

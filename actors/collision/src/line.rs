//! Line (thread, band, needle), the input of methods for lines: two slices and a radius, checked once.

use nalgebra::Point3;
use thiserror::Error;

use crate::primitive::Segment;
use crate::surface::{SurfaceError, check_finite};

/// Why a line is invalid. Segments of no length, unused vertices, forks and loops are accepted.
#[derive(Clone, Copy, Debug, Error, PartialEq)]
pub enum LineError {
    /// A segment refers to a vertex that does not exist.
    #[error(
        "segment {segment} names vertex {vertex}, but there are {vertices}: 0 to {vertices} - 1 are valid"
    )]
    NoVertex {
        /// The segment.
        segment: usize,
        /// The index it refers to.
        vertex: u32,
        /// Number found.
        vertices: usize,
    },
    /// A vertex is not finite.
    #[error("vertex {vertex} of the line has a coordinate that is not a finite number")]
    NotFinite {
        /// The vertex.
        vertex: usize,
    },
    /// The number of positions differs from that of the vertices.
    #[error("the line has {expected} vertices, but {found} positions came")]
    OtherVertices {
        /// Vertices of the line.
        expected: usize,
        /// Positions given.
        found: usize,
    },
    /// Too many segments for the index type.
    #[error("{found} segments are more than {} can be told apart", u32::MAX)]
    TooMany {
        /// Number found.
        found: usize,
    },
    /// The radius is negative or not finite.
    #[error("a radius of {radius} m is out of range (≥ 0)")]
    Radius {
        /// The value given \[m\].
        radius: f64,
    },
}

/// Vertices \[m\], segments between them, and the radius of the tube around them \[m\].
#[derive(Clone, Copy, Debug)]
pub struct Line<'a> {
    vertices: &'a [Point3<f64>],
    segments: &'a [[u32; 2]],
    radius: f64,
}

impl<'a> Line<'a> {
    /// Wraps the scene's slices, after one check.
    ///
    /// # Errors
    /// For an end that does not exist, a non-finite coordinate, a radius that is negative or not finite, more than
    /// [`u32::MAX`] segments.
    pub fn new(
        vertices: &'a [Point3<f64>],
        segments: &'a [[u32; 2]],
        radius: f64,
    ) -> Result<Self, LineError> {
        if u32::try_from(segments.len()).is_err() {
            return Err(LineError::TooMany { found: segments.len() });
        }
        if !(radius.is_finite() && radius >= 0.0) {
            return Err(LineError::Radius { radius });
        }
        check_line_finite(vertices)?;
        for (segment, ends) in segments.iter().enumerate() {
            if let Some(&vertex) = ends.iter().find(|&&vertex| vertex as usize >= vertices.len()) {
                return Err(LineError::NoVertex { segment, vertex, vertices: vertices.len() });
            }
        }
        Ok(Self { vertices, segments, radius })
    }

    /// Vertices, in the line's frame \[m\].
    #[must_use]
    pub fn vertices(&self) -> &'a [Point3<f64>] {
        self.vertices
    }

    /// Ends of the segments, each below the number of vertices.
    #[must_use]
    pub fn segments(&self) -> &'a [[u32; 2]] {
        self.segments
    }

    /// Radius of the tube \[m\].
    #[must_use]
    pub fn radius(&self) -> f64 {
        self.radius
    }

    /// The ends of one segment.
    ///
    /// # Panics
    /// When the segment does not exist.
    #[must_use]
    pub fn segment(&self, index: u32) -> Segment {
        self.segments[index as usize].map(|vertex| self.vertices[vertex as usize])
    }
}

/// Checks that every coordinate is finite.
pub(crate) fn check_line_finite(vertices: &[Point3<f64>]) -> Result<(), LineError> {
    check_finite(vertices).map_err(|error| match error {
        SurfaceError::NotFinite { vertex } => LineError::NotFinite { vertex },
        _ => LineError::NotFinite { vertex: 0 },
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_cannot_be_used_is_named() {
        let mut vertices = vec![Point3::origin(); 3];
        assert!(Line::new(&vertices, &[[0, 1], [1, 1]], 0.0).is_ok());
        assert!(Line::new(&[], &[], 0.0).is_ok());
        let error = Line::new(&vertices, &[[0, 1], [1, 3]], 0.0).expect_err("no such vertex");
        assert_eq!(error, LineError::NoVertex { segment: 1, vertex: 3, vertices: 3 });
        for radius in [f64::NAN, -1e-9, f64::INFINITY] {
            assert!(matches!(Line::new(&vertices, &[], radius), Err(LineError::Radius { .. })), "{radius}");
        }
        vertices[2].z = f64::NAN;
        let error = Line::new(&vertices, &[], 0.0).expect_err("not a number");
        assert_eq!(error.to_string(), "vertex 2 of the line has a coordinate that is not a finite number");
    }
}

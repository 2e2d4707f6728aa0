//! Triangle surface, the input of every method: two slices, checked once.

use nalgebra::Point3;
use thiserror::Error;

use crate::primitive::Triangle;

/// Why a surface is invalid. Every method accepts all other defects (triangles without area, edges with three
/// triangles, inverted or open surfaces, unused vertices, no triangles at all).
#[derive(Clone, Copy, Debug, Error, PartialEq, Eq)]
pub enum SurfaceError {
    /// A triangle refers to a vertex that does not exist.
    #[error(
        "triangle {triangle} names vertex {vertex}, but there are {vertices}: 0 to {vertices} - 1 are valid"
    )]
    NoVertex {
        /// The triangle.
        triangle: usize,
        /// The index it refers to.
        vertex: u32,
        /// Number found.
        vertices: usize,
    },
    /// A vertex is not finite.
    #[error("vertex {vertex} has a coordinate that is not a finite number")]
    NotFinite {
        /// The vertex.
        vertex: usize,
    },
    /// The number of positions differs from that of the vertices.
    #[error("the surface has {expected} vertices, but {found} positions came")]
    OtherVertices {
        /// Vertices of the surface.
        expected: usize,
        /// Positions given.
        found: usize,
    },
    /// The surface differs from the one that a structure was built from.
    #[error("built from {expected} triangles, but asked about a surface of {found}")]
    OtherTriangles {
        /// Triangles of the structure.
        expected: usize,
        /// Triangles given.
        found: usize,
    },
    /// Too many triangles for the index type.
    #[error("{found} triangles are more than {} can be told apart", u32::MAX)]
    TooMany {
        /// Number found.
        found: usize,
    },
}

/// Vertices \[m\] and triangles (corners counter-clockwise seen from outside) that belong together.
#[derive(Clone, Copy, Debug)]
pub struct Surface<'a> {
    vertices: &'a [Point3<f64>],
    triangles: &'a [[u32; 3]],
}

impl<'a> Surface<'a> {
    /// Wraps the scene's slices, after one check.
    ///
    /// # Errors
    /// For a corner that does not exist, a non-finite coordinate, or more than [`u32::MAX`] triangles.
    pub fn new(vertices: &'a [Point3<f64>], triangles: &'a [[u32; 3]]) -> Result<Self, SurfaceError> {
        if u32::try_from(triangles.len()).is_err() {
            return Err(SurfaceError::TooMany { found: triangles.len() });
        }
        check_finite(vertices)?;
        for (triangle, corners) in triangles.iter().enumerate() {
            for &vertex in corners {
                if vertex as usize >= vertices.len() {
                    return Err(SurfaceError::NoVertex { triangle, vertex, vertices: vertices.len() });
                }
            }
        }
        Ok(Self { vertices, triangles })
    }

    /// Wraps slices that were checked before.
    pub(crate) fn trusted(vertices: &'a [Point3<f64>], triangles: &'a [[u32; 3]]) -> Self {
        Self { vertices, triangles }
    }

    /// Vertices, in the surface's frame \[m\].
    #[must_use]
    pub fn vertices(&self) -> &'a [Point3<f64>] {
        self.vertices
    }

    /// Corners of the triangles, each below the number of vertices.
    #[must_use]
    pub fn triangles(&self) -> &'a [[u32; 3]] {
        self.triangles
    }

    /// The corners of one triangle.
    ///
    /// # Panics
    /// When the triangle does not exist.
    #[inline]
    #[must_use]
    pub fn triangle(&self, index: u32) -> Triangle {
        let [a, b, c] = self.triangles[index as usize];
        [self.vertices[a as usize], self.vertices[b as usize], self.vertices[c as usize]]
    }
}

/// Checks that every coordinate is finite, as required of positions for a refit.
///
/// # Errors
/// The first non-finite vertex.
pub fn check_finite(vertices: &[Point3<f64>]) -> Result<(), SurfaceError> {
    match vertices.iter().position(|vertex| !vertex.iter().all(|coordinate| coordinate.is_finite())) {
        Some(vertex) => Err(SurfaceError::NotFinite { vertex }),
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_cannot_be_used_is_named() {
        let mut vertices = vec![Point3::origin(); 3];
        assert!(Surface::new(&vertices, &[[0, 1, 2], [0, 0, 0]]).is_ok());
        assert!(Surface::new(&[], &[]).is_ok());
        let error = Surface::new(&vertices, &[[0, 1, 2], [0, 3, 1]]).expect_err("no such vertex");
        assert_eq!(error, SurfaceError::NoVertex { triangle: 1, vertex: 3, vertices: 3 });
        vertices[1].y = f64::NAN;
        let error = Surface::new(&vertices, &[[0, 1, 2]]).expect_err("not a number");
        assert_eq!(error, SurfaceError::NotFinite { vertex: 1 });
        assert_eq!(error.to_string(), "vertex 1 has a coordinate that is not a finite number");
    }
}

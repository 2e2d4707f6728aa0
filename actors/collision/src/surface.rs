//! A triangle surface as every method takes it: two slices, checked once.

use nalgebra::Point3;
use thiserror::Error;

use crate::primitive::Triangle;

/// What makes a surface unusable. Everything else (triangles without area, edges with three triangles, inverted or open
/// surfaces, unused vertices, no triangles at all) is answered by every method.
#[derive(Clone, Copy, Debug, Error, PartialEq, Eq)]
pub enum SurfaceError {
    /// A triangle names a vertex that there is none of.
    #[error(
        "triangle {triangle} names vertex {vertex}, but there are {vertices}: 0 to {vertices} - 1 are valid"
    )]
    NoVertex {
        /// Which triangle.
        triangle: usize,
        /// What it names.
        vertex: u32,
        /// How many there are.
        vertices: usize,
    },
    /// A vertex is nowhere.
    #[error("vertex {vertex} has a coordinate that is not a finite number")]
    NotFinite {
        /// Which vertex.
        vertex: usize,
    },
    /// Positions for a surface of another number of vertices.
    #[error("the surface has {expected} vertices, but {found} positions came")]
    OtherVertices {
        /// Vertices of the surface.
        expected: usize,
        /// Positions that came.
        found: usize,
    },
    /// Another surface than the one that something was built from.
    #[error("built from {expected} triangles, but asked about a surface of {found}")]
    OtherTriangles {
        /// Triangles that it was built from.
        expected: usize,
        /// Triangles that came.
        found: usize,
    },
    /// More triangles than an index can tell apart.
    #[error("{found} triangles are more than {} can be told apart", u32::MAX)]
    TooMany {
        /// How many there are.
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
    /// Takes what the scene holds, and looks through it once.
    ///
    /// # Errors
    /// A corner that does not exist, a coordinate that is not finite, more than [`u32::MAX`] triangles.
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

    /// What was looked through before.
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
    /// When there is no such triangle.
    #[inline]
    #[must_use]
    pub fn triangle(&self, index: u32) -> Triangle {
        let [a, b, c] = self.triangles[index as usize];
        [self.vertices[a as usize], self.vertices[b as usize], self.vertices[c as usize]]
    }
}

/// Whether every coordinate is a number; what a refit asks of the positions that it takes.
///
/// # Errors
/// The first vertex that is not.
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

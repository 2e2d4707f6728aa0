//! Swept surfaces and lines: their motion within a step, checked once.

use nalgebra::Point3;

use super::advancement::Sweep;
use crate::line::{Line, LineError, check_line_finite};
use crate::primitive::{Segment, Triangle};
use crate::surface::{Surface, SurfaceError, check_finite};

/// A thread, band or needle within a step: the same segments and radius, vertices at its two ends \[m\].
#[derive(Clone, Copy, Debug)]
pub struct SweptLine<'a> {
    line: Line<'a>,
    to: &'a [Point3<f64>],
}

impl<'a> SweptLine<'a> {
    /// A sweep from the line at the beginning of the step and the positions at its end.
    ///
    /// # Errors
    /// For another number of positions, or a non-finite one.
    pub fn new(from: Line<'a>, to: &'a [Point3<f64>]) -> Result<Self, LineError> {
        let (expected, found) = (from.vertices().len(), to.len());
        if expected != found {
            return Err(LineError::OtherVertices { expected, found });
        }
        check_line_finite(to)?;
        Ok(Self { line: from, to })
    }

    /// A line that does not move.
    #[must_use]
    pub fn still(line: Line<'a>) -> Self {
        Self { line, to: line.vertices() }
    }

    /// Its segments.
    #[must_use]
    pub fn segments(&self) -> &'a [[u32; 2]] {
        self.line.segments()
    }

    /// Radius of the tube \[m\].
    #[must_use]
    pub fn radius(&self) -> f64 {
        self.line.radius()
    }

    pub(super) fn vertices(&self) -> Sweep<&'a [Point3<f64>]> {
        Sweep { from: self.line.vertices(), to: self.to }
    }
}

/// A surface within a step: the same triangles, vertices at its two ends \[m\].
#[derive(Clone, Copy, Debug)]
pub struct SweptSurface<'a> {
    vertices: Sweep<&'a [Point3<f64>]>,
    triangles: &'a [[u32; 3]],
}

impl<'a> SweptSurface<'a> {
    /// A sweep from the surface at the beginning of the step and the positions at its end.
    ///
    /// # Errors
    /// For another number of positions, or a non-finite one.
    pub fn new(from: Surface<'a>, to: &'a [Point3<f64>]) -> Result<Self, SurfaceError> {
        let (expected, found) = (from.vertices().len(), to.len());
        if expected != found {
            return Err(SurfaceError::OtherVertices { expected, found });
        }
        check_finite(to)?;
        Ok(Self { vertices: Sweep { from: from.vertices(), to }, triangles: from.triangles() })
    }

    /// A surface that does not move.
    #[must_use]
    pub fn still(surface: Surface<'a>) -> Self {
        Self {
            vertices: Sweep { from: surface.vertices(), to: surface.vertices() },
            triangles: surface.triangles(),
        }
    }

    /// Its triangles.
    #[must_use]
    pub fn triangles(&self) -> &'a [[u32; 3]] {
        self.triangles
    }

    pub(super) fn vertices(&self) -> Sweep<&'a [Point3<f64>]> {
        self.vertices
    }
}

/// One vertex of many.
pub(super) fn vertex(of: &Sweep<&[Point3<f64>]>, index: u32) -> Sweep<Point3<f64>> {
    Sweep { from: of.from[index as usize], to: of.to[index as usize] }
}

/// One edge between vertices.
pub(super) fn edge(of: &Sweep<&[Point3<f64>]>, ends: [u32; 2]) -> Sweep<Segment> {
    Sweep { from: ends.map(|end| of.from[end as usize]), to: ends.map(|end| of.to[end as usize]) }
}

/// One face between vertices.
pub(super) fn face(of: &Sweep<&[Point3<f64>]>, corners: [u32; 3]) -> Sweep<Triangle> {
    Sweep {
        from: corners.map(|corner| of.from[corner as usize]),
        to: corners.map(|corner| of.to[corner as usize]),
    }
}

/// The unique vertices and edges of a list of triangles. Rebuilt only when the triangles change; the comparison costs a
/// hundredth of that.
#[derive(Clone, Debug, Default)]
pub(super) struct Features {
    triangles: Vec<[u32; 3]>,
    segments: Vec<[u32; 2]>,
    pub vertices: Vec<u32>,
    pub edges: Vec<[u32; 2]>,
}

impl Features {
    pub fn update(&mut self, triangles: &[[u32; 3]]) {
        if self.triangles == triangles && self.segments.is_empty() {
            return;
        }
        self.segments.clear();
        self.triangles.clear();
        self.triangles.extend_from_slice(triangles);
        self.vertices.clear();
        self.edges.clear();
        for &[a, b, c] in triangles {
            self.vertices.extend([a, b, c]);
            // Includes edges from a vertex to itself, the only ones of a triangle that is a point.
            self.edges.extend([[a, b], [b, c], [c, a]].map(|[from, to]| [from.min(to), from.max(to)]));
        }
        self.edges.sort_unstable();
        self.edges.dedup();
        self.sort_vertices();
    }

    /// The unique vertices of a list of segments.
    pub fn update_line(&mut self, segments: &[[u32; 2]]) {
        if self.segments == segments && self.triangles.is_empty() {
            return;
        }
        self.triangles.clear();
        self.segments.clear();
        self.segments.extend_from_slice(segments);
        self.edges.clear();
        self.vertices.clear();
        self.vertices.extend(segments.iter().flatten());
        self.sort_vertices();
    }

    fn sort_vertices(&mut self) {
        self.vertices.sort_unstable();
        self.vertices.dedup();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_cannot_be_used_is_named() {
        let vertices = vec![Point3::origin(); 3];
        let line = Line::new(&vertices, &[[0, 1]], 0.0).expect("a line");
        assert!(SweptLine::new(line, &vertices).is_ok());
        let error = SweptLine::new(line, &vertices[..2]).expect_err("other vertices");
        assert_eq!(error.to_string(), "the line has 3 vertices, but 2 positions came");
        let mut nowhere = vertices.clone();
        nowhere[2].z = f64::NAN;
        assert_eq!(SweptLine::new(line, &nowhere).err(), Some(LineError::NotFinite { vertex: 2 }));
        let surface = Surface::new(&vertices, &[[0, 1, 2]]).expect("a surface");
        assert!(SweptSurface::new(surface, &vertices).is_ok());
        assert_eq!(SweptSurface::new(surface, &nowhere).err(), Some(SurfaceError::NotFinite { vertex: 2 }));
        let found = SweptSurface::new(surface, &vertices[..1]).err();
        assert_eq!(found, Some(SurfaceError::OtherVertices { expected: 3, found: 1 }));
    }

    #[test]
    fn every_edge_and_vertex_stands_once() {
        let mut features = Features::default();
        features.update(&[[4, 1, 2], [2, 1, 3], [3, 3, 3]]);
        assert_eq!(features.vertices, [1, 2, 3, 4]);
        assert_eq!(features.edges, [[1, 2], [1, 3], [1, 4], [2, 3], [2, 4], [3, 3]]);
        features.update(&[]);
        assert!(features.vertices.is_empty() && features.edges.is_empty());
    }
}

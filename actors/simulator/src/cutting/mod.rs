//! Cutting of surfaces along arbitrary blade paths: the area swept by a blade's edge between two frames is intersected
//! with the triangles, the resulting paths are embedded in the mesh as edges, and the mesh splits along them into two
//! lips, which tension then opens.
//!
//! A path becomes edges by walking from vertex to vertex in the rest shape. Where it crosses the opposite edge, that
//! edge is split; where this would make a triangle too small for the springs, the nearer vertex is moved onto the path;
//! where that would, too, the path goes through the vertex ([`Sheet`] defines too small). So the walk always makes
//! progress without slivers. A path that ends inside a triangle stops at the last vertex, a *tip*, and continues with
//! the next frame.
//!
//! Each call returns a [`TopologyChange`].

pub(crate) mod cuttable_surface;
pub(crate) mod edge_path;
mod line;
pub(crate) mod swept_path;
mod tearing;
pub(crate) mod topology_change;

pub use cuttable_surface::{Sheet, SheetState};
pub use line::{CutLine, crossed, part_line, pieces, tear_line};
pub use topology_change::{TopologyChange, VertexChange};

use nalgebra::Point3;
use thiserror::Error;
use trocar_dynamics::tet_mesh::Sweep;

/// Why a cut was rejected.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum CutError {
    /// A number of positions other than that of vertices.
    #[error("{given} positions for a mesh of {expected} vertices")]
    Positions {
        /// Number of positions.
        given: usize,
        /// Number of vertices.
        expected: usize,
    },
    /// A non-finite blade or vertex.
    #[error("{what} {index} has a coordinate that is not finite")]
    NotFinite {
        /// Sweep or vertex.
        what: &'static str,
        /// Its index.
        index: usize,
    },
    /// The mesh has reached its maximum size.
    #[error("the mesh has {0} triangles, and is cut no further than {TRIANGLES_MAX}")]
    Full(usize),
}

/// Maximum number of triangles.
const TRIANGLES_MAX: usize = 1 << 20;

impl Sheet {
    /// Cuts where the blades' edges sweep through the surface at these positions.
    ///
    /// # Errors
    /// Non-finite or mismatched input; nothing is cut then.
    pub fn cut(&mut self, positions: &[Point3<f64>], sweeps: &[Sweep]) -> Result<TopologyChange, CutError> {
        let (given, expected) = (positions.len(), self.rest().len());
        if given != expected {
            return Err(CutError::Positions { given, expected });
        }
        if self.triangles().len() > TRIANGLES_MAX {
            return Err(CutError::Full(self.triangles().len()));
        }
        let nowhere = |point: &Point3<f64>| !point.iter().all(|value| value.is_finite());
        if let Some(index) = positions.iter().position(nowhere) {
            return Err(CutError::NotFinite { what: "vertex", index });
        }
        if let Some(index) =
            sweeps.iter().position(|sweep| sweep.before.iter().chain(&sweep.after).any(nowhere))
        {
            return Err(CutError::NotFinite { what: "sweep", index });
        }
        let mut all = TopologyChange::default();
        let mut positions = positions.to_vec();
        for sweep in sweeps {
            for path in swept_path::paths(self, &positions, sweep) {
                self.follow(path);
                let change = self.take_change();
                change.carry(&mut positions, |a, b, share| a + (b - a) * share);
                all.append(change);
            }
        }
        Ok(all)
    }

    /// Changes since the last call.
    fn take_change(&mut self) -> TopologyChange {
        let mut change = std::mem::take(&mut self.change);
        change.stale.sort_unstable();
        change.stale.dedup();
        change
    }
}

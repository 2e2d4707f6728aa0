//! A validated tetrahedral mesh at rest, for continuum solvers: volumes, shape-function gradients, boundary surface,
//! lumped masses.
//!
//! Imported meshes have bad elements. [`defects`] lists all of them by number, [`TetMesh::new`] rejects a mesh that has
//! any, [`TetMesh::repaired`] repairs what it can and reports the changes.

pub(crate) mod adjacency;
pub(crate) mod blade_crossing;
pub(crate) mod blade_cut;
pub(crate) mod blade_sweep;
pub(crate) mod box_mesh;
pub(crate) mod cut_path;
pub(crate) mod cut_sides;
pub(crate) mod edge_split;
pub(crate) mod longest_edge_bisection;
pub(crate) mod topology;

use nalgebra::{Matrix3, Point3, Vector3};
use trocar_scene::mesh::repaired_tets;

pub use adjacency::NodeAdjacency;
pub use blade_cut::NodeMotion;
pub use blade_sweep::Sweep;
pub use box_mesh::{BoxCells, box_cells};
pub use cut_path::{OpenCut, PathNode, PathNodes, Stroke};
pub use longest_edge_bisection::{NodesAndTets, RefineError, refined};
pub use topology::{NodeOrigin, SplitTet, TetFace, Volume, VolumeChange, VolumeError};
pub use trocar_scene::mesh::tet_faces::surface;
pub use trocar_scene::mesh::{BadTets as MeshError, Defect, MeshRules, Repairs, tet_defects as defects};
pub use trocar_scene::mesh::{mean_ratio, tet_shape as shape};

/// Tetrahedra of positive volume, with all quantities that follow from the rest shape.
#[derive(Clone, Debug, PartialEq)]
pub struct TetMesh {
    rest: Vec<Point3<f64>>,
    tets: Vec<[u32; 4]>,
    volumes: Vec<f64>,
    inverse_shapes: Vec<Matrix3<f64>>,
    surface: Vec<[u32; 3]>,
    surface_nodes: Vec<u32>,
}

impl TetMesh {
    /// Takes rest positions \[m\] and positively oriented elements, and validates them.
    ///
    /// # Errors
    /// [`MeshError`] with all defects.
    pub fn new(rest: &[Point3<f64>], tets: &[[u32; 4]], rules: &MeshRules) -> Result<Self, MeshError> {
        let defects = defects(rest, tets, rules);
        if defects.is_empty() {
            Ok(Self::checked(rest.to_vec(), tets.to_vec()))
        } else {
            Err(MeshError { defects })
        }
    }

    /// Repairs a mesh: reorients inverted elements, merges coincident nodes, drops degenerate elements, slivers and
    /// duplicates, and nodes that no element uses. The remaining elements and nodes keep their order.
    ///
    /// # Errors
    /// [`MeshError`] with the defects that cannot be repaired: non-finite coordinates, corners that do not exist, faces
    /// with more than two elements, overlapping elements, or an empty result.
    pub fn repaired(
        rest: &[Point3<f64>],
        tets: &[[u32; 4]],
        rules: &MeshRules,
    ) -> Result<(Self, Repairs), MeshError> {
        let (rest, tets, repairs) = repaired_tets(rest, tets, rules)?;
        Ok((Self::checked(rest, tets), repairs))
    }

    /// From a mesh in which [`defects`] found nothing.
    fn checked(rest: Vec<Point3<f64>>, tets: Vec<[u32; 4]>) -> Self {
        let shapes: Vec<_> = tets.iter().map(|tet| shape(&rest, tet)).collect();
        let volumes = shapes.iter().map(|shape| shape.determinant() / 6.0).collect();
        // Invertible: all volumes are positive.
        let inverse_shapes =
            shapes.iter().map(|shape| shape.try_inverse().unwrap_or_else(Matrix3::zeros)).collect();
        let surface = surface(&tets);
        let mut surface_nodes: Vec<u32> = surface.iter().flatten().copied().collect();
        surface_nodes.sort_unstable();
        surface_nodes.dedup();
        Self { rest, tets, volumes, inverse_shapes, surface, surface_nodes }
    }

    /// The same elements with renumbered corners at the same positions: after the first `known` nodes come duplicates
    /// of the nodes in `parents`, each parent before its duplicate.
    ///
    /// # Panics
    /// When the number of elements differs, or a corner or parent does not exist.
    #[must_use]
    pub fn parted(&self, known: usize, parents: &[u32], tets: Vec<[u32; 4]>) -> Self {
        assert_eq!(tets.len(), self.tets.len(), "the same elements");
        let mut rest = self.rest[..known].to_vec();
        parents.iter().for_each(|&parent| rest.push(rest[parent as usize]));
        let surface = surface(&tets);
        let mut surface_nodes: Vec<u32> = surface.iter().flatten().copied().collect();
        surface_nodes.sort_unstable();
        surface_nodes.dedup();
        let (volumes, inverse_shapes) = (self.volumes.clone(), self.inverse_shapes.clone());
        Self { rest, tets, volumes, inverse_shapes, surface, surface_nodes }
    }

    /// Positions at rest \[m\].
    #[must_use]
    pub fn rest(&self) -> &[Point3<f64>] {
        &self.rest
    }

    /// Corners of the elements, positively oriented: the fourth lies on the side that the counter-clockwise normal of
    /// the first three points to.
    #[must_use]
    pub fn tets(&self) -> &[[u32; 4]] {
        &self.tets
    }

    /// Volumes of the elements at rest \[m³\], all positive.
    #[must_use]
    pub fn volumes(&self) -> &[f64] {
        &self.volumes
    }

    /// Inverse rest-edge matrices, of the edges from the first corner \[1/m\]: with the same deformed edges as the
    /// columns of D, D times this is the deformation gradient.
    #[must_use]
    pub fn inverse_shapes(&self) -> &[Matrix3<f64>] {
        &self.inverse_shapes
    }

    /// Gradients of the four shape functions of an element at rest \[1/m\].
    ///
    /// # Panics
    /// When there is no such element.
    #[must_use]
    pub fn gradients(&self, tet: usize) -> [Vector3<f64>; 4] {
        gradients(&self.inverse_shapes[tet])
    }

    /// Boundary triangles, counter-clockwise seen from outside, in the order of their elements.
    #[must_use]
    pub fn surface(&self) -> &[[u32; 3]] {
        &self.surface
    }

    /// Boundary nodes, ascending.
    #[must_use]
    pub fn surface_nodes(&self) -> &[u32] {
        &self.surface_nodes
    }

    /// Total volume \[m³\].
    #[must_use]
    pub fn volume(&self) -> f64 {
        self.volumes.iter().sum()
    }

    /// Lumped mass of each node \[kg\], a quarter of the mass of each of its elements, for a density \[kg/m³\].
    #[must_use]
    pub fn lumped_masses(&self, density: f64) -> Vec<f64> {
        let mut masses = vec![0.0; self.rest.len()];
        for (tet, volume) in self.tets.iter().zip(&self.volumes) {
            for &node in tet {
                masses[node as usize] += 0.25 * density * volume;
            }
        }
        masses
    }

    /// The element that contains a point of the rest shape, or else the nearest by its smallest barycentric weight,
    /// with the weights; `None` for an empty mesh. Searches all elements: for attaching things, not for every step.
    #[must_use]
    pub fn locate(&self, point: &Point3<f64>) -> Option<(usize, [f64; 4])> {
        let mut best: Option<(usize, [f64; 4], f64)> = None;
        for (index, tet) in self.tets.iter().enumerate() {
            let inner = self.inverse_shapes[index] * (point - self.rest[tet[0] as usize]);
            let weights = [1.0 - inner.sum(), inner.x, inner.y, inner.z];
            let least = weights.iter().copied().fold(f64::INFINITY, f64::min);
            if best.is_none_or(|(.., known)| least > known) {
                best = Some((index, weights, least));
            }
        }
        best.map(|(index, weights, _)| (index, weights))
    }
}

/// Shape-function gradients from the inverse of the edge matrix.
pub fn gradients(inverse_shape: &Matrix3<f64>) -> [Vector3<f64>; 4] {
    let [b, c, d] = [0, 1, 2].map(|row| inverse_shape.row(row).transpose());
    [-(b + c + d), b, c, d]
}

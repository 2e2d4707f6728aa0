//! Precomputed compliance: displacements of all free surface nodes per unit force at each of them.
//!
//! With K = L Lᵀ in a fill-reducing order, the compliance is Zᵀ Z, where Z = L⁻¹ E are the columns of the surface: only
//! the part of K⁻¹ between surface nodes is formed, and only half of it, being symmetric, is computed.

use nalgebra::Vector3;
use thiserror::Error;
use trocar_dynamics::elasticity::Elastic;
use trocar_dynamics::tet_mesh::TetMesh;
use trocar_scene::disjoint_sets::DisjointSets;

use super::bounds::BATCH;
use crate::linear_algebra::{FactorError, SupernodalCholesky, nested_dissection};
use crate::stiffness::{Bonds, bound_stiffness};

/// Limits of a precomputation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Limits {
    /// Bytes of the stored compliance: 36 per pair of free surface nodes.
    pub bytes_max: u64,
    /// Nodes of the whole mesh.
    pub nodes_max: usize,
}

impl Default for Limits {
    /// 1 GiB, some 5,400 free surface nodes (the computation needs some four times as much), and 100,000 nodes.
    fn default() -> Self {
        Self { bytes_max: 1 << 30, nodes_max: 100_000 }
    }
}

/// Why there is no compliance.
#[derive(Clone, Copy, Debug, Error, PartialEq)]
pub enum PrecomputeError {
    /// A fixed node that does not exist.
    #[error("node {node} is to be fixed, but there are {nodes}: 0 to {nodes} - 1 are valid")]
    NoNode {
        /// The node.
        node: u32,
        /// Number of nodes.
        nodes: usize,
    },
    /// The dense part would be too large.
    #[error(
        "{surface_nodes} free surface nodes need {bytes} bytes of compliance, but at most {bytes_max} are allowed: \
         coarsen the surface, fix more of it, or raise the limit"
    )]
    TooLarge {
        /// Number of free surface nodes.
        surface_nodes: usize,
        /// Bytes required.
        bytes: u64,
        /// Bytes allowed.
        bytes_max: u64,
    },
    /// The sparse part would be too large.
    #[error("the mesh has {nodes} nodes, but at most {nodes_max} are allowed")]
    TooManyNodes {
        /// Number of nodes.
        nodes: usize,
        /// Number allowed.
        nodes_max: usize,
    },
    /// A part of the body is not constrained against rigid motion.
    #[error(
        "the part of the body that node {node} belongs to has no three fixed nodes that span a triangle: it could move \
         as a whole"
    )]
    Loose {
        /// The smallest node of that part.
        node: u32,
    },
    /// No surface node is free.
    #[error("no node of the surface is free: nothing could be touched")]
    NothingFree,
    /// The stiffness matrix is not positive definite, or there is not enough memory.
    #[error(transparent)]
    Factor(#[from] FactorError),
    /// Not enough memory for the dense part.
    #[error("there is no room for the dense inverse of {0} rows")]
    OutOfMemory(usize),
    /// The caller asked to stop.
    #[error("the precomputation was cancelled")]
    Cancelled,
}

/// Node numbering: free nodes in elimination order; fixed nodes have none.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Boundary {
    /// Row of each node in elimination order.
    pub(super) numbers: Vec<Option<u32>>,
    /// Number of free nodes.
    pub(super) free: usize,
    /// Free surface nodes, ascending.
    pub(super) surface: Vec<u32>,
    /// Index of each node among these.
    on_surface: Vec<Option<u32>>,
}

impl Boundary {
    /// For a mesh with these nodes fixed.
    ///
    /// # Errors
    /// A node that does not exist; no free node on the surface.
    pub fn new(mesh: &TetMesh, fixed: &[u32]) -> Result<Self, PrecomputeError> {
        Self::touched(mesh, fixed, mesh.surface_nodes(), &[])
    }

    /// The same with a touchable surface other than that of the whole mesh (its nodes, ascending), and with additional
    /// bonds between nodes.
    pub(super) fn touched(
        mesh: &TetMesh,
        fixed: &[u32],
        outside: &[u32],
        bonds: &[[u32; 2]],
    ) -> Result<Self, PrecomputeError> {
        let nodes = mesh.rest().len();
        let mut free = vec![true; nodes];
        for &node in fixed {
            *free.get_mut(node as usize).ok_or(PrecomputeError::NoNode { node, nodes })? = false;
        }
        let surface: Vec<u32> = outside.iter().copied().filter(|&node| free[node as usize]).collect();
        if surface.is_empty() {
            return Err(PrecomputeError::NothingFree);
        }
        if let Some(node) = loose(mesh, &free, bonds) {
            return Err(PrecomputeError::Loose { node });
        }
        let members: Vec<u32> = (0..nodes as u32).filter(|&node| free[node as usize]).collect();
        let mut local = vec![None; nodes];
        for (index, &node) in members.iter().enumerate() {
            local[node as usize] = Some(index as u32);
        }
        let edges = mesh.tets().iter().flat_map(|tet| {
            let own = tet.map(|node| local[node as usize]);
            (0..4).flat_map(move |i| (0..i).filter_map(move |j| Some((own[i]?, own[j]?))))
        });
        let bonds = bonds.iter().filter_map(|[a, b]| Some((local[*a as usize]?, local[*b as usize]?)));
        let edges = edges.chain(bonds);
        let places: Vec<_> = members.iter().map(|&node| mesh.rest()[node as usize]).collect();
        let mut numbers = vec![None; nodes];
        for (row, &index) in nested_dissection(&places, edges).iter().enumerate() {
            numbers[members[index as usize] as usize] = Some(row as u32);
        }
        let mut on_surface = vec![None; nodes];
        for (index, &node) in surface.iter().enumerate() {
            on_surface[node as usize] = Some(index as u32);
        }
        Ok(Self { numbers, free: members.len(), surface, on_surface })
    }

    /// Adds a copy of a node; returns whether it is a free surface node.
    pub(super) fn bear(&mut self, parent: u32) -> bool {
        self.numbers.push(self.numbers[parent as usize]);
        let on_surface = self.on_surface[parent as usize];
        self.on_surface.push(on_surface);
        on_surface.is_some()
    }

    /// Removes all nodes after the first `known`.
    pub(super) fn forget(&mut self, known: usize) {
        self.numbers.truncate(known);
        self.on_surface.truncate(known);
    }

    /// Number of free nodes.
    pub(super) fn free(&self) -> usize {
        self.free
    }

    /// Rows of the free surface nodes in elimination order.
    pub(super) fn rows_of_surface(&self) -> impl Iterator<Item = usize> {
        self.surface.iter().filter_map(|&node| Some(self.numbers[node as usize]? as usize))
    }

    /// Row of a node among the free surface nodes; `None` for others.
    pub(super) fn surface_row(&self, node: u32) -> Option<usize> {
        Some(self.on_surface[node as usize]? as usize)
    }
}

/// The smallest node of a part that is not constrained against rigid motion, if any: a part, connected by common nodes
/// or bonds, needs three fixed nodes that span a triangle.
fn loose(mesh: &TetMesh, free: &[bool], bonds: &[[u32; 2]]) -> Option<u32> {
    let mut parts = DisjointSets::new(free.len());
    for [first, others @ ..] in mesh.tets() {
        for other in others {
            parts.join(*first as usize, *other as usize);
        }
    }
    for &[one, other] in bonds {
        parts.join(one as usize, other as usize);
    }
    // Per part: a fixed node, the vector from it to the farthest one, and whether another lies off that line.
    let mut first: Vec<Option<u32>> = vec![None; free.len()];
    let mut along = vec![Vector3::zeros(); free.len()];
    let mut spans = vec![false; free.len()];
    let fixed: Vec<(u32, usize)> = (0..free.len() as u32)
        .filter(|&node| !free[node as usize])
        .map(|node| (node, parts.root(node as usize)))
        .collect();
    let way = |from: u32, to: u32| mesh.rest()[to as usize] - mesh.rest()[from as usize];
    for &(node, part) in &fixed {
        let reach = way(*first[part].get_or_insert(node), node);
        if reach.norm_squared() > along[part].norm_squared() {
            along[part] = reach;
        }
    }
    for &(node, part) in &fixed {
        if let Some(begin) = first[part] {
            spans[part] |= along[part].cross(&way(begin, node)).norm() > 1e-9 * along[part].norm_squared();
        }
    }
    (0..free.len() as u32).find(|&node| parts.is_root(node as usize) && !spans[node as usize])
}

/// Displacements of the free surface nodes per force on them \[m/N\], as f32: the rounding error is far below the
/// discretisation error, and half as much memory is read in every cycle.
#[derive(Clone, Debug, PartialEq)]
pub struct Compliance {
    /// Row i, column j, three of each per node of `nodes`.
    pub(super) entries: Vec<f32>,
    pub(super) nodes: Vec<u32>,
    /// Fingerprint of mesh, material and fixed nodes.
    pub(super) fingerprint: u64,
}

impl Compliance {
    /// Computes the compliance, and reports the completed fraction in \[0, 1\] to `progress`; it stops when `progress`
    /// returns `false`.
    ///
    /// # Errors
    /// A parameter out of range or too large, an insufficiently fixed body, cancelled.
    pub fn precompute(
        mesh: &TetMesh,
        material: &Elastic,
        fixed: &[u32],
        limits: &Limits,
        progress: &mut dyn FnMut(f64) -> bool,
    ) -> Result<Self, PrecomputeError> {
        let boundary = Boundary::new(mesh, fixed)?;
        let factor = factor(mesh, material, &[], &Bonds::default(), &boundary, limits)?;
        Self::from_factor(
            super::serialization::fingerprint(mesh, material, fixed),
            &boundary,
            &factor,
            progress,
        )
    }

    pub(super) fn from_factor(
        fingerprint: u64,
        boundary: &Boundary,
        factor: &SupernodalCholesky,
        progress: &mut dyn FnMut(f64) -> bool,
    ) -> Result<Self, PrecomputeError> {
        let rows = 3 * boundary.surface.len();
        if !progress(0.1) {
            return Err(PrecomputeError::Cancelled);
        }
        let mut entries = Vec::new();
        entries.try_reserve_exact(rows * rows).map_err(|_| PrecomputeError::OutOfMemory(rows))?;
        entries.resize(rows * rows, 0.0_f32);
        let places: Vec<usize> =
            boundary.rows_of_surface().flat_map(|row| (0..3).map(move |axis| 3 * row + axis)).collect();
        let visit = |row: usize, column: usize, value: f64| entries[row * rows + column] = value as f32;
        if !factor.inverse_between(&places, visit, &mut |share| progress(0.1 + 0.9 * share)) {
            return Err(PrecomputeError::Cancelled);
        }
        let nodes = boundary.surface.clone();
        Ok(Self { entries, nodes, fingerprint })
    }

    /// Its free surface nodes, ascending.
    #[must_use]
    pub fn nodes(&self) -> &[u32] {
        &self.nodes
    }

    /// Fingerprint: a hash of mesh, material and fixed nodes.
    #[must_use]
    pub fn fingerprint(&self) -> u64 {
        self.fingerprint
    }

    /// Displacements of all free surface nodes, three per node, per unit force along one axis at the `index`-th of them
    /// \[m/N\].
    #[must_use]
    pub fn row(&self, index: usize, axis: usize) -> &[f32] {
        let rows = 3 * self.nodes.len();
        &self.entries[(3 * index + axis) * rows..][..rows]
    }
}

/// The sparse factor of the whole stiffness matrix, free nodes in the order of the boundary; weights of elements and
/// bonds as in [`bound_stiffness`].
pub(super) fn factor(
    mesh: &TetMesh,
    material: &Elastic,
    weights: &[f64],
    bonds: &Bonds<'_>,
    boundary: &Boundary,
    limits: &Limits,
) -> Result<SupernodalCholesky, PrecomputeError> {
    let nodes = mesh.rest().len();
    if nodes > limits.nodes_max {
        return Err(PrecomputeError::TooManyNodes { nodes, nodes_max: limits.nodes_max });
    }
    let surface_nodes = boundary.surface.len();
    let bytes = 36 * (surface_nodes as u64).pow(2);
    if bytes > limits.bytes_max {
        return Err(PrecomputeError::TooLarge { surface_nodes, bytes, bytes_max: limits.bytes_max });
    }
    let matrix = bound_stiffness(mesh, material, weights, bonds, &boundary.numbers, boundary.free());
    let mut factor = SupernodalCholesky::new(matrix.pattern(), BATCH)?;
    factor.factor(matrix.pattern(), matrix.values())?;
    Ok(factor)
}

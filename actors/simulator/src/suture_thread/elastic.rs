//! An elastic body that a thread is tied around: linear, quasi-static, represented by its precomputed compliance
//! ([`Compliance`]). The thread's contacts with its surface are coupled through the body and through the thread in one
//! problem per step. No forces are exchanged between two solvers, so the coupling is stable for any stiffness.

use std::sync::Arc;

use nalgebra::{Matrix3, Point3, Vector3};
use serde::{Deserialize, Serialize};
use trocar_dynamics::tet_mesh::TetMesh;

use crate::linear_fem::Compliance;

/// A point on the surface of a body.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct SurfacePoint {
    /// Nodes of the triangle.
    pub nodes: [u32; 3],
    /// Barycentric weights; their sum is 1.
    pub weights: [f64; 3],
}

/// A force on a body at a point of its surface.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct SurfaceForce {
    /// The point.
    pub at: SurfacePoint,
    /// The force, in the frame of the body \[N\].
    pub force: Vector3<f64>,
}

/// Marks a node without a row in the compliance.
const FIXED: u32 = u32::MAX;

/// An elastic body and the forces that deform it.
#[derive(Clone, Debug)]
pub struct ElasticBody {
    rest: Vec<Point3<f64>>,
    triangles: Vec<[u32; 3]>,
    compliance: Arc<Compliance>,
    /// Row of each node in the compliance.
    row: Vec<u32>,
    positions: Vec<Point3<f64>>,
    presses: Vec<SurfaceForce>,
    /// Forces and displacements of the nodes in the compliance.
    on_nodes: Vec<Vector3<f64>>,
    moved: Vec<f32>,
}

impl ElasticBody {
    /// An undeformed body.
    #[must_use]
    pub fn new(mesh: &TetMesh, compliance: impl Into<Arc<Compliance>>) -> Self {
        let compliance = compliance.into();
        let mut row = vec![FIXED; mesh.rest().len()];
        for (index, &node) in compliance.nodes().iter().enumerate() {
            if let Some(row) = row.get_mut(node as usize) {
                *row = index as u32;
            }
        }
        let nodes = compliance.nodes().len();
        Self {
            rest: mesh.rest().to_vec(),
            triangles: mesh.surface().to_vec(),
            positions: mesh.rest().to_vec(),
            row,
            presses: Vec::new(),
            on_nodes: vec![Vector3::zeros(); nodes],
            moved: vec![0.0; 3 * nodes],
            compliance,
        }
    }

    /// Positions of the nodes, in its frame \[m\]. Interior nodes keep their rest positions.
    #[must_use]
    pub fn positions(&self) -> &[Point3<f64>] {
        &self.positions
    }

    /// Corners of the surface triangles.
    #[must_use]
    pub fn triangles(&self) -> &[[u32; 3]] {
        &self.triangles
    }

    /// The forces that deform it: its whole state.
    #[must_use]
    pub fn presses(&self) -> &[SurfaceForce] {
        &self.presses
    }

    /// Deforms the body by exactly these forces; forces at nodes that it does not have are ignored.
    pub fn deform(&mut self, presses: &[SurfaceForce]) {
        let nodes = self.rest.len();
        self.presses.clear();
        self.presses.extend(presses.iter().filter(|press| {
            press.at.nodes.iter().all(|node| (*node as usize) < nodes)
                && press.force.iter().chain(&press.at.weights).all(|x| x.is_finite())
        }));
        self.on_nodes.fill(Vector3::zeros());
        for press in &self.presses {
            for (node, weight) in press.at.nodes.iter().zip(press.at.weights) {
                if let Some(sum) = self.on_nodes.get_mut(self.row[*node as usize] as usize) {
                    *sum += press.force * weight;
                }
            }
        }
        self.moved.fill(0.0);
        for (index, force) in self.on_nodes.iter().enumerate() {
            for axis in (0..3).filter(|axis| force[*axis] != 0.0) {
                let size = force[axis] as f32;
                for (moved, of) in self.moved.iter_mut().zip(self.compliance.row(index, axis)) {
                    *moved += size * of;
                }
            }
        }
        for (index, &node) in self.compliance.nodes().iter().enumerate() {
            let by = Vector3::from_fn(|axis, _| f64::from(self.moved[3 * index + axis]));
            self.positions[node as usize] = self.rest[node as usize] + by;
        }
    }

    /// Compliance of one surface point to a force at another one \[m/N\]; swapping the points transposes it. Only for
    /// nodes of this body.
    #[must_use]
    pub(crate) fn between(&self, place: &SurfacePoint, by: &SurfacePoint) -> Matrix3<f64> {
        let mut sum = Matrix3::zeros();
        for (node, weight) in by.nodes.iter().zip(by.weights) {
            let index = self.row[*node as usize];
            if index == FIXED || weight == 0.0 {
                continue;
            }
            let columns = [0, 1, 2].map(|axis| self.compliance.row(index as usize, axis));
            for (other, share) in place.nodes.iter().zip(place.weights) {
                let first = self.row[*other as usize];
                if first == FIXED {
                    continue;
                }
                let (first, share) = (3 * first as usize, share * weight);
                for (axis, column) in columns.iter().enumerate() {
                    for k in 0..3 {
                        sum[(k, axis)] += share * f64::from(column[first + k]);
                    }
                }
            }
        }
        sum
    }

    /// Displacement of a surface point under forces \[m\].
    pub(crate) fn displacement(&self, place: &SurfacePoint, presses: &[SurfaceForce]) -> Vector3<f64> {
        presses.iter().map(|press| self.between(place, &press.at) * press.force).sum()
    }

    /// Resultant force, and moment about the origin of its frame \[N\], \[N·m\].
    #[must_use]
    pub fn load(&self) -> [Vector3<f64>; 2] {
        let mut sum = [Vector3::zeros(); 2];
        for press in &self.presses {
            let corners = press.at.nodes.iter().zip(press.at.weights);
            let at: Vector3<f64> =
                corners.map(|(node, weight)| self.positions[*node as usize].coords * weight).sum();
            sum[0] += press.force;
            sum[1] += at.cross(&press.force);
        }
        sum
    }
}

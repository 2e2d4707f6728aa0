//! Local correction of a stale factor near a cut: the response of the new mesh near it minus that of the mesh with its
//! split nodes still joined.
//!
//! Both are small problems with the same elements and held outer nodes. With `A` for the one and `PᵀAP` for the other,
//! `A⁻¹ − P (PᵀAP)⁻¹ Pᵀ` is positive semidefinite, so that it may be added to any approximate inverse.

use nalgebra::{Matrix3, Point3, Vector3};
use trocar_dynamics::tet_mesh::{gradients, shape};

use super::incremental_potential::{Element, ElementForces};
use crate::linear_algebra::{BlockMatrix, BlockPattern, FactorError, SupernodalCholesky, minimum_degree};

/// Maximum number of nodes near the cut: farther ones respond alike in both.
const NEAR_MAX: usize = 300;

/// Node weights, by row.
type NodeWeights = Vec<(u32, f64)>;

/// The two local problems.
pub(super) struct NearCut {
    /// Nodes, by rows of the first problem.
    nodes: Vec<u32>,
    /// Rows of the second problem that each node moves with.
    homes: Vec<NodeWeights>,
    apart: SupernodalCholesky,
    together: SupernodalCholesky,
    flat: [Vec<f64>; 2],
}

/// A body around its cut.
pub(super) struct CutNeighbourhood<'a> {
    pub element_forces: ElementForces<'a>,
    /// Masses of the nodes \[kg\].
    pub masses: &'a [f64],
    /// Fixed nodes.
    pub is_fixed: &'a [bool],
    /// Number of original nodes, and for each new one the nodes it moves with.
    pub known: usize,
    pub parents: &'a [NodeWeights],
}

impl NearCut {
    /// Around the new nodes, at these positions \[m\].
    pub fn new(about: &CutNeighbourhood<'_>, positions: &[Point3<f64>]) -> Result<Self, FactorError> {
        let near = about.near();
        let elements: Vec<NearElement> = about
            .element_forces
            .elements
            .iter()
            .filter(|element| !element.is_gone() && element.nodes.iter().any(|node| near[*node as usize]))
            .map(|element| NearElement::new(element, &about.element_forces, positions))
            .collect();
        let own: Vec<u32> = (0..near.len() as u32).filter(|&node| near[node as usize]).collect();
        let mut alone = vec![NodeWeights::new(); near.len()];
        own.iter().zip(0_u32..).for_each(|(&node, row)| alone[node as usize].push((row, 1.0)));
        let (rows, apart) = factored(about, &elements, own.len(), &alone)?;
        let mut nodes = vec![0; own.len()];
        own.iter().zip(&rows).for_each(|(&node, &row)| nodes[row as usize] = node);
        // New nodes have no rows of their own here.
        let mut with = vec![NodeWeights::new(); near.len()];
        let former = own.iter().filter(|node| (**node as usize) < about.known);
        former.clone().zip(0_u32..).for_each(|(&node, row)| with[node as usize].push((row, 1.0)));
        let count = former.count();
        for (born, parents) in (about.known..).zip(about.parents).filter(|(born, _)| near[*born]) {
            let of = |&(node, share): &(u32, f64)| Some((with[node as usize].first()?.0, share));
            with[born] = parents.iter().filter_map(of).collect();
        }
        let (rows, together) = factored(about, &elements, count, &with)?;
        let at = |&(row, share): &(u32, f64)| (rows[row as usize], share);
        let homes = nodes.iter().map(|&node| with[node as usize].iter().map(at).collect()).collect();
        let flat = [vec![0.0; apart.rows()], vec![0.0; together.rows()]];
        Ok(Self { nodes, homes, apart, together, flat })
    }

    /// Takes the nodal forces \[N\].
    pub fn load(&mut self, forces: &[Vector3<f64>]) {
        let [apart, together] = &mut self.flat;
        together.fill(0.0);
        for (row, (&node, node_weights)) in self.nodes.iter().zip(&self.homes).enumerate() {
            let force = forces[node as usize];
            apart[3 * row..][..3].copy_from_slice(force.as_slice());
            for &(at, share) in node_weights {
                (0..3).for_each(|axis| together[3 * at as usize + axis] += force[axis] * share);
            }
        }
        self.apart.solve(apart);
        self.together.solve(together);
    }

    /// Adds the difference of the two responses \[m\].
    pub fn add(&self, moved: &mut [Vector3<f64>]) {
        let [apart, together] = &self.flat;
        let of = |flat: &[f64], row: usize| Vector3::from_column_slice(&flat[3 * row..][..3]);
        for (row, (&node, node_weights)) in self.nodes.iter().zip(&self.homes).enumerate() {
            let stays = node_weights.iter().map(|&(at, share)| of(together, at as usize) * share);
            moved[node as usize] += of(apart, row) - stays.sum::<Vector3<f64>>();
        }
    }
}

impl CutNeighbourhood<'_> {
    /// Free nodes near the cut: the new nodes, their parents, and layers around these.
    fn near(&self) -> Vec<bool> {
        let mut near: Vec<bool> = (0..self.masses.len()).map(|node| node >= self.known).collect();
        self.parents.iter().flatten().for_each(|&(node, _)| near[node as usize] = true);
        let count = |near: &[bool]| near.iter().filter(|near| **near).count();
        let mut before = count(&near);
        while before < NEAR_MAX {
            let mut more = near.clone();
            for element in self.element_forces.elements.iter().filter(|element| !element.is_gone()) {
                if element.nodes.iter().any(|node| near[*node as usize]) {
                    element.nodes.iter().for_each(|node| more[*node as usize] = true);
                }
            }
            let after = count(&more);
            if after == before || after > NEAR_MAX {
                break;
            }
            (near, before) = (more, after);
        }
        near.iter_mut().zip(self.is_fixed).for_each(|(near, fixed)| *near &= !fixed);
        near
    }
}

/// An element near the cut.
struct NearElement {
    nodes: [u32; 4],
    /// Its stiffness \[N/m\], damping included, between its nodes.
    blocks: [[Matrix3<f64>; 4]; 4],
}

impl NearElement {
    fn new(element: &Element, element_forces: &ElementForces<'_>, positions: &[Point3<f64>]) -> Self {
        let f = shape(positions, &element.nodes) * element.inverse_shape;
        let stiffness = element_forces.material.stiffness(&f);
        let turned = gradients(&element.inverse_shape).map(|gradient| stiffness.v.tr_mul(&gradient));
        // As in the global Hessian.
        let volume = element.volume * (1.0 + element_forces.damping.stiffness / element_forces.dt);
        let blocks = [0, 1, 2, 3].map(|i| turned.map(|with| stiffness.block(volume, &turned[i], &with)));
        Self { nodes: element.nodes, blocks }
    }
}

/// Factor of the elements over `count` unknowns with node weights, and the row of each.
fn factored(
    about: &CutNeighbourhood<'_>,
    elements: &[NearElement],
    count: usize,
    homes: &[NodeWeights],
) -> Result<(Vec<u32>, SupernodalCholesky), FactorError> {
    let mut pairs: Vec<(u32, u32)> = Vec::new();
    for element in elements {
        let all = || element.nodes.iter().flat_map(|node| &homes[*node as usize]).map(|(at, _)| *at);
        all().for_each(|a| pairs.extend(all().filter(|b| a < *b).map(|b| (a, b))));
    }
    pairs.sort_unstable();
    pairs.dedup();
    let order = minimum_degree(count, pairs.iter().copied());
    let mut rows = vec![0; count];
    order.iter().zip(0_u32..).for_each(|(&at, row)| rows[at as usize] = row);
    let pairs = pairs.iter().map(|&(a, b)| (rows[a as usize], rows[b as usize]));
    let mut matrix = BlockMatrix::zeros(BlockPattern::new(count, pairs));
    let mut add = |of: &NodeWeights, with: &NodeWeights, block: &Matrix3<f64>| {
        for &(a, share) in of {
            for &(b, weight) in with {
                let (row, column) = (rows[a as usize], rows[b as usize]);
                if row >= column {
                    matrix.add(row, column, &(block * (share * weight)));
                }
            }
        }
    };
    let dt = about.element_forces.dt;
    let inertia = 1.0 / (dt * dt) + about.element_forces.damping.mass / dt;
    for (node_weights, mass) in
        homes.iter().zip(about.masses).filter(|(node_weights, _)| !node_weights.is_empty())
    {
        add(node_weights, node_weights, &Matrix3::from_diagonal_element(mass * inertia));
    }
    for NearElement { nodes, blocks } in elements {
        for (node, row) in nodes.iter().zip(blocks) {
            for (other, block) in nodes.iter().zip(row) {
                add(&homes[*node as usize], &homes[*other as usize], block);
            }
        }
    }
    let mut factor = SupernodalCholesky::new(matrix.pattern(), 1)?;
    factor.factor(matrix.pattern(), matrix.values())?;
    Ok((rows, factor))
}

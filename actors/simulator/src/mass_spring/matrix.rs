//! System matrix of a backward Euler step, M(1 + hα) + hC + h²K, stored element by element: each contributes `a·I + b·u
//! uᵀ` times the products of its weights. With four numbers per element, a product with a vector reads less memory than
//! with the assembled matrix (`implicit/operator.rs`). Positive definite by construction: for a compressed spring only
//! the axial stiffness is kept.

use nalgebra::{Matrix3, Point3, Vector3};

use super::collapse::{self, Squeezed};
use super::contact::Contact;
use super::forces::pull_of_rest;
use super::network::Network;

/// `along·u uᵀ + all·I`, with `u` a unit vector.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Block {
    pub all: f64,
    pub along: f64,
    pub axis: Vector3<f64>,
}

impl Block {
    pub(super) fn matrix(&self) -> Matrix3<f64> {
        Matrix3::from_diagonal_element(self.all) + self.axis * self.axis.transpose() * self.along
    }
}

/// All terms of the matrix, in the order of the network's elements.
#[derive(Clone, Debug, Default)]
pub(super) struct StepMatrix {
    /// Mass of each node, including damping; 0 where it is held \[kg\].
    pub masses: Vec<f64>,
    pub springs: Vec<Block>,
    pub hinges: Vec<Block>,
    pub contacts: Vec<Block>,
    pub squeezed: Vec<Squeezed>,
}

impl StepMatrix {
    /// Linearises springs, hinges and tetrahedra at these positions; the pure stiffness matrix for `h` = 1 and `lag` = 0.
    pub fn linearise(&mut self, network: &Network, h: f64, lag: f64, positions: &[Point3<f64>]) {
        self.springs.clear();
        self.springs.extend(network.springs.iter().map(|spring| {
            let [a, b] = spring.nodes.map(|node| positions[node as usize]);
            let along = b - a;
            let length = along.norm();
            let inverse = if length > 0.0 { 1.0 / length } else { 0.0 };
            block(spring.stiffness, h, lag, along * inverse, 1.0 - spring.rest * inverse)
        }));
        self.hinges.clear();
        self.hinges.extend(network.hinges.iter().map(|hinge| {
            if hinge.rest == 0.0 && lag == 0.0 {
                return Block { all: h * h * hinge.stiffness, ..Block::default() };
            }
            let vector = hinge.vector(positions);
            let length = vector.norm();
            let pull =
                if hinge.rest > 0.0 { pull_of_rest(hinge.rest, length, hinge.sense(positions)) } else { 0.0 };
            let inverse = if length > 0.0 { 1.0 / length } else { 0.0 };
            block(hinge.stiffness, h, lag, vector * inverse, 1.0 - pull)
        }));
        collapse::linearise(network, h, positions, &mut self.squeezed);
    }

    /// Linearises contacts: a penalty where active, and friction as a drag at the current slip.
    pub fn press(&mut self, contact: &Contact, h: f64, pressing: f64, drag: f64) {
        let all = h * drag;
        let normal = if pressing > 0.0 { h * h * contact.stiffness + h * contact.damping } else { 0.0 };
        self.contacts.push(Block { all, along: normal - all, axis: contact.normal });
    }

    /// Calls `each` with every off-diagonal pair of nodes once: row, column and block; (row, column) but not (column,
    /// row). Without tetrahedra, whose blocks are not symmetric.
    pub fn for_each_pair(
        &self,
        network: &Network,
        contacts: &[Contact],
        mut each: impl FnMut(u32, u32, f64, &Block),
    ) {
        for (spring, block) in network.springs.iter().zip(&self.springs) {
            let [a, b] = spring.nodes;
            each(a, a, 1.0, block);
            each(b, b, 1.0, block);
            each(a, b, -1.0, block);
        }
        for (hinge, block) in network.hinges.iter().zip(&self.hinges) {
            pairs(&hinge.nodes, &hinge.weights, |a, b, weight| each(a, b, weight, block));
        }
        for (contact, block) in contacts.iter().zip(&self.contacts) {
            let joint = contact.joint();
            pairs(&joint.map(|of| of.0), &joint.map(|of| of.1), |a, b, weight| each(a, b, weight, block));
        }
    }
}

/// Each pair of an element's nodes once, except those with zero weight.
pub(super) fn pairs<const N: usize>(
    nodes: &[u32; N],
    weights: &[f64; N],
    mut each: impl FnMut(u32, u32, f64),
) {
    for first in 0..N {
        for second in 0..=first {
            let weight = weights[first] * weights[second];
            if weight != 0.0 {
                each(nodes[first], nodes[second], weight);
            }
        }
    }
}

/// Block of axial stiffness, transverse stiffness from tension, and axial damping.
#[inline]
fn block(stiffness: f64, h: f64, lag: f64, axis: Vector3<f64>, across: f64) -> Block {
    let stiff = h * h * stiffness;
    let all = stiff * across.max(0.0);
    // A compressed hinge that is inside out has a transverse share above 1: the axial term never becomes negative.
    Block { all, along: stiff - all.min(stiff) + h * lag * stiffness, axis }
}

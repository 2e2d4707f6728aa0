//! Block Jacobi preconditioner: the nodes' 3 × 3 diagonal blocks, rebuilt in each step.

use nalgebra::Matrix3;

use super::StepMatrix;
use super::conjugate_gradients::Preconditioner;
use super::rigid_operator::RigidOperator;
use crate::mass_spring::{Contact, Network};
use crate::simd::f64x4::Quad;

#[derive(Clone, Debug, Default)]
pub(super) struct NodeBlocks {
    inverse: Vec<Matrix3<f64>>,
    /// Columns of the inverse blocks.
    columns: Vec<[Quad; 3]>,
}

impl NodeBlocks {
    /// Builds the blocks from the current matrix.
    pub fn update(
        &mut self,
        matrix: &StepMatrix,
        network: &Network,
        contacts: &[Contact],
        rigid: &RigidOperator,
    ) {
        self.inverse.clear();
        self.inverse.extend(matrix.masses.iter().map(|&mass| Matrix3::from_diagonal_element(mass)));
        for (spring, block) in network.springs.iter().zip(&matrix.springs) {
            let own = block.matrix();
            self.inverse[spring.nodes[0] as usize] += own;
            self.inverse[spring.nodes[1] as usize] += own;
        }
        for (hinge, block) in network.hinges.iter().zip(&matrix.hinges) {
            let own = block.matrix();
            for (node, weight) in hinge.nodes.into_iter().zip(hinge.weights) {
                self.inverse[node as usize] += own * (weight * weight);
            }
        }
        for (contact, block) in contacts.iter().zip(&matrix.contacts) {
            let own = block.matrix();
            for (node, share) in contact.joint() {
                self.inverse[node as usize] += own * (share * share);
            }
        }
        for of in &matrix.squeezed {
            for (node, along) in of.nodes.into_iter().zip(&of.along) {
                self.inverse[node as usize] += along * along.transpose();
            }
        }
        for (joint, axis, stiffness) in rigid.contacts() {
            let own = axis * axis.transpose() * stiffness;
            for (node, share) in joint {
                self.inverse[node as usize] += own * (share * share);
            }
        }
        for (inverse, mass) in self.inverse.iter_mut().zip(&matrix.masses) {
            *inverse = if *mass > 0.0 {
                inverse.try_inverse().unwrap_or_else(|| Matrix3::from_diagonal_element(1.0 / mass))
            } else {
                // A held node has a zero block: its residual never becomes a direction.
                Matrix3::zeros()
            };
        }
        self.columns.clear();
        self.columns.extend(
            self.inverse.iter().map(|inverse| {
                std::array::from_fn(|column| Quad::from(&inverse.column(column).into_owned()))
            }),
        );
    }
}

impl Preconditioner for NodeBlocks {
    #[inline(always)]
    fn apply(&mut self, _: &[f64], residual: &[Quad], product: &mut [Quad]) {
        for ((product, [x, y, z]), residual) in product.iter_mut().zip(&self.columns).zip(residual) {
            *product = *x * residual.0[0] + *y * residual.0[1] + *z * residual.0[2];
        }
    }
}

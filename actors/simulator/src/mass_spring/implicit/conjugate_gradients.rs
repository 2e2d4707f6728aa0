//! Conjugate gradients on the step's matrix, preconditioned by the nodes' own 3 × 3 blocks.

use nalgebra::{Matrix3, Vector3};

use super::StepMatrix;
use crate::mass_spring::{Contact, Network};

#[derive(Clone, Debug)]
pub(super) struct ConjugateGradients {
    tolerance: f64,
    iterations_max: u32,
    inverse: Vec<Matrix3<f64>>,
    residual: Vec<Vector3<f64>>,
    direction: Vec<Vector3<f64>>,
    product: Vec<Vector3<f64>>,
}

impl ConjugateGradients {
    pub fn new(tolerance: f64, iterations_max: u32) -> Self {
        let (inverse, residual) = (Vec::new(), Vec::new());
        Self { tolerance, iterations_max, inverse, residual, direction: Vec::new(), product: Vec::new() }
    }

    /// Iterations taken, and what remains of the right-hand side, in the preconditioner's norm.
    pub fn solve(
        &mut self,
        matrix: &StepMatrix,
        network: &Network,
        contacts: &[Contact],
        right: &[Vector3<f64>],
        solution: &mut [Vector3<f64>],
    ) -> (u32, f64) {
        self.invert_blocks(matrix, network, contacts);
        solution.fill(Vector3::zeros());
        self.residual.clear();
        self.residual.extend_from_slice(right);
        self.direction.clear();
        self.direction.extend(self.inverse.iter().zip(right).map(|(inverse, right)| inverse * right));
        self.product.resize(right.len(), Vector3::zeros());
        let mut size = dot(&self.residual, &self.direction);
        let begun = size;
        let wanted = self.tolerance * self.tolerance * begun;
        let mut iterations = 0;
        while iterations < self.iterations_max && size > wanted && size > 0.0 {
            iterations += 1;
            for ((product, mass), direction) in
                self.product.iter_mut().zip(&matrix.masses).zip(&self.direction)
            {
                *product = direction * *mass;
            }
            matrix.add_product(network, contacts, &self.direction, &mut self.product);
            let curvature = dot(&self.direction, &self.product);
            if curvature.is_nan() || curvature <= 0.0 {
                break;
            }
            let along = size / curvature;
            let mut next = 0.0;
            let vectors = solution.iter_mut().zip(&mut self.residual).zip(&mut self.product);
            for (((solution, residual), product), (direction, inverse)) in
                vectors.zip(self.direction.iter().zip(&self.inverse))
            {
                *solution += direction * along;
                // A held node has an empty block: its residual never becomes a direction.
                *residual -= *product * along;
                *product = inverse * *residual;
                next += residual.dot(product);
            }
            let keep = next / size;
            size = next;
            for (direction, preconditioned) in self.direction.iter_mut().zip(&self.product) {
                *direction = preconditioned + *direction * keep;
            }
        }
        (iterations, if begun > 0.0 { (size / begun).max(0.0).sqrt() } else { 0.0 })
    }

    fn invert_blocks(&mut self, matrix: &StepMatrix, network: &Network, contacts: &[Contact]) {
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
        for (inverse, mass) in self.inverse.iter_mut().zip(&matrix.masses) {
            *inverse = if *mass > 0.0 {
                inverse.try_inverse().unwrap_or_else(|| Matrix3::from_diagonal_element(1.0 / mass))
            } else {
                Matrix3::zeros()
            };
        }
    }
}

fn dot(first: &[Vector3<f64>], second: &[Vector3<f64>]) -> f64 {
    first.iter().zip(second).map(|(first, second)| first.dot(second)).sum()
}

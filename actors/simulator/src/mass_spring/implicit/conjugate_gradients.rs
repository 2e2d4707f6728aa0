//! Conjugate gradients on the step's matrix, which is never formed.

use nalgebra::Vector3;

use super::StepMatrix;
use crate::mass_spring::{Contact, Network};

/// Something near the inverse of the matrix: symmetric and definite on the nodes that are free, nothing on those held.
pub(super) trait Preconditioner {
    fn apply(&mut self, matrix: &StepMatrix, residual: &[Vector3<f64>], product: &mut [Vector3<f64>]);
}

#[derive(Clone, Debug)]
pub(super) struct ConjugateGradients {
    tolerance: f64,
    iterations_max: u32,
    residual: Vec<Vector3<f64>>,
    preconditioned: Vec<Vector3<f64>>,
    direction: Vec<Vector3<f64>>,
    product: Vec<Vector3<f64>>,
}

impl ConjugateGradients {
    pub fn new(tolerance: f64, iterations_max: u32) -> Self {
        let (residual, preconditioned) = (Vec::new(), Vec::new());
        let (direction, product) = (Vec::new(), Vec::new());
        Self { tolerance, iterations_max, residual, preconditioned, direction, product }
    }

    /// Iterations taken, and what remains of the right-hand side, in the preconditioner's norm.
    pub fn solve(
        &mut self,
        preconditioner: &mut impl Preconditioner,
        (matrix, network, contacts): (&StepMatrix, &Network, &[Contact]),
        right: &[Vector3<f64>],
        solution: &mut [Vector3<f64>],
    ) -> (u32, f64) {
        solution.fill(Vector3::zeros());
        self.residual.clear();
        self.residual.extend_from_slice(right);
        for vector in [&mut self.preconditioned, &mut self.product] {
            vector.resize(right.len(), Vector3::zeros());
        }
        preconditioner.apply(matrix, &self.residual, &mut self.preconditioned);
        self.direction.clear();
        self.direction.extend_from_slice(&self.preconditioned);
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
            for ((solution, residual), (direction, product)) in
                solution.iter_mut().zip(&mut self.residual).zip(self.direction.iter().zip(&self.product))
            {
                *solution += direction * along;
                *residual -= product * along;
            }
            preconditioner.apply(matrix, &self.residual, &mut self.preconditioned);
            // Against the change of the residual, so that a preconditioner of few digits does not spoil the directions
            // (Golub and Ye 1999).
            let keep = -along * dot(&self.preconditioned, &self.product) / size;
            size = dot(&self.residual, &self.preconditioned);
            for (direction, preconditioned) in self.direction.iter_mut().zip(&self.preconditioned) {
                *direction = preconditioned + *direction * keep;
            }
        }
        (iterations, if begun > 0.0 { (size / begun).max(0.0).sqrt() } else { 0.0 })
    }
}

fn dot(first: &[Vector3<f64>], second: &[Vector3<f64>]) -> f64 {
    first.iter().zip(second).map(|(first, second)| first.dot(second)).sum()
}

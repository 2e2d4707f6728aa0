//! Matrix-free conjugate gradients on the step's matrix.

use nalgebra::Vector3;

use super::operator::Operator;
use crate::simd::dispatch::wide;
use crate::simd::f64x4::{Quad, dot};

/// An approximate inverse of the matrix: symmetric and definite on free nodes, zero on held ones.
pub(super) trait Preconditioner {
    /// Always inlined, so that it is compiled for the same registers as the iteration.
    fn apply(&mut self, masses: &[f64], residual: &[Quad], product: &mut [Quad]);
}

#[derive(Clone, Debug)]
pub(super) struct ConjugateGradients {
    tolerance: f64,
    iterations_max: u32,
    solution: Vec<Quad>,
    residual: Vec<Quad>,
    preconditioned: Vec<Quad>,
    direction: Vec<Quad>,
    product: Vec<Quad>,
}

impl ConjugateGradients {
    pub fn new(tolerance: f64, iterations_max: u32) -> Self {
        let [solution, residual, preconditioned, direction, product] = [const { Vec::new() }; 5];
        Self { tolerance, iterations_max, solution, residual, preconditioned, direction, product }
    }

    /// Solves; returns the iterations taken and the relative residual in the preconditioner's norm.
    pub fn solve(
        &mut self,
        preconditioner: &mut impl Preconditioner,
        operator: &Operator,
        right: &[Vector3<f64>],
        solution: &mut [Vector3<f64>],
    ) -> (u32, f64) {
        self.residual.clear();
        self.residual.extend(right.iter().map(Quad::from));
        for vector in [&mut self.solution, &mut self.preconditioned, &mut self.product] {
            vector.clear();
            vector.resize(right.len(), Quad::default());
        }
        let report = wide(
            #[inline(always)]
            || self.iterate(preconditioner, operator),
        );
        solution.iter_mut().zip(&self.solution).for_each(|(slot, solution)| *slot = solution.vector());
        report
    }

    #[inline(always)]
    fn iterate(&mut self, preconditioner: &mut impl Preconditioner, operator: &Operator) -> (u32, f64) {
        let Self { tolerance, iterations_max, solution, residual, preconditioned, direction, product } = self;
        let masses = &operator.masses;
        preconditioner.apply(masses, residual, preconditioned);
        direction.clone_from(preconditioned);
        let mut size = dot(residual, direction);
        let begun = size;
        let wanted = *tolerance * *tolerance * begun;
        let mut iterations = 0;
        while iterations < *iterations_max && size > wanted && size > 0.0 {
            iterations += 1;
            operator.apply(direction, product);
            let curvature = dot(direction, product);
            if curvature.is_nan() || curvature <= 0.0 {
                break;
            }
            let along = size / curvature;
            for ((solution, residual), (direction, product)) in
                solution.iter_mut().zip(residual.iter_mut()).zip(direction.iter().zip(product.iter()))
            {
                *solution += *direction * along;
                *residual -= *product * along;
            }
            preconditioner.apply(masses, residual, preconditioned);
            // Flexible variant, with the change of the residual: an inexact preconditioner does not spoil the
            // directions (Golub and Ye 1999).
            let keep = -along * dot(preconditioned, product) / size;
            size = dot(residual, preconditioned);
            for (direction, preconditioned) in direction.iter_mut().zip(preconditioned.iter()) {
                *direction = *preconditioned + *direction * keep;
            }
        }
        (iterations, if begun > 0.0 { (size / begun).max(0.0).sqrt() } else { 0.0 })
    }
}

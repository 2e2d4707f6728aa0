//! L-BFGS memory (Nocedal 1980): pairs of steps and gradient changes.

use nalgebra::Vector3;

/// Number of pairs kept.
const PAIRS: usize = 8;

/// A ring buffer of pairs; its memory is reused from step to step.
#[derive(Default)]
pub(super) struct Memory {
    steps: Vec<Vec<Vector3<f64>>>,
    changes: Vec<Vec<Vector3<f64>>>,
    inverse: Vec<f64>,
    share: Vec<f64>,
    first: usize,
    count: usize,
}

pub(super) fn dot(a: &[Vector3<f64>], b: &[Vector3<f64>]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a.dot(b)).sum()
}

fn add(to: &mut [Vector3<f64>], from: &[Vector3<f64>], factor: f64) {
    to.iter_mut().zip(from).for_each(|(to, from)| *to += from * factor);
}

impl Memory {
    /// Allocates for this many nodes.
    pub fn new(nodes: usize) -> Self {
        let room = || vec![vec![Vector3::zeros(); nodes]; PAIRS];
        Self {
            steps: room(),
            changes: room(),
            inverse: vec![0.0; PAIRS],
            share: vec![0.0; PAIRS],
            first: 0,
            count: 0,
        }
    }

    pub fn forget(&mut self) {
        self.count = 0;
    }

    /// Stores the gradient change of a step; skipped where curvature is negative.
    pub fn remember(
        &mut self,
        direction: &[Vector3<f64>],
        length: f64,
        from: &[Vector3<f64>],
        to: &[Vector3<f64>],
    ) {
        let slot = (self.first + self.count) % PAIRS;
        let (step, change) = (&mut self.steps[slot], &mut self.changes[slot]);
        for node in 0..step.len() {
            step[node] = direction[node] * length;
            change[node] = to[node] - from[node];
        }
        let curvature = dot(step, change);
        if !(curvature > 1e-14 * (dot(step, step) * dot(change, change)).sqrt()) {
            return;
        }
        self.inverse[slot] = curvature.recip();
        if self.count < PAIRS { self.count += 1 } else { self.first = (self.first + 1) % PAIRS }
    }

    /// Multiplies a gradient by H, where `base` applies the initial inverse Hessian.
    pub fn apply(&mut self, vector: &mut [Vector3<f64>], base: impl FnOnce(&mut [Vector3<f64>])) {
        for back in (0..self.count).rev() {
            let slot = (self.first + back) % PAIRS;
            let share = self.inverse[slot] * dot(&self.steps[slot], vector);
            self.share[slot] = share;
            add(vector, &self.changes[slot], -share);
        }
        base(vector);
        for on in 0..self.count {
            let slot = (self.first + on) % PAIRS;
            let other = self.inverse[slot] * dot(&self.changes[slot], vector);
            add(vector, &self.steps[slot], self.share[slot] - other);
        }
    }
}

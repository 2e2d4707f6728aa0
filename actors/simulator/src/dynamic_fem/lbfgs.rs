//! What a quasi-Newton method remembers of the last iterates (Nocedal 1980): pairs of steps and changes of the gradient.

use nalgebra::Vector3;

/// Pairs that are remembered.
const PAIRS: usize = 8;

/// A ring of pairs; its memory is kept from step to step.
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
    /// Makes room for so many nodes.
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

    /// Remembers that this step changed the gradient from one to another; not where curvature is negative.
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

    /// Turns a gradient into H times it, where `base` applies the first guess of the inverse Hessian.
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

//! Prediction of a body's next step, for contact between two steps.

use nalgebra::Vector3;

use super::incremental_potential::Inputs;
use super::solver::DynamicFem;
use super::stale_factor;

impl DynamicFem {
    /// Mass of each node \[kg\].
    #[must_use]
    pub fn masses(&self) -> &[f64] {
        &self.mass.lumped
    }

    /// Velocities of all nodes after one more step with the same inputs \[m/s\]: by one iteration with the factor of
    /// the last step; the current ones without a factor or after a failed iteration. Overwrites the reactions.
    pub fn expected(&mut self, dt: f64, inputs: &Inputs, velocities: &mut Vec<Vector3<f64>>) {
        velocities.clone_from(&self.velocities);
        if self.factored_at.dt != dt || self.factored_at.positions.is_empty() {
            return;
        }
        let mut work = std::mem::take(&mut self.work);
        self.begin(dt, inputs, &mut work);
        self.memory.forget();
        self.evaluate(dt, inputs, &mut work, |work| &work.now);
        std::mem::swap(&mut work.gradient, &mut work.next);
        self.descend(&mut work);
        for (node, velocity) in velocities.iter_mut().enumerate().filter(|(node, _)| !work.held[*node]) {
            let expected = (work.now[node] + work.direction[node] - self.positions[node]) / dt;
            if expected.iter().all(|x| x.is_finite()) {
                *velocity = expected;
            }
        }
        self.work = work;
    }

    /// Effective inverse mass of these nodes when all receive equal impulses in a step of `dt` seconds \[1/kg\], the
    /// mean over directions, by the factor of the last step; inverse nodal masses before the first step. 0 where held.
    pub fn yielding(&mut self, dt: f64, nodes: &[u32]) -> Vec<f64> {
        let mass = |node: u32| self.mass.lumped[node as usize];
        let alone = |node: u32| if self.moves(node as usize) { mass(node).recip() } else { 0.0 };
        let mut yielding: Vec<f64> = nodes.iter().map(|&node| alone(node)).collect();
        if self.factored_at.positions.is_empty() {
            return yielding;
        }
        yielding.fill(0.0);
        let mut vector = vec![Vector3::zeros(); self.positions.len()];
        for axis in 0..3 {
            vector.fill(Vector3::zeros());
            nodes.iter().for_each(|&node| vector[node as usize][axis] = 1.0);
            let flat = &mut self.work.flat;
            flat.fill(0.0);
            stale_factor::solve(&mut self.factor, &self.numbers, self.lent.as_mut(), flat, &mut vector);
            for (&node, yielding) in nodes.iter().zip(&mut yielding) {
                // The factor maps displacements to forces: an impulse is a force times the step, and a velocity is a
                // displacement over the step.
                *yielding += vector[node as usize][axis] / (3.0 * dt * dt);
            }
        }
        yielding.iter_mut().for_each(|yielding| *yielding = yielding.max(0.0));
        yielding
    }
}

//! Newton iterations of a volume that bears rigid bodies or is squeezed, with a line search: which contacts press, and how
//! far tetrahedra are squeezed, changes within a step, and full steps would alternate between two sets of contacts.
//!
//! The step minimises an incremental potential (Martin, Thomaszewski, Grinspun and Gross, *Example-based elastic
//! materials*, 2011), whose slope along a direction is the residual times it. No energy is evaluated: a step is shortened
//! until the slope at its end is small or still descends.

use nalgebra::Vector3;

use super::{Implicit, Input, MassSpring, answer_to, forces};

/// Maximum number of iterations beyond those configured.
pub(super) const SEARCHES_MAX: u32 = 12;
/// Maximum number of trials of a line search.
const TRIALS_MAX: u32 = 6;
/// Slope at the end of a step that overshoots, over that at its beginning, up to which it is taken.
const OVERSHOOT: f64 = 0.5;
/// Residual at which the iteration ends, over that of the first iterate or of gravity.
const TOLERANCE: f64 = 1e-3;

/// Where a search stands: squared residuals, in the norm of kinetic energy \[J\].
#[derive(Clone, Copy, Debug)]
pub(super) struct Search {
    wanted: f64,
    now: f64,
}

impl Search {
    pub fn is_solved(&self) -> bool {
        self.now <= self.wanted
    }
}

impl MassSpring {
    /// At the first iterate, whose residual is the right-hand side.
    pub(super) fn begin_search(&self, implicit: &Implicit, h: f64, input: &Input<'_>) -> Search {
        let begun = self.size(&implicit.right);
        let weight: f64 = self.network.masses.iter().sum::<f64>() * (input.gravity * h).norm_squared();
        Search { wanted: TOLERANCE * TOLERANCE * begun.max(weight), now: begun }
    }

    /// Shortens the change of velocity of this iteration until it decreases the potential, and moves there.
    pub(super) fn search(&mut self, search: &mut Search, implicit: &mut Implicit, h: f64, input: &Input<'_>) {
        let slope = |of: &[Vector3<f64>], change: &[Vector3<f64>]| -> f64 {
            of.iter().zip(change).map(|(of, change)| of.dot(change)).sum()
        };
        let begun = slope(&implicit.right, &implicit.change);
        let (mut low, mut high) = ((0.0, begun), None);
        let mut share = 1.0;
        for _ in 0..TRIALS_MAX {
            self.try_at(implicit, h, input);
            let now = slope(&implicit.trial, &implicit.change) / share;
            if now >= -OVERSHOOT * begun && (share == 1.0 || now <= OVERSHOOT * begun) {
                break;
            }
            if now < 0.0 {
                high = Some((share, now));
            } else {
                low = (share, now);
            }
            let Some(high) = high else { break };
            // The secant's root, inside of the bracket.
            let root = low.0 + (high.0 - low.0) * (low.1 / (low.1 - high.1)).clamp(0.1, 0.9);
            self.scale_change(implicit, root / share, h, input);
            share = root;
        }
        search.now = self.size(&implicit.trial);
    }

    /// Multiplies the change of velocity of this iteration, and moves there.
    fn scale_change(&mut self, implicit: &mut Implicit, by: f64, h: f64, input: &Input<'_>) {
        // Back by the part that is left out.
        implicit.change.iter_mut().for_each(|change| *change *= by - 1.0);
        self.advance(implicit, h, input);
        implicit.change.iter_mut().for_each(|change| *change *= by / (by - 1.0));
    }

    /// The residual at the present iterate, as the right-hand side of the next one.
    fn try_at(&mut self, implicit: &mut Implicit, h: f64, input: &Input<'_>) {
        let scratch = &mut self.scratch;
        let (positions, velocities) = (&scratch.next.positions, &scratch.next.velocities);
        scratch.forces.fill(Vector3::zeros());
        forces::add_all_forces(&self.network, self.config.lag, positions, velocities, &mut scratch.forces);
        for force in input.forces {
            scratch.forces[force.node as usize] += force.force;
        }
        for (contact, touched) in input.contacts.iter().zip(&scratch.touched) {
            let (force, _) = contact.force_at_end(positions, velocities, touched, h, &Vector3::zeros());
            for (node, share) in contact.joint() {
                scratch.forces[node as usize] += force * share;
            }
        }
        if !input.rigid.contacts.is_empty() {
            answer_to(velocities, &input.rigid, h, &mut scratch.rigid_trial);
            for (contact, force) in input.rigid.contacts.iter().zip(&scratch.rigid_trial.forces) {
                for (node, share) in contact.joint() {
                    scratch.forces[node as usize] += contact.normal * (force * share);
                }
            }
        }
        let damping = self.config.damping;
        for (node, trial) in implicit.trial.iter_mut().enumerate() {
            *trial = Vector3::zeros();
            if scratch.mobility[node] > 0.0 {
                let (velocity, before) = (velocities[node], self.state.velocities[node]);
                *trial = (before - velocity + (input.gravity - velocity * damping) * h)
                    * self.network.masses[node]
                    + scratch.forces[node] * h;
            }
        }
    }

    /// The square of a residual's size \[J\].
    fn size(&self, residual: &[Vector3<f64>]) -> f64 {
        let all = residual.iter().zip(&self.scratch.mobility);
        all.map(|(residual, mobility)| residual.norm_squared() * mobility).sum()
    }
}

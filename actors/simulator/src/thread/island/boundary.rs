//! What holds and surroundings do to the island, and feel of it.

use nalgebra::{Point3, Vector3};

use super::Island;
use crate::thread::frame::{angle_about, perpendicular};
use crate::thread::{Hold, Surroundings, ThreadMaterial, TwistHold};

impl Island {
    /// What strands in contact feel for moving across themselves, against what they touched at the beginning. Of another
    /// strand its velocity there is taken, which keeps the matrix narrow.
    pub(super) fn resist(&mut self, material: &ThreadMaterial, dt: f64) {
        let stiffness = material.contact_damping / dt;
        let velocities = &self.trial.velocities;
        let of = |edge: usize| (velocities[edge] + velocities[edge + 1]) * 0.5;
        for memory in &self.trial.contacts {
            let edge = memory.key.edge as usize;
            let other = memory.key.feature as usize;
            let pairs = if memory.key.with == 0 {
                [Some((edge, of(other) * dt)), Some((other, of(edge) * dt))]
            } else {
                let motion = self.motions.get(memory.key.with as usize - 1);
                [
                    motion.map(|motion| {
                        let at = self.trial.positions[edge];
                        (edge, motion.to * motion.from.inverse_transform_point(&at) - at)
                    }),
                    None,
                ]
            };
            for (edge, carried) in pairs.into_iter().flatten() {
                let tangent = self.at.tangents[edge];
                for node in [edge, edge + 1] {
                    let by = self.at.positions[node] - self.trial.positions[node] - carried;
                    let across = by - tangent * tangent.dot(&by);
                    for row in 0..3 {
                        self.right[node][row] -= 0.5 * stiffness * across[row];
                        for column in 0..3 {
                            let unit = f64::from(u8::from(row == column));
                            self.matrix.diagonal[node][(row, column)] +=
                                0.5 * stiffness * (unit - tangent[row] * tangent[column]);
                        }
                    }
                }
            }
        }
    }

    /// Of a hold on its node \[N\], and whether it is all that the hold can give; `share` of the way from the beginning
    /// of this part.
    pub(super) fn pull(&self, hold: &Hold, share: f64) -> (Vector3<f64>, bool) {
        let from = self.trial.positions[hold.node];
        let pull = (from + (hold.to - from) * share - self.at.positions[hold.node]) * hold.stiffness;
        let size = pull.norm();
        if size > hold.force_max { (pull * (hold.force_max / size), true) } else { (pull, false) }
    }

    /// How far an edge still has to turn \[rad\]; `share` of the way from the beginning of this part.
    pub(super) fn turn_left(&self, hold: &TwistHold, share: f64) -> f64 {
        let (tangent, director) = (&self.at.tangents[hold.edge], &self.at.directors[hold.edge]);
        let wanted = perpendicular(&hold.director, tangent);
        let left = angle_about(director, &wanted, tangent);
        // The whole way is what is left and what has been turned.
        (left + self.at.turns[hold.edge]) * share - self.at.turns[hold.edge]
    }

    /// Adds the forces of this part to what holds and obstacles feel, by its share of the step.
    pub(super) fn feel(&mut self, material: &ThreadMaterial, fractions: [f64; 2], around: &Surroundings) {
        let weight = fractions[1] - fractions[0];
        let share = weight / (1.0 - fractions[0]);
        for (index, hold) in around.holds.iter().enumerate() {
            let pull = self.pull(hold, share).0;
            self.hold_forces[index] += pull * weight;
        }
        for (index, hold) in around.twist_holds.iter().enumerate() {
            let stiffness = twist_hold_stiffness(material, self.trial.rest_lengths[hold.edge]);
            let left = self.turn_left(hold, share);
            self.hold_torques[index] += stiffness * left * weight;
        }
        for contact in self.active.iter().filter(|contact| contact.key.with > 0) {
            let index = contact.key.with as usize - 1;
            let force = -contact.rows.vector(&contact.force) * weight;
            let arm = contact.surface - Point3::from(around.obstacles[index].to.translation.vector);
            self.reactions[index].force += force;
            self.reactions[index].torque += arm.cross(&force);
        }
    }
}

/// Far stiffer than the edge against its neighbours \[N·m/rad\].
pub(super) fn twist_hold_stiffness(material: &ThreadMaterial, rest_length: f64) -> f64 {
    1e3 * material.twisting_stiffness / rest_length
}

//! Boundary conditions of the island, and the reactions of holds and surroundings.

use nalgebra::{Matrix3, Point3, Vector3};

use super::Island;
use crate::suture_thread::bishop_frame::{angle_about, perpendicular};
use crate::suture_thread::{Hold, Surroundings, ThreadMaterial, TwistHold};

impl Island {
    /// Force of a hold on its node \[N\] and its stiffness \[N/m\]; `share` is the fraction of the way from the
    /// beginning of this substep.
    pub(super) fn pull(&self, hold: &Hold, share: f64) -> (Vector3<f64>, Matrix3<f64>) {
        let from = self.trial.positions[hold.node];
        let pull = (from + (hold.to - from) * share - self.at.positions[hold.node]) * hold.stiffness;
        let size = pull.norm();
        if size <= hold.force_max {
            return (pull, Matrix3::identity() * hold.stiffness);
        }
        // At the force limit; the direction turns with the node.
        let (along, held) = (pull / size, hold.force_max / size);
        (pull * held, (Matrix3::identity() - along * along.transpose()) * (hold.stiffness * held))
    }

    /// Remaining rotation of a held edge \[rad\]; `share` is the fraction of the way from the beginning of this
    /// substep.
    pub(super) fn turn_left(&self, hold: &TwistHold, share: f64) -> f64 {
        let (tangent, director) = (&self.at.tangents[hold.edge], &self.at.directors[hold.edge]);
        let wanted = perpendicular(&hold.director, tangent);
        let left = angle_about(director, &wanted, tangent);
        // The whole way is the remaining plus the completed rotation.
        (left + self.at.turns[hold.edge]) * share - self.at.turns[hold.edge]
    }

    /// Accumulates the reactions of holds and obstacles in this substep, weighted by its share of the step.
    pub(super) fn feel(
        &mut self,
        material: &ThreadMaterial,
        fractions: [f64; 2],
        surroundings: &Surroundings,
    ) {
        let weight = fractions[1] - fractions[0];
        let share = weight / (1.0 - fractions[0]);
        for (index, hold) in surroundings.holds.iter().enumerate() {
            let pull = self.pull(hold, share).0;
            self.hold_forces[index] += pull * weight;
        }
        for (index, hold) in surroundings.twist_holds.iter().enumerate() {
            let stiffness = twist_hold_stiffness(material, self.trial.rest_lengths[hold.edge]);
            let left = self.turn_left(hold, share);
            self.hold_torques[index] += stiffness * left * weight;
        }
        let contacts = self.dense.iter().chain(&self.sprung).filter(|contact| contact.tie.is_none());
        for contact in contacts.filter(|contact| contact.key.with > 0) {
            let index = contact.key.with as usize - 1;
            let force = -contact.rows.vector(&contact.force) * weight;
            let arm = contact.surface - Point3::from(surroundings.obstacles[index].to.translation.vector);
            self.reactions[index].force += force;
            self.reactions[index].torque += arm.cross(&force);
        }
    }
}

/// Far stiffer than the edge against its neighbours \[N·m/rad\].
pub(super) fn twist_hold_stiffness(material: &ThreadMaterial, rest_length: f64) -> f64 {
    1e3 * material.twisting_stiffness / rest_length
}

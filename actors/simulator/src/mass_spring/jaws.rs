//! Jaws that hold nodes by friction (Coulomb): they stop what they hold, or slow it down as much as they can. Explicit
//! steps bound the impulse of each substep. An implicit step is tried with the nodes held; those of a grip that would
//! need more force than its jaws bear are stepped again as free nodes under that force (a return mapping).

use nalgebra::Vector3;
use trocar_dynamics::particles::StepError;
use trocar_dynamics::soft_body::jaw_friction::{GripForce, JawFriction};

use super::{Input, MassSpring, NodeForce, Report, forces};

impl MassSpring {
    /// Velocities of nodes in watched jaws after a substep of `part` \[s\], from the forces on them.
    pub(super) fn hold(&mut self, part: f64, input: &Input<'_>) {
        let (scratch, damping) = (&mut self.scratch, self.config.damping);
        scratch.stopping.clear();
        scratch.stopping.resize(scratch.grips.len(), Vector3::zeros());
        for (place, driven) in input.prescribed.iter().enumerate() {
            let node = driven.node as usize;
            let (Some((grip, _)), mobility) = (input.jaws.watched(place), self.mobility[node]) else {
                continue;
            };
            let velocity = &mut scratch.next.velocities[node];
            if mobility > 0.0 {
                *velocity += (scratch.forces[node] * mobility + input.gravity - *velocity * damping) * part;
                scratch.stopping[grip] += (scratch.driven[place] - *velocity) / mobility;
            }
        }
        for (place, driven) in input.prescribed.iter().enumerate() {
            let Some((grip, limit)) = input.jaws.watched(place) else { continue };
            let share = GripForce::share(&scratch.stopping[grip], limit * part);
            let velocity = &mut scratch.next.velocities[driven.node as usize];
            *velocity = if share < 1.0 {
                velocity.lerp(&scratch.driven[place], share)
            } else {
                scratch.driven[place]
            };
        }
        for ((grip, stopping), limit) in
            scratch.grips.iter_mut().zip(&scratch.stopping).zip(input.jaws.limits)
        {
            let share = GripForce::share(stopping, limit * part);
            grip.force += stopping * share;
            grip.slipped |= share < 1.0;
        }
    }

    /// An implicit step of `dt` \[s\], in which what the jaws cannot hold slips.
    pub(super) fn step_held(&mut self, dt: f64, input: &Input<'_>, newton: u32) -> Result<Report, StepError> {
        if !input.jaws.is_watching() {
            return self.step_implicit(dt, input, newton);
        }
        // Held nodes move as their jaws do.
        for (driven, velocity) in input.prescribed.iter().zip(&self.scratch.driven) {
            self.scratch.next.velocities[driven.node as usize] = *velocity;
        }
        let report = self.step_implicit(dt, input, newton)?;
        let mut grips = std::mem::take(&mut self.scratch.grips);
        let mut given = std::mem::take(&mut self.scratch.given);
        let mut kept = std::mem::take(&mut self.scratch.kept);
        self.bear(dt, input, &mut grips);
        let slips = grips.iter().any(|grip| grip.slipped);
        let report = if slips {
            kept.clear();
            given.clear();
            given.extend_from_slice(input.forces);
            for (place, driven) in input.prescribed.iter().enumerate() {
                let Some((grip, limit)) = input.jaws.watched(place).filter(|(grip, _)| grips[*grip].slipped)
                else {
                    kept.push(*driven);
                    continue;
                };
                let own = self.holding(dt, driven.node, &self.scratch.driven[place], input);
                let share = GripForce::share(&grips[grip].force, limit);
                given.push(NodeForce { node: driven.node, force: own * share });
            }
            let again = Input { forces: &given, prescribed: &kept, jaws: JawFriction::default(), ..*input };
            self.prepare(dt, &again);
            let report = self.step_implicit(dt, &again, newton);
            for (grip, limit) in grips.iter_mut().zip(input.jaws.limits).filter(|(grip, _)| grip.slipped) {
                grip.force *= GripForce::share(&grip.force, *limit);
            }
            report
        } else {
            Ok(report)
        };
        (self.scratch.grips, self.scratch.given, self.scratch.kept) = (grips, given, kept);
        report
    }

    /// The forces that would hold what watched jaws hold, at the end of a tried step.
    fn bear(&mut self, dt: f64, input: &Input<'_>, grips: &mut [GripForce]) {
        let scratch = &mut self.scratch;
        scratch.forces.fill(Vector3::zeros());
        let next = &scratch.next;
        forces::add_all_forces(
            &self.network,
            self.config.lag,
            &next.positions,
            &next.velocities,
            &mut scratch.forces,
        );
        for force in input.forces {
            scratch.forces[force.node as usize] += force.force;
        }
        for (place, driven) in input.prescribed.iter().enumerate() {
            if let Some((grip, _)) = input.jaws.watched(place) {
                grips[grip].force += self.holding(dt, driven.node, &self.scratch.driven[place], input);
            }
        }
        for (grip, limit) in grips.iter_mut().zip(input.jaws.limits) {
            grip.slipped = GripForce::share(&grip.force, *limit) < 1.0;
        }
    }

    /// The force that makes a node move with its jaws, from the forces at the end of the step \[N\].
    fn holding(&self, dt: f64, node: u32, velocity: &Vector3<f64>, input: &Input<'_>) -> Vector3<f64> {
        let node = node as usize;
        let change = (velocity - self.state.velocities[node]) / dt;
        (change + velocity * self.config.damping - input.gravity) * self.network.masses[node]
            - self.scratch.forces[node]
    }
}

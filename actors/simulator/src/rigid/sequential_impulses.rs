//! The impulses of contacts, and the moves that undo penetration.

use nalgebra::{Matrix3, UnitQuaternion, Vector3};

use super::contact::{ContactConfig, ContactImpulse, RigidContact};
use super::contact_constraint::{Row, Twist};
use super::islands::Islands;
use super::jaw_joint::{Arm, Joint, Turning};
use super::{RigidMass, RigidState};

/// Buffers of the solve.
#[derive(Clone, Debug, Default)]
pub(super) struct Response {
    rows: Vec<Row>,
    islands: Islands,
    pub impulses: Vec<ContactImpulse>,
    /// How often a contact was solved in the last step.
    pub visits: u64,
    /// Of the bodies, and of what stands.
    twists: Vec<Twist>,
    undo: Vec<Twist>,
    inverse: Vec<(f64, Matrix3<f64>)>,
    turning: Vec<Turning>,
}

impl Response {
    /// Changes the momenta of `next`; speeds of approach are those of `before` and what forces did since. `own_arms` says which
    /// contacts move with openings of jaws: one entry for each contact, or none at all.
    #[allow(clippy::too_many_arguments)] // what a step is about
    pub(super) fn solve(
        &mut self,
        dt: f64,
        masses: &[RigidMass],
        before: &[RigidState],
        next: &mut [RigidState],
        contacts: &[RigidContact],
        own_arms: &[[Option<Arm>; 2]],
        joints: &mut [Joint],
        config: &ContactConfig,
    ) {
        self.undo.clear();
        self.visits = 0;
        if contacts.is_empty() && joints.is_empty() {
            self.impulses.clear();
            return;
        }
        let Self { rows, islands, impulses, visits, twists, undo, inverse, turning } = self;
        turning.clear();
        turning.extend(joints.iter().map(Turning::begin));
        // A list of other length is of other contacts; one of the same that is not the same costs rounds, no more.
        let is_warm = impulses.len() == contacts.len();
        twists.clear();
        inverse.clear();
        for (mass, (state, next)) in masses.iter().zip(before.iter().zip(next.iter())) {
            let turned = mass.inverse_inertia_in_world(&state.rotation);
            inverse.push((1.0 / mass.mass, turned));
            twists.push([next.momentum / mass.mass, turned * next.angular_momentum]);
        }
        let stands = masses.len();
        inverse.push((0.0, Matrix3::zeros()));
        twists.push([Vector3::zeros(); 2]);
        undo.resize(stands + 1, [Vector3::zeros(); 2]);
        rows.clear();
        islands.begin(stands, joints.len());
        for (index, contact) in contacts.iter().enumerate() {
            let bodies = [contact.body as usize, contact.other.map_or(stands, |other| other as usize)];
            let arms = bodies.map(|body| {
                before.get(body).map_or_else(Vector3::zeros, |body| contact.point_in_world - body.position)
            });
            let openings = own_arms.get(index).copied().unwrap_or_default();
            if bodies[1] < stands {
                islands.join(bodies[0], bodies[1]);
            }
            for arm in openings.iter().flatten() {
                islands.join(bodies[0], stands + arm.joint as usize);
            }
            let mut row = Row::new(contact, bodies, arms, openings, inverse, turning);
            // The approach when the step begins: what gravity adds in it would make every bounce a little higher.
            let of = |body: usize, arm: &Vector3<f64>| {
                before.get(body).map_or_else(Vector3::zeros, |state| {
                    masses[body].velocity(state) + masses[body].angular_velocity(state).cross(arm)
                })
            };
            let opening = |arm: Option<Arm>| {
                arm.map_or_else(Vector3::zeros, |arm| arm.arm * joints[arm.joint as usize].rate)
            };
            let approach = (of(bodies[0], &arms[0]) - of(bodies[1], &arms[1]) + opening(openings[0])
                - opening(openings[1])
                - contact.surface_velocity)
                .dot(&row.normal);
            if contact.depth < 0.0 {
                row.wanted = contact.depth / dt;
            }
            if approach < -config.rest_speed && contact.depth >= approach * dt {
                row.wanted = row.wanted.max(-contact.restitution * approach);
            }
            row.undo = config.correction * (contact.depth - config.slop).max(0.0) / dt;
            if is_warm {
                row.warm(&impulses[index].impulse, twists, turning);
            }
            rows.push(row);
        }
        islands.sort(stands, contacts.iter().map(|contact| contact.body as usize));
        // Each by itself: where one is hard to solve, the others need not wait.
        for (of_rows, of_joints) in islands.each() {
            for round in 0..config.iterations {
                // The largest speed that this round still changes.
                let mut change = 0.0_f64;
                for &joint in of_joints {
                    turning[joint as usize].solve(&joints[joint as usize], dt);
                }
                // There and back: one order only would lean every stack to one side.
                let mut solve = |row: &u32| {
                    change = change.max(rows[*row as usize].solve(twists, undo, turning));
                };
                if round % 2 == 0 {
                    of_rows.iter().for_each(&mut solve);
                } else {
                    of_rows.iter().rev().for_each(&mut solve);
                }
                *visits += of_rows.len() as u64;
                if change < config.tolerance {
                    break;
                }
            }
        }
        // Momenta by the impulses themselves: what one body gets the other gives, to the last bit but rounding.
        impulses.clear();
        for (row, contact) in rows.iter().zip(contacts) {
            let impulse = row.impulse();
            let bodies = [Some(contact.body), contact.other];
            for (body, sign) in bodies.iter().zip([1.0, -1.0]) {
                if let Some(body) = body {
                    let body = *body as usize;
                    next[body].momentum += impulse * sign;
                    next[body].angular_momentum +=
                        (contact.point_in_world - before[body].position).cross(&impulse) * sign;
                }
            }
            impulses.push(ContactImpulse { impulse });
        }
        for (turning, joint) in turning.iter().zip(joints.iter_mut()) {
            turning.end(joint, dt);
        }
    }

    /// Moves bodies out of each other, by velocities that are forgotten.
    pub(super) fn correct(&self, dt: f64, next: &mut [RigidState]) {
        for (state, [velocity, spin]) in next.iter_mut().zip(&self.undo) {
            if *velocity != Vector3::zeros() || *spin != Vector3::zeros() {
                state.position += velocity * dt;
                state.rotation = UnitQuaternion::from_scaled_axis(spin * dt) * state.rotation;
            }
        }
    }
}

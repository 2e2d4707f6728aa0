//! Sequential impulses for contacts, and split impulses that correct penetration.

use nalgebra::{Matrix3, UnitQuaternion, Vector3};

use super::body_joint::JointImpulse;
use super::contact::{ContactConfig, ContactImpulse, RigidContact};
use super::contact_constraint::{Row, Twist};
use super::direct_grasp::{self, DirectGrasp};
use super::islands::Islands;
use super::jaw_joint::{Arm, Joint, Turning};
use super::joint_system::{self, JointSystem};
use super::{Integrator, RigidMass, RigidState};

/// Stiffness of a contact point of a jaw \[N/m\]: under 100 N it gives way by 10 µm. Rigid points would leave it open
/// which of them bears: with all load on one corner of each pad, nothing keeps the body from turning about it.
const PAD_STIFFNESS: f64 = 1e7;
/// What jaws hold is solved directly once it has taken more iterations than this, and again after so many.
const DIRECT_AFTER: u32 = 15;
const DIRECT_EVERY: u32 = 40;

/// Buffers of the solve.
#[derive(Clone, Debug, Default)]
pub(super) struct Response {
    rows: Vec<Row>,
    islands: Islands,
    pub impulses: Vec<ContactImpulse>,
    /// Number of contact solves in the last step.
    pub visits: u64,
    /// Velocities of the bodies, then of the fixed world.
    twists: Vec<Twist>,
    undo: Vec<Twist>,
    inverse: Vec<(f64, Matrix3<f64>)>,
    turning: Vec<Turning>,
    direct: DirectGrasp,
    pub joints: JointSystem,
    /// Impulses of the joints of bodies in the last step.
    pub joint_impulses: Vec<JointImpulse>,
}

impl Response {
    /// Changes the momenta of `next`; approach velocities are those of `before` plus the effect of forces since.
    /// `own_arms` tells which contacts move with jaw openings: one entry per contact, or none at all.
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
        integrator: Integrator,
    ) {
        self.undo.clear();
        self.visits = 0;
        self.joint_impulses.clear();
        if contacts.is_empty() && joints.is_empty() && self.joints.is_empty() {
            self.impulses.clear();
            return;
        }
        let Self {
            rows,
            islands,
            impulses,
            visits,
            twists,
            undo,
            inverse,
            turning,
            direct,
            joints: body_joints,
            joint_impulses,
        } = self;
        turning.clear();
        turning.extend(joints.iter().map(|joint| Turning::begin(joint, dt)));
        // A list of another length has other contacts; a changed list of the same length only costs iterations.
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
        body_joints.begin(dt, before, inverse);
        body_joints.join(islands);
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
            // The approach velocity at the beginning of the step: gravity within the step would make every bounce
            // slightly higher.
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
            if row.has_openings() {
                row.soften(PAD_STIFFNESS, contact.depth.min(config.slop), dt);
            } else if contact.depth < 0.0 {
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
        body_joints.sort(islands);
        // Each island by itself: easy ones end early.
        for (island, (of_rows, of_joints)) in (0..).zip(islands.each()) {
            let has_joints = body_joints.is_in(island);
            let is_grasp = !of_joints.is_empty()
                && of_rows.len() <= direct_grasp::ROWS_MAX
                && of_rows.iter().any(|row| rows[*row as usize].has_openings());
            for _ in 0..=joint_system::ROUNDS_MAX + 1 {
                for round in 0..config.iterations {
                    // Largest velocity change in this iteration.
                    let mut change = 0.0_f64;
                    for &joint in of_joints {
                        turning[joint as usize].solve(&joints[joint as usize], dt);
                    }
                    // Forwards and backwards: one order only would tilt every stack to one side.
                    let mut solve = |row: &u32| {
                        change = change.max(rows[*row as usize].solve(twists, undo, turning));
                    };
                    if round % 2 == 0 {
                        of_rows.iter().for_each(&mut solve);
                    } else {
                        of_rows.iter().rev().for_each(&mut solve);
                    }
                    *visits += of_rows.len() as u64;
                    if has_joints {
                        body_joints.solve(island, twists, undo);
                    }
                    if change < config.tolerance {
                        break;
                    }
                    if round % DIRECT_EVERY == DIRECT_AFTER && is_grasp {
                        direct.solve(rows, of_rows, joints, of_joints, dt, twists, turning);
                    }
                }
                if !(has_joints && body_joints.look_ahead(island, dt, masses, next, twists, integrator)) {
                    break;
                }
            }
        }
        if body_joints.is_in(joint_system::ALONE) {
            for _ in 0..=joint_system::ROUNDS_MAX + 1 {
                body_joints.solve(joint_system::ALONE, twists, undo);
                if !body_joints.look_ahead(joint_system::ALONE, dt, masses, next, twists, integrator) {
                    break;
                }
            }
        }
        body_joints.divide(dt, masses, before, next, integrator);
        body_joints.end(next, joint_impulses);
        // Momenta from the impulses themselves: action and reaction agree to rounding.
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

    /// Separates penetrating bodies, by velocities that are discarded.
    pub(super) fn correct(&self, dt: f64, next: &mut [RigidState]) {
        for (state, [velocity, spin]) in next.iter_mut().zip(&self.undo) {
            if *velocity != Vector3::zeros() || *spin != Vector3::zeros() {
                state.position += velocity * dt;
                state.rotation = UnitQuaternion::from_scaled_axis(spin * dt) * state.rotation;
            }
        }
    }
}

//! The impulses of contacts, and the moves that undo penetration.

use nalgebra::{Matrix3, UnitQuaternion, Vector3};

use super::contact::{ContactConfig, ContactImpulse, RigidContact};
use super::joint::{Arm, Joint, Turning};
use super::{RigidMass, RigidState};

/// A contact during the solve.
#[derive(Clone, Copy, Debug)]
struct Row {
    bodies: [Option<usize>; 2],
    arms: [Vector3<f64>; 2],
    /// Openings of jaws that move the point.
    joints: [Option<Arm>; 2],
    normal: Vector3<f64>,
    /// Velocity along the normal that is wanted at least \[m/s\].
    wanted: f64,
    /// The same, of the velocities that undo penetration.
    undo: f64,
    surface: Vector3<f64>,
    friction: f64,
    /// Inverse of what the contact feels as mass, along the normal, and in all directions.
    normal_mass: f64,
    mass: Matrix3<f64>,
    /// The same in that direction across in which the contact is felt least.
    least_mass: f64,
    /// What an impulse makes of its speed, over all directions \[1/kg\].
    yields: f64,
    along: f64,
    across: Vector3<f64>,
    undone: f64,
}

/// Buffers of the solve.
#[derive(Clone, Debug, Default)]
pub(super) struct Response {
    rows: Vec<Row>,
    pub impulses: Vec<ContactImpulse>,
    /// Over all contacts in the last step.
    pub rounds: u32,
    /// Velocity and angular velocity.
    velocities: Vec<[Vector3<f64>; 2]>,
    undo: Vec<[Vector3<f64>; 2]>,
    inverse: Vec<(f64, Matrix3<f64>)>,
    turning: Vec<Turning>,
}

fn speed(velocities: &[[Vector3<f64>; 2]], row: &Row) -> Vector3<f64> {
    let of = |side: usize| {
        row.bodies[side].map_or_else(Vector3::zeros, |body| {
            velocities[body][0] + velocities[body][1].cross(&row.arms[side])
        })
    };
    of(0) - of(1)
}

/// What openings of jaws add to it.
fn turned(turning: &[Turning], row: &Row) -> Vector3<f64> {
    let of = |side: usize| {
        row.joints[side].map_or_else(Vector3::zeros, |arm| arm.arm * turning[arm.joint as usize].rate)
    };
    of(0) - of(1)
}

fn turn(turning: &mut [Turning], row: &Row, impulse: &Vector3<f64>) {
    for (side, sign) in [(0, 1.0), (1, -1.0)] {
        if let Some(Arm { joint, arm }) = row.joints[side] {
            let turning = &mut turning[joint as usize];
            turning.rate += sign * turning.inverse * arm.dot(impulse);
        }
    }
}

fn push(
    velocities: &mut [[Vector3<f64>; 2]],
    inverse: &[(f64, Matrix3<f64>)],
    row: &Row,
    impulse: &Vector3<f64>,
) {
    for (side, sign) in [(0, 1.0), (1, -1.0)] {
        if let Some(body) = row.bodies[side] {
            velocities[body][0] += impulse * (sign * inverse[body].0);
            velocities[body][1] += inverse[body].1 * row.arms[side].cross(impulse) * sign;
        }
    }
}

/// What an impulse across `normal` makes of the speed across at most, over all directions \[1/kg\].
pub(crate) fn most_across(feels: &Matrix3<f64>, normal: &Vector3<f64>) -> f64 {
    let across = Matrix3::identity() - normal * normal.transpose();
    let feels = across * feels * across;
    // Of the two numbers that are not zero: their sum, and the sum of their squares.
    let (sum, squares) = (feels.trace(), feels.norm_squared());
    0.5 * (sum + (2.0 * squares - sum * sum).max(0.0).sqrt())
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
        self.rounds = 0;
        if contacts.is_empty() && joints.is_empty() {
            self.impulses.clear();
            return;
        }
        let Self { rows, impulses, rounds, velocities, undo, inverse, turning } = self;
        turning.clear();
        turning.extend(joints.iter().map(Turning::begin));
        // A list of other length is of other contacts; one of the same that is not the same costs rounds, no more.
        let is_warm = impulses.len() == contacts.len();
        velocities.clear();
        inverse.clear();
        for (mass, (state, next)) in masses.iter().zip(before.iter().zip(next.iter())) {
            let turned = mass.inverse_inertia_in_world(&state.rotation);
            inverse.push((1.0 / mass.mass, turned));
            velocities.push([next.momentum / mass.mass, turned * next.angular_momentum]);
            undo.push([Vector3::zeros(); 2]);
        }
        rows.clear();
        for (index, contact) in contacts.iter().enumerate() {
            let bodies = [Some(contact.body as usize), contact.other.map(|other| other as usize)];
            let arms = bodies.map(|body| {
                body.map_or_else(Vector3::zeros, |body| contact.point_in_world - before[body].position)
            });
            let mut feels = Matrix3::zeros();
            for (body, arm) in bodies.iter().zip(&arms) {
                if let Some(body) = body {
                    let cross = arm.cross_matrix();
                    feels += Matrix3::identity() * inverse[*body].0 - cross * inverse[*body].1 * cross;
                }
            }
            let openings = own_arms.get(index).copied().unwrap_or_default();
            for arm in openings.iter().flatten() {
                feels += arm.arm * arm.arm.transpose() * turning[arm.joint as usize].inverse;
            }
            let normal = contact.normal_in_world;
            let mut row = Row {
                bodies,
                arms,
                joints: openings,
                normal,
                wanted: 0.0,
                undo: 0.0,
                surface: contact.surface_velocity,
                friction: contact.friction,
                normal_mass: 1.0 / normal.dot(&(feels * normal)),
                mass: feels.try_inverse().unwrap_or_else(Matrix3::zeros),
                least_mass: 1.0 / most_across(&feels, &normal),
                yields: feels.trace() / 3.0,
                along: 0.0,
                across: Vector3::zeros(),
                undone: 0.0,
            };
            // The approach when the step begins: what gravity adds in it would make every bounce a little higher.
            let of = |body: Option<usize>, arm: &Vector3<f64>| {
                body.map_or_else(Vector3::zeros, |body| {
                    masses[body].velocity(&before[body])
                        + masses[body].angular_velocity(&before[body]).cross(arm)
                })
            };
            let opening = |arm: Option<Arm>| {
                arm.map_or_else(Vector3::zeros, |arm| arm.arm * joints[arm.joint as usize].rate)
            };
            let approach = (of(bodies[0], &arms[0]) - of(bodies[1], &arms[1]) + opening(openings[0])
                - opening(openings[1])
                - row.surface)
                .dot(&normal);
            if contact.depth < 0.0 {
                row.wanted = contact.depth / dt;
            }
            if approach < -config.rest_speed && contact.depth >= approach * dt {
                row.wanted = row.wanted.max(-contact.restitution * approach);
            }
            row.undo = config.correction * (contact.depth - config.slop).max(0.0) / dt;
            if is_warm {
                let held = impulses[index].impulse;
                row.along = held.dot(&normal).max(0.0);
                let across = held - normal * held.dot(&normal);
                row.across =
                    across * (row.friction * row.along / across.norm().max(f64::MIN_POSITIVE)).min(1.0);
                let impulse = normal * row.along + row.across;
                push(velocities, inverse, &row, &impulse);
                turn(turning, &row, &impulse);
            }
            rows.push(row);
        }
        impulses.clear();
        let count = rows.len();
        for round in 0..config.iterations {
            *rounds += 1;
            // The largest speed that this round still changes.
            let mut change = 0.0_f64;
            for (turning, joint) in turning.iter_mut().zip(joints.iter()) {
                turning.solve(joint, dt);
            }
            for index in 0..count {
                // There and back: one order only would lean every stack to one side.
                let row = &mut rows[if round % 2 == 0 { index } else { count - 1 - index }];
                let slip = speed(velocities, row) + turned(turning, row) - row.surface;
                let along = (row.along + row.normal_mass * (row.wanted - slip.dot(&row.normal))).max(0.0);
                let impulse = row.normal * (along - row.along);
                change = change.max((along - row.along).abs() * row.yields);
                row.along = along;
                push(velocities, inverse, row, &impulse);
                turn(turning, row, &impulse);
                // What would stop the slip, if Coulomb's cone lets it. Else as much as it does against the slip itself: what
                // would stop it leans to the side wherever a body turns more easily than it moves.
                let slip = speed(velocities, row) + turned(turning, row) - row.surface;
                let slip = slip - row.normal * slip.dot(&row.normal);
                let most = row.friction * row.along;
                let mut across = row.across - row.mass * slip;
                across -= row.normal * across.dot(&row.normal);
                if across.norm() > most {
                    across = row.across - slip * row.least_mass;
                    across *= (most / across.norm().max(f64::MIN_POSITIVE)).min(1.0);
                }
                let impulse = across - row.across;
                change = change.max(impulse.norm() * row.yields);
                row.across = across;
                push(velocities, inverse, row, &impulse);
                turn(turning, row, &impulse);
                let gap = speed(undo, row).dot(&row.normal);
                let undone = (row.undone + row.normal_mass * (row.undo - gap)).max(0.0);
                let impulse = row.normal * (undone - row.undone);
                change = change.max((undone - row.undone).abs() * row.yields);
                row.undone = undone;
                push(undo, inverse, row, &impulse);
            }
            if change < config.tolerance {
                break;
            }
        }
        // Momenta by the impulses themselves: what one body gets the other gives, to the last bit but rounding.
        for row in rows.iter() {
            let impulse = row.normal * row.along + row.across;
            for (side, sign) in [(0, 1.0), (1, -1.0)] {
                if let Some(body) = row.bodies[side] {
                    next[body].momentum += impulse * sign;
                    next[body].angular_momentum += row.arms[side].cross(&impulse) * sign;
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

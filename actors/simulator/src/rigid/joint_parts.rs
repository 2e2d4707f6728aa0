//! Joined bodies that turn by a radian or more in a step, as the light links of a whip: their step is taken in parts, each
//! short enough for Newton's method to close all joints at its end.

use nalgebra::{Isometry3, Matrix3, UnitQuaternion};

use super::body_joint::{BodyJoint, JointEnd, JointImpulse, JointRows, Locked, with_twist};
use super::contact_constraint::Twist;
use super::joint_factor::JointFactor;
use super::joint_system::{CLOSED, NEAR, ROUNDS_MAX};
use super::{Integrator, RigidMass, RigidState};

/// Most parts of a step.
const PARTS_MAX: u32 = 128;
/// A part may end a little open, so that rounding does not divide it further: this many times what counts as closed.
const NEARLY: f64 = 100.0;

/// Buffers of steps that are taken in parts.
#[derive(Clone, Debug, Default)]
pub(super) struct StepParts {
    /// Bodies that were moved so, and where they are at the end of the step.
    pub moved: Vec<(usize, RigidState)>,
    states: Vec<RigidState>,
    ends: Vec<RigidState>,
    twists: Vec<Twist>,
    inverse: Vec<(f64, Matrix3<f64>)>,
    rows: Vec<JointRows>,
    led: Vec<BodyJoint>,
    unknowns: Vec<Locked>,
    bodies: Vec<usize>,
    impulses: Vec<(u32, JointImpulse)>,
}

impl StepParts {
    /// Moves the bodies of these joints, which hang together with no others and touch nothing, from `states` on with the
    /// momenta that `next` has gained. Returns the impulse of each joint; nothing where no division closes all of them.
    pub fn divide(
        &mut self,
        members: &[u32],
        joints: &[BodyJoint],
        factor: &mut JointFactor,
        dt: f64,
        (masses, states, next): (&[RigidMass], &[RigidState], &[RigidState]),
        integrator: Integrator,
    ) -> &[(u32, JointImpulse)] {
        let stands = states.len();
        self.bodies.clear();
        for &joint in members {
            let of = &joints[joint as usize];
            self.bodies.push(of.body as usize);
            if let JointEnd::Body { body, .. } = of.other {
                self.bodies.push(body as usize);
            }
        }
        self.bodies.sort_unstable();
        self.bodies.dedup();
        self.twists.clear();
        self.twists.resize(stands + 1, Twist::default());
        self.inverse.clear();
        self.inverse.resize(stands + 1, (0.0, Matrix3::zeros()));
        self.led.clear();
        self.led.extend_from_slice(joints);
        self.unknowns.clear();
        self.unknowns.resize(joints.len(), [0.0; 6]);
        let mut parts = 2;
        while parts <= PARTS_MAX {
            if self.advance(members, joints, factor, dt, parts, (masses, states, next), integrator) {
                self.moved.extend(self.bodies.iter().map(|body| (*body, self.states[*body])));
                return &self.impulses;
            }
            parts *= 2;
        }
        self.impulses.clear();
        &self.impulses
    }

    #[allow(clippy::too_many_arguments)] // a step of some joints
    fn advance(
        &mut self,
        members: &[u32],
        joints: &[BodyJoint],
        factor: &mut JointFactor,
        dt: f64,
        parts: u32,
        (masses, states, next): (&[RigidMass], &[RigidState], &[RigidState]),
        integrator: Integrator,
    ) -> bool {
        let (part, share) = (dt / f64::from(parts), 1.0 / f64::from(parts));
        self.states.clear();
        self.states.extend_from_slice(states);
        self.impulses.clear();
        self.impulses.extend(members.iter().map(|joint| (*joint, JointImpulse::default())));
        for index in 0..parts {
            for &body in &self.bodies {
                let (state, mass) = (&mut self.states[body], &masses[body]);
                let gained = (next[body].momentum - states[body].momentum) * share;
                if integrator == Integrator::RungeKutta4 {
                    // As in a whole step: exact for a constant force.
                    state.position -= gained * (part / 2.0 / mass.mass);
                }
                let inertia = mass.inverse_inertia_in_world(&state.rotation);
                state.momentum += gained;
                state.angular_momentum +=
                    (next[body].angular_momentum - states[body].angular_momentum) * share;
                self.inverse[body] = (1.0 / mass.mass, inertia);
                self.twists[body] = [state.momentum / mass.mass, inertia * state.angular_momentum];
            }
            for &joint in members {
                let led = &mut self.led[joint as usize];
                if let (JointEnd::World([from, to]), JointEnd::World(now)) =
                    (&joints[joint as usize].other, &mut led.other)
                {
                    *now = [index, index + 1].map(|at| between(from, to, f64::from(at) * share));
                }
            }
            if !self.close(members, factor, part, masses, integrator) {
                return false;
            }
            for (joint, sum) in &mut self.impulses {
                let total = self.rows[*joint as usize].total();
                sum.impulse += total.impulse;
                sum.turn += total.turn;
            }
        }
        true
    }

    /// One part: finds the impulses, and moves the bodies.
    fn close(
        &mut self,
        members: &[u32],
        factor: &mut JointFactor,
        part: f64,
        masses: &[RigidMass],
        integrator: Integrator,
    ) -> bool {
        let Self { states, ends, twists, inverse, rows, led, unknowns, bodies, .. } = self;
        rows.clear();
        // Of other joints the rows are not used.
        rows.extend(led.iter().map(|joint| JointRows::new(joint, states, inverse)));
        for &joint in members {
            let of = &mut rows[joint as usize];
            if of.allowed.iter().take(of.count).all(|apart| apart.abs() <= NEAR) {
                of.allowed = [0.0; 6];
            }
        }
        factor.factorise(members, rows);
        ends.clone_from(states);
        let mut former = f64::INFINITY;
        for _ in 0..2 * ROUNDS_MAX {
            for &joint in members {
                let of = &rows[joint as usize];
                let speed = of.speed(twists);
                unknowns[joint as usize] =
                    std::array::from_fn(|k| if k < of.count { of.wanted[k] - speed[k] } else { 0.0 });
            }
            factor.solve(members, unknowns);
            for &joint in members {
                let (of, impulse) = (&mut rows[joint as usize], &unknowns[joint as usize]);
                of.push(impulse, twists);
                of.impulse.iter_mut().zip(impulse).for_each(|(sum, more)| *sum += more);
            }
            for &body in bodies.iter() {
                let state = with_twist(&masses[body], &states[body], &twists[body]);
                ends[body] = masses[body].moved(&state, part, integrator);
            }
            let mut worst = 0.0_f64;
            for &joint in members {
                let error = rows[joint as usize].error(&led[joint as usize], ends);
                let of = &mut rows[joint as usize];
                for k in 0..of.count {
                    let open = error[k] - of.allowed[k];
                    worst = worst.max(open.abs() / CLOSED[usize::from(k >= 3)]);
                    of.wanted[k] -= open / part;
                }
            }
            // Written so that NaN fails.
            if worst <= 1.0 || (worst <= NEARLY && worst > 0.5 * former) {
                std::mem::swap(states, ends);
                return true;
            }
            if worst.is_nan() || worst > 0.9 * former {
                return false;
            }
            former = worst;
        }
        false
    }
}

/// A frame on the way from one to another.
fn between(from: &Isometry3<f64>, to: &Isometry3<f64>, share: f64) -> Isometry3<f64> {
    let turn = (to.rotation * from.rotation.inverse()).scaled_axis();
    let place = from.translation.vector.lerp(&to.translation.vector, share);
    Isometry3::from_parts(place.into(), UnitQuaternion::from_scaled_axis(turn * share) * from.rotation)
}

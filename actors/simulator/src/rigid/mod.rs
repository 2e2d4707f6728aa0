//! Rigid-body dynamics: momenta, selectable integrators, impulses at detected contacts (Baraff, *An introduction to
//! physically based modeling: rigid body simulation*, 1997).
//!
//! | Concept | File |
//! |---|---|
//! | A body and its integrators | `body.rs` |
//! | Contacts | `contact.rs` |
//! | Jaw joints and their drives | `jaw_joint.rs` |
//! | Joints of bodies: one, all that hang together, their factor, fast ones | `body_joint.rs`, `joint_system.rs`, `joint_factor.rs`, `joint_parts.rs` |
//! | Impulse solver: a step, a contact, islands | `sequential_impulses.rs`, `contact_constraint.rs`, `islands.rs` |
//! | What jaws hold, solved directly | `direct_grasp.rs` |

mod body;
mod body_joint;
mod contact;
pub(crate) mod contact_constraint;
mod direct_grasp;
mod error;
mod islands;
pub(crate) mod jaw_joint;
mod joint_factor;
mod joint_parts;
mod joint_system;
pub(crate) mod sequential_impulses;

use nalgebra::Vector3;
use trocar_scene::kinematics::spatial::Wrench;

pub use body::{Integrator, RigidMass, RigidState};
pub use body_joint::{BodyJoint, JointEnd, JointImpulse};
pub use contact::{ContactConfig, ContactImpulse, RigidContact};
pub use error::{RigidError, RigidStepError};
pub use jaw_joint::{Arm, Joint};

use sequential_impulses::Response;

/// Most products of blocks in a factorisation of the joints' matrix: some 20 ms a step.
const JOINT_PRODUCTS_MAX: usize = 50_000;

/// Rigid bodies with contacts.
#[derive(Clone, Debug)]
pub struct RigidBodies {
    masses: Vec<RigidMass>,
    states: Vec<RigidState>,
    next: Vec<RigidState>,
    gravity: Vector3<f64>,
    integrator: Integrator,
    config: ContactConfig,
    response: Response,
}

impl RigidBodies {
    /// Bodies with their states; a restart needs the states and, with [`RigidBodies::begin_with`], the impulses.
    ///
    /// # Errors
    /// Lists of different lengths; all bodies with an invalid mass, inertia or state; a parameter out of range.
    pub fn new(
        masses: &[RigidMass],
        states: &[RigidState],
        gravity: Vector3<f64>,
        integrator: Integrator,
        config: ContactConfig,
    ) -> Result<Self, RigidError> {
        error::check(masses, states, &gravity, &config)?;
        Ok(Self {
            masses: masses.to_vec(),
            states: states.to_vec(),
            next: states.to_vec(),
            gravity,
            integrator,
            config,
            response: Response::default(),
        })
    }

    /// The bodies' states.
    #[must_use]
    pub fn states(&self) -> &[RigidState] {
        &self.states
    }

    /// The bodies' inertias.
    #[must_use]
    pub fn masses(&self) -> &[RigidMass] {
        &self.masses
    }

    /// Impulses of the contacts in the last step, in their order.
    #[must_use]
    pub fn impulses(&self) -> &[ContactImpulse] {
        &self.response.impulses
    }

    /// Number of contact solves in the last step.
    #[must_use]
    pub fn visits(&self) -> u64 {
        self.response.visits
    }

    /// Warm-starts the next step with these impulses, one for each of its contacts: with the states, they restart a run
    /// bit for bit. Non-finite values count as zero.
    pub fn begin_with(&mut self, impulses: &[ContactImpulse]) {
        self.response.impulses.clear();
        let is_finite = |of: &&ContactImpulse| of.impulse.iter().all(|x| x.is_finite());
        if impulses.iter().all(|of| is_finite(&of)) {
            self.response.impulses.extend_from_slice(impulses);
        }
    }

    /// Applies an impulse \[N·s\] to a body at a point, both in world.
    ///
    /// # Errors
    /// A missing body; a non-finite impulse or point.
    pub fn apply_impulse(
        &mut self,
        body: u32,
        impulse: &Vector3<f64>,
        point_in_world: &nalgebra::Point3<f64>,
    ) -> Result<(), RigidStepError> {
        let bodies = self.states.len();
        let state =
            self.states.get_mut(body as usize).ok_or(RigidStepError::NoBody { contact: 0, body, bodies })?;
        if !impulse.iter().chain(point_in_world.iter()).all(|x| x.is_finite()) {
            return Err(RigidStepError::Body { body: body as usize });
        }
        state.momentum += impulse;
        state.angular_momentum += (point_in_world - state.position).cross(impulse);
        Ok(())
    }

    /// Replaces the joints of bodies. They are part of every later step.
    ///
    /// # Errors
    /// [`RigidError::Joint`], [`RigidError::Joints`]; there are no joints then.
    pub fn set_joints(&mut self, joints: &[BodyJoint]) -> Result<(), RigidError> {
        let system = &mut self.response.joints;
        let bodies = self.states.len();
        let found = match joints.iter().position(|joint| !error::is_joint(joint, bodies)) {
            Some(joint) => Err(RigidError::Joint { joint, bodies }),
            None => system
                .set(joints, bodies, JOINT_PRODUCTS_MAX)
                .map_err(|products| RigidError::Joints { products, most: JOINT_PRODUCTS_MAX }),
        };
        if found.is_err() {
            *system = joint_system::JointSystem::default();
        }
        found
    }

    /// Moves the world's side of a joint from one frame to another in the next step; of one between two bodies nothing changes.
    pub fn lead_joint(&mut self, joint: usize, world_from_joint: [nalgebra::Isometry3<f64>; 2]) {
        if let Some(BodyJoint { other: JointEnd::World(frames), .. }) =
            self.response.joints.joints.get_mut(joint)
        {
            *frames = world_from_joint;
        }
    }

    /// Impulses of the joints in the last step, in their order.
    #[must_use]
    pub fn joint_impulses(&self) -> &[JointImpulse] {
        &self.response.joint_impulses
    }

    /// How far a joint is open now: distance \[m\], and angle in what it locks \[rad\].
    #[must_use]
    pub fn joint_errors(&self, joint: usize) -> [f64; 2] {
        self.response.joints.errors(joint, &self.states)
    }

    /// Sets the state of a body.
    ///
    /// # Errors
    /// A missing body; a non-finite state.
    pub fn place(&mut self, body: usize, state: RigidState) -> Result<(), RigidStepError> {
        let at = self.states.get_mut(body).filter(|_| error::is_finite(&state));
        *at.ok_or(RigidStepError::Body { body })? = state;
        Ok(())
    }

    /// Advances all bodies by `dt` \[s\] under gravity, `wrenches` about the centres of mass (one per body, or
    /// none at all) and contacts.
    ///
    /// # Errors
    /// An invalid time step; lists of wrong lengths; an invalid contact; a body whose state would become non-finite.
    /// The bodies are unchanged then.
    pub fn step(
        &mut self,
        dt: f64,
        wrenches: &[Wrench],
        contacts: &[RigidContact],
    ) -> Result<(), RigidStepError> {
        self.step_with_jaws(dt, wrenches, contacts, &[], &mut [])
    }

    /// The same with jaws: `arms` tells which contact points move with their openings (one entry per contact, or none
    /// at all), and `joints` are advanced as well.
    ///
    /// # Errors
    /// As [`RigidBodies::step`]; an arm of a missing joint. The joints may have advanced then.
    pub fn step_with_jaws(
        &mut self,
        dt: f64,
        wrenches: &[Wrench],
        contacts: &[RigidContact],
        arms: &[[Option<Arm>; 2]],
        joints: &mut [Joint],
    ) -> Result<(), RigidStepError> {
        error::check_arms(contacts, arms, joints)?;
        error::check_step(dt, wrenches, contacts, &self.states)?;
        self.next.copy_from_slice(&self.states);
        if self.integrator == Integrator::ExplicitEuler {
            // Positions by the velocities before the step.
            for (next, mass) in self.next.iter_mut().zip(&self.masses) {
                *next = mass.moved(next, dt, self.integrator);
            }
        }
        for (index, next) in self.next.iter_mut().enumerate() {
            let wrench = wrenches.get(index).copied().unwrap_or_default();
            let force = wrench.force + self.gravity * self.masses[index].mass;
            if self.integrator == Integrator::RungeKutta4 {
                // The velocity at the end overshoots: this is exact for a constant force.
                next.position -= force * (dt * dt / 2.0 / self.masses[index].mass);
            }
            next.momentum += force * dt;
            next.angular_momentum += wrench.torque * dt;
        }
        self.response.solve(
            dt,
            &self.masses,
            &self.states,
            &mut self.next,
            contacts,
            arms,
            joints,
            &self.config,
            self.integrator,
        );
        if self.integrator != Integrator::ExplicitEuler {
            for (next, mass) in self.next.iter_mut().zip(&self.masses) {
                *next = mass.moved(next, dt, self.integrator);
            }
        }
        self.response.joints.take_divided(&mut self.next);
        self.response.correct(dt, &mut self.next);
        if let Some(body) = self.next.iter().position(|state| !error::is_finite(state)) {
            return Err(RigidStepError::Body { body });
        }
        std::mem::swap(&mut self.states, &mut self.next);
        Ok(())
    }
}

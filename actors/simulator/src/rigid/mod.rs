//! Rigid bodies of our own: momenta, selectable integrators, impulses at contacts that a detector found (Baraff, *An
//! introduction to physically based modeling: rigid body simulation*, 1997).
//!
//! | Concept | File |
//! |---|---|
//! | A body and its integrators | `body.rs` |
//! | Contacts | `contact.rs` |
//! | Jaws of instruments and their drives | `jaw_joint.rs` |
//! | Impulses: all of a step, one contact, and which have to do with each other | `sequential_impulses.rs`, `contact_constraint.rs`, `islands.rs` |

mod body;
mod contact;
pub(crate) mod contact_constraint;
mod error;
mod islands;
pub(crate) mod jaw_joint;
pub(crate) mod sequential_impulses;

use nalgebra::Vector3;
use trocar_dynamics::rigid_world::Wrench;

pub use body::{Integrator, RigidMass, RigidState};
pub use contact::{ContactConfig, ContactImpulse, RigidContact};
pub use error::{RigidError, RigidStepError};
pub use jaw_joint::{Arm, Joint};

use sequential_impulses::Response;

/// Bodies that move and collide.
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
    /// Bodies with their states; a run goes on from the states and, with [`RigidBodies::begin_with`], the impulses.
    ///
    /// # Errors
    /// Lists of different lengths; all bodies with a mass, an inertia or a state that cannot be; a parameter out of range.
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

    /// What each contact of the last step came to, in their order.
    #[must_use]
    pub fn impulses(&self) -> &[ContactImpulse] {
        &self.response.impulses
    }

    /// How often the last step solved a contact, all of them together.
    #[must_use]
    pub fn visits(&self) -> u64 {
        self.response.visits
    }

    /// Lets the next step begin with these impulses, one for each of its contacts: with the states, they are what a run goes
    /// on from, bit for bit. What is not finite counts as none.
    pub fn begin_with(&mut self, impulses: &[ContactImpulse]) {
        self.response.impulses.clear();
        let is_finite = |of: &&ContactImpulse| of.impulse.iter().all(|x| x.is_finite());
        if impulses.iter().all(|of| is_finite(&of)) {
            self.response.impulses.extend_from_slice(impulses);
        }
    }

    /// Strikes a body: an impulse \[N·s\] at a point, both in world.
    ///
    /// # Errors
    /// A body that there is none of; an impulse or a point that is not finite.
    pub fn strike(
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

    /// Puts a body somewhere else.
    ///
    /// # Errors
    /// A body that there is none of; a state that is not finite.
    pub fn place(&mut self, body: usize, state: RigidState) -> Result<(), RigidStepError> {
        let at = self.states.get_mut(body).filter(|_| error::is_finite(&state));
        *at.ok_or(RigidStepError::Body { body })? = state;
        Ok(())
    }

    /// Moves all on by `dt` \[s\] under gravity, `wrenches` (one for each body, or none at all) and the contacts.
    ///
    /// # Errors
    /// A step that is no time; lists that do not fit; a contact that cannot be; a body that came to be nowhere. The bodies
    /// are as before.
    pub fn step(
        &mut self,
        dt: f64,
        wrenches: &[Wrench],
        contacts: &[RigidContact],
    ) -> Result<(), RigidStepError> {
        self.step_with_jaws(dt, wrenches, contacts, &[], &mut [])
    }

    /// The same with jaws: `arms` says which points of contact move with their openings (one entry for each contact, or none
    /// at all), and `joints` go on as well.
    ///
    /// # Errors
    /// As [`RigidBodies::step`]; an arm of an opening that there is none of. The joints may then have moved on.
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
            // Positions by what the velocities were.
            for (next, mass) in self.next.iter_mut().zip(&self.masses) {
                *next = mass.moved(next, dt, self.integrator);
            }
        }
        for (index, next) in self.next.iter_mut().enumerate() {
            let wrench = wrenches.get(index).copied().unwrap_or_default();
            let force = wrench.force + self.gravity * self.masses[index].mass;
            if self.integrator == Integrator::RungeKutta4 {
                // The velocity at the end takes it too far: exact for a constant force.
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
        );
        if self.integrator != Integrator::ExplicitEuler {
            for (next, mass) in self.next.iter_mut().zip(&self.masses) {
                *next = mass.moved(next, dt, self.integrator);
            }
        }
        self.response.correct(dt, &mut self.next);
        if let Some(body) = self.next.iter().position(|state| !error::is_finite(state)) {
            return Err(RigidStepError::Body { body });
        }
        std::mem::swap(&mut self.states, &mut self.next);
        Ok(())
    }
}

//! Steps in which all constraints of a cloth or a rod are solved together.
//!
//! A sweep carries a force on by one constraint. What presses or hangs on a body with more than the mass of a node is
//! therefore borne by the few nodes beside it, and stretches them without limit. Sweeps converge to a backward Euler step
//! (Macklin et al. 2016), which the network of the same springs and hinges solves at once, by a sparse factor, together
//! with the motion of the rigid bodies.

use trocar_dynamics::particles::StepError;

use super::{Xpbd, XpbdInput};
use crate::mass_spring::{Config, Input, Integrator, LinearSolver, MassSpring, Network, NetworkError};

impl Xpbd {
    /// Gives it the network that its constraints are of, for steps that solve them together; a change of its constraints
    /// takes it away.
    ///
    /// # Errors
    /// A network that does not fit.
    pub fn take_network(&mut self, network: &Network) -> Result<(), NetworkError> {
        let config = Config {
            integrator: Integrator::Implicit { solver: LinearSolver::Cholesky, newton: 1 },
            lag: 0.0,
            damping: self.config.damping,
            speed_max: self.config.speed_max,
        };
        let solver = MassSpring::restore(network.clone(), self.state.clone(), &self.pinned, config)?;
        self.network = Some(Box::new(solver));
        Ok(())
    }

    /// Whether it has a network.
    #[must_use]
    pub fn has_network(&self) -> bool {
        self.network.is_some()
    }

    /// A step of `dt` \[s\] of a body with a network.
    pub(super) fn step_directly(&mut self, dt: f64, input: &XpbdInput<'_>) -> Result<(), StepError> {
        let Self { network: Some(solver), state, scratch, .. } = self else { return Ok(()) };
        solver.continue_from(state);
        let XpbdInput { gravity, forces, prescribed, contacts, rigid, jaws, .. } = *input;
        solver.step(dt, &Input { gravity, forces, prescribed, contacts, rigid, jaws })?;
        state.clone_from(solver.state());
        scratch.contact_forces.clear();
        scratch.contact_forces.extend_from_slice(solver.contact_forces());
        scratch.rigid.take(solver.rigid_forces(), dt);
        scratch.jaws.forces.clear();
        scratch.jaws.forces.extend_from_slice(solver.grip_forces());
        scratch.was_direct = true;
        Ok(())
    }
}

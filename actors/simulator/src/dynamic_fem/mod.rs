//! Implicit dynamic finite elements: corotational, neo-Hookean or St. Venant–Kirchhoff tetrahedra, stepped by backward Euler.
//!
//! A step minimises the incremental potential (Martin et al. 2011; Gast et al. 2015): inertia, elasticity, damping,
//! springs and penalty contacts. The minimum is approached by a quasi-Newton method whose first guess of the inverse
//! Hessian is a sparse Cholesky factor that is kept over many steps (Liu, Bouaziz, Kavan 2017); it is computed anew
//! where the body has moved so far away that the iterations it costs would pay for a new one. Every iterate lowers the
//! potential, so that no step explodes; elements that were turned inside out come back.
//!
//! Poisson's ratio is limited by [`Elastic`](trocar_dynamics::elasticity::Elastic) to where linear tetrahedra do not lock.

#![expect(clippy::neg_cmp_op_on_partial_ord, reason = "what is not a number passes no test")]

pub(crate) mod assembly;
mod config;
pub(crate) mod constitutive;
pub(crate) mod element_damage;
pub(crate) mod incremental_potential;
mod lbfgs;
pub(crate) mod local_correction;
mod polar;
pub(crate) mod prediction;
mod solver;
pub(crate) mod stale_factor;
mod state;

pub use config::{Config, DynamicFemError, Energies, MassMatrix, Report, StepError};
pub use constitutive::{Constitution, JACOBIAN_MIN};
pub use incremental_potential::{Contact, Coupling, Inputs, Spring};
pub use solver::DynamicFem;
pub use stale_factor::Analysis;
pub use state::DynamicFemState;

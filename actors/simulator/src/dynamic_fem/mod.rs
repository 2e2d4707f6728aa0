//! Implicit dynamic finite elements: corotational, neo-Hookean or St. Venant–Kirchhoff tetrahedra, stepped by backward Euler.
//!
//! A step minimises the incremental potential (Martin et al. 2011; Gast et al. 2015): inertia, elasticity, damping,
//! springs and penalty contacts. The minimiser is a quasi-Newton method whose initial inverse Hessian is a sparse
//! Cholesky factor that is reused over many steps (Liu, Bouaziz, Kavan 2017), and recomputed once the extra iterations
//! cost more than a new factor. Every iterate decreases the potential, so that no step diverges; inverted elements
//! recover.
//!
//! Poisson's ratio is limited by [`Elastic`](trocar_dynamics::elasticity::Elastic) to the range in which linear
//! tetrahedra do not lock.

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
pub use state::{DynamicFemState, Motion};

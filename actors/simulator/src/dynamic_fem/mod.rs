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

mod change;
mod config;
mod derived;
mod lbfgs;
mod lent;
mod material;
mod near_cut;
mod objective;
mod outlook;
mod polar;
mod solver;
mod state;

pub use config::{Config, DynamicFemError, Energies, MassMatrix, Report, StepError};
pub use lent::Analysis;
pub use material::{Constitution, JACOBIAN_MIN};
pub use objective::{Contact, Coupling, Inputs, Spring};
pub use solver::DynamicFem;
pub use state::DynamicFemState;

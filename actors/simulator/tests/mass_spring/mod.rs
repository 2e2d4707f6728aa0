//! Masses and springs.

mod reference;
mod solver;

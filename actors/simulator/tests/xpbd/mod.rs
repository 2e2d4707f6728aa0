//! Position-based bodies.

mod controller;
mod reference;
mod solver;

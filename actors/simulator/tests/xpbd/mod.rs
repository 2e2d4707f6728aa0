//! XPBD bodies.

mod controller;
mod reference;
mod solver;

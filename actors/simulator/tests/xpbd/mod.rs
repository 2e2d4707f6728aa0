//! XPBD bodies.

mod controller;
mod reference;
mod solver;
mod volume_law;

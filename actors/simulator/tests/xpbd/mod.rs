//! XPBD bodies.

mod controller;
mod direct;
mod reference;
mod solver;
mod volume_law;

//! Implicit dynamic finite elements.

mod controller;
mod solver;
mod topology_change;

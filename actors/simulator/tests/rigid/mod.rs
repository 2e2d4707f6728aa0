//! Rigid bodies by momenta and impulses.

mod controller;
mod solver;

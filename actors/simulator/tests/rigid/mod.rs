//! Rigid bodies by momenta and impulses.

mod controller;
mod joints;
mod solver;

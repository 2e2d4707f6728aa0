//! Linear finite elements with a precomputed inverse.

mod contact_patch;
mod controller;
mod convergence;
mod element_removal;
mod embedded_points;
mod held_back;
mod node_split;
mod reference;
mod solver;
mod topology_change;

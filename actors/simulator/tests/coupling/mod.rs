//! Bodies of different controllers that are coupled.

mod controllers;
mod ghost_nodes;

//! Surfaces, lines and volumes that are cut and torn.

mod remesh;
mod scissors;
mod surface;
mod volume;

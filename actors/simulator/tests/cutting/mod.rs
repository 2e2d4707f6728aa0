//! Cutting and tearing of surfaces, lines and volumes.

mod remesh;
mod scissors;
mod surface;
mod volume;

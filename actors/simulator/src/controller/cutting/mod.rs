//! Cutting and tearing, for every method: surfaces, lines, volumes and membranes, and scissors.

pub mod divisible_volume;
pub mod line;
pub mod membrane;
pub mod scissors;
pub mod surface;
pub mod volume;
mod volume_surface;

//! Cutting and tearing, for every method: surfaces, lines, volumes and membranes, and scissors.

pub mod line;
pub mod membrane;
pub mod scissors;
pub mod surface;
pub mod volume;

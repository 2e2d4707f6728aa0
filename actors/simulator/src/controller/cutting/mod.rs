//! Bodies that come apart, whichever method moves them: surfaces, lines, volumes and membranes, and the blades that part them.

pub mod line;
pub mod membrane;
pub mod scissors;
pub mod surface;
pub mod volume;

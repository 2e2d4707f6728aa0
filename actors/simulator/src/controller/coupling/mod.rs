//! The faster side of a coupling: represents nodes of slower bodies as ghosts, and publishes the impulses on them.

pub mod attachment;
pub mod fast_side;

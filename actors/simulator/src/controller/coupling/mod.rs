//! The faster side of a coupling: it meets nodes of slower bodies as ghosts, and tells them what it gave.

pub mod attachment;
pub mod fast_side;

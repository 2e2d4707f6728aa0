//! Sessions among peers: each computes the scene for itself, by the same hands at the same time.
//!
//! All hands move their instruments a fixed time after they were there
//! ([playout](crate::hands_link::playout)), so that all peers compute the same of the same. What goes through the network is
//! hands, and what only one computes: tasks, heat, liquids, persons. Every entity has one owner, who is right where two peers
//! differ all the same, since a sample was late or a ring fell otherwise: the station that serves a hand owns its device, and
//! the founder everything else.
//!
//! ```text
//!  founder  ── sketches of its bodies, twice a second ──▶  peer: compares them with what it had at that time
//!  founder  ◀── asks for a body that differs, with hashes of its rows ── peer
//!  founder  ── the rows that differ, reliably ──▶  peer: writes them, and builds its simulators anew from there
//! ```
//!
//! Hashes of quantised state would not do for bodies that move: two peers that are 10 µm apart differ in nearly every chunk of
//! 64 vertices, however coarse the grid, since some vertex is at the border of two cells. A [`sketch`] tells how far apart they
//! are, in as few bytes.

pub mod comparison;
pub mod repair;
pub mod repaired;
pub mod sketch;

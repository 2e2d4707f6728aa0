//! Contacts of a thread with itself and with what is around it: found ahead of the motion, solved together with the
//! rod, those of strands through its compliance (`W = J A⁻¹ Jᵀ`, as Duriez et al. 2006 do for deformable solids), with
//! static friction as a place to which the surfaces are drawn back.

mod candidates;
mod law;
mod nearest;
mod obstacle;
mod rows;
pub(crate) mod rule;
mod solve;

pub(crate) use candidates::{Candidates, passed_through, passed_through_face};
pub(crate) use law::Law;
pub(crate) use obstacle::Motion;
pub use obstacle::{Obstacle, Shape};
pub(crate) use rows::{Rows, Side, place, tangents};
pub(crate) use rule::Rule;
pub(crate) use solve::{Complementarity, SOFTENING};

pub(crate) use nearest::{nearest_on_obstacle, nearest_segments};

/// Contacts of strands with each other that are solved for at most; of those with obstacles any number is.
pub const CONTACTS_MAX: usize = 1000;

//! Contacts of a thread with itself and with what is around it: found ahead of the motion, solved together with the
//! rod, those of strands through its compliance (`W = J A⁻¹ Jᵀ`, as Duriez et al. 2006 do for deformable solids), with
//! static friction as a place to which the surfaces are drawn back.

pub(crate) mod broad_phase;
pub(crate) mod closest_points;
pub(crate) mod constraint_rows;
pub(crate) mod coulomb;
pub(crate) mod force_law;
mod obstacle;
pub(crate) mod semismooth_newton;

pub(crate) use broad_phase::{Candidates, passed_through, passed_through_face};
pub(crate) use constraint_rows::{Rows, Side, place, tangents};
pub(crate) use coulomb::Law;
pub(crate) use force_law::Rule;
pub(crate) use obstacle::Motion;
pub use obstacle::{Obstacle, Shape};
pub(crate) use semismooth_newton::{Complementarity, SOFTENING};

pub(crate) use closest_points::{nearest_on_obstacle, nearest_segments};

/// Contacts of strands with each other that are solved for at most; of those with obstacles any number is.
pub const CONTACTS_MAX: usize = 1000;

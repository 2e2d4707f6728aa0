//! Contacts of a thread with itself and with obstacles: detected ahead of the motion and solved together with the rod,
//! those between strands through its compliance (`W = J A⁻¹ Jᵀ`, as in Duriez et al. 2006 for deformable solids).
//! Static friction is a spring to the sticking point.

pub(crate) mod broad_phase;
pub(crate) mod closest_points;
pub(crate) mod constraint_rows;
pub(crate) mod coulomb;
pub(crate) mod force_law;
mod led_instrument;
mod obstacle;
pub(crate) mod semismooth_newton;

pub(crate) use broad_phase::{Candidates, passed_through, passed_through_face};
pub(crate) use constraint_rows::{Rows, Side, place, tangents};
pub(crate) use coulomb::{CoulombState, FrictionLimit};
pub(crate) use force_law::ForceLaw;
pub use led_instrument::{LedInstrument, LedMotion};
pub(crate) use obstacle::Motion;
pub use obstacle::{Obstacle, ObstacleMobility, Shape, Yielded};
pub(crate) use semismooth_newton::{Complementarity, SOFTENING};

pub(crate) use closest_points::{crossing_of_mesh, nearest_on_obstacle, nearest_segments};

/// Maximum number of strand contacts; contacts with obstacles are unlimited.
pub const CONTACTS_MAX: usize = 1000;

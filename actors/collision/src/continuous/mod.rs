//! Continuous collision detection: when within a step two things first meet, so that nothing fast passes through
//! something thin.
//!
//! Over a step every point moves in a straight line at constant speed (a [`Sweep`]), as a solver integrates it. The
//! tests are functions that a solver calls inside its own step: [`vertex_face`], [`edge_edge`], [`vertex_edge`],
//! [`vertex_vertex`] and [`segment_face`]; with a `separation` (sum of the radii) they are sweeps of spheres and
//! capsules. [`ImpactFinder`] lists the impacts of whole lines and surfaces.
//!
//! # Never a miss
//! The usual way (Provot 1997) looks for roots of the cubic that says when the four points are in one plane, and
//! rounding makes it miss some (Brochu, Edwards, Bridson 2012; Wang et al. 2021 count them). Here time advances only
//! as far as a *separating plane* proves that nothing can have met: conservative advancement (Mirtich 1996), with the
//! bound taken along the plane's normal, exactly, since over a step of linear motion the gap along a fixed direction
//! is a concave, piecewise linear function of time. A wrong direction costs an iteration, never a contact. So:
//!
//! - whatever comes within `separation` during the step is reported, at a time not after the first contact;
//! - at the reported time both are still at least `separation` apart (unless they were nearer at the beginning, which
//!   is reported as time 0), and no more than [`RESOLUTION`] times their size further, so that also what passes by as
//!   closely is reported. Pairs that turn past each other closer than 1e-5 of their size for long are given up after a
//!   bounded number of planes, as an impact; of pairs made to graze these are less than one in a hundred.
//!
//! Sizes are those of the pair and of its relative motion. Positions further than a million times that from the origin
//! carry a rounding of their own, which no test can take back.
//!
//! Numbers that are not finite cannot be proven apart and are reported at time 0.

mod advancement;
mod finder;
mod pairs;
mod swept;

pub use advancement::{Impact, RESOLUTION, Sweep};
pub use finder::{FoundImpact, ImpactFinder};
pub use pairs::{edge_edge, segment_face, vertex_edge, vertex_face, vertex_vertex};
pub use swept::{SweptLine, SweptSurface};

//! Continuous collision detection: the first time of contact within a step, so that fast objects do not tunnel through
//! thin ones.
//!
//! Over a step every point moves in a straight line at constant speed (a [`Sweep`]), as in a solver's integration. The
//! tests are functions that a solver calls within its own step: [`vertex_face`], [`edge_edge`], [`vertex_edge`],
//! [`vertex_vertex`] and [`segment_face`]; with a `separation` (sum of the radii) they are sweeps of spheres and
//! capsules. [`ImpactFinder`] lists the impacts of whole lines and surfaces.
//!
//! # Never a miss
//! The usual method (Provot 1997) finds roots of the cubic for coplanarity of the four points, and misses some because
//! of rounding (Brochu, Edwards, Bridson 2012; Wang et al. 2021 count them). Here time advances only as far as a
//! *separating plane* proves absence of contact: conservative advancement (Mirtich 1996), with the bound taken along
//! the plane's normal, exactly, since over a step of linear motion the gap along a fixed direction is a concave,
//! piecewise linear function of time. A wrong direction costs an iteration, but never misses a contact. So:
//!
//! - every pair that comes within `separation` during the step is reported, at a time not after the first contact;
//! - at the reported time both are still at least `separation` apart (unless they were nearer at the beginning, which
//!   is reported as time 0), and no more than [`RESOLUTION`] times their size further, so that pairs passing within
//!   that tolerance are reported as well. Pairs that rotate past each other closer than 1e-5 of their size for long are
//!   reported as an impact after a bounded number of planes; of pairs constructed to graze these are less than one in a
//!   hundred.
//!
//! Sizes are those of the pair and of its relative motion. Positions further than a million times that from the origin
//! have rounding errors that no test can undo.
//!
//! Non-finite pairs cannot be proven apart and are reported at time 0.

mod advancement;
mod finder;
mod pairs;
mod swept;

pub use advancement::{Impact, RESOLUTION, Sweep};
pub use finder::{FoundImpact, ImpactFinder};
pub use pairs::{edge_edge, segment_face, vertex_edge, vertex_face, vertex_vertex};
pub use swept::{SweptLine, SweptSurface};

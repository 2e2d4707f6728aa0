//! Which knot a thread has been tied into, told by invariants that can: square and granny knot have the Alexander
//! polynomial and the determinant in common, but neither the signature nor the Jones polynomial.
//!
//! | Part | File |
//! |---|---|
//! | Closing an open curve, taking corners out | `polygon.rs` |
//! | Projection, crossings, Reidemeister moves | `diagram.rs` |
//! | Jones polynomial | `kauffman_bracket.rs` |
//! | Signature, determinant | `goeritz.rs` |
//! | Names | `classification.rs` |
//! | Throws one by one | `throw_order.rs` |
//!
//! An open thread has no knot but the one that is made of it by closing it. [`identify`] closes it towards 25 directions
//! spread evenly over the sphere ([`close_towards`]) and takes the knot that most of them give (Millett, Dobay, Stasiak
//! 2005): a loop or an ear that happens to hang in the way of one closure does not hang in that of most. A throw of `k`
//! half hitches, tied with both ends around something, closes to the torus knot of `2k + 1` half turns, and throws one
//! after the other to their connected sum.

pub(crate) mod classification;
mod diagram;
mod goeritz;
pub(crate) mod kauffman_bracket;
mod polygon;
pub(crate) mod throw_order;

pub use classification::{Hand, Knot, KnotKind, Throw, identify, identify_closed, identify_joined, notation};
pub use diagram::Diagram;
pub use goeritz::signature_and_determinant;
pub use kauffman_bracket::{CROSSINGS_MAX, Laurent, jones};
pub use polygon::{close_towards, simplified};
pub use throw_order::{Reading, throws};

use thiserror::Error;

/// Why a curve's knot cannot be told.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum KnotError {
    /// Too few points.
    #[error("a curve of {0} points; valid: 3 or more")]
    Points(usize),
    /// A point with a number that is not finite.
    #[error("point {0} of the curve is not finite")]
    NotFinite(usize),
    /// Crossings that cannot be told in any direction.
    #[error("the curve meets itself")]
    MeetsItself,
    /// More than can be evaluated.
    #[error("a diagram of {0} crossings that cannot be simplified; valid: at most {CROSSINGS_MAX}")]
    TooManyCrossings(usize),
}

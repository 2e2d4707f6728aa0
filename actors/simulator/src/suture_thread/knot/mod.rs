//! Classification of the knot of a thread by invariants that distinguish surgical knots: square and granny knot have
//! the Alexander polynomial and the determinant in common, but neither the signature nor the Jones polynomial.
//!
//! | Part | File |
//! |---|---|
//! | Closing an open curve, taking corners out | `polygon.rs` |
//! | Closing an open curve, removing corners | `polygon.rs` |
//! | Jones polynomial | `kauffman_bracket.rs` |
//! | Signature, determinant | `goeritz.rs` |
//! | Names of knots | `classification.rs` |
//! | Order of the throws | `throw_order.rs` |
//!
//! An open thread has a knot only once it is closed. [`identify`] closes it in 25 directions spread evenly over the
//! sphere ([`close_towards`]) and takes the most frequent result (Millett, Dobay, Stasiak 2005): a loop or an ear in
//! the way of one closure is not in the way of most. A throw of `k` half hitches, tied with both ends around something,
//! closes to the torus knot of `2k + 1` half turns, and consecutive throws to their connected sum.

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
pub use throw_order::{ThrowReader, throws};

use thiserror::Error;

/// Why a curve's knot cannot be identified.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum KnotError {
    /// Too few points.
    #[error("a curve of {0} points; valid: 3 or more")]
    Points(usize),
    /// A point with a non-finite coordinate.
    #[error("point {0} of the curve is not finite")]
    NotFinite(usize),
    /// The curve intersects itself, or no projection separates its crossings.
    #[error("the curve meets itself")]
    MeetsItself,
    /// More crossings than can be evaluated.
    #[error("a diagram of {0} crossings that cannot be simplified; valid: at most {CROSSINGS_MAX}")]
    TooManyCrossings(usize),
}

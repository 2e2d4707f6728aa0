//! Limits of an inverse and of its corrections.

/// Maximum number of constrained directions: 128 grasped points.
pub(super) const ROWS_MAX: usize = 384;
/// Maximum number of removed elements before a new inverse is required.
pub const REMOVED_MAX: usize = 64;
/// Remnant stiffness of a removed element, as a fraction, so that nodes without elements and parts that hang by one
/// node keep a position.
pub(super) const REMNANT: f64 = 1e-6;
/// Rank of an element's stiffness.
pub(super) const RANK: usize = 6;
/// Maximum number of correction unknowns.
pub(super) const UNKNOWNS_MAX: usize = RANK * REMOVED_MAX;
/// Maximum number of unknowns added at once: reading the factor for many columns takes hardly longer than for one.
pub(super) const BATCH: usize = 48;

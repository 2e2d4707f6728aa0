//! How much an inverse can serve, and how much it can be corrected by.

/// Directions that can be held at once: 128 grasped points.
pub(super) const ROWS_MAX: usize = 384;
/// Elements that can be taken out until a new inverse is due.
pub const REMOVED_MAX: usize = 64;
/// Share of its stiffness that an element leaves behind, so that nodes that lose their last element, and parts that hang
/// by one node, stay somewhere.
pub(super) const REMNANT: f64 = 1e-6;
/// Rank of an element's stiffness.
pub(super) const RANK: usize = 6;
/// Unknowns that an inverse is corrected by at most.
pub(super) const UNKNOWNS_MAX: usize = RANK * REMOVED_MAX;
/// Unknowns that are added at once at most: reading the factor for many columns takes hardly longer than for one.
pub(super) const BATCH: usize = 48;

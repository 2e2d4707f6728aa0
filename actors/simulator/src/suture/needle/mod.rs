//! A suture needle: a rigid piece of an arc, with a tip that tapers and a tail to which the thread is swaged.
//!
//! | Part | File |
//! |---|---|
//! | Shape, mass, inertia, the nearest place on it | `shape.rs` |
//! | Momenta, and where it is | `body.rs` |
//!
//! What it does in tissue, and together with its thread, is the matter of [`suture`](crate::suture).

mod body;
mod shape;

pub use body::NeedleState;
pub use shape::{NeedleError, NeedleShape, Solid};

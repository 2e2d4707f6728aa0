//! Suture needle: a rigid arc with a tapered tip and a tail to which the thread is swaged.
//!
//! | Part | File |
//! |---|---|
//! | Shape, mass, inertia, closest point | `shape.rs` |
//! | Momenta and pose | `body.rs` |
//!
//! Its interaction with tissue and thread is in [`suture`](crate::suture).

mod body;
mod shape;

pub use body::NeedleState;
pub use shape::{NeedleError, NeedleShape, Solid};

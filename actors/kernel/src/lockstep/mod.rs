//! Lock-step: the whole session on one thread in virtual time, bit-reproducible.
//!
//! At each instant, in this order: faults that are due, the supervisor's deadlines, batches that a slow step finishes,
//! device peers, then controllers in the order of the specification. A controller sees everything applied before it,
//! even within the same instant. Results do not depend on the machine: time advances by the schedule alone, and the
//! jitter of restart pauses comes from the session's seed.
//!
//! The cores are those of the live session: [`ModelCore`](crate::ModelCore),
//! [`Supervisor`](crate::supervision::Supervisor), [`FaultSchedule`](crate::faults::FaultSchedule).

#[cfg(test)]
mod begin_tests;
#[cfg(test)]
mod branch_tests;
mod branching;
mod faulting;
mod operating;
mod session;
mod slot;
mod supervising;
#[cfg(test)]
mod tests;

pub use branching::{BranchError, Moment};
pub use session::{LockstepSession, SessionError};

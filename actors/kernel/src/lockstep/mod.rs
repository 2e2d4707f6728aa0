//! Lock-step: the whole session on one thread in virtual time, the same bits every time.
//!
//! At each instant, in this order: faults that are due, the supervisor's deadlines, batches that a slow step
//! finishes, device peers, then controllers in the order of the specification. A controller sees everything
//! that was applied before it, also in the same instant. Nothing depends on the machine: time passes by the
//! schedule alone, and pauses before restarts are spread by the session's seed.
//!
//! The cores are those of the live session: [`ModelCore`](crate::ModelCore),
//! [`Supervisor`](crate::supervision::Supervisor), [`FaultSchedule`](crate::faults::FaultSchedule).

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

//! The Model actor, runtimes and rates, supervision, faults, recording, clock and lock-step.

mod admission;
pub mod bench;
pub mod commit;
pub mod faults;
pub mod handle;
mod heartbeat;
pub mod intake;
pub mod live;
pub mod lockstep;
pub mod model_core;
#[cfg(test)]
mod model_core_tests;
pub mod operator;
#[cfg(test)]
mod operator_tests;
pub mod publish;
pub mod recorder;
pub mod runtime;
mod signal;
pub mod snapshot_reclaimer;
pub mod spec;
pub mod state_hash;
pub mod supervision;
mod sync;
#[cfg(test)]
mod testing;
pub mod token_bucket;

/// actix, in the version that [`live::LiveSession::actor`] takes.
pub use actix;
pub use commit::{Commit, CommitBuffer};
pub use handle::{Doorbell, LaneStatus, Submitted, WriterHandle};
pub use intake::{Arrival, Intake, LaneIndex, Lanes};
pub use lockstep::{BranchError, LockstepSession, Moment, SessionError};
pub use model_core::{DeclareError, ModelCore, Outcome, Rejection, WriterCounts};
pub use operator::{OPERATOR, OPERATOR_NAME, OperatorError};
pub use state_hash::{CommitKind, StateHash};
pub use token_bucket::FlowLimit;

//! The operator: whoever writes into a session from outside of it. A researcher's program, a tuning panel, a
//! console.
//!
//! It declares nothing and may write everything, so it overlaps with nobody; a controller that writes the same
//! row simply does so again at its next tick. What it writes is screened as everybody's is, stands in the
//! recording and the chain of hashes under its name, and comes back in a replay. The Model knows it from the
//! beginning, so that nothing has to be asked of anybody before the first write.

use std::time::Duration;

use thiserror::Error;
use trocar_scene::{Refusal, Revision, WriterId};

use crate::model_core::{Outcome, Rejection};

/// The operator's number, and the spawner part of the entities that it creates.
pub const OPERATOR: WriterId = WriterId(u16::MAX - 1);
/// The operator's name in recordings and hashes.
pub const OPERATOR_NAME: &str = "operator";
/// Most rows, entities and events that one batch of the operator may write.
pub const OPERATOR_WRITES_MAX: usize = 16_384;
/// It is never restarted.
pub(crate) const OPERATOR_EPOCH: u32 = 1;

/// Why what an operator wrote is not in the scene, or may not be.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum OperatorError {
    /// It broke a rule; nothing of it is in the scene.
    #[error(transparent)]
    Rejected(#[from] Rejection),
    /// A precondition did not hold any more; nothing of it is in the scene.
    #[error(transparent)]
    Conflict(Refusal),
    /// A component's own code panicked in the Model; nothing of it is in the scene, and the Model goes on from
    /// what was last published.
    #[error("the batch made the Model panic; nothing of it is in the scene")]
    Quarantined,
    /// The Model has failed and is not back yet; try again.
    #[error("the Model is being restarted")]
    ModelDown,
    /// Batches that the Model has not answered fill the way to it; try again.
    #[error("the Model has not answered the batches before this one")]
    Busy,
    /// No answer came in time: it may still be applied, later.
    #[error("the Model did not answer within {} s", .0.as_secs_f64())]
    NoAnswer(Duration),
    /// The session has ended.
    #[error("the session has ended")]
    Ended,
    /// Every handle that a session gives out is in use.
    #[error("the session has {0} operators already; drop one")]
    TooMany(u32),
}

/// The Model's decision as whoever asked for it sees it.
pub(crate) fn answer(outcome: Outcome) -> Result<Revision, OperatorError> {
    match outcome {
        Outcome::Applied { revision } => Ok(revision),
        Outcome::Rejected(rejection) => Err(rejection.into()),
        Outcome::Conflict(refusal) => Err(OperatorError::Conflict(refusal)),
    }
}

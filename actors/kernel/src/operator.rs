//! The operator: the writer for programs outside the session, such as a researcher's script, a tuning panel or a
//! console.
//!
//! It declares no access and may write every row, so it conflicts with no writer; a controller that owns the same row
//! overwrites it at its next tick. The operator's batches are checked like all others, enter the recording and the hash
//! chain under its name, and are replayed. The Model knows it from the start, so the first write needs no declaration.

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

/// Why an operator's batch is not, or may not be, in the scene.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum OperatorError {
    /// The batch broke a rule; none of it was applied.
    #[error(transparent)]
    Rejected(#[from] Rejection),
    /// A precondition no longer held; none of the batch was applied.
    #[error(transparent)]
    Conflict(Refusal),
    /// A component's own code panicked in the Model; none of the batch was applied, and the Model continues from the
    /// last published state.
    #[error("the batch made the Model panic; nothing of it is in the scene")]
    Quarantined,
    /// The Model failed and has not restarted yet; try again.
    #[error("the Model is being restarted")]
    ModelDown,
    /// The ring is full of unanswered batches; try again.
    #[error("the Model has not answered the batches before this one")]
    Busy,
    /// No answer in time: the batch may still be applied later.
    #[error("the Model did not answer within {} s", .0.as_secs_f64())]
    NoAnswer(Duration),
    /// The session has ended.
    #[error("the session has ended")]
    Ended,
    /// All operator handles of the session are in use.
    #[error("the session has {0} operators already; drop one")]
    TooMany(u32),
}

/// Converts the Model's decision to the operator's result.
pub(crate) fn answer(outcome: Outcome) -> Result<Revision, OperatorError> {
    match outcome {
        Outcome::Applied { revision } => Ok(revision),
        Outcome::Rejected(rejection) => Err(rejection.into()),
        Outcome::Conflict(refusal) => Err(OperatorError::Conflict(refusal)),
    }
}

//! What the Model says of a batch or a writer, and what it counts.

use thiserror::Error;
use trocar_scene::{AccessOverlap, ComponentError, Entity, Refusal, RegistryError, Revision};

use crate::operator::{OPERATOR, OPERATOR_NAME, OPERATOR_WRITES_MAX};

/// Most rows whose ownership has moved from one writer to another.
pub(crate) const TRANSFERS_MAX: usize = 4096;

/// What became of a batch.
#[derive(Clone, Debug, PartialEq)]
pub enum Outcome {
    /// It is in the scene.
    Applied {
        /// The revision that it made.
        revision: Revision,
    },
    /// It broke a rule; nothing of it is in the scene.
    Rejected(Rejection),
    /// A precondition did not hold any more; nothing of it is in the scene, and nobody is to blame.
    Conflict(Refusal),
}

/// Why a batch was rejected.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum Rejection {
    /// From a writer that never declared itself.
    #[error("writer {0} has not declared what it writes")]
    UnknownWriter(u16),
    /// From an earlier life of its writer.
    #[error("epoch {found} is fenced off; the writer is in epoch {current}")]
    StaleEpoch {
        /// The batch's epoch.
        found: u32,
        /// The writer's.
        current: u32,
    },
    /// A row handed over to nobody.
    #[error("a row is handed over to writer {0}, which has not declared itself")]
    UnknownHeir(u16),
    /// A row of a writer's own entity handed over: its contributions would outlive it.
    #[error("{component} of {entity} stands on a writer's own entity and cannot be handed over")]
    OwnEntity {
        /// Name of the component.
        component: &'static str,
        /// The writer's entity.
        entity: Entity,
    },
    /// Too many rows handed over.
    #[error("more than {TRANSFERS_MAX} rows have been handed over")]
    TooManyTransfers,
    /// It cannot be encoded, so it could be neither hashed nor recorded.
    #[error("the batch cannot be encoded: {0}")]
    Unencodable(ComponentError),
    /// More in one batch than an operator may ask for: the Model would keep everybody waiting.
    #[error("{0} writes in one batch; valid: up to {OPERATOR_WRITES_MAX}")]
    TooManyWrites(usize),
    /// It broke a rule of the scene.
    #[error(transparent)]
    Refused(Refusal),
}

/// A writer that the Model does not take.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum DeclareError {
    /// The operator's name or number.
    #[error("'{name}' cannot be writer {id}: '{OPERATOR_NAME}', writer {}, is whoever writes from outside", OPERATOR.0)]
    Reserved {
        /// The writer.
        name: String,
        /// Its number.
        id: u16,
    },
    /// Two writers of one name.
    #[error("two writers are named '{0}'")]
    NameTaken(String),
    /// Two writers of one number.
    #[error("'{name}' and '{other}' both are writer {id}")]
    IdTaken {
        /// The new one.
        name: String,
        /// The one that had it.
        other: String,
        /// The number.
        id: u16,
    },
    /// An unknown component.
    #[error("'{name}': {error}")]
    Component {
        /// The writer.
        name: String,
        /// What is wrong.
        error: RegistryError,
    },
    /// Two writers of one row.
    #[error(transparent)]
    Overlap(#[from] AccessOverlap),
}

/// What the Model counts for each writer.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct WriterCounts {
    /// Batches applied.
    pub applied: u64,
    /// Batches rejected.
    pub rejected: u64,
    /// Batches whose preconditions did not hold.
    pub conflicts: u64,
    /// Batches that made the Model panic.
    pub quarantined: u64,
    /// Applied batches that were undone before anybody saw them, because a later one made the Model panic.
    pub undone: u64,
}

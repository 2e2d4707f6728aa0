//! Admission results: outcomes of batches, errors of declarations, and counters per writer.

use thiserror::Error;
use trocar_scene::{
    AccessOverlap, CommandError, ComponentError, Entity, Refusal, RegistryError, Revision, Snapshot,
};

use crate::operator::{OPERATOR, OPERATOR_NAME, OPERATOR_WRITES_MAX};
use crate::runtime::ControllerReport;

/// Most rows transferred from one writer to another.
pub(crate) const TRANSFERS_MAX: usize = 4096;

/// Outcome of a batch.
#[derive(Clone, Debug, PartialEq)]
pub enum Outcome {
    /// The batch was applied.
    Applied {
        /// The revision that it made.
        revision: Revision,
    },
    /// The batch broke a rule; none of it was applied.
    Rejected(Rejection),
    /// A precondition no longer held; none of the batch was applied. This is not an error of the writer.
    Conflict(Refusal),
}

/// Why a batch was rejected.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum Rejection {
    /// The writer never declared itself.
    #[error("writer {0} has not declared what it writes")]
    UnknownWriter(u16),
    /// The batch is from an earlier life of its writer.
    #[error("epoch {found} is fenced off; the writer is in epoch {current}")]
    StaleEpoch {
        /// The batch's epoch.
        found: u32,
        /// The writer's.
        current: u32,
    },
    /// A row was transferred to an unknown writer.
    #[error("a row is handed over to writer {0}, which has not declared itself")]
    UnknownHeir(u16),
    /// A row of a writer's own entity was transferred: its contributions would outlive it.
    #[error("{component} of {entity} stands on a writer's own entity and cannot be handed over")]
    OwnEntity {
        /// Name of the component.
        component: &'static str,
        /// The writer's entity.
        entity: Entity,
    },
    /// Too many rows were transferred.
    #[error("more than {TRANSFERS_MAX} rows have been handed over")]
    TooManyTransfers,
    /// It cannot be encoded, so it could be neither hashed nor recorded.
    #[error("the batch cannot be encoded: {0}")]
    Unencodable(ComponentError),
    /// An operator's batch is too large: it would block the Model for too long.
    #[error("{0} writes in one batch; valid: up to {OPERATOR_WRITES_MAX}")]
    TooManyWrites(usize),
    /// It broke a rule of the scene.
    #[error(transparent)]
    Refused(Refusal),
}

impl Rejection {
    /// The reason with entities by their names, and with the remedy.
    pub fn told(&self, scene: &Snapshot) -> String {
        match self {
            Self::Refused(Refusal::NotDeclared { component, entity }) => format!(
                "it writes '{component}' of '{}', which its access does not declare: add it to `Access::writes`, unless \
                 another controller writes it",
                scene.name(*entity)
            ),
            Self::Refused(Refusal::NotOwner(entity)) => {
                format!("it creates or removes '{}', which is not its own", scene.name(*entity))
            }
            Self::Refused(Refusal::Command(CommandError::Value { component, entity, error })) => {
                format!("its '{component}' of '{}' is not valid: {error}", scene.name(*entity))
            }
            Self::OwnEntity { component, entity } => format!(
                "it hands over '{component}' of '{}', an entity that stands for a writer",
                scene.name(*entity)
            ),
            other => other.to_string(),
        }
    }
}

/// A writer whose batches were all refused, with their number and the first reason.
pub(crate) fn all_refused(
    report: &ControllerReport,
    first: &Rejection,
    scene: &Snapshot,
) -> Option<(String, String)> {
    let count = report.rejected;
    let all = count > 0 && report.applied + report.conflicts == 0;
    all.then(|| {
        (report.name.clone(), format!("all of its {count} batches were refused: {}", first.told(scene)))
    })
}

/// Why the Model refuses a writer's declaration.
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
    /// Two writers have the same name.
    #[error("two writers are named '{0}'")]
    NameTaken(String),
    /// Two writers have the same number.
    #[error("'{name}' and '{other}' both are writer {id}")]
    IdTaken {
        /// The new one.
        name: String,
        /// The writer that already has it.
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
    /// Two writers declared the same row.
    #[error(transparent)]
    Overlap(#[from] AccessOverlap),
}

/// Counters of the Model per writer.
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
    /// Applied batches rolled back before publication, because a later one made the Model panic.
    pub undone: u64,
}

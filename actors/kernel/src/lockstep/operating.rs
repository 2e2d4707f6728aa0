//! Operator writes into a lock-step session, at its current instant.

use std::sync::Arc;

use trocar_scene::{Batch, Commands, EntityAllocator, Provenance, Registry, Revision};

use super::session::LockstepSession;
use super::slot::blank;
use crate::operator::{OPERATOR, OPERATOR_EPOCH, OperatorError, answer};

/// The operator's writer state.
pub(super) struct OperatorWriter {
    pub(super) allocator: EntityAllocator,
    /// Number of its next batch.
    pub(super) tick: u64,
    spare: Option<Box<Batch>>,
}

impl OperatorWriter {
    pub(super) fn new(allocator: EntityAllocator, tick: u64) -> Self {
        Self { allocator, tick, spare: None }
    }

    fn take(&mut self, registry: &Arc<Registry>) -> Box<Batch> {
        self.spare.take().unwrap_or_else(|| blank(registry, &self.allocator, OPERATOR))
    }
}

impl LockstepSession {
    /// Applies the commands of `write` as one atomic batch, now: all later ticks see it. Any component of any entity
    /// may be written; a controller that owns the same row overwrites it at its next tick. An empty batch changes
    /// nothing.
    ///
    /// # Errors
    /// [`OperatorError`] says why the batch was not applied.
    pub fn apply(&mut self, write: impl FnOnce(&mut Commands)) -> Result<Revision, OperatorError> {
        if self.exit.is_some() {
            return Err(OperatorError::Ended);
        }
        if !self.model_up {
            return Err(OperatorError::ModelDown);
        }
        let mut batch = self.operator.take(&self.registry);
        batch.commands.clear();
        batch.commands.begin(self.now);
        write(&mut batch.commands);
        let based_on = self.core.view().revision();
        if batch.commands.is_empty() {
            self.operator.spare = Some(batch);
            return Ok(based_on);
        }
        batch.commands.seal();
        let tick = self.operator.tick;
        self.operator.tick += 1;
        batch.provenance =
            Provenance { writer: OPERATOR, epoch: OPERATOR_EPOCH, tick, time: self.now, based_on };
        match self.decide(&mut batch) {
            Ok(outcome) => {
                self.operator.spare = Some(batch);
                answer(outcome)
            }
            // The batch is discarded.
            Err(text) => {
                self.model_died(Some(OPERATOR), text);
                Err(OperatorError::Quarantined)
            }
        }
    }
}

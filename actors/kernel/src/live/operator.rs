//! The operator of a live session: its own ring to the Model, and a ring of receipts back.

use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use rtrb::Consumer;
use trocar_scene::{Commands, Revision};

use super::shared::Shared;
use crate::handle::{LaneStatus, Receipt, Submitted, WriterHandle};
use crate::operator::{OPERATOR, OPERATOR_EPOCH, OperatorError, answer};

/// Most operator handles of a session at a time.
pub const OPERATORS_MAX: u32 = 16;

/// Batches that may wait for the Model; normally one, more when answers time out.
const CAPACITY: usize = 4;

/// Polling period for the answer.
const LOOK_EVERY: Duration = Duration::from_micros(50);

/// A handle for writing into a live session from any thread. It never blocks the Model or a controller.
pub struct Operator {
    shared: Arc<Shared>,
    handle: WriterHandle,
    answers: Consumer<Receipt>,
}

impl Operator {
    pub(super) fn new(shared: Arc<Shared>) -> Result<Self, OperatorError> {
        let taken = shared.operator.handles.fetch_update(Ordering::AcqRel, Ordering::Acquire, |count| {
            (count < OPERATORS_MAX).then_some(count + 1)
        });
        if taken.is_err() {
            return Err(OperatorError::TooMany(OPERATORS_MAX));
        }
        let (handle, answers) = open(&shared);
        Ok(Self { shared, handle, answers })
    }

    /// Sends the commands of `write` as one atomic batch, and waits for the Model's answer, at most `limit`. When the
    /// answer arrives, the batch is published. An empty batch changes nothing.
    ///
    /// # Errors
    /// [`OperatorError`] says why the batch was not applied; only after [`OperatorError::NoAnswer`] it may still be
    /// applied.
    pub fn apply(
        &mut self,
        limit: Duration,
        write: impl FnOnce(&mut Commands),
    ) -> Result<Revision, OperatorError> {
        let until = Instant::now() + limit;
        // Discards late answers to earlier batches.
        while self.answers.pop().is_ok() {}
        let now = self.shared.clock.now();
        write(self.handle.begin(now));
        let based_on = self.shared.published.load().revision();
        let tick = self.shared.operator.tick.fetch_add(1, Ordering::Relaxed);
        match self.handle.submit(tick, now, based_on) {
            Submitted::Sent => {}
            Submitted::Empty => return Ok(based_on),
            Submitted::Dropped => return Err(OperatorError::Busy),
        }
        loop {
            while let Ok(receipt) = self.answers.pop() {
                if receipt.tick == tick {
                    return receipt.outcome.map_or(Err(OperatorError::Quarantined), answer);
                }
            }
            if self.shared.over.load(Ordering::Relaxed) {
                return Err(OperatorError::Ended);
            }
            if Instant::now() >= until {
                return Err(OperatorError::NoAnswer(limit));
            }
            std::thread::sleep(LOOK_EVERY);
        }
    }
}

impl Drop for Operator {
    fn drop(&mut self) {
        self.shared.operator.handles.fetch_sub(1, Ordering::AcqRel);
    }
}

fn open(shared: &Shared) -> (WriterHandle, Consumer<Receipt>) {
    shared.intake.open_with_receipts(
        OPERATOR,
        OPERATOR_EPOCH,
        CAPACITY,
        shared.operator.allocator.clone(),
        Arc::<LaneStatus>::default(),
    )
}

//! The operator of a live session: a ring of its own to the Model, and one of answers back.

use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use rtrb::Consumer;
use trocar_scene::{Commands, Revision};

use super::shared::Shared;
use crate::handle::{LaneStatus, Receipt, Submitted, WriterHandle};
use crate::operator::{OPERATOR, OPERATOR_EPOCH, OperatorError, answer};

/// Most operators of a session at a time.
pub const OPERATORS_MAX: u32 = 16;

/// Batches that may wait for the Model; one, unless answers stay out.
const CAPACITY: usize = 4;

/// Between two looks at whether the answer has come.
const LOOK_EVERY: Duration = Duration::from_micros(50);

/// A handle for writing into a live session from any thread. Neither the Model nor any controller ever waits for
/// it.
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

    /// Writes what `write` commands as one batch, all of it or nothing, and waits for the Model's answer, at most
    /// `limit`. With the answer the batch is published. Commanding nothing changes nothing.
    ///
    /// # Errors
    /// [`OperatorError`] says why nothing of it is in the scene; only after [`OperatorError::NoAnswer`] it may still
    /// get there.
    pub fn apply(
        &mut self,
        limit: Duration,
        write: impl FnOnce(&mut Commands),
    ) -> Result<Revision, OperatorError> {
        let until = Instant::now() + limit;
        // Answers that came too late.
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

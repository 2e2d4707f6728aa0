//! Guests: participants of a live session that are not ticked, such as a console, a viewer, a device's own program, or
//! a plain actix actor.
//!
//! A guest reads the latest snapshot and sends batches through a ring of its own, like a controller. It cannot delay
//! others: reading is loading a pointer, a full ring refuses the guest's own batch, and the Model drains all rings
//! round-robin.

use std::fmt;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use rtrb::Consumer;
use tokio::sync::oneshot::error::TryRecvError;
use trocar_scene::{
    Access, CommandError, Commands, Entity, EntityAllocator, Event, Revision, SimTime, Snapshot, WriterId,
};

use super::LiveError;
use super::shared::Shared;
use crate::handle::{LaneStatus, Receipt, Submitted, WriterHandle};
use crate::operator::{OperatorError, answer};
use crate::token_bucket::FlowLimit;

/// Longest wait for the Model's answer to a guest's declaration.
const ANSWER_MAX: Duration = Duration::from_secs(1);

/// Identity of a guest, which it keeps through all its lives.
#[derive(Clone)]
pub(super) struct GuestIdentity {
    pub(super) shared: Arc<Shared>,
    pub(super) name: String,
    pub(super) id: WriterId,
    pub(super) access: Access,
    pub(super) capacity: usize,
    /// Whether the Model answers each of its batches.
    pub(super) is_answered: bool,
}

impl GuestIdentity {
    /// Declares the guest and waits for the Model's answer, at most a second.
    pub(super) fn accept(&self) -> Result<Guest, LiveError> {
        let refused = |reason: String| LiveError::Controller { name: self.name.clone(), reason };
        let mut answer = self.shared.request_declaration(&self.name, self.id, &self.access);
        let until = Instant::now() + ANSWER_MAX;
        loop {
            match answer.try_recv() {
                Ok(answer) => break answer.map_err(refused)?,
                Err(TryRecvError::Empty) if Instant::now() < until => {
                    std::thread::sleep(Duration::from_millis(1));
                }
                Err(_) => return Err(refused("the Model did not answer".to_owned())),
            }
        }
        let status = Arc::<LaneStatus>::default();
        let seen = self.shared.published.load().events().next();
        let (handle, answers) = self.open(&status);
        Ok(Guest { handle, answers, status, identity: self.clone(), seen, batches: 0 })
    }

    fn open(&self, status: &Arc<LaneStatus>) -> (WriterHandle, Option<Consumer<Receipt>>) {
        let allocator = EntityAllocator::new(self.shared.station, self.id.0);
        allocator.skip_to(self.shared.published.load().first_free(self.shared.station, self.id.0));
        if self.is_answered {
            let (handle, answers) =
                self.shared.intake.open_with_receipts(self.id, 1, self.capacity, allocator, status.clone());
            return (handle, Some(answers));
        }
        let bounds = (self.capacity, FlowLimit::UNLIMITED);
        (self.shared.intake.open(self.id, 1, bounds, allocator, status.clone()), None)
    }
}

/// A participant of a live session that is not ticked: it reads the latest snapshot, and sends batches through its own
/// ring. It cannot delay others: reading is loading a pointer, and a full ring refuses only its own batch.
///
/// It stays valid when the Model is replaced: the next Model knows it.
pub struct Guest {
    identity: GuestIdentity,
    handle: WriterHandle,
    /// What the Model says of its batches, if it is answered.
    answers: Option<Consumer<Receipt>>,
    status: Arc<LaneStatus>,
    /// Number of the first event that it has not seen.
    seen: u64,
    batches: u64,
}

impl Guest {
    /// Its name among the writers.
    pub fn name(&self) -> &str {
        &self.identity.name
    }
    /// Its own entity, for its own components.
    pub fn me(&self) -> Entity {
        Entity::of_writer(self.identity.shared.station, self.identity.id.0)
    }
    /// Time of the session.
    pub fn now(&self) -> SimTime {
        self.identity.shared.clock.now()
    }
    /// Whether the session has ended; later batches do not arrive.
    pub fn has_ended(&self) -> bool {
        self.identity.shared.over.load(Ordering::Relaxed)
    }
    /// The latest snapshot. Only loads a pointer; holding it keeps its memory alive.
    pub fn snapshot(&self) -> Arc<Snapshot> {
        self.identity.shared.published.load_full()
    }
    /// Number of batches refused because the ring was full.
    pub fn dropped(&self) -> u64 {
        self.status.dropped()
    }

    /// Events since the last call (the first time: since it joined), oldest first. The log holds about 4,096 events; a
    /// guest that calls too rarely misses the oldest.
    pub fn events(&mut self) -> Vec<Event> {
        let scene = self.identity.shared.published.load();
        let events = scene.events().since(self.seen).map(|(_, event)| event.clone()).collect();
        self.seen = scene.events().next();
        events
    }

    /// Sends one batch: `command` sees the latest snapshot and fills the commands, which the Model applies as a whole
    /// or not at all. Never blocks: [`Submitted::Dropped`] means that the ring is full.
    ///
    /// # Errors
    /// The first invalid command, such as one with a non-finite number; nothing is sent then.
    pub fn write(
        &mut self,
        command: impl FnOnce(&Snapshot, &mut Commands),
    ) -> Result<Submitted, CommandError> {
        let (scene, now) = (self.identity.shared.published.load(), self.now());
        let out = self.handle.begin(now);
        command(&scene, out);
        if let Some(error) = out.error() {
            return Err(error.clone());
        }
        self.batches += 1;
        Ok(self.handle.submit(self.batches, now, scene.revision()))
    }

    /// What became of the oldest batch that the Model has judged since: the revision with it, which is published, or why
    /// none of it was applied. For a guest that joined with answers; others get none.
    pub fn answer(&mut self) -> Option<Result<Revision, OperatorError>> {
        let receipt = self.answers.as_mut()?.pop().ok()?;
        Some(receipt.outcome.map_or(Err(OperatorError::Quarantined), answer))
    }

    /// Its plain writer handle, for measurements.
    pub fn into_handle(self) -> WriterHandle {
        self.handle
    }
}

impl fmt::Debug for Guest {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Guest")
            .field("name", &self.name())
            .field("handle", &self.handle)
            .finish_non_exhaustive()
    }
}

//! The Model as an actix actor: woken by a doorbell that it watches as a stream, drains the rings, publishes.

use std::pin::Pin;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::task::{Context as TaskContext, Poll};

use actix::prelude::*;
use tokio::sync::Notify;
use tokio::sync::futures::OwnedNotified;
use trocar_scene::{SimTime, Snapshot, Store, WriterId};

use super::shared::{Life, Shared, lock};
use crate::commit::CommitBuffer;
use crate::handle::{LaneIndex, Lanes, Receipt};
use crate::model_core::{ModelCore, Outcome};
use crate::retire::Retired;
use crate::runtime::{guarded, sched};
use crate::supervision::{Cause, Event};

/// Retired snapshots kept for their readers before the reaper gets them.
const RETIRED_MAX: usize = 64;

/// Somebody rang.
pub(super) struct Rung;

/// The doorbell as a stream; polling it allocates nothing.
struct Bell {
    notify: Arc<Notify>,
    waiting: Pin<Box<OwnedNotified>>,
}

impl Stream for Bell {
    type Item = Rung;
    fn poll_next(mut self: Pin<&mut Self>, cx: &mut TaskContext<'_>) -> Poll<Option<Rung>> {
        match self.waiting.as_mut().poll(cx) {
            Poll::Pending => Poll::Pending,
            Poll::Ready(()) => {
                let next = self.notify.clone().notified_owned();
                self.waiting.set(next);
                Poll::Ready(Some(Rung))
            }
        }
    }
}

/// Begin a life.
#[derive(Message)]
#[rtype(result = "()")]
pub(super) struct Live(pub(super) Arc<Life>);

struct Desk {
    core: ModelCore,
    lanes: Lanes,
    retired: Retired<Snapshot>,
    spare: CommitBuffer,
    last: Arc<Snapshot>,
}

/// The actor.
pub(super) struct ModelActor {
    shared: Arc<Shared>,
    life: Option<Arc<Life>>,
    /// Survives panics: the core falls back to what it published last.
    desk: Option<Desk>,
    /// The core of a new Model, made before its thread.
    first: Option<ModelCore>,
    /// Whose batch is being applied, where it came in, and its tick.
    culprit: Option<(WriterId, LaneIndex, u64)>,
    resumed: bool,
}

impl ModelActor {
    /// Takes the core over; `None` builds one from the last published snapshot.
    pub(super) fn new(shared: Arc<Shared>, first: Option<ModelCore>) -> Self {
        Self { shared, life: None, desk: None, first, culprit: None, resumed: false }
    }

    fn begin(&mut self, life: &Life) -> Result<(), String> {
        let tid = sched::current_tid();
        life.tid.store(tid, Ordering::Relaxed);
        self.shared.model.stats.enter_thread(tid);
        if let Some(desk) = &mut self.desk {
            let culprit = self.culprit.take();
            desk.core.recover(culprit.map(|(id, ..)| id));
            if let Some((_, lane, tick)) = culprit {
                desk.lanes.answer(lane, Receipt { tick, outcome: None });
            }
            if let Some(index) = culprit.and_then(|(id, ..)| self.shared.writer_index(id)) {
                // The batch that killed it is not tried again.
                self.shared.writers[index].seat.stats.rejected();
            }
            return Ok(());
        }
        let core = match self.first.take() {
            Some(core) => core,
            None => self.rebuild()?,
        };
        let retired = Retired::new(RETIRED_MAX).map_err(|error| error.to_string())?;
        let mut desk = Desk {
            core,
            lanes: self.shared.intake.take(),
            retired,
            spare: CommitBuffer::new(),
            last: self.shared.published.load_full(),
        };
        desk.core.keep_commits(self.shared.has_sink);
        // Takes the place of what an abandoned Model published, so that it can publish nothing any more.
        let snapshot = desk.core.publish();
        let before = self.shared.published.swap(snapshot.clone());
        desk.retired.retire(before);
        desk.last = snapshot;
        self.desk = Some(desk);
        Ok(())
    }

    /// A core for a Model whose predecessor is out of reach, from what everybody can see.
    fn rebuild(&self) -> Result<ModelCore, String> {
        let store = Store::from_snapshot(&self.shared.published.load());
        let mut core = ModelCore::new(store, self.shared.station).map_err(|error| error.to_string())?;
        if let Some(head) = *lock(&self.shared.published_hash) {
            // The log goes on, and so does the chain over it.
            core = core.with_chain(head);
        }
        for writer in &self.shared.writers {
            if let Some(access) = &*lock(&writer.declared) {
                core.declare(&writer.seat.name, writer.id, access).map_err(|error| error.to_string())?;
            }
        }
        // The rings went with the old Model: everybody opens new ones.
        self.shared.generation.fetch_add(1, Ordering::Release);
        self.shared.fences_waiting.raise();
        Ok(core)
    }

    /// One pass: everything that waits, published in between as the rule says.
    fn pass(&mut self, life: &Life) {
        let Some(desk) = &mut self.desk else { return };
        let shared = &*self.shared;
        if shared.model.seam.take_kill() {
            panic!("fault injected: kill");
        }
        if let Some(span) = shared.model.seam.take_stall() {
            super::host::stall(shared, span);
            shared.model.seam.end_stall();
        }
        let mut now = shared.clock.now();
        if shared.declares_waiting.take() {
            // A new life that declares something else must not keep its predecessor's contributions alive.
            desk.raise_fences(shared, now);
            desk.hear_declarations(shared);
            // Who is new to the Model may have been fenced before.
            shared.fences_waiting.raise();
        }
        desk.lanes.begin_pass();
        if shared.fences_waiting.take() {
            desk.raise_fences(shared, now);
        }
        while let Some((lane, mut batch)) = desk.lanes.next() {
            let id = batch.provenance.writer;
            let tick = batch.provenance.tick;
            self.culprit = Some((id, lane, tick));
            let writer = shared.writer_index(id).map(|index| &shared.writers[index]);
            // Raised between the pass's beginning and this batch: it must not slip through.
            if writer.is_some_and(|w| w.epoch.load(Ordering::Acquire) > batch.provenance.epoch) {
                desk.raise_fences(shared, now);
            }
            let outcome = desk.core.apply(&mut batch, now);
            // Guests have no row in the report.
            if let Some(writer) = writer {
                match &outcome {
                    Outcome::Applied { .. } => drop(writer.applied.fetch_add(1, Ordering::Relaxed)),
                    Outcome::Rejected(_) => writer.seat.stats.rejected(),
                    Outcome::Conflict(_) => writer.seat.stats.conflict(),
                }
            }
            // Whoever waits for an answer may read the scene when it has it, and what it was told must stand.
            if desk.lanes.wants_receipt(lane) && desk.publish(shared) {
                desk.lanes.answer(lane, Receipt { tick, outcome: Some(outcome) });
            }
            shared.batches.fetch_add(1, Ordering::Relaxed);
            desk.lanes.give_back(lane, batch);
            now = shared.clock.now();
            life.bump(now);
            life.bump(now);
            if desk.core.is_publish_due(now, false) {
                desk.publish(shared);
            }
        }
        self.culprit = None;
        if desk.core.is_publish_due(now, true) {
            desk.publish(shared);
        }
    }

    fn rung(&mut self, ctx: &mut Context<Self>) {
        let Some(life) = self.life.clone() else { return };
        let begun = self.shared.clock.now();
        life.bump(begun);
        let outcome = guarded(|| self.pass(&life));
        let ended = self.shared.clock.now();
        life.bump(ended);
        if life.is_abandoned() {
            self.shared.report(Event::ZombieEnded);
            return self.leave(ctx);
        }
        match outcome {
            Err(panic) => {
                self.life = None;
                life.running.store(false, Ordering::Relaxed);
                self.shared.died(&self.shared.model, &life, Cause::Panic(panic));
            }
            Ok(()) => {
                self.shared.model.stats.ran(begun, SimTime::ZERO, ended.since(begun));
                if !self.resumed {
                    self.resumed = true;
                    let (child, incarnation) = (self.shared.model.child, life.incarnation);
                    self.shared.report(Event::Resumed { child, incarnation });
                }
                if life.stop.load(Ordering::Relaxed) {
                    if let Some(desk) = &self.desk {
                        *lock(&self.shared.final_hash) = Some(desk.core.hash());
                    }
                    self.shared.model.stats.leave_thread();
                    self.shared.died(&self.shared.model, &life, Cause::Stop);
                    self.life = None;
                    self.leave(ctx);
                }
            }
        }
    }

    fn leave(&mut self, ctx: &mut Context<Self>) {
        ctx.stop();
        Arbiter::current().stop();
    }
}

impl Desk {
    fn hear_declarations(&mut self, shared: &Shared) {
        for declare in std::mem::take(&mut *lock(&shared.declares)) {
            let answer = self.core.declare(&declare.name, declare.id, &declare.access);
            if answer.is_ok()
                && let Some(index) = shared.writer_index(declare.id)
            {
                *lock(&shared.writers[index].declared) = Some(declare.access);
            }
            let _ = declare.reply.send(answer.map(|_| ()).map_err(|error| error.to_string()));
        }
    }

    /// Brings the core's epochs up to those that the supervisor ordered.
    fn raise_fences(&mut self, shared: &Shared, now: SimTime) {
        for writer in &shared.writers {
            let ordered = writer.epoch.load(Ordering::Acquire);
            if self.core.epoch(writer.id).is_some_and(|epoch| epoch < ordered) {
                self.core.fence(writer.id, ordered, now);
            }
        }
    }

    /// Publish is commit: readers first, then who records. `false` when another Model has taken over.
    fn publish(&mut self, shared: &Shared) -> bool {
        let snapshot = self.core.publish();
        let before = shared.published.compare_and_swap(&self.last, snapshot.clone());
        if !Arc::ptr_eq(&before, &self.last) {
            // What this one thinks no longer counts.
            return false;
        }
        drop(before);
        *lock(&shared.published_hash) = Some(self.core.hash());
        self.retired.retire(std::mem::replace(&mut self.last, snapshot));
        if shared.has_sink
            && let Some(sink) = lock(&shared.sink).as_mut()
        {
            let commits = self.core.swap_commits(std::mem::take(&mut self.spare));
            self.spare = sink.committed(&self.last, commits);
        }
        true
    }
}

impl Actor for ModelActor {
    type Context = Context<Self>;
    fn started(&mut self, ctx: &mut Self::Context) {
        let notify = self.shared.bell.clone();
        let waiting = Box::pin(notify.clone().notified_owned());
        ctx.add_stream(Bell { notify, waiting });
    }
}

impl StreamHandler<Rung> for ModelActor {
    fn handle(&mut self, _: Rung, ctx: &mut Self::Context) {
        self.rung(ctx);
    }
}

impl Handler<Live> for ModelActor {
    type Result = ();
    fn handle(&mut self, Live(life): Live, ctx: &mut Self::Context) {
        let seat = &self.shared.model;
        let (child, incarnation) = (seat.child, life.incarnation);
        let begun = guarded(|| self.begin(&life)).unwrap_or_else(Err);
        let shared = self.shared.clone();
        match begun {
            Err(error) => shared.died(&shared.model, &life, Cause::Error(error)),
            Ok(()) => {
                self.life = Some(life.clone());
                self.resumed = false;
                life.running.store(true, Ordering::Release);
                shared.report(Event::Started { child, incarnation });
                // What came while nobody listened.
                self.rung(ctx);
            }
        }
    }
}

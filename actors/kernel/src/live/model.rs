//! The Model as an actix actor: woken by a doorbell that it watches as a stream, drains the rings, publishes.

use std::pin::Pin;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::task::{Context as TaskContext, Poll};
use std::time::Duration;

use actix::prelude::*;
use tokio::sync::Notify;
use tokio::sync::futures::OwnedNotified;
use trocar_scene::{SimTime, Snapshot, Store, WriterId};

use super::shared::{DeclareWriter, GuestDeclaration, Life, Shared, lock};
use crate::commit::CommitBuffer;
use crate::handle::Receipt;
use crate::intake::{Arrival, LaneIndex, Lanes};
use crate::model_core::{ModelCore, Outcome};
use crate::runtime::{guarded, sched};
use crate::snapshot_reclaimer::Retired;
use crate::state_hash::StateHash;
use crate::supervision::{Cause, Event};

/// Retired snapshots kept for their readers before the reclaimer frees them.
const RETIRED_MAX: usize = 64;
/// Number of polls, and the pause between them, for the hash of a published scene.
const HASH_TRIES: u32 = 200;
const HASH_PAUSE: Duration = Duration::from_micros(100);

/// The doorbell rang.
pub(super) struct DoorbellRang;

/// The doorbell as a stream; polling it allocates nothing.
struct DoorbellStream {
    notify: Arc<Notify>,
    waiting: Pin<Box<OwnedNotified>>,
}

impl Stream for DoorbellStream {
    type Item = DoorbellRang;
    fn poll_next(mut self: Pin<&mut Self>, cx: &mut TaskContext<'_>) -> Poll<Option<DoorbellRang>> {
        match self.waiting.as_mut().poll(cx) {
            Poll::Pending => Poll::Pending,
            Poll::Ready(()) => {
                let next = self.notify.clone().notified_owned();
                self.waiting.set(next);
                Poll::Ready(Some(DoorbellRang))
            }
        }
    }
}

/// Message that begins a life.
#[derive(Message)]
#[rtype(result = "()")]
pub(super) struct BeginLife(pub(super) Arc<Life>);

struct RunningModel {
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
    /// Survives panics: the core rolls back to the last published state.
    running: Option<RunningModel>,
    /// The core of a new Model, built before its thread.
    first: Option<ModelCore>,
    /// Writer, lane and tick of the batch being applied.
    culprit: Option<(WriterId, LaneIndex, u64)>,
    resumed: bool,
}

impl ModelActor {
    /// Takes the core over; `None` builds one from the last published snapshot.
    pub(super) fn new(shared: Arc<Shared>, first: Option<ModelCore>) -> Self {
        Self { shared, life: None, running: None, first, culprit: None, resumed: false }
    }

    fn begin(&mut self, life: &Life) -> Result<(), String> {
        let tid = sched::current_tid();
        life.tid.store(tid, Ordering::Relaxed);
        self.shared.model.stats.enter_thread(tid);
        if let Some(running) = &mut self.running {
            let culprit = self.culprit.take();
            let fell_back = running.core.recover(culprit.map(|(id, ..)| id));
            if let Some((_, lane, tick)) = culprit {
                running.lanes.answer(lane, Receipt { tick, outcome: None });
            }
            if let Some(index) = culprit.and_then(|(id, ..)| self.shared.writer_index(id)) {
                // The batch that caused the panic is not retried.
                let writer = &self.shared.writers[index];
                writer.state.stats.quarantined();
                writer.taken.store(0, Ordering::Relaxed);
            }
            if fell_back {
                self.shared.writers.iter().for_each(|writer| writer.lose_unpublished());
            }
            return Ok(());
        }
        // An abandoned predecessor takes no more batches.
        let lanes = self.shared.intake.take();
        let retired = Retired::new(RETIRED_MAX).map_err(|error| error.to_string())?;
        let (mut core, mut from) = match self.first.take() {
            Some(core) => (core, self.shared.published.load_full()),
            None => {
                // Batches waiting in the rings are ours now; batches that the predecessor took and did not publish are
                // lost.
                self.shared.writers.iter().for_each(|writer| writer.lose_unpublished());
                self.rebuild()?
            }
        };
        let mut running = loop {
            // Replaces the snapshot published by an abandoned Model, so that it can publish nothing more.
            let snapshot = core.publish();
            let before = self.shared.published.compare_and_swap(&from, snapshot.clone());
            if Arc::ptr_eq(&before, &from) {
                break RunningModel { core, lanes, retired, spare: CommitBuffer::new(), last: snapshot };
            }
            // The predecessor published once more while we read its previous state.
            (core, from) = self.rebuild()?;
        };
        running.core.keep_commits(self.shared.has_sink);
        running.retired.retire(from);
        self.running = Some(running);
        Ok(())
    }

    /// Builds a core from the last published state when the predecessor is unreachable; returns that snapshot as well.
    fn rebuild(&self) -> Result<(ModelCore, Arc<Snapshot>), String> {
        let (scene, head) = self.published()?;
        let mut core = ModelCore::new(Store::from_snapshot(&scene), self.shared.station)
            .map_err(|error| error.to_string())?;
        if let Some(head) = head {
            // The commit log continues, and so does its hash chain.
            core = core.with_chain(head);
        }
        for writer in &self.shared.writers {
            if let Some(access) = &*lock(&writer.declared) {
                core.declare(&writer.state.name, writer.id, access).map_err(|error| error.to_string())?;
            }
        }
        for GuestDeclaration { name, id, access } in &*lock(&self.shared.guests) {
            core.declare(name, *id, access).map_err(|error| error.to_string())?;
        }
        self.shared.fences_waiting.raise();
        Ok((core, scene))
    }

    /// The published scene with its hash, which a predecessor may be about to publish.
    fn published(&self) -> Result<(Arc<Snapshot>, Option<StateHash>), String> {
        for _ in 0..HASH_TRIES {
            let scene = self.shared.published.load_full();
            match *lock(&self.shared.published_hash) {
                None => return Ok((scene, None)),
                Some((revision, hash)) if revision == scene.revision() => return Ok((scene, Some(hash))),
                Some(_) => {}
            }
            std::thread::sleep(HASH_PAUSE);
        }
        Err("a Model that was left behind published a scene and not its hash".to_owned())
    }

    /// One pass: applies all waiting batches and publishes as the publication rule says.
    fn pass(&mut self, life: &Life) {
        let Some(running) = &mut self.running else { return };
        let shared = &*self.shared;
        if shared.model.fault_hooks.take_kill() {
            panic!("fault injected: kill");
        }
        if let Some(span) = shared.model.fault_hooks.take_stall() {
            super::host::stall(shared, span);
            if life.is_abandoned() {
                return;
            }
            shared.model.fault_hooks.end_stall();
        }
        let mut now = shared.clock.now();
        if shared.declares_waiting.take() {
            // A new life with another declaration must not keep its predecessor's contributions.
            running.raise_fences(shared, now);
            running.apply_declarations(shared);
            // A writer new to this Model may have been fenced before.
            shared.fences_waiting.raise();
        }
        running.lanes.begin_pass();
        if shared.fences_waiting.take() {
            running.raise_fences(shared, now);
        }
        while let Some(Arrival { lane, sealed_at, mut batch }) = running.lanes.pop(now) {
            let id = batch.provenance.writer;
            let tick = batch.provenance.tick;
            self.culprit = Some((id, lane, tick));
            let writer = shared.writer_index(id).map(|index| &shared.writers[index]);
            if let Some(writer) = writer {
                writer.taken.store(1, Ordering::Relaxed);
                writer.state.stats.waited(now.since(sealed_at));
            }
            // A fence raised since the pass began must also stop this batch.
            if writer.is_some_and(|w| w.epoch.load(Ordering::Acquire) > batch.provenance.epoch) {
                running.raise_fences(shared, now);
            }
            let outcome = running.core.apply(&mut batch, now);
            // Guests have no row in the report, and an abandoned Model no longer counts.
            if let Some(writer) = writer.filter(|_| running.lanes.is_current()) {
                match &outcome {
                    Outcome::Applied { .. } => {
                        writer.applied.fetch_add(1, Ordering::Relaxed);
                        writer.unpublished.fetch_add(1, Ordering::Relaxed);
                    }
                    Outcome::Rejected(why) => writer.state.stats.rejected(why),
                    Outcome::Conflict(_) => writer.state.stats.conflict(),
                }
                writer.taken.store(0, Ordering::Relaxed);
            }
            // A writer may read the scene as soon as it has its receipt, so the receipt must follow the publication.
            if running.lanes.wants_receipt(lane) && running.publish(shared) {
                running.lanes.answer(lane, Receipt { tick, outcome: Some(outcome) });
            }
            shared.batches.fetch_add(1, Ordering::Relaxed);
            running.lanes.give_back(lane, batch);
            now = shared.clock.now();
            life.bump(now);
            life.bump(now);
            if running.core.is_publish_due(now, false) {
                running.publish(shared);
            }
        }
        self.culprit = None;
        if running.core.is_publish_due(now, true) {
            running.publish(shared);
        }
    }

    fn doorbell_rang(&mut self, ctx: &mut Context<Self>) {
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
                    if let Some(running) = &self.running {
                        *lock(&self.shared.final_hash) = Some(running.core.hash());
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

impl RunningModel {
    fn apply_declarations(&mut self, shared: &Shared) {
        for declare in std::mem::take(&mut *lock(&shared.declares)) {
            let answer = self.core.declare(&declare.name, declare.id, &declare.access);
            if answer.is_ok() {
                match shared.writer_index(declare.id) {
                    Some(index) => *lock(&shared.writers[index].declared) = Some(declare.access),
                    None => {
                        let DeclareWriter { name, id, access, .. } = &declare;
                        let guest = GuestDeclaration { name: name.clone(), id: *id, access: access.clone() };
                        let mut guests = lock(&shared.guests);
                        guests.retain(|known| known.id != guest.id);
                        guests.push(guest);
                    }
                }
            }
            let _ = declare.reply.send(answer.map(|_| ()).map_err(|error| error.to_string()));
        }
    }

    /// Raises the core's epochs to those ordered by the supervisor.
    fn raise_fences(&mut self, shared: &Shared, now: SimTime) {
        for writer in &shared.writers {
            let ordered = writer.epoch.load(Ordering::Acquire);
            if self.core.epoch(writer.id).is_some_and(|epoch| epoch < ordered) {
                self.core.fence(writer.id, ordered, now);
            }
        }
    }

    /// Publish is commit: readers first, then the recorder. `false` when another Model has taken over.
    fn publish(&mut self, shared: &Shared) -> bool {
        let snapshot = self.core.publish();
        let before = shared.published.compare_and_swap(&self.last, snapshot.clone());
        if !Arc::ptr_eq(&before, &self.last) {
            // This Model is superseded: its state no longer counts.
            return false;
        }
        drop(before);
        for writer in &shared.writers {
            writer.unpublished.store(0, Ordering::Relaxed);
        }
        *lock(&shared.published_hash) = Some((snapshot.revision(), self.core.hash()));
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
        ctx.add_stream(DoorbellStream { notify, waiting });
    }
}

impl StreamHandler<DoorbellRang> for ModelActor {
    fn handle(&mut self, _: DoorbellRang, ctx: &mut Self::Context) {
        self.doorbell_rang(ctx);
    }
}

impl Handler<BeginLife> for ModelActor {
    type Result = ();
    fn handle(&mut self, BeginLife(life): BeginLife, ctx: &mut Self::Context) {
        let state = &self.shared.model;
        let (child, incarnation) = (state.child, life.incarnation);
        let begun = guarded(|| self.begin(&life)).unwrap_or_else(Err);
        let shared = self.shared.clone();
        match begun {
            Err(error) => shared.died(&shared.model, &life, Cause::Error(error)),
            Ok(()) => {
                self.life = Some(life.clone());
                self.resumed = false;
                life.running.store(true, Ordering::Release);
                shared.report(Event::Started { child, incarnation });
                // Batches that arrived while no Model was listening.
                self.doorbell_rang(ctx);
            }
        }
    }
}

//! What the supervisor orders and what it is told.

use trocar_scene::{BuildContext, Controller, ControllerError, SimTime, WriterId};

use super::session::LockstepSession;
use crate::runtime::panics::guarded;
use crate::supervision::{Action, Cause, ChildId, Event};

impl LockstepSession {
    /// Does what the supervisor orders; gives the answer that it waits for.
    pub(super) fn act(&mut self, action: Action) -> Option<Event> {
        match action {
            Action::Fence { child, epoch } => {
                self.fence(child, epoch);
                None
            }
            Action::Start { child, incarnation, .. } => Some(self.start(child, incarnation)),
            Action::Stop { child } => self.stop(child),
            Action::Abandon { child, .. } => {
                self.abandon(child);
                None
            }
            Action::ZeroForces => {
                self.zero_forces.iter().for_each(|zero| zero());
                None
            }
            Action::CloseRecording => {
                self.close();
                None
            }
            Action::Exit(code) => {
                self.exit = Some(code);
                None
            }
        }
    }

    fn slot_of(&self, child: ChildId) -> Option<usize> {
        self.slots.iter().position(|slot| slot.child == child)
    }

    /// The devices first, then the Model: nothing of an older life counts from here on.
    fn fence(&mut self, child: ChildId, epoch: u32) {
        let Some(index) = self.slot_of(child) else { return };
        let slot = &self.slots[index];
        slot.spec.fences.iter().for_each(|fence| fence.raise(epoch));
        self.core.fence(slot.writer, epoch, self.now);
    }

    fn start(&mut self, child: ChildId, incarnation: u32) -> Event {
        if child == self.model {
            self.model_starts(incarnation);
            return Event::Started { child, incarnation };
        }
        match self.slot_of(child) {
            Some(index) => match self.build(index, incarnation) {
                Ok(controller) => {
                    self.slots[index].start(controller, incarnation);
                    if incarnation > 1 {
                        self.slots[index].stats.restarted();
                        let name = self.slots[index].spec.name.clone();
                        self.fault_log.restarted(&name, self.now);
                    }
                    Event::Started { child, incarnation }
                }
                Err(cause) => Event::Died { child, incarnation, cause },
            },
            // Something of the tree that only exists live, such as a viewer.
            None => Event::Started { child, incarnation },
        }
    }

    /// A life is built from the scene as it is, never from the corpse.
    fn build(&mut self, index: usize, epoch: u32) -> Result<Box<dyn Controller>, Cause> {
        // A sibling that is restarted without having failed was not fenced before.
        self.fence(self.slots[index].child, epoch);
        let slot = &self.slots[index];
        let context = BuildContext {
            scene: self.core.view(),
            // What the scene tells of it is as old as its last tick.
            time: if self.resuming { slot.last_tick() } else { self.now },
            name: &slot.spec.name,
            me: slot.me,
            epoch,
            seed: self.seed,
        };
        let built = guarded(|| {
            let controller = (slot.spec.factory)(&context)?;
            let access = controller.access();
            Ok::<_, ControllerError>((controller, access))
        });
        let (controller, access) = match built {
            Ok(Ok(built)) => built,
            Ok(Err(error)) => return Err(Cause::Error(error.to_string())),
            Err(text) => return Err(Cause::Panic(text)),
        };
        let writer = slot.writer;
        self.core
            .declare(&slot.spec.name, writer, &access)
            .map_err(|error| Cause::Error(error.to_string()))?;
        // The Model counts epochs from 1 as the supervisor does; a writer that it meets late catches up.
        self.core.fence(writer, epoch, self.now);
        Ok(controller)
    }

    fn stop(&mut self, child: ChildId) -> Option<Event> {
        let incarnation = self.supervisor.incarnation(child);
        let stopped = Event::Died { child, incarnation, cause: Cause::Stop };
        if child == self.model {
            self.model_up = false;
            self.model_hangs = None;
            return Some(stopped);
        }
        let Some(index) = self.slot_of(child) else { return Some(stopped) };
        if self.slots[index].pending.is_some() {
            self.slots[index].stopping = true;
            return None;
        }
        self.slots[index].end();
        Some(stopped)
    }

    fn abandon(&mut self, child: ChildId) {
        let Some(index) = self.slot_of(child) else { return };
        let zombie = self.slots[index].abandon(index, &self.registry);
        self.zombies.extend(zombie);
    }

    /// The life of slot `index` ended by `cause`.
    pub(super) fn died(&mut self, index: usize, cause: Cause) {
        let slot = &mut self.slots[index];
        slot.end();
        let child = slot.child;
        if self.fault_log.is_open() {
            self.fault_log.detected(&slot.spec.name, self.now);
        }
        let incarnation = self.supervisor.incarnation(child);
        self.tell(Event::Died { child, incarnation, cause });
    }

    /// Slow steps that end now, and those that the watchdog gives up on.
    pub(super) fn finish_slow_step(&mut self, index: usize) {
        let slot = &mut self.slots[index];
        if slot.pending.as_ref().is_some_and(|pending| pending.at <= self.now)
            && let Some(pending) = slot.pending.take()
        {
            slot.stalls_at = super::slot::NEVER;
            self.fault_log.stall_ended(&slot.spec.name, self.now);
            let ticked = slot.late_step(pending, self.now, self.core.view(), &self.registry);
            let (stopping, child) = (slot.stopping, slot.child);
            if stopping {
                slot.end();
                let incarnation = self.supervisor.incarnation(child);
                self.tell(Event::Died { child, incarnation, cause: Cause::Stop });
            } else {
                self.finish_tick(index, ticked);
            }
        } else if slot.stalls_at <= self.now {
            slot.stalls_at = super::slot::NEVER;
            let child = slot.child;
            self.fault_log.detected(&slot.spec.name, self.now);
            let incarnation = self.supervisor.incarnation(child);
            self.tell(Event::Stalled { child, incarnation });
        }
    }

    /// Zombies whose step ends after all: what they send is refused, and they are gone.
    pub(super) fn zombies_finish(&mut self) {
        while let Some(at) = self.zombies.iter().position(|zombie| zombie.pending.at <= self.now) {
            let zombie = self.zombies.remove(at);
            let (slot, batch) = (zombie.slot, zombie.wake(self.core.view()));
            self.apply_stale(slot, batch);
            self.tell(Event::ZombieEnded);
        }
    }

    /// At the end of the session those that are still stuck are dropped with it.
    pub(super) fn forget_zombies(&mut self) {
        for zombie in self.zombies.drain(..) {
            let _ = guarded(move || drop(zombie));
        }
    }

    /// A batch, or a fault, made the Model panic.
    pub(super) fn model_died(&mut self, culprit: Option<WriterId>, text: String) {
        if self.core.recover(culprit) {
            for slot in &mut self.slots {
                slot.applied -= slot.unpublished;
                slot.forgotten += std::mem::take(&mut slot.unpublished);
            }
        }
        self.model_up = false;
        self.model_resumed = false;
        self.fault_log.detected(crate::spec::MODEL, self.now);
        let (child, incarnation) = (self.model, self.supervisor.incarnation(self.model));
        self.tell(Event::Died { child, incarnation, cause: Cause::Panic(text) });
    }

    /// A life of the Model begins; what has been waiting for it is drained at the next instant.
    fn model_starts(&mut self, incarnation: u32) {
        self.model_up = true;
        if incarnation > 1 {
            self.model_stats.restarted();
            self.fault_log.restarted(crate::spec::MODEL, self.now);
        }
    }

    /// Batches that came while the Model was down, one per writer in turn.
    pub(super) fn drain_queues(&mut self) {
        self.queued = false;
        let mut waiting = true;
        while waiting && self.model_up {
            waiting = false;
            for index in 0..self.slots.len() {
                if self.model_up
                    && let Some(batch) = self.slots[index].queue.pop_front()
                {
                    waiting = true;
                    self.commit(index, batch);
                }
            }
        }
        // It died of one of them; the others go on waiting.
        self.queued = self.queued || waiting;
    }

    /// A step of slot `index` ended well as far as its controller is concerned.
    pub(super) fn step_is_over(&mut self, index: usize) {
        let slot = &mut self.slots[index];
        if !slot.resumed && slot.is_alive() {
            slot.resumed = true;
            let (child, incarnation) = (slot.child, slot.epoch);
            self.tell(Event::Resumed { child, incarnation });
        }
    }

    /// A step of slot `index` ended well and the Model agreed.
    pub(super) fn did_good_work(&mut self, index: usize) {
        self.step_is_over(index);
        if !self.model_resumed {
            self.model_resumed = true;
            let (child, incarnation) = (self.model, self.supervisor.incarnation(self.model));
            self.tell(Event::Resumed { child, incarnation });
        }
        if self.fault_log.is_open() {
            let ailments = self.slots[index].ailments;
            if !ailments.nan && !ailments.queue_full && ailments.slow == SimTime::ZERO {
                self.fault_log.resumed(&self.slots[index].spec.name, self.now);
            }
            self.fault_log.resumed(crate::spec::MODEL, self.now);
        }
    }
}

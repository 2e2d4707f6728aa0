//! Supervision in lock-step: executes the supervisor's actions and reports events to it.

use trocar_scene::{BuildContext, Controller, ControllerError, SimTime, WriterId};

use super::session::LockstepSession;
use crate::runtime::panics::guarded;
use crate::supervision::{Action, Cause, ChildId, Event};

impl LockstepSession {
    /// Executes an action of the supervisor; returns the event that it waits for.
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

    /// Fences the devices first, then the Model: output of older lives is refused from now on.
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
            // A child that exists only in live sessions, such as a viewer.
            None => Event::Started { child, incarnation },
        }
    }

    /// Builds a life from the current scene, never from the state of the failed one.
    fn build(&mut self, index: usize, epoch: u32) -> Result<Box<dyn Controller>, Cause> {
        // A sibling restarted without a failure was not fenced before.
        self.fence(self.slots[index].child, epoch);
        let slot = &self.slots[index];
        let context = BuildContext {
            scene: self.core.view(),
            // Its state in the scene dates from its last tick.
            time: if self.resuming { slot.last_tick(self.begin) } else { self.now },
            period: slot.spec.period(),
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
        // The Model counts epochs from 1 as the supervisor does; a writer declared late catches up.
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

    /// Finishes slow steps that end now, and abandons those over the watchdog's limit.
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

    /// HandleParts zombies whose step returns: their batches are refused.
    pub(super) fn zombies_finish(&mut self) {
        while let Some(at) = self.zombies.iter().position(|zombie| zombie.pending.at <= self.now) {
            let zombie = self.zombies.remove(at);
            let (slot, batch) = (zombie.slot, zombie.wake(self.core.view()));
            self.apply_stale(slot, batch);
            self.tell(Event::ZombieEnded);
        }
    }

    /// Drops the zombies that are still stuck at the end of the session.
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

    /// Begins a life of the Model; waiting batches are drained at the next instant.
    fn model_starts(&mut self, incarnation: u32) {
        self.model_up = true;
        if incarnation > 1 {
            self.model_stats.restarted();
            self.fault_log.restarted(crate::spec::MODEL, self.now);
        }
    }

    /// Drains the batches that arrived while the Model was down, round-robin over writers.
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
        // One of them made it panic; the others keep waiting.
        self.queued = self.queued || waiting;
    }

    /// Records that a step of slot `index` succeeded in its controller.
    pub(super) fn step_is_over(&mut self, index: usize) {
        let slot = &mut self.slots[index];
        if !slot.resumed && slot.is_alive() {
            slot.resumed = true;
            let (child, incarnation) = (slot.child, slot.epoch);
            self.tell(Event::Resumed { child, incarnation });
        }
    }

    /// Records that a step of slot `index` succeeded and the Model applied its batch.
    pub(super) fn did_good_work(&mut self, index: usize) {
        self.step_is_over(index);
        if !self.model_resumed {
            self.model_resumed = true;
            let (child, incarnation) = (self.model, self.supervisor.incarnation(self.model));
            self.tell(Event::Resumed { child, incarnation });
        }
        if self.fault_log.is_open() {
            let active_faults = self.slots[index].active_faults;
            if !active_faults.nan && !active_faults.queue_full && active_faults.slow == SimTime::ZERO {
                self.fault_log.resumed(&self.slots[index].spec.name, self.now);
            }
            self.fault_log.resumed(crate::spec::MODEL, self.now);
        }
    }
}

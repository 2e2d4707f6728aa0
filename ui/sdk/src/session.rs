//! A running session, whichever way time passes.

use std::sync::Arc;
use std::time::Instant;

use trocar_devices::DriverThread;
use trocar_kernel::live::{Guest, HostedActor, LiveError, LiveSession};
use trocar_kernel::lockstep::LockstepSession;
use trocar_kernel::runtime::ControllerReport;
use trocar_kernel::runtime::sched;
use trocar_kernel::spec::SessionOutcome;
use trocar_kernel::supervision::RuntimeClass;
use trocar_scene::{Access, SimTime, Snapshot, WriterId};

use crate::assembly::Assembly;
use crate::hands::{HandPort, OpenedHand};
use crate::run::RunError;

/// Numbers of guests among the writers: above those of any scenario's controllers, below the recorder's.
const GUESTS_FROM: u16 = 0x8000;
/// Batches of a guest that may wait for the Model.
const GUEST_CAPACITY: usize = 64;

/// A session that runs.
pub struct Session {
    running: Running,
    hands: Vec<HandPort>,
    drivers: Vec<DriverThread>,
    actors: Vec<HostedActor>,
    next_guest: u16,
    fences_raised: bool,
}

enum Running {
    Lockstep(Box<LockstepSession>),
    Live(LiveSession),
}

/// What is left of a session: the kernel's outcome and the drivers' figures.
pub struct Finished {
    /// What the kernel says.
    pub outcome: SessionOutcome,
    /// Largest force at any driver, after its clamp \[N\].
    pub force_newtons_max: f64,
    /// Commands that drivers refused because a dead or abandoned controller had sent them.
    pub commands_refused: u64,
    /// Ways in which drivers and plain actors did not end well, in words.
    pub driver_errors: Vec<String>,
}

impl Session {
    /// Starts a session in virtual time.
    ///
    /// # Errors
    /// When the session's specification is contradictory or a controller cannot be built.
    pub fn lockstep(assembly: Assembly) -> Result<Self, RunError> {
        let hands = assembly.hands.iter().map(|hand| hand.port().clone()).collect();
        let mut spec = assembly.spec;
        spec.peers.extend(assembly.hands.into_iter().map(OpenedHand::into_peer));
        let running = Running::Lockstep(Box::new(LockstepSession::new(spec)?));
        Ok(Self::new(running, hands, Vec::new()))
    }

    /// Starts a session in real time: drivers first, so that the first haptic tick finds a sample.
    ///
    /// # Errors
    /// When the session's specification is contradictory, or the system starts no thread.
    pub fn live(assembly: Assembly) -> Result<Self, RunError> {
        let hands: Vec<HandPort> = assembly.hands.iter().map(|hand| hand.port().clone()).collect();
        let start = Instant::now();
        let priority =
            sched::fifo_priority(RuntimeClass::Driver).and_then(|p| u8::try_from(p).ok()).unwrap_or(1);
        let mut drivers = Vec::with_capacity(hands.len());
        for hand in assembly.hands {
            drivers.push(hand.into_thread(start, priority)?);
        }
        let live = LiveSession::start_at(assembly.spec, start)?;
        let mut session = Self::new(Running::Live(live), hands, drivers);
        for actor in assembly.actors {
            let id = session.number_of_a_guest()?;
            let Running::Live(live) = &session.running else { break };
            let hosted = (actor.start)(live, id)?;
            session.actors.push(hosted);
        }
        Ok(session)
    }

    fn new(running: Running, hands: Vec<HandPort>, drivers: Vec<DriverThread>) -> Self {
        let (actors, next_guest) = (Vec::new(), GUESTS_FROM);
        Self { running, hands, drivers, actors, next_guest, fences_raised: false }
    }

    fn number_of_a_guest(&mut self) -> Result<WriterId, LiveError> {
        // The last number is the recorder's.
        if self.next_guest == u16::MAX {
            let reason = "there is no room for another one".to_owned();
            return Err(LiveError::Controller { name: "guest".to_owned(), reason });
        }
        self.next_guest += 1;
        Ok(WriterId(self.next_guest - 1))
    }

    /// Lets somebody take part in a live session without being ticked: from any thread it reads snapshots and
    /// events, and sends batches that the Model checks like a controller's. It can slow nobody down.
    ///
    /// # Errors
    /// When the session runs in lock-step, where nobody acts at a time of his own choice, when the name is taken,
    /// or when `access` overlaps with what others write.
    pub fn guest(&mut self, name: &str, access: &Access) -> Result<Guest, RunError> {
        let id = self.number_of_a_guest()?;
        match &self.running {
            Running::Live(live) => Ok(live.guest(name, id, access, GUEST_CAPACITY)?),
            Running::Lockstep(_) => {
                let reason = "lock-step has no guests; a controller can take part in it".to_owned();
                Err(LiveError::Controller { name: name.to_owned(), reason }.into())
            }
        }
    }

    /// The plain actors that take part.
    pub fn actors(&self) -> &[HostedActor] {
        &self.actors
    }

    /// The hands.
    pub fn hands(&self) -> &[HandPort] {
        &self.hands
    }

    /// Time of the session.
    pub fn now(&self) -> SimTime {
        match &self.running {
            Running::Lockstep(session) => session.now(),
            Running::Live(session) => session.elapsed(),
        }
    }

    /// Lets the session run until `until`: computes in virtual time, waits in real time. False when it has
    /// ended.
    pub fn run_until(&mut self, until: SimTime) -> bool {
        match &mut self.running {
            Running::Lockstep(session) => session.step_until(until),
            Running::Live(session) => {
                // Waiting wakes up at once when the session ends.
                while session.elapsed() < until && !session.wait((until - session.elapsed()).to_duration()) {}
                !session.has_ended()
            }
        }
    }

    /// The latest snapshot.
    pub fn snapshot(&mut self) -> Arc<Snapshot> {
        match &mut self.running {
            Running::Lockstep(session) => session.snapshot(),
            Running::Live(session) => session.snapshot(),
        }
    }

    /// How every controller keeps its rate so far.
    pub fn reports(&self) -> Vec<ControllerReport> {
        match &self.running {
            Running::Lockstep(session) => {
                session.statistics().map(|stats| stats.report(session.now())).collect()
            }
            Running::Live(session) => session.stats(),
        }
    }

    /// What every controller reads and writes, with its rate \[Hz\].
    pub fn accesses(&self) -> Vec<(String, f64, Access)> {
        match &self.running {
            Running::Lockstep(session) => {
                let rates: Vec<(String, f64)> = session
                    .statistics()
                    .map(|stats| (stats.name().to_owned(), stats.report(session.now()).target_hz))
                    .collect();
                let writers = session.model().writers();
                writers
                    .filter_map(|(_, name, access)| {
                        let (_, hz) = rates.iter().find(|(rated, _)| rated == name)?;
                        Some((name.to_owned(), *hz, access.clone()))
                    })
                    .collect()
            }
            Running::Live(session) => session.accesses(),
        }
    }

    /// The supervised children with their health.
    pub fn health(&self) -> Vec<(String, &'static str)> {
        match &self.running {
            Running::Lockstep(session) => {
                let names = session.statistics().map(|stats| stats.name().to_owned());
                names
                    .filter_map(|name| {
                        let child = session.supervisor().find(&name)?;
                        Some((name, session.supervisor().health(child)?.name()))
                    })
                    .collect()
            }
            Running::Live(session) => {
                session.health().into_iter().map(|(name, health)| (name, health.name())).collect()
            }
        }
    }

    /// Forces to zero, at once and for good; the session itself goes on until [`Session::finish`].
    pub fn zero_forces(&mut self) {
        if !self.fences_raised {
            self.hands.iter().for_each(|hand| hand.slot.fence().zero_all_forces());
            self.fences_raised = true;
        }
    }

    /// Ends the session: forces to zero, controllers down, recording closed, drivers stopped.
    pub fn finish(mut self) -> Finished {
        self.zero_forces();
        self.actors.iter().for_each(HostedActor::ask_to_end);
        let outcome = match self.running {
            Running::Lockstep(session) => session.finish(),
            Running::Live(session) => session.stop(0),
        };
        let mut driver_errors = Vec::new();
        for driver in self.drivers {
            if let Err(error) = driver.stop() {
                driver_errors.push(error.to_string());
            }
        }
        for actor in self.actors {
            let name = actor.name().to_owned();
            driver_errors.extend(actor.given_up().map(|why| format!("actor '{name}' was given up: {why}")));
            if !actor.end() {
                driver_errors.push(format!("actor '{name}' hung and was left behind"));
            }
        }
        let samples = self.hands.iter().map(|hand| hand.monitor.sample().statistics);
        let (mut force_newtons_max, mut commands_refused) = (0.0_f64, 0);
        for statistics in samples {
            force_newtons_max = force_newtons_max.max(statistics.force_newtons_max);
            commands_refused += statistics.refused_epoch;
        }
        Finished { outcome, force_newtons_max, commands_refused, driver_errors }
    }
}

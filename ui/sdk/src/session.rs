//! A running session, whichever way time passes.

mod losses;

use std::sync::Arc;
use std::time::Instant;

use trocar_devices::DriverThread;
use trocar_kernel::live::LiveSession;
use trocar_kernel::lockstep::LockstepSession;
use trocar_kernel::runtime::ControllerReport;
use trocar_kernel::runtime::sched;
use trocar_kernel::spec::SessionOutcome;
use trocar_kernel::supervision::RuntimeClass;
use trocar_scene::{Access, SimTime, Snapshot};

use crate::assembly::Assembly;
use crate::hands::{HandPort, OpenedHand};
use crate::run::RunError;

/// A session that runs.
pub struct Session {
    running: Running,
    hands: Vec<HandPort>,
    drivers: Vec<DriverThread>,
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
    /// Ways in which drivers did not end well, in words.
    pub driver_errors: Vec<String>,
    /// What the system refused or took away: [`Session::losses`].
    pub losses: Vec<String>,
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
        Ok(Self { running, hands, drivers: Vec::new(), fences_raised: false })
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
        let running = Running::Live(LiveSession::start_at(assembly.spec, start)?);
        Ok(Self { running, hands, drivers, fences_raised: false })
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
        let losses = self.losses();
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
        let samples = self.hands.iter().map(|hand| hand.monitor.sample().statistics);
        let (mut force_newtons_max, mut commands_refused) = (0.0_f64, 0);
        for statistics in samples {
            force_newtons_max = force_newtons_max.max(statistics.force_newtons_max);
            commands_refused += statistics.refused_epoch;
        }
        Finished { outcome, force_newtons_max, commands_refused, driver_errors, losses }
    }
}

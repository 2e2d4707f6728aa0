//! A running session, in virtual or real time.

#[cfg(test)]
mod begin_tests;
mod forecast;
mod losses;
mod pause;
pub(crate) mod plan;

pub use forecast::forecast;
pub use losses::{doubts, frozen_now};

use std::sync::Arc;
use std::time::{Duration, Instant};

use arc_swap::ArcSwap;
use trocar_devices::{DriverStatistics, DriverThread};
use trocar_kernel::live::{Guest, HostedActor, LiveError, LiveSession, Operator};
use trocar_kernel::lockstep::LockstepSession;
use trocar_kernel::operator::{OPERATOR, OperatorError};
use trocar_kernel::runtime::sched;
use trocar_kernel::runtime::{Clock, ControllerReport, PausableClock, TickStats};
use trocar_kernel::spec::SessionOutcome;
use trocar_kernel::supervision::{GroupSpec, RuntimeClass};
use trocar_network::control::ControlError;
use trocar_network::session::HostCourse;
use trocar_scene::{Access, Commands, Revision, SimTime, Snapshot, WriterId};

use crate::assembly::Assembly;
use crate::branching::Origin;
use crate::error::RunError;
use crate::hands::{HandPort, OpenedHand};
use crate::network::{LastWord, NetworkPart, RunningPart};

/// First writer number of guests: above those of any scenario's controllers, below the operator's.
const GUESTS_FROM: u16 = 0x8000;
/// Capacity of a guest's ring, in batches.
const GUEST_CAPACITY: usize = 64;
/// Longest wait for the other stations to take the last word, and time between two tries.
const LAST_WORD_MAX: Duration = Duration::from_millis(300);
const LAST_WORD_EVERY: Duration = Duration::from_millis(2);
/// Time between two looks at whether a station's host has paused the session.
const HOST_LOOK_EVERY: SimTime = SimTime::from_millis(20);
/// Longest wait for the Model's answer to the operator.
const ANSWER_MAX: Duration = Duration::from_secs(1);

/// A running session.
pub struct Session {
    pub(crate) running: Running,
    pub(crate) hands: Vec<HandPort>,
    drivers: Vec<DriverThread>,
    actors: Vec<HostedActor>,
    /// What moves the hands' datagrams.
    network: Vec<RunningPart>,
    last_word: Option<LastWord>,
    /// At a station: whether its host's session pauses or is over, and whether this one is paused for that.
    host_course: Option<HostCourse>,
    is_paused_by_host: bool,
    next_guest: u16,
    pub(crate) fences_raised: bool,
    /// In virtual time, the plan and prototypes for resets and branches.
    pub(crate) origin: Option<Origin>,
}

/// Reads the latest snapshot of a session from any thread, also after the session's end. Reading loads a pointer and
/// never blocks.
#[derive(Clone)]
pub struct SceneReader(Arc<ArcSwap<Snapshot>>);

impl SceneReader {
    /// The latest snapshot.
    pub fn scene(&self) -> Arc<Snapshot> {
        self.0.load_full()
    }
}

pub(crate) enum Running {
    Lockstep(Box<LockstepSession>),
    /// With the operator of [`Session::apply`], made on first use.
    Live(LiveSession, Option<Box<Operator>>),
}

/// The results of a finished session: the kernel's outcome and the drivers' counters.
pub struct Finished {
    /// The kernel's outcome.
    pub outcome: SessionOutcome,
    /// Largest force at any driver, after its clamp \[N\].
    pub force_newtons_max: f64,
    /// Commands that drivers refused because they came from a dead or abandoned controller.
    pub commands_refused: u64,
    /// Counters of each driver, hand by hand.
    pub drivers: Vec<DriverStatistics>,
    /// Errors of drivers and plain actors at their end, in words.
    pub driver_errors: Vec<String>,
    /// Losses of the session: [`Session::losses`].
    pub losses: Vec<String>,
}

impl Finished {
    /// Greatest age of a driver's last accepted command while it still rendered a force.
    pub fn force_age_max(&self) -> SimTime {
        SimTime(self.drivers.iter().map(|driver| driver.force_age_max_ns).max().unwrap_or(0))
    }
}

impl Session {
    /// Starts a session in virtual time.
    ///
    /// # Errors
    /// When the session's specification is contradictory or a controller cannot be built.
    pub fn lockstep(assembly: Assembly) -> Result<Self, RunError> {
        let hands = assembly.hands.iter().map(|hand| hand.port().clone()).collect();
        let origin = Origin {
            plan: assembly.plan,
            prototypes: assembly.hands.iter().map(OpenedHand::prototype).collect(),
            seed: assembly.spec.seed,
            begin: assembly.spec.begin,
            reflected: assembly.reflected,
        };
        let last_word = assembly.last_word;
        let mut spec = assembly.spec;
        spec.peers.extend(assembly.hands.into_iter().map(OpenedHand::into_peer));
        spec.peers.extend(assembly.network.into_iter().filter_map(NetworkPart::into_peer));
        let running = Running::Lockstep(Box::new(LockstepSession::new(spec)?));
        let mut session = Self::new(running, hands, Vec::new(), Some(origin));
        session.last_word = last_word;
        Ok(session)
    }

    /// Starts a session in real time. Drivers start first, so that the first haptic tick finds a sample.
    ///
    /// # Errors
    /// When the session's specification is contradictory, or the system cannot start a thread.
    pub fn live(assembly: Assembly) -> Result<Self, RunError> {
        let hands: Vec<HandPort> = assembly.hands.iter().map(|hand| hand.port().clone()).collect();
        let (start, clock) = (Instant::now(), Arc::<PausableClock>::default());
        let begin = assembly.spec.begin;
        let priority =
            sched::fifo_priority(RuntimeClass::Driver).and_then(|p| u8::try_from(p).ok()).unwrap_or(1);
        let mut drivers = Vec::with_capacity(hands.len());
        for hand in assembly.hands {
            drivers.push(hand.into_thread(start, pause::device_time(&clock, begin), priority)?);
        }
        let clock = Clock::pausable(start, clock).beginning_at(begin);
        let mut network = Vec::new();
        for part in assembly.network {
            network.extend(part.start(clock.clone()).map_err(RunError::Network)?);
        }
        let (last_word, host_course) = (assembly.last_word, assembly.host_course);
        let live = LiveSession::start_on(assembly.spec, clock)?;
        let mut session = Self::new(Running::Live(live, None), hands, drivers, None);
        (session.network, session.last_word, session.host_course) = (network, last_word, host_course);
        for actor in assembly.actors {
            let id = session.number_of_a_guest()?;
            let Running::Live(live, _) = &session.running else { break };
            let hosted = (actor.start)(live, id)?;
            session.actors.push(hosted);
        }
        Ok(session)
    }

    pub(crate) fn new(
        running: Running,
        hands: Vec<HandPort>,
        drivers: Vec<DriverThread>,
        origin: Option<Origin>,
    ) -> Self {
        let (actors, next_guest) = (Vec::new(), GUESTS_FROM);
        Self {
            running,
            hands,
            drivers,
            actors,
            network: Vec::new(),
            last_word: None,
            host_course: None,
            is_paused_by_host: false,
            next_guest,
            fences_raised: false,
            origin,
        }
    }

    fn number_of_a_guest(&mut self) -> Result<WriterId, LiveError> {
        // The last numbers are reserved for the operator and the recorder.
        if self.next_guest >= OPERATOR.0 {
            let reason = "there is no room for another one".to_owned();
            return Err(LiveError::Controller { name: "guest".to_owned(), reason });
        }
        self.next_guest += 1;
        Ok(WriterId(self.next_guest - 1))
    }

    /// Adds a guest to a live session, which is not ticked: from any thread it reads snapshots and events, and sends
    /// batches that the Model checks like a controller's. A guest cannot slow the session down.
    ///
    /// # Errors
    /// When the session runs in lock-step, where only ticked controllers act, when the name is taken, or when `access`
    /// overlaps with the writes of others.
    pub fn guest(&mut self, name: &str, access: &Access) -> Result<Guest, RunError> {
        self.join(name, |live, id| live.guest(name, id, access, GUEST_CAPACITY))
    }

    /// The same for a guest that wants to know what the Model says of each of its batches ([`Guest::answer`]).
    ///
    /// # Errors
    /// As [`Self::guest`].
    pub fn guest_with_answers(&mut self, name: &str, access: &Access) -> Result<Guest, RunError> {
        self.join(name, |live, id| live.guest_with_answers(name, id, access, GUEST_CAPACITY))
    }

    fn join(
        &mut self,
        name: &str,
        accept: impl FnOnce(&LiveSession, WriterId) -> Result<Guest, LiveError>,
    ) -> Result<Guest, RunError> {
        let id = self.number_of_a_guest()?;
        match &self.running {
            Running::Live(live, _) => Ok(accept(live, id)?),
            Running::Lockstep(_) => {
                let reason = "lock-step has no guests; a controller can take part in it".to_owned();
                Err(LiveError::Controller { name: name.to_owned(), reason }.into())
            }
        }
    }

    /// The plain actors of the session.
    pub fn actors(&self) -> &[HostedActor] {
        &self.actors
    }

    /// The hands.
    pub fn hands(&self) -> &[HandPort] {
        &self.hands
    }

    /// Session time at the start: zero, unless [`RunOptions::begin`](crate::run::RunOptions::begin) says otherwise.
    pub fn begin(&self) -> SimTime {
        match &self.running {
            Running::Lockstep(session) => session.begin(),
            Running::Live(session, _) => session.begin(),
        }
    }

    /// Session time.
    pub fn now(&self) -> SimTime {
        match &self.running {
            Running::Lockstep(session) => session.now(),
            Running::Live(session, _) => session.elapsed(),
        }
    }

    /// Runs the session until `until`: computes in virtual time, waits in real time. Returns false when it has ended, or is
    /// to end as that of its host has ([`Session::host_end`]), and at once while it is paused; that of a station whose host
    /// has paused the session, after some milliseconds.
    pub fn run_until(&mut self, until: SimTime) -> bool {
        self.follow_host();
        if self.is_paused_by_host {
            std::thread::sleep(HOST_LOOK_EVERY.to_duration());
            self.follow_host();
        }
        match &mut self.running {
            Running::Lockstep(session) => session.step_until(until) && self.host_end().is_none(),
            Running::Live(session, _) => {
                let look_every = self.host_course.as_ref().map(|_| HOST_LOOK_EVERY);
                let has_turned = |course: &HostCourse| course.is_paused() || course.end().is_some();
                let is_over = |now| now >= until || self.host_course.as_ref().is_some_and(has_turned);
                // The wait returns at once when the session ends.
                while !is_over(session.elapsed()) && !session.is_paused() {
                    let rest = until - session.elapsed();
                    if session.wait(look_every.map_or(rest, |most| rest.min(most)).to_duration()) {
                        break;
                    }
                }
                !session.has_ended() && self.host_end().is_none()
            }
        }
    }

    /// At a station, why the host's session is over for it, once it is: the station's own is then to end as well.
    pub fn host_end(&self) -> Option<&ControlError> {
        self.host_course.as_ref()?.end()
    }

    /// The latest snapshot.
    pub fn snapshot(&mut self) -> Arc<Snapshot> {
        match &mut self.running {
            Running::Lockstep(session) => session.snapshot(),
            Running::Live(session, _) => session.snapshot(),
        }
    }

    /// A reader of the latest snapshot of a session in real time, for other threads; `None` in virtual time, where
    /// snapshots come from [`Session::snapshot`].
    pub fn reader(&self) -> Option<SceneReader> {
        match &self.running {
            Running::Lockstep(_) => None,
            Running::Live(session, _) => Some(SceneReader(session.snapshots())),
        }
    }

    /// Writes into the running session from outside: the commands of `write` become one batch, applied completely or
    /// not at all. It may write any component of any entity, also those that a controller owns; that controller
    /// overwrites it at its next tick. The batch is checked like every batch, is part of the recording and the state
    /// hash under the name `operator`, and is replayed.
    ///
    /// In virtual time the batch is applied at the present instant, before the next tick. In real time this call waits
    /// for the Model's answer, at most a second; the session does not wait.
    ///
    /// # Errors
    /// [`OperatorError`] says why the batch was not applied.
    ///
    /// ```
    /// use trocar::prelude::*;
    /// use trocar::run;
    ///
    /// let app = App::new();
    /// let options = RunOptions { lockstep: true, ..RunOptions::default() };
    /// let mut session = run::start(&app, &app.scenario("wall")?, &options)?;
    /// session.run_until(SimTime::from_millis(100));
    /// let wall = session.snapshot().find("wall").expect("the scenario has a wall");
    /// let mark = session.apply(|out| out.put(wall, Name("the wall".into())))?;
    /// assert_eq!(session.snapshot().changed::<Name>(wall), Some(mark));
    /// let wrong = session.apply(|out| out.put(Entity::new(7, 7, 7), Name("nobody".into())));
    /// assert!(wrong.unwrap_err().to_string().contains("7:7:7 does not exist"));
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn apply(&mut self, write: impl FnOnce(&mut Commands)) -> Result<Revision, OperatorError> {
        match &mut self.running {
            Running::Lockstep(session) => session.apply(write),
            Running::Live(session, operator) => {
                let operator = match operator {
                    Some(operator) => operator,
                    None => operator.insert(Box::new(session.operator()?)),
                };
                operator.apply(ANSWER_MAX, write)
            }
        }
    }

    /// A handle for writing into a session in real time from another thread, as [`Session::apply`] does; `None` in
    /// virtual time, where only the thread that advances the session can write to it.
    ///
    /// # Errors
    /// [`OperatorError::TooMany`] when there are too many of them.
    pub fn operator(&self) -> Result<Option<Operator>, OperatorError> {
        match &self.running {
            Running::Lockstep(_) => Ok(None),
            Running::Live(session, _) => session.operator().map(Some),
        }
    }

    /// Achieved rate and lateness of every controller so far.
    pub fn reports(&self) -> Vec<ControllerReport> {
        match &self.running {
            Running::Lockstep(session) => session.reports(),
            Running::Live(session, _) => session.stats(),
        }
    }

    /// How many ticks each controller has run so far, in the order of [`Session::reports`]; cheaper than those.
    pub fn ticks(&self) -> Vec<u64> {
        match &self.running {
            Running::Lockstep(session) => session.statistics().map(TickStats::ticks).collect(),
            Running::Live(session, _) => session.ticks().collect(),
        }
    }

    /// The declared access of every controller, with its rate \[Hz\].
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
            Running::Live(session, _) => session.accesses(),
        }
    }

    /// The supervisor tree.
    pub fn tree(&self) -> Arc<GroupSpec> {
        match &self.running {
            Running::Lockstep(session) => session.supervisor().tree().clone(),
            Running::Live(session, _) => session.tree().clone(),
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
            Running::Live(session, _) => {
                session.health().into_iter().map(|(name, health)| (name, health.name())).collect()
            }
        }
    }

    /// Sets all forces to zero, at once and permanently; the session itself goes on until [`Session::finish`].
    pub fn zero_forces(&mut self) {
        if !self.fences_raised {
            self.hands.iter().for_each(|hand| hand.slot.fence().zero_all_forces());
            self.fences_raised = true;
        }
    }

    /// Ends the session: zeroes forces, stops controllers, closes the recording, stops drivers.
    pub fn finish(mut self) -> Finished {
        self.zero_forces();
        let losses = self.losses();
        self.actors.iter().for_each(HostedActor::ask_to_end);
        let outcome = match self.running {
            Running::Lockstep(session) => session.finish(),
            Running::Live(session, _) => session.stop(0),
        };
        if let Some(last_word) = &mut self.last_word {
            let begun = Instant::now();
            while !last_word() && begun.elapsed() < LAST_WORD_MAX {
                std::thread::sleep(LAST_WORD_EVERY);
            }
        }
        drop(self.network);
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
        let drivers: Vec<DriverStatistics> =
            self.hands.iter().map(|hand| hand.monitor.sample().statistics).collect();
        let force_newtons_max = drivers.iter().map(|driver| driver.force_newtons_max).fold(0.0, f64::max);
        let commands_refused = drivers.iter().map(|driver| driver.refused_epoch).sum();
        Finished { outcome, force_newtons_max, commands_refused, drivers, driver_errors, losses }
    }
}

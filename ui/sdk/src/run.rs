//! Runs a scenario from start to end, as `trocar run` does.

use std::sync::atomic::Ordering;
use std::time::Instant;

use trocar_devices::DriverStatistics;
use trocar_kernel::SessionError;
use trocar_kernel::faults::Measured;
use trocar_kernel::live::LiveError;
use trocar_kernel::recorder::{self, Recorder, RecordingHead};
use trocar_kernel::runtime::ControllerReport;
use trocar_kernel::spec::{MODEL, RECORDER, SessionOutcome};
use trocar_network::control::{ControlError, Goodbye};
use trocar_scene::scenario::{HandEntry, Scenario};
use trocar_scene::{Access, CollisionList, SimTime, Snapshot, TaskState, Teleoperation, output_file};

use crate::app::App;
use crate::assembly::{Assembly, AssemblyError};
pub use crate::error::RunError;
use crate::graph::ActorGraph;
pub use crate::options::{FaultTargets, ResumeError, Resumed, RunOptions};
use crate::session::{Finished, Session, doubts, forecast};
use crate::summary::{
    BY_THE_HOST, BY_THE_PROGRAM, Exit, FaultSummary, Mode, RunSummary, TaskErrorSummary, TaskSummary,
};
use crate::trace::RunTrace;
use crate::watch::contacts::ContactWatch;
use crate::watch::frozen::FrozenWatch;
use crate::watch::motion::HandMotions;
use crate::watch::rates::RateWatch;

/// Session time between two calls of the observer.
const LOOK_EVERY: SimTime = SimTime::from_millis(20);

/// The observer's view of a running session.
pub struct Progress<'a> {
    /// The session; the observer may write to it.
    pub session: &'a mut Session,
    /// Its latest snapshot.
    pub scene: &'a Snapshot,
    /// Time of the session.
    pub now: SimTime,
    /// Wall-clock time \[s\].
    pub wall_secs: f64,
    /// Set by the observer to end the run here.
    pub end: bool,
}

/// All results of a run.
pub struct RunOutcome {
    /// The machine-readable summary.
    pub summary: RunSummary,
    /// Time series for plots.
    pub trace: RunTrace,
    /// One row per controller.
    pub reports: Vec<ControllerReport>,
    /// The kernel's outcome.
    pub kernel: SessionOutcome,
    /// Counters of each driver, hand by hand.
    pub drivers: Vec<DriverStatistics>,
    /// Supervised children with their health just before the end.
    pub health: Vec<(String, &'static str)>,
    /// The actor graph, with achieved rates.
    pub graph: ActorGraph,
    /// Expectations of the fault plan that failed, one sentence each.
    pub failed_expectations: Vec<String>,
    /// At a station, why the host's session was over for it.
    pub host_end: Option<ControlError>,
}

impl RunOutcome {
    /// The exit code of the process: not ok if the exercise was not completed (at a station, unless the host ended the
    /// session), the host could not be reached any more or sent the station away, an expectation failed, a controller
    /// failed too often, everything that a controller wrote was refused, or an exercise had a contact that was not kept or a frozen body.
    /// The signal that ended a run is known to the caller only.
    pub fn exit(&self) -> Exit {
        if self.kernel.code != 0 {
            return Exit::Internal;
        }
        let of_network = self.host_end.as_ref().map_or(Exit::Ok, |end| Exit::of_network(end.exit_class()));
        if of_network != Exit::Ok {
            return of_network;
        }
        let held = !self.kernel.held.is_empty() || !self.kernel.refused.is_empty();
        let unkept = self.summary.contacts_not_kept > 0 || self.summary.bodies_frozen > 0;
        let spoilt = unkept && self.summary.task.is_exercise();
        self.summary.exit(held || spoilt || !self.failed_expectations.is_empty())
    }
}

/// Starts a session with these options.
///
/// # Errors
/// [`RunError`].
pub fn start(app: &App, scenario: &Scenario, options: &RunOptions) -> Result<Session, RunError> {
    let mut assembly = Assembly::new(app, scenario, options)?;
    if let Some(file) = &options.record {
        let head = RecordingHead {
            scenario: scenario.name.clone(),
            scenario_text: scenario.text().to_owned(),
            seed: options.seed,
            station: assembly.spec.station,
            begin: assembly.spec.begin,
            mode: if options.lockstep { "lockstep" } else { "live" }.to_owned(),
            devices: assembly.hands.iter().map(|hand| (hand.port().name.clone(), hand.describe())).collect(),
            extra: std::collections::BTreeMap::new(),
        };
        let scene = assembly.spec.scene.view();
        Recorder::create(file, &head, scene, options.recorder)?.install(&mut assembly.spec);
    }
    let started = if options.lockstep { Session::lockstep(assembly) } else { Session::live(assembly) };
    if let (Err(_), Some(file)) = (&started, &options.record) {
        output_file::discard(file);
    }
    started.map_err(|error| located(scenario, error))
}

/// A first start that failed, with the place of what it is about: the entity that the reason names in quotes, or else the
/// controller.
fn located(scenario: &Scenario, error: RunError) -> RunError {
    let (RunError::Session(SessionError::Start(reason)) | RunError::Live(LiveError::Start(reason))) = &error
    else {
        return error;
    };
    // Entities are numbered in the order of the file.
    let mut entities: Vec<_> = scenario.entities().iter().collect();
    entities.sort_by_key(|(_, entity)| **entity);
    let named = |name: &str| reason.contains(&format!("'{name}'"));
    let of_entity = entities.iter().position(|(name, _)| named(name)).map(|index| ("entity", index));
    let starts = |name: &str| reason.strip_prefix(name).is_some_and(|rest| rest.starts_with(' '));
    let of_controller = scenario.controllers.iter().position(|entry| starts(&entry.name));
    match of_entity.or(of_controller.map(|index| ("controller", index))) {
        Some((table, index)) => AssemblyError::from(scenario.error_at(table, index, reason.clone())).into(),
        None => error,
    }
}

/// Runs a scenario to its end and calls `observer` about 50 times per second of the session. A slow observer holds up a
/// session in virtual time, and may pause one in real time.
///
/// # Errors
/// [`RunError`]; a run that started is always finished and summarised.
pub fn run(
    app: &App,
    scenario: &Scenario,
    options: &RunOptions,
    observer: &mut dyn FnMut(&mut Progress<'_>),
) -> Result<RunOutcome, RunError> {
    let begun = Instant::now();
    let mut session = start(app, scenario, options)?;
    let start = session.begin();
    let mut trace = RunTrace::starting_at(start.as_secs_f64());
    trace.sample(&session.snapshot());
    let warnings = forecast(&session.snapshot(), scenario);
    let mut health = session.health();
    let (mut motions, mut contacts) = (HandMotions::default(), ContactWatch::default());
    let mut frozen = FrozenWatch::default();
    let rows = session.reports();
    let mut rates = RateWatch::new(start, rows.into_iter().map(|row| (row.name, row.target_hz)));
    rates.look(session.now(), &session.ticks());
    let mut next = SimTime((start.0 / LOOK_EVERY.0 + 1) * LOOK_EVERY.0);
    let mut is_cut_off = false;
    while session.run_until(next) {
        if options.stop.load(Ordering::Relaxed) {
            is_cut_off = true;
            break;
        }
        let scene = session.snapshot();
        trace.sample(&scene);
        let now = session.now();
        rates.look(now, &session.ticks());
        motions.look(scene.time().max(start).as_secs_f64(), &scene);
        contacts.look(now, &scene);
        frozen.look(&scene);
        if scene.iter::<TaskState>().next().is_none() {
            contacts.keep_quiet();
        } else if contacts.has_news() {
            // An operator that is refused loses the event; the summary has the contact all the same.
            let _ = session.apply(|out| contacts.tell(out));
        }
        // The last look before the end: afterwards all controllers are stopped.
        health = session.health();
        let mut progress = Progress {
            session: &mut session,
            scene: &scene,
            now,
            wall_secs: begun.elapsed().as_secs_f64(),
            end: false,
        };
        observer(&mut progress);
        if progress.end {
            is_cut_off = true;
            break;
        }
        // After a delay, or after the observer itself advanced the session, skip the looks that were missed.
        let now = session.now();
        while next <= now {
            next += LOOK_EVERY;
        }
    }
    let last = session.snapshot();
    trace.sample(&last);
    frozen.look(&last);
    drop(last);
    let accesses = session.accesses();
    let host_end = session.host_end().cloned();
    let finished = session.finish();
    let mut graph = ActorGraph::from_access(
        &scenario.name,
        accesses.iter().map(|(name, hz, access)| (name.as_str(), *hz, access)),
    );
    if options.record.is_some() {
        graph.flow(MODEL, RECORDER, vec!["commits".to_owned()], Some(recorder::RATE_HZ));
    }
    for report in &finished.outcome.controllers {
        graph.achieved(&report.name, report.achieved_hz);
    }
    let mut summary = summarise(scenario, options, &finished, begun.elapsed().as_secs_f64());
    summary.slow_actors = rates.slow();
    summary.task.disturbed = !summary.slow_actors.is_empty();
    motions.complete(&mut summary.task.metrics);
    (summary.unkept_contacts, summary.contacts_not_kept) = contacts.found();
    (summary.frozen_bodies, summary.bodies_frozen) = frozen.found();
    summary.warnings = warnings;
    summary.cut_off_by = is_cut_off.then(|| BY_THE_PROGRAM.to_owned());
    match &host_end {
        Some(ControlError::Goodbye(goodbye)) => {
            summary.cut_off_by = Some(BY_THE_HOST.to_owned());
            if *goodbye != Goodbye::SessionOver {
                summary.error = Some(goodbye.to_string());
            }
        }
        Some(end) => summary.error = Some(end.to_string()),
        None => {}
    }
    let failed_expectations = options.faults.as_ref().map_or_else(Vec::new, |plan| {
        let measured = Measured {
            force_newtons_max: finished.force_newtons_max,
            model_restarts: u64::from(finished.outcome.model.restarts),
            task_completed: summary.task.completed,
            ended: finished.outcome.sim,
        };
        plan.expect.failures(&finished.outcome.faults, &measured)
    });
    let reports = finished.outcome.controllers.clone();
    let (kernel, drivers) = (finished.outcome, finished.drivers);
    Ok(RunOutcome { summary, trace, reports, kernel, drivers, health, graph, failed_expectations, host_end })
}

fn summarise(scenario: &Scenario, options: &RunOptions, finished: &Finished, wall_secs: f64) -> RunSummary {
    let outcome = &finished.outcome;
    let scene = &outcome.snapshot;
    let mode = if options.lockstep { Mode::Lockstep } else { Mode::Live };
    let mut summary = RunSummary::new(&scenario.name, mode, options.seed);
    summary.sim_secs = outcome.sim.since(outcome.begin).as_secs_f64();
    summary.wall_secs = wall_secs;
    summary.state_hash = Some(outcome.hash.to_string());
    summary.task = task_summary(scene);
    summary.controllers = outcome.controllers.clone();
    for row in &mut summary.controllers {
        let entry = scenario.controllers.iter().find(|entry| entry.name == row.name);
        row.kind = entry.map(|entry| entry.kind.clone());
    }
    summary.faults = outcome
        .faults
        .iter()
        .map(|row| {
            let record = row.record();
            FaultSummary {
                id: record.id,
                target: record.target,
                kind: record.kind.name().to_owned(),
                injected_secs: record.injected_secs,
                healed_secs: record.healed_secs,
                detected_secs: record.detected_secs,
                restarted_secs: record.restarted_secs,
                resumed_secs: record.resumed_secs,
            }
        })
        .collect();
    let figures = |hand: &HandEntry| {
        let row = scene.get::<Teleoperation>(hand.entity)?;
        Some((hand.name.clone(), row.figures))
    };
    summary.teleoperation = scenario.hands.iter().filter_map(figures).collect();
    summary.force_newtons_max = finished.force_newtons_max;
    summary.force_age_max_us = finished.force_age_max().as_nanos() as f64 * 1e-3;
    summary.commands_refused = finished.commands_refused;
    summary.penetration_max =
        scene.iter::<CollisionList>().map(|(_, list)| list.penetration_max).fold(0.0, f64::max);
    summary.recording = options.record.as_ref().map(|file| file.display().to_string());
    summary.recording_bytes = options.record.as_ref().and_then(|file| Some(file.metadata().ok()?.len()));
    summary.recording_complete = outcome.recording_complete.unwrap_or(false);
    summary.losses = finished.losses.clone();
    summary.losses.extend(doubts(scene));
    let held = outcome.held.first().map(|(name, why)| format!("{name} was {why}"));
    let refused: Vec<String> = outcome.refused.iter().map(|(name, why)| format!("{name}: {why}")).collect();
    let refused = (!refused.is_empty()).then(|| refused.join("; "));
    summary.error =
        outcome.reason.clone().or(held).or(refused).or_else(|| finished.driver_errors.first().cloned());
    summary
}

/// The declared access of every controller of a scenario, with its rate \[Hz\]; nothing is run.
///
/// # Errors
/// [`RunError`] when the session cannot start.
pub fn accesses(
    app: &App,
    scenario: &Scenario,
    options: &RunOptions,
) -> Result<Vec<(String, f64, Access)>, RunError> {
    let session = start(app, scenario, &RunOptions { lockstep: true, ..options.clone() })?;
    let accesses = session.accesses();
    session.finish();
    Ok(accesses)
}

/// The state of the exercise in a scene.
pub fn task_summary(scene: &Snapshot) -> TaskSummary {
    let Some((_, task)) = scene.iter::<TaskState>().next() else {
        // Without an exercise the task counts as completed.
        return TaskSummary { completed: true, ..TaskSummary::default() };
    };
    TaskSummary {
        completed: task.completed,
        cut_off: !task.over,
        score: if task.over { task.score } else { None },
        disturbed: false,
        score_kind: task.score_kind(),
        seconds: task.seconds,
        errors: task
            .errors
            .iter()
            .map(|error| TaskErrorSummary { kind: error.kind.clone(), at_secs: error.at_secs })
            .collect(),
        metrics: task.metrics.clone(),
    }
}

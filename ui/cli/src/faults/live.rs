//! The fault table in real time: medians of at least twenty, beside a bare thread.

use std::sync::Arc;
use std::sync::mpsc::sync_channel;
use std::time::{Duration, Instant};

use trocar::app::{App, Blueprint};
use trocar::assembly::Assembly;
use trocar::run::{RunError, RunOptions};
use trocar::session::{Finished, Session};
use trocar::soak::FORCE_MAX;
use trocar::summary::{BenchResult, Better};
use trocar_kernel::faults::{FaultPlan, FaultRow, secs};
use trocar_kernel::runtime::sched;
use trocar_kernel::spec::{MODEL, SessionSpec};
use trocar_kernel::supervision::{Backoff, GroupSpec, Intensity, Node, RuntimeClass};
use trocar_scene::scenario::Scenario;
use trocar_scene::{Controller, SimTime};

use super::hostile::{NeverReturns, Nuisance};
use super::lockstep::{ACTORS, SCENARIO, detection_bar};
use super::{Plan, forces};
use crate::failure::Failure;
use trocar_kernel::bench::median_and_spread as median;

/// Number of strikes of each fault.
pub const TIMES: usize = 20;
/// Warm-up time before the first fault \[s\].
pub const WARM: f64 = 2.0;
/// Interval at which drivers are sampled: less than the time between two faults.
const LOOK_EVERY: SimTime = SimTime::from_millis(5);
/// Length of the runs that are compared with each other \[s\].
pub const COMPARED_SECS: f64 = 5.0;

/// The rows of this table.
pub fn plan(plan: &mut Plan<'_>) {
    plan.row("live_bare_thread_restart_p50", |name| {
        Ok(BenchResult::on_value(name, "ms", median(&bare_restarts()), None, Better::Lower))
    });
    plan.row("live_bare_watchdog_lateness_p50", |name| {
        Ok(BenchResult::on_value(name, "ms", median(&bare_wakes()), None, Better::Lower))
    });
    plan.rows("live kills", |_| kills());
    plan.rows("live stalls", |_| stalls());
    plan.rows("live endless loop", |_| endless_loop());
}

/// Lateness of a bare thread of the watchdog's priority that sleeps to the end of a 50 ms limit \[ms\]: a lower bound
/// for the detection of a stall.
pub fn bare_wakes() -> Vec<f64> {
    let sleeper = std::thread::spawn(|| {
        let _ = sched::promote_current(RuntimeClass::Watchdog);
        let limit = Duration::from_millis(50);
        let late = |_| {
            let begun = Instant::now();
            std::thread::sleep(limit);
            begun.elapsed().saturating_sub(limit).as_secs_f64() * 1e3
        };
        (0..TIMES).map(late).collect()
    });
    sleeper.join().unwrap_or_default()
}

/// Time from the panic of a bare thread until a replacement runs \[ms\].
fn bare_restarts() -> Vec<f64> {
    let once = || {
        let (died, inbox) = sync_channel(1);
        let (up, answer) = sync_channel(1);
        let first = std::thread::spawn(move || {
            let begun = Instant::now();
            // No message: the panic hook would print it, and printing is not to be measured.
            let _ = std::panic::catch_unwind(|| std::panic::resume_unwind(Box::new(())));
            let _ = died.send(begun);
        });
        let begun = inbox.recv().ok()?;
        let second = std::thread::spawn(move || up.send(Instant::now()));
        let resumed = answer.recv().ok()?;
        let _ = (first.join(), second.join());
        Some((resumed - begun).as_secs_f64() * 1e3)
    };
    (0..TIMES).filter_map(|_| once()).collect()
}

/// Kills every actor repeatedly, all in one session.
fn kills() -> Result<Vec<BenchResult>, Failure> {
    let gap = 0.06;
    let mut plan = FaultPlan::new(1);
    for time in 0..TIMES {
        for (index, (actor, _, _)) in ACTORS.iter().enumerate() {
            let from = WARM + gap * (time * ACTORS.len() + index) as f64;
            // At a random time within its slot: a fault in phase with its target's ticks would always wait longest.
            plan = plan.between(secs(from), secs(from + 0.5 * gap)).kill(actor);
        }
    }
    let seconds = WARM + gap * (TIMES * ACTORS.len()) as f64 + 1.0;
    let finished = run(&App::new(), plan, seconds)?;
    let mut rows = Vec::new();
    for (actor, _, _) in ACTORS {
        let figures = figures(&finished, actor, |row| (row.injected, row.resumed));
        let name = format!("live_kill_{actor}_resumed_p50");
        rows.push(BenchResult::on_value(name, "ms", median(&figures), Some(10.0), Better::Lower));
    }
    rows.push(forces::longest("live_force_held_after_a_kill_max", &finished.drivers));
    let force = (finished.force_newtons_max, 0.0);
    rows.push(BenchResult::on_value("live_kills_force_max", "N", force, Some(FORCE_MAX), Better::Lower));
    Ok(rows)
}

/// Every actor hangs for 300 ms repeatedly; its replacement takes over long before.
fn stalls() -> Result<Vec<BenchResult>, Failure> {
    let (gap, span) = (0.5, 0.3);
    let stalled = || ACTORS.iter().filter(|(name, _, _)| *name != MODEL);
    let mut plan = FaultPlan::new(1);
    for time in 0..TIMES {
        for (index, (actor, _, _)) in stalled().enumerate() {
            // All of them within one gap: hung threads do not hinder each other's detection.
            let at = WARM + gap * time as f64 + 0.02 * index as f64;
            plan = plan.between(secs(at), secs(at + 0.02)).lasting(secs(span)).stall(actor);
        }
    }
    let app = App::new();
    let scenario = app.scenario(SCENARIO)?;
    let Watched { finished, released_ms } = watched(&app, &scenario, plan, WARM + gap * TIMES as f64 + 1.0)?;
    let (late, _) = median(&bare_wakes());
    let mut rows = Vec::new();
    for (actor, class, rate_hz) in stalled() {
        let figures = figures(&finished, actor, |row| (row.injected, row.detected));
        // The upper bound of detection, for a watchdog that wakes up as late as this machine's.
        let floor = detection_bar(actor, *class, *rate_hz) + late;
        let name = format!("live_stall_{actor}_detected_p50");
        rows.push(BenchResult::on_ratio(name, "ms", median(&figures), floor, Some(1.0), Better::Lower));
    }
    rows.extend(forces::held_rows("live_force_held_after_a_stall", &released_ms, &finished.drivers));
    rows.push(BenchResult::on_value(
        "live_zombie_forces_refused",
        "commands",
        (finished.commands_refused as f64, 0.0),
        None,
        Better::Higher,
    ));
    let force = (finished.force_newtons_max, 0.0);
    rows.push(BenchResult::on_value("live_stalls_force_max", "N", force, Some(FORCE_MAX), Better::Lower));
    Ok(rows)
}

pub fn figures(
    finished: &Finished,
    actor: &str,
    span: fn(&FaultRow) -> (Option<SimTime>, Option<SimTime>),
) -> Vec<f64> {
    let rows = finished.outcome.faults.iter().filter(|row| row.target == actor);
    rows.map(|row| match span(row) {
        (Some(from), Some(to)) => to.since(from).as_secs_f64() * 1e3,
        // It never resumed: take a time longer than any fault.
        _ => 1e4,
    })
    .collect()
}

/// The effect on the two hands of a controller in an endless loop at real-time priority.
fn endless_loop() -> Result<Vec<BenchResult>, Failure> {
    let (mut costs, mut replaced) = (Vec::new(), true);
    for _ in 0..3 {
        let alone = run(&App::new(), FaultPlan::new(1), COMPARED_SECS)?;
        let app = App::new().component::<Nuisance>().kind("loops", Arc::new(|_| Ok(loops())));
        let beside = run(&app.joins("loops", 100.0), FaultPlan::new(1), COMPARED_SECS)?;
        costs.push((worst_on_time(&alone) - worst_on_time(&beside)) * 100.0);
        let row = beside.outcome.controllers.iter().find(|row| row.name == "loops");
        replaced &= row.is_some_and(|row| row.restarts == 1) && beside.outcome.zombies == 1;
    }
    let (cost, spread) = median(&costs);
    let cost = (cost.max(0.0), spread.abs());
    let mut row =
        BenchResult::on_value("live_endless_loop_on_time_lost", "points", cost, Some(2.0), Better::Lower);
    row.holds &= replaced;
    Ok(vec![row])
}

fn loops() -> Blueprint {
    Blueprint {
        class: RuntimeClass::Collision,
        factory: Arc::new(|_| Ok(Box::new(NeverReturns) as Box<dyn Controller>)),
        fences: Vec::new(),
        for_hands: None,
        arrange: None,
    }
}

/// On-time share of the worse hand.
pub fn worst_on_time(finished: &Finished) -> f64 {
    let hands = finished.outcome.controllers.iter().filter(|row| row.name.starts_with("haptics."));
    hands.map(|row| row.on_time).fold(1.0, f64::min)
}

/// A session of that length; its drivers are not sampled while it runs.
pub fn run(app: &App, plan: FaultPlan, seconds: f64) -> Result<Finished, Failure> {
    let mut session = start(app, &app.scenario(SCENARIO)?, plan, seconds)?;
    session.run_until(SimTime::from_secs_f64(seconds));
    finish(session)
}

/// A session, and the releases of its drivers.
pub struct Watched {
    pub finished: Finished,
    /// Age of the last command at each release of a force \[ms\].
    pub released_ms: Vec<f64>,
}

/// A session of that length whose drivers are sampled.
pub fn watched(app: &App, scenario: &Scenario, plan: FaultPlan, seconds: f64) -> Result<Watched, Failure> {
    let mut session = start(app, scenario, plan, seconds)?;
    let mut seen = vec![0; session.hands().len()];
    let (mut released_ms, mut next) = (Vec::new(), SimTime::ZERO);
    while next < SimTime::from_secs_f64(seconds) && session.run_until(next) {
        for (hand, seen) in session.hands().iter().zip(&mut seen) {
            let driver = hand.monitor.sample().statistics;
            if driver.releases > *seen {
                *seen = driver.releases;
                released_ms.push(driver.release_age_ns as f64 * 1e-6);
            }
        }
        next = session.now() + LOOK_EVERY;
    }
    Ok(Watched { finished: finish(session)?, released_ms })
}

fn start(app: &App, scenario: &Scenario, plan: FaultPlan, seconds: f64) -> Result<Session, Failure> {
    let options = RunOptions { seconds: Some(seconds), faults: Some(plan), ..RunOptions::default() };
    let mut assembly = Assembly::new(app, scenario, &options).map_err(RunError::from)?;
    endure(&mut assembly.spec);
    Ok(Session::live(assembly)?)
}

fn finish(session: Session) -> Result<Finished, Failure> {
    let finished = session.finish();
    if finished.outcome.code != 0 {
        let reason = finished.outcome.reason.unwrap_or_default();
        return Err(Failure::internal(format!("the session gave up: {reason}")));
    }
    // Let abandoned threads end before the next session measures.
    std::thread::sleep(Duration::from_millis(400));
    Ok(finished)
}

/// A supervisor tree without restart limit or pause, so that the restart itself is measured.
fn endure(spec: &mut SessionSpec) {
    let mut tree = GroupSpec::default_tree(spec.children());
    for node in &mut tree.children {
        if let Node::Group(group) = node {
            group.intensity = Intensity { restarts: 1_000, period: SimTime::from_millis(10_000) };
            group.backoff = Backoff { base: SimTime::ZERO, max: SimTime::ZERO, ..Backoff::default() };
        }
    }
    spec.tree = Some(tree);
    spec.zombies_max = 64;
}

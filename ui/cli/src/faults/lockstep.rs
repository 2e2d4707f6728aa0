//! The fault table in lock-step: exact and the same on every machine.

use std::path::Path;
use std::thread;

use trocar::app::App;
use trocar::run::{RunOptions, RunOutcome};
use trocar::soak::{FORCE_MAX, is_finite};
use trocar::summary::{BenchResult, Better};
use trocar_kernel::faults::{During, Expect, FaultAt, FaultPlan, FaultRow, secs};
use trocar_kernel::runtime::ControllerReport;
use trocar_kernel::spec::MODEL;
use trocar_kernel::supervision::{ChildSpec, RuntimeClass};
use trocar_scene::SimTime;

use super::Plan;
use super::hostile::{AlwaysFails, Floods, Nuisance, WritesNan};
use crate::failure::Failure;

/// The scenario under test.
pub const SCENARIO: &str = "peg-transfer";
/// Period in which an instrument holds something at some moment, for every seed \[s\].
const WINDOW: (f64, f64) = (3.0, 12.0);
/// Length of a run \[s\]: by then faults that wait for a grasp have struck and are overcome.
pub const RUN_SECS: f64 = 20.0;
/// Seeds of each row; the worst result counts.
const SEEDS: std::ops::RangeInclusive<u64> = 1..=3;
/// Longest recovery from a killed actor \[ms\].
pub const RESUME_MS_MAX: f64 = 10.0;
/// Longest recovery after a device is plugged in again: the driver tries every 100 ms \[ms\].
pub const REPLUG_MS_MAX: f64 = 150.0;
/// Rate of the Model's fastest clients \[Hz\].
const FASTEST_HZ: f64 = 1_000.0;
/// Length of an injected stall \[s\].
pub const STALL: f64 = 0.3;

/// Actors of the exercise that can be killed, with the class and rate that decide their heartbeat limit.
pub const ACTORS: [(&str, RuntimeClass, f64); 6] = [
    (MODEL, RuntimeClass::Model, 0.0),
    ("haptics.left", RuntimeClass::Haptics, 1000.0),
    ("haptics.right", RuntimeClass::Haptics, 1000.0),
    ("engine", RuntimeClass::Simulation, 500.0),
    ("task", RuntimeClass::Task, 100.0),
    ("autopilot", RuntimeClass::Task, 100.0),
];

/// The rows of this table.
pub fn plan<'a>(folder: &'a Path, plan: &mut Plan<'a>) {
    kills(folder, plan);
    stalls(plan);
    strikes(plan);
    guests(plan);
}

fn kills<'a>(folder: &'a Path, plan: &mut Plan<'a>) {
    for (actor, _, _) in ACTORS {
        plan.row(format!("lockstep_kill_{actor}_resumed"), move |name| {
            worst(name, "ms", RESUME_MS_MAX, |seed| {
                let outcome = run(&App::new(), seed, struck(seed).kill(actor))?;
                Ok(millis(row_of(&outcome)?.injected, row_of(&outcome)?.resumed))
            })
        });
    }
    plan.row("lockstep_kill_recorder_resumed", move |name| {
        worst(name, "ms", 100.0, |seed| {
            let record = Some(folder.join(format!("killed-{seed}.mcap")));
            let options = RunOptions { record, ..options(seed, struck(seed).kill("recorder")) };
            let outcome = run_with(&App::new(), &options)?;
            let whole = outcome.summary.recording_complete;
            let figure = millis(row_of(&outcome)?.injected, row_of(&outcome)?.resumed);
            Ok(if whole { figure } else { f64::INFINITY })
        })
    });
}

fn stalls(plan: &mut Plan<'_>) {
    for (actor, class, rate_hz) in ACTORS {
        let bar = detection_bar(actor, class, rate_hz);
        plan.row(format!("lockstep_stall_{actor}_detected"), move |name| {
            worst(name, "ms", bar, |seed| {
                let outcome = run(&App::new(), seed, struck(seed).lasting(secs(STALL)).stall(actor))?;
                let unaccounted = outcome.reports.iter().map(ControllerReport::unaccounted).sum::<u64>();
                let row = row_of(&outcome)?;
                // The stalled step is the first one after the injection.
                let figure = millis(row.injected, row.detected);
                Ok(if row.resumed.is_some() && unaccounted == 0 { figure } else { f64::INFINITY })
            })
        });
    }
}

/// Heartbeat limit and one period \[ms\]; the Model has no rate of its own, so its fastest client's period counts.
pub fn detection_bar(actor: &str, class: RuntimeClass, rate_hz: f64) -> f64 {
    let limit = ChildSpec::new(actor, class, rate_hz).heartbeat_limit.as_secs_f64();
    (limit + 1.0 / if rate_hz > 0.0 { rate_hz } else { FASTEST_HZ }) * 1e3
}

fn strikes(plan: &mut Plan<'_>) {
    plan.row("lockstep_unplug_device_resumed", |name| {
        worst(name, "ms", REPLUG_MS_MAX, |seed| {
            let outcome = run(&App::new(), seed, struck(seed).lasting(secs(0.5)).unplug("device.left"))?;
            Ok(recovery(row_of(&outcome)?))
        })
    });
    for target in ["engine", "device.left"] {
        plan.row(format!("lockstep_nan_from_{target}"), move |name| {
            violations(name, |seed, wrong| {
                let outcome = run(&App::new(), seed, struck(seed).lasting(secs(0.05)).nan(target))?;
                let row = row_of(&outcome)?;
                wrong.check(row.detected.is_some(), "nobody noticed");
                wrong.check(row.resumed.is_some(), "it never worked again");
                wrong.check(is_finite(&outcome.kernel.snapshot), "a number that is none is in the scene");
                Ok(())
            })
        });
    }
    plan.row("lockstep_queue_full_engine_resumed", |name| {
        worst(name, "ms", RESUME_MS_MAX, |seed| {
            let outcome = run(&App::new(), seed, struck(seed).lasting(secs(0.05)).queue_full("engine"))?;
            Ok(recovery(row_of(&outcome)?))
        })
    });
}

fn guests(plan: &mut Plan<'_>) {
    plan.row("lockstep_nan_from_a_user", |name| {
        violations(name, |seed, wrong| {
            let outcome = with_guest(seed, |app| app.controller_with("guest", |(): &(), _| Ok(WritesNan)))?;
            let (guest, others) = split(&outcome.reports, "guest");
            wrong
                .check(guest.rejected == guest.scheduled && guest.rejected > 0, "some of its batches got in");
            wrong.check(others.iter().all(|row| row.rejected == 0), "somebody else's batch was refused");
            Ok(())
        })
    });
    plan.row("lockstep_error_on_every_tick", |name| {
        violations(name, |seed, wrong| {
            let outcome = with_guest(seed, |app| app.controller_with("guest", |(): &(), _| Ok(AlwaysFails)))?;
            let held: Vec<&str> = outcome.kernel.held.iter().map(|(name, _)| name.as_str()).collect();
            wrong.check(held == ["guest"], "it is not the one that is held");
            wrong.check(outcome.summary.error.is_some(), "the report does not say so");
            wrong.check(outcome.kernel.code == 0, "the session gave up");
            let (_, others) = split(&outcome.reports, "guest");
            wrong.check(others.iter().all(|row| row.missed == 0), "somebody else missed ticks");
            wrong.check(others.iter().all(|row| row.restarts == 0), "somebody else was restarted");
            Ok(())
        })
    });
    plan.row("lockstep_flood_of_1e6_commands_per_second", |name| {
        violations(name, |seed, wrong| {
            let app = |app: App| app.controller_with("guest", |(): &(), _| Ok(Floods::new(5_000)));
            let outcome = with_guest(seed, app)?;
            let (guest, others) = split(&outcome.reports, "guest");
            wrong.check(guest.dropped > 0, "nothing was refused at its own handle");
            let refused = |row: &ControllerReport| row.dropped + row.rejected + row.lost;
            wrong.check(others.iter().all(|row| refused(row) == 0), "somebody else's batch was refused");
            wrong.check(others.iter().all(|row| row.missed == 0), "somebody else missed ticks");
            Ok(())
        })
    });
}

/// A fault at a random moment while an instrument holds something.
pub fn struck(seed: u64) -> FaultAt {
    let expect = Expect { force_newtons_max: Some(FORCE_MAX), ..Expect::default() };
    let plan = FaultPlan::new(seed).expecting(expect);
    plan.between(secs(WINDOW.0), secs(WINDOW.1)).during(During::Grasp)
}

/// A lock-step run of the exercise, long enough for faults that wait for a grasp.
pub fn options(seed: u64, plan: FaultPlan) -> RunOptions {
    RunOptions { lockstep: true, seconds: Some(RUN_SECS), seed, faults: Some(plan), ..RunOptions::default() }
}

pub fn run(app: &App, seed: u64, plan: FaultPlan) -> Result<RunOutcome, Failure> {
    run_with(app, &options(seed, plan))
}

pub fn run_with(app: &App, options: &RunOptions) -> Result<RunOutcome, Failure> {
    let scenario = app.scenario(SCENARIO)?;
    let outcome = trocar::run::run(app, &scenario, options, &mut |_| {})?;
    if let Some(failure) = outcome.failed_expectations.first() {
        return Err(Failure::internal(format!("{SCENARIO}, seed {}: {failure}", options.seed)));
    }
    Ok(outcome)
}

/// A run with a controller called `guest` at 100 Hz.
fn with_guest(seed: u64, add: impl Fn(App) -> App) -> Result<RunOutcome, Failure> {
    let app = add(App::new().component::<Nuisance>()).joins("guest", 100.0);
    run(&app, seed, FaultPlan::new(seed))
}

/// The row of `name`, and all other rows.
pub fn split<'a>(rows: &'a [ControllerReport], name: &str) -> (ControllerReport, Vec<&'a ControllerReport>) {
    let guest = rows.iter().find(|row| row.name == name).cloned();
    (guest.unwrap_or_default(), rows.iter().filter(|row| row.name != name).collect())
}

/// From the end of a fault to the first good work \[ms\].
pub fn recovery(row: &FaultRow) -> f64 {
    row.recovery().map_or(f64::INFINITY, |span| span.as_secs_f64() * 1e3)
}

pub fn row_of(outcome: &RunOutcome) -> Result<&FaultRow, Failure> {
    let row = outcome.kernel.faults.first().filter(|row| row.injected.is_some());
    row.ok_or_else(|| Failure::internal("the fault did not strike"))
}

pub fn millis(from: Option<SimTime>, to: Option<SimTime>) -> f64 {
    match (from, to) {
        (Some(from), Some(to)) => to.since(from).as_secs_f64() * 1e3,
        _ => f64::INFINITY,
    }
}

/// Runs every seed in parallel.
fn each_seed<T: Send>(look: impl Fn(u64) -> Result<T, Failure> + Sync) -> Result<Vec<T>, Failure> {
    let look = &look;
    thread::scope(|scope| {
        let runs: Vec<_> = SEEDS.map(|seed| scope.spawn(move || look(seed))).collect();
        let join = |run: thread::ScopedJoinHandle<'_, Result<T, Failure>>| {
            run.join().unwrap_or_else(|_| Err(Failure::internal("a run panicked")))
        };
        runs.into_iter().map(join).collect()
    })
}

/// The largest figure over the seeds, compared with a bar.
pub fn worst(
    name: &str,
    unit: &str,
    bar: f64,
    figure: impl Fn(u64) -> Result<f64, Failure> + Sync,
) -> Result<BenchResult, Failure> {
    let figures = each_seed(figure)?;
    let largest = figures.iter().copied().fold(0.0, f64::max);
    let smallest = figures.iter().copied().fold(f64::INFINITY, f64::min);
    let spread = if largest > 0.0 && largest.is_finite() { (largest - smallest) / largest } else { 0.0 };
    // JSON has no infinity: an event that never came counts as the length of the run.
    let largest = largest.min(RUN_SECS * 1e3);
    Ok(BenchResult::on_value(name, unit, (largest, spread), Some(bar), Better::Lower))
}

/// Collects violations.
#[derive(Default)]
pub struct Wrong(Vec<String>);

impl Wrong {
    pub fn check(&mut self, holds: bool, otherwise: &str) {
        if !holds {
            self.0.push(otherwise.to_owned());
        }
    }
    /// The violations as a row.
    pub fn row(&self, name: &str) -> BenchResult {
        for what in &self.0 {
            tracing::warn!("{name}: {what}");
        }
        BenchResult::on_value(name, "violations", (self.0.len() as f64, 0.0), Some(0.0), Better::Lower)
    }
}

pub fn violations(
    name: &str,
    look: impl Fn(u64, &mut Wrong) -> Result<(), Failure> + Sync,
) -> Result<BenchResult, Failure> {
    let found = each_seed(|seed| {
        let mut wrong = Wrong::default();
        look(seed, &mut wrong).map(|()| wrong.0)
    })?;
    Ok(Wrong(found.into_iter().flatten().collect()).row(name))
}

//! The fault table in virtual time: exact, the same on every machine.

use std::path::Path;

use trocar::app::App;
use trocar::run::{RunOptions, RunOutcome};
use trocar::soak::{FORCE_MAX, is_finite};
use trocar::summary::{BenchResult, Better};
use trocar_kernel::faults::{During, Expect, FaultAt, FaultPlan, FaultRow, secs};
use trocar_kernel::spec::MODEL;
use trocar_kernel::supervision::{ChildSpec, RuntimeClass};
use trocar_scene::SimTime;

use super::hostile::{AlwaysFails, Floods, Nuisance, WritesNan};
use crate::failure::Failure;

/// What the faults strike.
pub const SCENARIO: &str = "peg-transfer";
/// Time in which something is held at some moment, whatever the seed.
const WINDOW: (f64, f64) = (3.0, 12.0);
/// Length of a run: faults that wait for a grasp have struck and are overcome.
const RUN_SECS: f64 = 20.0;
/// Seeds of each row; the worst one counts.
const SEEDS: std::ops::RangeInclusive<u64> = 1..=3;
/// Longest way back from a death \[ms\].
const RESUME_MS_MAX: f64 = 10.0;
/// Length of an injected stall.
const STALL: f64 = 0.3;

/// Who can die in the exercise; with the class and rate that its heartbeat limit follows from.
pub const ACTORS: [(&str, RuntimeClass, f64); 6] = [
    (MODEL, RuntimeClass::Model, 0.0),
    ("haptics.left", RuntimeClass::Haptics, 1000.0),
    ("haptics.right", RuntimeClass::Haptics, 1000.0),
    ("engine", RuntimeClass::Simulation, 500.0),
    ("task", RuntimeClass::Task, 100.0),
    ("autopilot", RuntimeClass::Task, 100.0),
];

/// One row after another, with `tell` called before each.
pub fn rows(folder: &Path, tell: &mut dyn FnMut(&str)) -> Result<Vec<BenchResult>, Failure> {
    let mut rows = Vec::new();
    let mut add = |name: String, row: &mut dyn FnMut(&str) -> Result<BenchResult, Failure>| {
        tell(&name);
        rows.push(row(&name)?);
        Ok::<(), Failure>(())
    };
    for (actor, _, _) in ACTORS {
        add(format!("lockstep_kill_{actor}_resumed"), &mut |name| {
            worst(name, "ms", RESUME_MS_MAX, |seed| {
                let plan = struck(seed).kill(actor);
                let outcome = run(&App::new(), seed, plan, None)?;
                Ok(millis(row_of(&outcome)?.injected, row_of(&outcome)?.resumed))
            })
        })?;
    }
    add("lockstep_kill_recorder_resumed".into(), &mut |name| {
        let file = folder.join("killed.mcap");
        let mut complete = true;
        let mut row = worst(name, "ms", 100.0, |seed| {
            let outcome = run(&App::new(), seed, struck(seed).kill("recorder"), Some(&file))?;
            complete &= outcome.summary.recording_complete;
            Ok(millis(row_of(&outcome)?.injected, row_of(&outcome)?.resumed))
        })?;
        row.holds &= complete;
        Ok(row)
    })?;
    for (actor, class, rate_hz) in ACTORS.into_iter().filter(|(_, class, _)| *class != RuntimeClass::Model) {
        let limit = ChildSpec::new(actor, class, rate_hz).heartbeat_limit.as_secs_f64();
        add(format!("lockstep_stall_{actor}_detected"), &mut |name| {
            worst(name, "ms", (limit + 1.0 / rate_hz) * 1e3, |seed| {
                let plan = struck(seed).lasting(secs(STALL)).stall(actor);
                let outcome = run(&App::new(), seed, plan, None)?;
                // The step that hangs is the first one after the injection.
                Ok(millis(row_of(&outcome)?.injected, row_of(&outcome)?.detected))
            })
        })?;
    }
    add("lockstep_unplug_device_resumed".into(), &mut |name| {
        worst(name, "ms", 150.0, |seed| {
            let plan = struck(seed).lasting(secs(0.5)).unplug("device.left");
            let outcome = run(&App::new(), seed, plan, None)?;
            Ok(row_of(&outcome)?.recovery().map_or(f64::INFINITY, |span| span.as_secs_f64() * 1e3))
        })
    })?;
    for target in ["engine", "device.left"] {
        add(format!("lockstep_nan_from_{target}"), &mut |name| {
            violations(name, |seed, wrong| {
                let plan = struck(seed).lasting(secs(0.05)).nan(target);
                let outcome = run(&App::new(), seed, plan, None)?;
                let row = row_of(&outcome)?;
                wrong.check(row.detected.is_some(), "nobody noticed");
                wrong.check(row.resumed.is_some(), "it never worked again");
                wrong.check(is_finite(&outcome.kernel.snapshot), "a number that is none is in the scene");
                Ok(())
            })
        })?;
    }
    add("lockstep_nan_from_a_user".into(), &mut |name| {
        violations(name, |seed, wrong| {
            let outcome = with_guest(seed, |app| app.controller_with("guest", |(): &(), _| Ok(WritesNan)))?;
            let (guest, others) = guest_and_others(&outcome);
            wrong.check(guest.0 == guest.1 && guest.0 > 0, "some of its batches got in");
            wrong.check(others == 0, "somebody else's batch was refused");
            Ok(())
        })
    })?;
    add("lockstep_error_on_every_tick".into(), &mut |name| {
        violations(name, |seed, wrong| {
            let outcome = with_guest(seed, |app| app.controller_with("guest", |(): &(), _| Ok(AlwaysFails)))?;
            let held: Vec<&str> = outcome.kernel.held.iter().map(|(name, _)| name.as_str()).collect();
            wrong.check(held == ["guest"], "it is not the one that is held");
            wrong.check(outcome.summary.error.is_some(), "the report does not say so");
            wrong.check(outcome.kernel.code == 0, "the session gave up");
            let others = outcome.reports.iter().filter(|row| row.name != "guest");
            wrong.check(others.clone().all(|row| row.missed == 0), "somebody else missed ticks");
            wrong.check(others.clone().all(|row| row.restarts == 0), "somebody else was restarted");
            Ok(())
        })
    })?;
    add("lockstep_flood_of_1e6_commands_per_second".into(), &mut |name| {
        violations(name, |seed, wrong| {
            let app = |app: App| app.controller_with("guest", |(): &(), _| Ok(Floods::new(5_000)));
            let outcome = with_guest(seed, app)?;
            let (_, others) = guest_and_others(&outcome);
            wrong.check(others == 0, "somebody else's batch was refused");
            let others = outcome.reports.iter().filter(|row| row.name != "guest");
            wrong.check(others.clone().all(|row| row.missed == 0), "somebody else missed ticks");
            Ok(())
        })
    })?;
    add("lockstep_queue_full_engine_resumed".into(), &mut |name| {
        worst(name, "ms", RESUME_MS_MAX, |seed| {
            let plan = struck(seed).lasting(secs(0.05)).queue_full("engine");
            let outcome = run(&App::new(), seed, plan, None)?;
            Ok(row_of(&outcome)?.recovery().map_or(f64::INFINITY, |span| span.as_secs_f64() * 1e3))
        })
    })?;
    add("lockstep_full_disk_leaves_the_simulation_untouched".into(), &mut |name| {
        violations(name, |seed, wrong| {
            let file = folder.join("full.mcap");
            let plan = FaultPlan::new(seed).at(secs(2.0)).lasting(secs(3.0)).disk_full();
            let without = run(&App::new(), seed, FaultPlan::new(seed), None)?;
            let with = run(&App::new(), seed, plan, Some(&file))?;
            wrong.check(with.summary.state_hash == without.summary.state_hash, "the state hash differs");
            wrong.check(row_of(&with)?.detected.is_some(), "nobody noticed");
            wrong.check(row_of(&with)?.resumed.is_some(), "the recorder never wrote again");
            Ok(())
        })
    })?;
    Ok(rows)
}

/// A fault at a random moment at which something is held.
fn struck(seed: u64) -> FaultAt {
    let expect = Expect { force_newtons_max: Some(FORCE_MAX), ..Expect::default() };
    let plan = FaultPlan::new(seed).expecting(expect);
    plan.between(secs(WINDOW.0), secs(WINDOW.1)).during(During::Grasp)
}

fn run(app: &App, seed: u64, plan: FaultPlan, record: Option<&Path>) -> Result<RunOutcome, Failure> {
    let scenario = app.scenario(SCENARIO)?;
    let options = RunOptions {
        lockstep: true,
        seconds: Some(RUN_SECS),
        seed,
        faults: Some(plan),
        record: record.map(Path::to_owned),
        ..RunOptions::default()
    };
    let outcome = trocar::run::run(app, &scenario, &options, &mut |_| {})?;
    if let Some(failure) = outcome.failed_expectations.first() {
        return Err(Failure::internal(format!("{SCENARIO}, seed {seed}: {failure}")));
    }
    Ok(outcome)
}

/// A run with a controller called `guest` at 100 Hz.
fn with_guest(seed: u64, add: impl Fn(App) -> App) -> Result<RunOutcome, Failure> {
    let app = add(App::new().component::<Nuisance>()).joins("guest", 100.0);
    run(&app, seed, FaultPlan::new(seed), None)
}

/// The guest's rejected and scheduled batches, and the rejected batches of everybody else.
fn guest_and_others(outcome: &RunOutcome) -> ((u64, u64), u64) {
    let guest = outcome.reports.iter().find(|row| row.name == "guest");
    let others = outcome.reports.iter().filter(|row| row.name != "guest").map(|row| row.rejected).sum();
    (guest.map_or((0, 0), |row| (row.rejected, row.scheduled)), others)
}

fn row_of(outcome: &RunOutcome) -> Result<&FaultRow, Failure> {
    let row = outcome.kernel.faults.first().filter(|row| row.injected.is_some());
    row.ok_or_else(|| Failure::internal("the fault did not strike"))
}

fn millis(from: Option<SimTime>, to: Option<SimTime>) -> f64 {
    match (from, to) {
        (Some(from), Some(to)) => to.since(from).as_secs_f64() * 1e3,
        _ => f64::INFINITY,
    }
}

/// The largest figure over the seeds, held against a bar.
fn worst(
    name: &str,
    unit: &str,
    bar: f64,
    mut figure: impl FnMut(u64) -> Result<f64, Failure>,
) -> Result<BenchResult, Failure> {
    let mut figures = Vec::new();
    for seed in SEEDS {
        figures.push(figure(seed)?);
    }
    let largest = figures.iter().copied().fold(0.0, f64::max);
    let smallest = figures.iter().copied().fold(f64::INFINITY, f64::min);
    let spread = if largest > 0.0 && largest.is_finite() { (largest - smallest) / largest } else { 0.0 };
    // JSON has no infinity: what never came is the length of the run.
    let largest = largest.min(RUN_SECS * 1e3);
    Ok(BenchResult::on_value(name, unit, (largest, spread), Some(bar), Better::Lower))
}

/// Counts what must not be.
#[derive(Default)]
struct Wrong(Vec<String>);

impl Wrong {
    fn check(&mut self, holds: bool, otherwise: &str) {
        if !holds {
            self.0.push(otherwise.to_owned());
        }
    }
}

fn violations(
    name: &str,
    mut look: impl FnMut(u64, &mut Wrong) -> Result<(), Failure>,
) -> Result<BenchResult, Failure> {
    let mut wrong = Wrong::default();
    for seed in SEEDS {
        look(seed, &mut wrong)?;
    }
    for what in &wrong.0 {
        tracing::warn!("{name}: {what}");
    }
    Ok(BenchResult::on_value(name, "violations", (wrong.0.len() as f64, 0.0), Some(0.0), Better::Lower))
}

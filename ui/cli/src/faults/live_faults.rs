//! Live faults that kill no actor, twenty times each; and guests that misbehave.

use trocar::app::App;
use trocar::run::RunOptions;
use trocar::soak::{FORCE_MAX, is_finite};
use trocar::summary::{BenchResult, Better};
use trocar_kernel::bench::median_and_spread as median;
use trocar_kernel::faults::{FaultAt, FaultPlan, secs};
use trocar_kernel::runtime::ControllerReport;
use trocar_kernel::spec::MODEL;
use trocar_kernel::supervision::RuntimeClass;

use super::Plan;
use super::hostile::{AlwaysFails, Nuisance, WritesNan};
use super::live::{COMPARED_SECS, TIMES, WARM, bare_wakes, figures, run};
use super::lockstep::{REPLUG_MS_MAX, RESUME_MS_MAX, SCENARIO, STALL, Wrong, detection_bar, recovery, split};
use crate::failure::Failure;

/// A fault that strikes repeatedly.
struct Strike {
    name: &'static str,
    span: f64,
    gap: f64,
    bar: f64,
    strike: fn(FaultAt) -> FaultPlan,
}

const STRIKES: [Strike; 4] = [
    Strike {
        name: "live_unplug_device_resumed_p50",
        span: 0.2,
        gap: 0.5,
        bar: REPLUG_MS_MAX,
        strike: |at| at.unplug("device.left"),
    },
    Strike {
        name: "live_nan_from_engine_resumed_p50",
        span: 0.05,
        gap: 0.12,
        bar: RESUME_MS_MAX,
        strike: |at| at.nan("engine"),
    },
    Strike {
        name: "live_nan_from_device_resumed_p50",
        span: 0.05,
        gap: 0.12,
        bar: RESUME_MS_MAX,
        strike: |at| at.nan("device.left"),
    },
    Strike {
        name: "live_queue_full_engine_resumed_p50",
        span: 0.05,
        gap: 0.12,
        bar: RESUME_MS_MAX,
        strike: |at| at.queue_full("engine"),
    },
];

/// The rows.
pub fn live(plan: &mut Plan<'_>) {
    for strike in &STRIKES {
        plan.row(strike.name, |name| struck_often(name, strike));
    }
    plan.rows("live model stalls", |_| model_stalls());
    plan.row("live_nan_from_a_user", nan_from_a_user);
    plan.row("live_error_on_every_tick", error_on_every_tick);
}

fn struck_often(name: &str, strike: &Strike) -> Result<BenchResult, Failure> {
    let Strike { span, gap, bar, strike, .. } = *strike;
    let mut plan = FaultPlan::new(1);
    for time in 0..TIMES {
        let at = WARM + gap * time as f64;
        plan = strike(plan.between(secs(at), secs(at + 0.2 * gap)).lasting(secs(span)));
    }
    let finished = run(&App::new(), plan, WARM + gap * TIMES as f64 + 0.5)?;
    let outcome = &finished.outcome;
    let figures: Vec<f64> = outcome.faults.iter().map(|row| recovery(row).min(1e4)).collect();
    let mut row = BenchResult::on_value(name, "ms", median(&figures), Some(bar), Better::Lower);
    row.holds &= figures.len() >= TIMES
        && outcome.faults.iter().all(|row| row.detected.is_some())
        && is_finite(&outcome.snapshot)
        && finished.force_newtons_max <= FORCE_MAX;
    Ok(row)
}

/// The Model hangs for 300 ms repeatedly; its successor takes over the waiting batches.
fn model_stalls() -> Result<Vec<BenchResult>, Failure> {
    let gap = 0.5;
    let mut plan = FaultPlan::new(1);
    for time in 0..TIMES {
        let at = WARM + gap * time as f64;
        plan = plan.between(secs(at), secs(at + 0.1)).lasting(secs(STALL)).stall(MODEL);
    }
    let finished = run(&App::new(), plan, WARM + gap * TIMES as f64 + 1.0)?;
    let detected = figures(&finished, MODEL, |row| (row.injected, row.detected));
    let resumed = figures(&finished, MODEL, |row| (row.detected, row.resumed));
    let floor = detection_bar(MODEL, RuntimeClass::Model, 0.0) + median(&bare_wakes()).0;
    let (name, figure) = ("live_stall_model_detected_p50", median(&detected));
    let seen = BenchResult::on_ratio(name, "ms", figure, floor, Some(1.0), Better::Lower);
    let controllers = &finished.outcome.controllers;
    let unaccounted = controllers.iter().map(ControllerReport::unaccounted).sum::<u64>() as f64;
    let lost = controllers.iter().map(|row| row.lost).sum::<u64>() as f64;
    let row =
        |name: &str, unit: &str, figure, bar| BenchResult::on_value(name, unit, figure, bar, Better::Lower);
    Ok(vec![
        seen,
        row("live_stall_model_resumed_after_detection_p50", "ms", median(&resumed), Some(RESUME_MS_MAX)),
        row("live_stall_model_batches_unaccounted_for", "batches", (unaccounted, 0.0), Some(0.0)),
        row("live_stall_model_batches_lost", "batches", (lost, 0.0), None),
    ])
}

fn nan_from_a_user(name: &str) -> Result<BenchResult, Failure> {
    let app = App::new().component::<Nuisance>();
    let app = app.controller_with("guest", |(): &(), _| Ok(WritesNan)).joins("guest", 100.0);
    let finished = run(&app, FaultPlan::new(1), COMPARED_SECS)?;
    let (guest, others) = split(&finished.outcome.controllers, "guest");
    let mut wrong = Wrong::default();
    wrong.check(guest.rejected > 0 && guest.applied == 0, "some of its batches got in");
    wrong.check(others.iter().all(|row| row.rejected == 0), "somebody else's batch was refused");
    wrong.check(
        finished.outcome.snapshot.iter::<Nuisance>().next().is_none(),
        "its component is in the scene",
    );
    Ok(wrong.row(name))
}

fn error_on_every_tick(name: &str) -> Result<BenchResult, Failure> {
    let app = App::new().component::<Nuisance>();
    let app = app.controller_with("guest", |(): &(), _| Ok(AlwaysFails)).joins("guest", 100.0);
    let scenario = app.scenario(SCENARIO)?;
    // The default tree: it is the one that holds a child.
    let options = RunOptions { seconds: Some(12.0), ..RunOptions::default() };
    let outcome = trocar::run::run(&app, &scenario, &options, &mut |_| {})?;
    let held: Vec<&str> = outcome.kernel.held.iter().map(|(name, _)| name.as_str()).collect();
    let (_, others) = split(&outcome.reports, "guest");
    let mut wrong = Wrong::default();
    wrong.check(held == ["guest"], "it is not the one that is held");
    wrong.check(outcome.summary.error.is_some(), "the report does not say so");
    wrong.check(outcome.kernel.code == 0, "the session gave up");
    wrong.check(others.iter().all(|row| row.restarts == 0), "somebody else was restarted");
    wrong.check(others.iter().all(|row| row.achieved_hz > 0.9 * row.target_hz), "somebody else fell behind");
    Ok(wrong.row(name))
}

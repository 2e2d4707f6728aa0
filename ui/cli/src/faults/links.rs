//! Faulty links between a controller and the Model: lost, delayed, duplicated, reordered or corrupted batches, and partitions.

use trocar::app::App;
use trocar::plans;
use trocar::run::{RunOptions, RunOutcome};
use trocar::soak::is_finite;
use trocar::summary::{BenchResult, Better};
use trocar_kernel::bench::median_and_spread as median;
use trocar_kernel::faults::{FaultAt, FaultKind, FaultPlan, FaultRow, secs};
use trocar_kernel::runtime::ControllerReport;
use trocar_kernel::spec::MODEL;
use trocar_scene::SimTime;

use super::Plan;
use super::live::{TIMES, WARM, watched};
use super::lockstep::{self, RESUME_MS_MAX, Wrong, options, recovery, row_of, run, run_with, split, struck};
use crate::failure::Failure;

/// All kinds of link faults.
fn kinds() -> impl Iterator<Item = FaultKind> {
    FaultKind::ALL.into_iter().filter(|kind| kind.is_of_link())
}

/// The controller with the faulty link.
const WHO: &str = "haptics.left";
/// Share of its batches that is affected.
const SHARE: f64 = 0.5;
/// The delay, and its variation.
const DELAY: SimTime = SimTime::from_millis(20);
const JITTER: SimTime = SimTime::from_millis(10);

/// What a limited link passes [bytes/s]: a part of what the hand sends; and how long its queue is.
const RATE: f64 = 50_000.0;
const QUEUE: SimTime = SimTime::from_millis(20);

fn of_kind(kind: FaultKind, at: FaultAt) -> FaultPlan {
    match kind {
        FaultKind::Drop => at.drop(WHO, SHARE),
        FaultKind::Delay => at.jitter(WHO, DELAY, JITTER),
        FaultKind::Duplicate => at.duplicate(WHO, SHARE),
        FaultKind::Reorder => at.reorder(WHO, SHARE),
        FaultKind::Corrupt => at.corrupt(WHO, SHARE),
        FaultKind::RateLimit => at.rate_limit(WHO, RATE, QUEUE),
        _ => at.partition(WHO),
    }
}

/// Longest recovery once the link is good again \[ms\]: batches that were delayed before arrive late.
fn bar(kind: FaultKind) -> f64 {
    let late = match kind {
        FaultKind::Delay => DELAY + JITTER,
        FaultKind::RateLimit => QUEUE,
        _ => SimTime::ZERO,
    };
    RESUME_MS_MAX + late.as_secs_f64() * 1e3
}

/// Number of batches that this kind of fault affected, by the writer's row.
fn touched(kind: FaultKind, row: &ControllerReport) -> u64 {
    match kind {
        FaultKind::Delay | FaultKind::Reorder | FaultKind::RateLimit => row.delayed,
        FaultKind::Duplicate => row.duplicated,
        _ => row.lost,
    }
}

/// Rows in virtual time.
pub fn lockstep(plan: &mut Plan<'_>) {
    for kind in kinds() {
        plan.row(format!("lockstep_link_{kind}_resumed"), move |name| {
            lockstep::worst(name, "ms", bar(kind), |seed| {
                let outcome = run(&App::new(), seed, of_kind(kind, struck(seed).lasting(secs(0.3))))?;
                let (hand, others) = split(&outcome.reports, WHO);
                let told = touched(kind, &hand) > 0 && row_of(&outcome)?.detected.is_some();
                let apart = others.iter().all(|row| row.lost + row.delayed + row.duplicated == 0);
                let whole = outcome.reports.iter().all(|row| row.unaccounted() == 0);
                let well = told && apart && whole && is_finite(&outcome.kernel.snapshot);
                Ok(if well { recovery(row_of(&outcome)?) } else { f64::INFINITY })
            })
        });
    }
    plan.row("lockstep_flaky_network", |name| {
        lockstep::violations(name, |seed, wrong| {
            let plan = FaultPlan { seed, ..plans::plan("flaky-network").map_err(Failure::internal)? };
            let options = RunOptions {
                seconds: None,
                ..options(seed, FaultPlan { expect: Default::default(), ..plan.clone() })
            };
            check_flaky(&plan, &run_with(&App::new(), &options)?, wrong);
            Ok(())
        })
    });
}

/// Checks an exercise with the plan `flaky-network`.
fn check_flaky(plan: &FaultPlan, outcome: &RunOutcome, wrong: &mut Wrong) {
    let summary = &outcome.summary;
    let honest = summary.task.completed || !summary.task.errors.is_empty();
    wrong.check(honest, "the exercise failed and does not say why");
    wrong.check(outcome.kernel.code == 0 && outcome.kernel.held.is_empty(), "somebody gave up");
    wrong.check(outcome.kernel.model.restarts == 0, "the Model was restarted");
    wrong.check(is_finite(&outcome.kernel.snapshot), "a number that is none is in the scene");
    wrong.check(outcome.reports.iter().all(|row| row.unaccounted() == 0), "batches are unaccounted for");
    let behind = ["haptics.left", "haptics.right", "autopilot"];
    let far = outcome.reports.iter().filter(|row| behind.contains(&row.name.as_str()));
    wrong.check(far.clone().count() == 3 && far.clone().all(|row| row.lost > 0), "the network was good");
    let limit = plan.expect.force_newtons_max.unwrap_or(0.0);
    wrong.check(summary.force_newtons_max <= limit, "a force was above its limit");
    wrong.check(outcome.kernel.faults.iter().all(|row| row.resumed.is_some()), "a fault was not overcome");
}

/// Rows in real time: every kind strikes repeatedly, all in one session.
pub fn live(plan: &mut Plan<'_>) {
    plan.rows("live links", |_| {
        let (gap, span) = (0.12, 0.05);
        let mut plan = FaultPlan::new(1);
        for time in 0..TIMES {
            for (index, kind) in kinds().enumerate() {
                let at = WARM + gap * (time * kinds().count() + index) as f64;
                plan = of_kind(kind, plan.between(secs(at), secs(at + 0.3 * gap)).lasting(secs(span)));
            }
        }
        let app = App::new();
        let scenario = app.scenario(lockstep::SCENARIO)?;
        let seconds = WARM + gap * (TIMES * kinds().count()) as f64 + 1.0;
        let outcome = watched(&app, &scenario, plan, seconds)?.finished.outcome;
        let (hand, others) = split(&outcome.controllers, WHO);
        let apart = others.iter().all(|row| row.lost + row.delayed + row.duplicated == 0);
        let mut rows = Vec::new();
        for kind in kinds() {
            let struck = |row: &&FaultRow| row.kind == kind && row.target != MODEL;
            let figures: Vec<f64> =
                outcome.faults.iter().filter(struck).map(|row| recovery(row).min(1e4)).collect();
            let name = format!("live_link_{kind}_resumed_p50");
            let mut row = BenchResult::on_value(name, "ms", median(&figures), Some(bar(kind)), Better::Lower);
            row.holds &= apart && touched(kind, &hand) > 0;
            rows.push(row);
        }
        let unaccounted: u64 = outcome.controllers.iter().map(ControllerReport::unaccounted).sum();
        let name = "live_links_batches_unaccounted_for";
        rows.push(BenchResult::on_value(
            name,
            "batches",
            (unaccounted as f64, 0.0),
            Some(0.0),
            Better::Lower,
        ));
        Ok(rows)
    });
    plan.row("live_flaky_network", |name| {
        let plan = plans::plan("flaky-network").map_err(Failure::internal)?;
        let options = RunOptions {
            lockstep: false,
            seconds: None,
            ..options(1, FaultPlan { expect: Default::default(), ..plan.clone() })
        };
        let mut wrong = Wrong::default();
        check_flaky(&plan, &run_with(&App::new(), &options)?, &mut wrong);
        Ok(wrong.row(name))
    });
}

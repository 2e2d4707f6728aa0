//! Full and slow disks: the recording declares a gap, and the simulation is unaffected.

use std::path::Path;

use trocar::app::App;
use trocar::run::{RunOptions, RunOutcome};
use trocar::summary::{BenchResult, Better};
use trocar_kernel::bench::median_and_spread as median;
use trocar_kernel::faults::{FaultAt, FaultPlan, secs};
use trocar_kernel::recorder::{RecorderOptions, Recording, Replay};
use trocar_scene::SimTime;

use super::live::WARM;
use super::lockstep::{Wrong, options, recovery, run, run_with, violations};
use super::{Plan, Rows};
use crate::failure::Failure;

/// Limit of the recorder's backlog [bytes]: small, so that it must drop data.
const BACKLOG_MAX: usize = 100_000;
/// Throughput of the slow disk [bytes/s].
const SLOW: f64 = 200_000.0;
/// Duration of the fault \[s\].
const LASTING: f64 = 6.0;

/// In real time: number of sessions with a bad disk, each compared with one with a good disk; number of faults in each,
/// their duration and interval \[s\].
const SESSIONS: u64 = 3;
const STRIKES: usize = 8;
const STRIKE: f64 = 0.3;
const APART: f64 = 0.6;
/// Flush interval then: several flushes during each fault.
const FLUSH: SimTime = SimTime::from_millis(100);
/// Longest until the recorder writes again after the fault \[ms\]: it checks every 20 ms, and writes its backlog first.
const RESUME_MS_MAX: f64 = 100.0;

/// Adds a disk fault to a plan.
type Strike = fn(FaultAt) -> FaultPlan;

/// Kinds of disk faults.
const KINDS: [(&str, Strike); 2] = [("full", |at| at.disk_full()), ("slow", |at| at.disk_slow(SLOW))];

/// Rows in virtual time.
pub fn lockstep<'a>(folder: &'a Path, plan: &mut Plan<'a>) {
    for (kind, fault) in KINDS {
        plan.row(format!("lockstep_{kind}_disk_leaves_the_simulation_untouched"), move |name| {
            violations(name, |seed, wrong| {
                bad_disk(&folder.join(format!("{kind}-{seed}.mcap")), seed, wrong, fault)
            })
        });
    }
}

/// Rows in real time.
pub fn live<'a>(folder: &'a Path, plan: &mut Plan<'a>) {
    plan.rows("live disks", |_| {
        let file = folder.join("live.mcap");
        let (mut good, mut rows) = (Vec::new(), Vec::new());
        for seed in 1..=SESSIONS {
            good.push(worst_on_time(&recorded(&file, seed, FaultPlan::new(seed))?));
        }
        for (kind, fault) in KINDS {
            rows.extend(bad_disks(kind, fault, &file, &good)?);
        }
        Ok(rows)
    });
}

/// A session in real time that is recorded through a small backlog.
fn recorded(file: &Path, seed: u64, plan: FaultPlan) -> Result<RunOutcome, Failure> {
    let seconds = WARM + APART * STRIKES as f64 + 1.0;
    let recorder =
        RecorderOptions { backlog_max: BACKLOG_MAX, flush_period: FLUSH, ..RecorderOptions::exact() };
    let record = Some(file.to_owned());
    let options =
        RunOptions { lockstep: false, seconds: Some(seconds), record, recorder, ..options(seed, plan) };
    run_with(&App::new(), &options)
}

fn worst_on_time(outcome: &RunOutcome) -> f64 {
    let hands = outcome.reports.iter().filter(|row| row.name.starts_with("haptics."));
    hands.map(|row| row.on_time).fold(1.0, f64::min)
}

/// The same sessions with repeated disk faults.
fn bad_disks(kind: &str, fault: Strike, file: &Path, good: &[f64]) -> Rows {
    let (mut resumed, mut costs, mut wrong) = (Vec::new(), Vec::new(), Wrong::default());
    for (seed, good) in (1..).zip(good) {
        let plan = (0..STRIKES).fold(FaultPlan::new(seed), |plan, time| {
            let at = WARM + APART * time as f64;
            fault(plan.between(secs(at), secs(at + 0.1)).lasting(secs(STRIKE)))
        });
        let outcome = recorded(file, seed, plan)?;
        resumed.extend(outcome.kernel.faults.iter().map(|row| recovery(row).min(1e4)));
        costs.push((good - worst_on_time(&outcome)) * 100.0);
        wrong.check(outcome.reports.iter().all(|row| row.unaccounted() == 0), "batches are unaccounted for");
        wrong.check(outcome.kernel.model.restarts == 0, "the Model was restarted");
        check_recording(file, &outcome, STRIKES, &mut wrong)?;
    }
    let (cost, spread) = median(&costs);
    let resumed = median(&resumed);
    let name = |what: &str| format!("live_{kind}_disk_{what}");
    Ok(vec![
        BenchResult::on_value(name("resumed_p50"), "ms", resumed, Some(RESUME_MS_MAX), Better::Lower),
        BenchResult::on_value(
            name("on_time_lost"),
            "points",
            (cost.max(0.0), spread),
            Some(2.0),
            Better::Lower,
        ),
        wrong.row(&name("leaves_the_session_untouched")),
    ])
}

/// Checks that dropped data is declared, and that the recording after a gap can be replayed.
fn check_recording(
    file: &Path,
    outcome: &RunOutcome,
    gaps_min: usize,
    wrong: &mut Wrong,
) -> Result<(), Failure> {
    wrong.check(!outcome.summary.recording_complete, "the recording is said to be complete");
    wrong.check(outcome.kernel.faults.iter().all(|row| row.detected.is_some()), "nobody noticed");
    wrong.check(
        outcome.kernel.faults.iter().all(|row| row.resumed.is_some()),
        "the recorder never wrote again",
    );
    let recording = Recording::open(file).map_err(Failure::internal)?;
    let app = App::new();
    let mut replay = Replay::new(&recording, app.registry()).map_err(Failure::internal)?;
    // A gap without a keyframe after it could not be replayed across.
    let end = replay.run_to_end().map_err(Failure::internal)?;
    wrong.check(replay.gaps().len() >= gaps_min, "a gap is not declared");
    wrong.check(Some(end.to_string()) == outcome.summary.state_hash, "the recording ends in another state");
    Ok(())
}

fn bad_disk(file: &Path, seed: u64, wrong: &mut Wrong, fault: Strike) -> Result<(), Failure> {
    let app = App::new();
    let without = run(&app, seed, FaultPlan::new(seed))?;
    let options = RunOptions {
        record: Some(file.to_owned()),
        recorder: RecorderOptions { backlog_max: BACKLOG_MAX, ..RecorderOptions::exact() },
        ..options(seed, fault(FaultPlan::new(seed).at(secs(2.0)).lasting(secs(LASTING))))
    };
    let with = run_with(&app, &options)?;
    wrong.check(with.summary.state_hash == without.summary.state_hash, "the state hash differs");
    check_recording(file, &with, 1, wrong)
}

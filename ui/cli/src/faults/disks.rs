//! Disks that are full or slow: a declared gap, and a simulation that does not notice.

use std::path::Path;

use trocar::app::App;
use trocar::run::RunOptions;
use trocar_kernel::faults::{FaultPlan, secs};
use trocar_kernel::recorder::{RecorderOptions, Recording, Replay};

use super::Plan;
use super::lockstep::{options, row_of, run, run_with, violations};
use crate::failure::Failure;

/// What may wait for the disk [bytes]: little, so that something has to be given up.
const BACKLOG_MAX: usize = 100_000;
/// What the slow disk takes [bytes/s].
const SLOW: f64 = 200_000.0;
/// How long it is full or slow \[s\].
const LASTING: f64 = 6.0;

/// Rows in virtual time.
pub fn plan<'a>(folder: &'a Path, plan: &mut Plan<'a>) {
    plan.row("lockstep_full_disk_leaves_the_simulation_untouched", move |name| {
        violations(name, |seed, wrong| {
            bad_disk(&folder.join(format!("full-{seed}.mcap")), seed, wrong, |at| at.disk_full())
        })
    });
    plan.row("lockstep_slow_disk_leaves_the_simulation_untouched", move |name| {
        violations(name, |seed, wrong| {
            bad_disk(&folder.join(format!("slow-{seed}.mcap")), seed, wrong, |at| at.disk_slow(SLOW))
        })
    });
}

fn bad_disk(
    file: &Path,
    seed: u64,
    wrong: &mut super::lockstep::Wrong,
    fault: impl Fn(trocar_kernel::faults::FaultAt) -> FaultPlan,
) -> Result<(), Failure> {
    let app = App::new();
    let without = run(&app, seed, FaultPlan::new(seed))?;
    let options = RunOptions {
        record: Some(file.to_owned()),
        recorder: RecorderOptions { backlog_max: BACKLOG_MAX, ..RecorderOptions::default() },
        ..options(seed, fault(FaultPlan::new(seed).at(secs(2.0)).lasting(secs(LASTING))))
    };
    let with = run_with(&app, &options)?;
    wrong.check(with.summary.state_hash == without.summary.state_hash, "the state hash differs");
    wrong.check(!with.summary.recording_complete, "the recording is said to be complete");
    wrong.check(row_of(&with)?.detected.is_some(), "nobody noticed");
    wrong.check(row_of(&with)?.resumed.is_some(), "the recorder never wrote again");
    let recording = Recording::open(file).map_err(Failure::internal)?;
    let mut replay = Replay::new(&recording, app.registry()).map_err(Failure::internal)?;
    // A gap that no keyframe follows could not be replayed across.
    let end = replay.run_to_end().map_err(Failure::internal)?;
    wrong.check(!replay.gaps().is_empty(), "no gap is declared");
    wrong.check(Some(end.to_string()) == with.summary.state_hash, "the recording ends in another state");
    Ok(())
}

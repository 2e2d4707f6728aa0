//! The suite `recording`: what a minute of each scenario takes, what recording costs the hands, and how long opening and
//! seeking take in an hour's file.

use std::path::Path;
use std::time::Instant;

use trocar::app::{App, SCENARIOS};
use trocar::run::{self, RunOptions};
use trocar::summary::{BenchResult, Better};
use trocar_kernel::recorder::{RecorderOptions, Recording};
use trocar_scene::SimTime;

use super::exercise;
use crate::failure::Failure;

type Rows = Result<Vec<BenchResult>, Failure>;

/// Longest part of an exercise whose size is measured \[s\].
const PART: f64 = 20.0;
/// Bars on a minute \[MB\].
const PEG_TRANSFER_MAX: f64 = 10.0;
const MINUTE_MAX: f64 = 20.0;
/// The scenario whose recording is also kept exact, for comparison.
const EXACT: &str = exercise::SCENARIO;
/// Seconds of a live session, and how often each kind is run.
const LIVE: f64 = 6.0;
const ROUNDS: usize = 3;
/// Bar on the share of ticks on time that a recording costs \[points\].
const LOST_MAX: f64 = 1.0;
const HOUR: f64 = 3_600.0;
/// Bars on opening and seeking \[ms\].
const OPEN_MAX: f64 = 100.0;
const SEEK_MAX: f64 = 300.0;
/// Looks into the hour's file.
const SEEKS: usize = 20;

fn folder() -> Result<tempfile::TempDir, Failure> {
    tempfile::tempdir().map_err(Failure::internal)
}

/// Records a scenario in virtual time; returns megabytes a minute.
fn per_minute(app: &App, name: &str, file: &Path, exact: bool) -> Result<f64, Failure> {
    let options = RunOptions {
        lockstep: true,
        seconds: Some(PART),
        record: Some(file.to_owned()),
        recorder: RecorderOptions { exact, ..RecorderOptions::default() },
        ..RunOptions::default()
    };
    let outcome = run::run(app, &app.scenario(name)?, &options, &mut |_| {})?;
    if !outcome.summary.recording_complete {
        return Err(Failure::internal(format!("the recording of {name} has gaps")));
    }
    let bytes = file.metadata().map_err(Failure::internal)?.len();
    Ok(bytes as f64 * 1e-6 / outcome.summary.sim_secs * 60.0)
}

/// What a minute of each scenario takes.
pub fn sizes() -> Rows {
    let (app, folder) = (App::new(), folder()?);
    let file = folder.path().join("size.mcap");
    let mut rows = Vec::new();
    for (name, _) in SCENARIOS {
        let size = per_minute(&app, name, &file, false)?;
        let bar = if name == exercise::SCENARIO { PEG_TRANSFER_MAX } else { MINUTE_MAX };
        let name = format!("recording_minute_{}", name.replace('-', "_"));
        rows.push(BenchResult::on_value(name, "MB", (size, 0.0), Some(bar), Better::Lower));
    }
    let size = per_minute(&app, EXACT, &file, true)?;
    let name = format!("recording_minute_{}_exact", EXACT.replace('-', "_"));
    rows.push(BenchResult::on_value(name, "MB", (size, 0.0), None, Better::Lower));
    Ok(rows)
}

/// The exercise live, with and without a recording in turns: the worst hand's share of ticks on time.
pub fn hands() -> Rows {
    let (app, folder) = (App::new(), folder()?);
    let scenario = app.scenario(exercise::SCENARIO)?;
    let on_time = |record: Option<&Path>| -> Result<f64, Failure> {
        let options =
            RunOptions { seconds: Some(LIVE), record: record.map(Path::to_owned), ..RunOptions::default() };
        let outcome = run::run(&app, &scenario, &options, &mut |_| {})?;
        let hands = outcome.reports.iter().filter(|row| row.name.starts_with("haptics."));
        Ok(hands.map(|row| row.on_time).fold(1.0, f64::min))
    };
    let mut costs = Vec::new();
    for round in 0..ROUNDS {
        let file = folder.path().join(format!("{round}.mcap"));
        let (without, with) = (on_time(None)?, on_time(Some(&file))?);
        costs.push((without - with) * 100.0);
    }
    costs.sort_by(f64::total_cmp);
    let (cost, spread) = (costs[ROUNDS / 2], costs[ROUNDS - 1] - costs[0]);
    Ok(vec![BenchResult::on_value(
        "recording_on_time_lost",
        "points",
        (cost.max(0.0), spread / 100.0),
        Some(LOST_MAX),
        Better::Lower,
    )])
}

/// Opening an hour's file, and rebuilding its scene at random times; the same in the largest scenes.
pub fn hour() -> Rows {
    let (app, folder) = (App::new(), folder()?);
    let file = folder.path().join("hour.mcap");
    let options = RunOptions {
        lockstep: true,
        seconds: Some(HOUR),
        record: Some(file.clone()),
        ..RunOptions::default()
    };
    // A hand that presses for as long as it is let.
    run::run(&app, &app.scenario("wall")?, &options, &mut |_| {})?;
    let mut opens = Vec::new();
    for _ in 0..SEEKS {
        let begun = Instant::now();
        Recording::open(&file).map_err(Failure::internal)?;
        opens.push(begun.elapsed().as_secs_f64() * 1e3);
    }
    let mut rows = vec![quantile("recording_hour_open_p99", &mut opens, OPEN_MAX)];
    rows.push(seeks(&app, "recording_hour_seek_p99", &file, HOUR)?);
    for name in ["peg-transfer", "cautery"] {
        per_minute(&app, name, &file, false)?;
        let row = format!("recording_seek_{}_p99", name.replace('-', "_"));
        rows.push(seeks(&app, &row, &file, PART)?);
    }
    Ok(rows)
}

/// Rebuilds the scene at times that are spread over a file.
fn seeks(app: &App, name: &str, file: &Path, seconds: f64) -> Result<BenchResult, Failure> {
    let recording = Recording::open(file).map_err(Failure::internal)?;
    let mut times = Vec::new();
    for number in 0..SEEKS {
        // The golden ratio spreads them evenly.
        let at = seconds * (number as f64 * 0.618_034).fract();
        let begun = Instant::now();
        recording.snapshot_at(app.registry(), SimTime::from_secs_f64(at)).map_err(Failure::internal)?;
        times.push(begun.elapsed().as_secs_f64() * 1e3);
    }
    Ok(quantile(name, &mut times, SEEK_MAX))
}

/// The longest of some times, as of twenty the 99th percentile is, with their median in the spread.
fn quantile(name: &str, times: &mut [f64], bar: f64) -> BenchResult {
    times.sort_by(f64::total_cmp);
    let (median, longest) = (times[times.len() / 2], times[times.len() - 1]);
    let spread = (longest - median) / longest.max(1e-9);
    BenchResult::on_value(name, "ms", (longest, spread), Some(bar), Better::Lower)
}

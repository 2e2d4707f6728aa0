//! The suite `session`: simulation speed of one session and of one per core, and the cost of branching and reset.

use std::sync::Barrier;
use std::thread;
use std::time::Instant;

use trocar::branching::BranchError;
use trocar::session::Session;
use trocar::summary::{BenchResult, Better};
use trocar_kernel::bench::median_and_spread;
use trocar_scene::SimTime;

use super::exercise::SCENARIO;
use crate::failure::Failure;

/// A step: the period of a driver and of a haptic controller.
const STEP: SimTime = SimTime::from_millis(1);
/// Steps of one measurement; the first ring is handed over meanwhile.
const STEPS: u32 = 8_000;
/// Measurements of each kind.
const BLOCKS: u64 = 3;
/// Number of timed branches and resets.
const TIMES: usize = 200;
/// Interval between two branches, so that they happen at rest, in motion and with a ring in the jaws.
const BETWEEN: SimTime = SimTime::from_millis(37);

/// Longest branch \[ms\].
const BRANCH_MAX_MS: f64 = 1.0;

fn open(seed: u64) -> Result<Session, Failure> {
    Session::builder().seed(seed).open(SCENARIO).map_err(Failure::internal)
}

fn failed(error: BranchError) -> Failure {
    Failure::internal(error)
}

/// Every figure about sessions.
pub fn sessions() -> Result<Vec<BenchResult>, Failure> {
    let cores = thread::available_parallelism().map_or(1, usize::from);
    let mut one = Vec::new();
    let mut all = Vec::new();
    for seed in 1..=BLOCKS {
        one.push(steps_per_sec(vec![open(seed)?]));
        all.push(steps_per_sec((0..cores as u64).map(|n| open(seed + n)).collect::<Result<_, _>>()?));
    }
    let steps = |name: &str, values: &[f64]| {
        BenchResult::on_value(name, "steps of 1 ms per s", median_and_spread(values), None, Better::Higher)
    };
    let mut rows = vec![steps("session_steps", &one), steps("session_steps_all_cores", &all)];
    rows.extend(branches()?);
    Ok(rows)
}

/// Steps per second of all sessions together, one thread each.
fn steps_per_sec(sessions: Vec<Session>) -> f64 {
    let start = Barrier::new(sessions.len() + 1);
    let steps = f64::from(STEPS) * sessions.len() as f64;
    let begun = thread::scope(|scope| {
        for mut session in sessions {
            let start = &start;
            scope.spawn(move || {
                start.wait();
                (0..STEPS).all(|_| session.step(STEP))
            });
        }
        start.wait();
        // Read after the last thread has arrived and before any has ended: the scope waits for them.
        Instant::now()
    });
    steps / begun.elapsed().as_secs_f64()
}

fn branches() -> Result<Vec<BenchResult>, Failure> {
    let mut session = open(1)?;
    let (mut branch, mut past, mut first, mut later) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    let mut before = session.snapshot();
    for _ in 0..TIMES {
        session.step(BETWEEN);
        let snapshot = session.snapshot();
        let mut other = timed(&mut branch, || session.branch()).map_err(failed)?;
        timed(&mut first, || other.step(STEP));
        timed(&mut later, || other.step(STEP));
        drop(other);
        drop(timed(&mut past, || session.branch_from(&before)).map_err(failed)?);
        before = snapshot;
    }
    let mut reset = Vec::new();
    for _ in 0..TIMES {
        timed(&mut reset, || session.reset()).map_err(failed)?;
        session.step(STEP);
    }
    let ms = |name: &str, values: &[f64], bar: Option<f64>| {
        BenchResult::on_value(name, "ms", median_and_spread(values), bar, Better::Lower)
    };
    Ok(vec![
        ms("session_branch", &branch, Some(BRANCH_MAX_MS)),
        ms("session_branch_from_the_past", &past, Some(BRANCH_MAX_MS)),
        ms("session_first_step_of_a_branch", &first, None),
        ms("session_second_step_of_a_branch", &later, None),
        ms("session_reset", &reset, None),
    ])
}

/// Runs `work` and appends its duration \[ms\].
fn timed<T>(times: &mut Vec<f64>, work: impl FnOnce() -> T) -> T {
    let begun = Instant::now();
    let done = work();
    times.push(begun.elapsed().as_secs_f64() * 1e3);
    done
}

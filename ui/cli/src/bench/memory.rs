//! The suite `memory`: live bytes of sessions over an hour of simulated time, counted by the program's own allocator.

use trocar::app::App;
use trocar::run::{self, RunOptions};
use trocar::summary::{BenchResult, Better};
use trocar_scene::SimTime;

use super::counting;
use crate::failure::Failure;

const HOUR: SimTime = SimTime::from_millis(3_600_000);
/// Interval between two samples of an exercise.
const LOOK: SimTime = SimTime::from_millis(10_000);
/// Interval between two samples of a long session, and the time of the first one that counts: logs are full by then.
const MINUTE: SimTime = SimTime::from_millis(60_000);
const WARM: SimTime = SimTime::from_millis(300_000);
/// Bar on the drift of live bytes.
const DRIFT_MAX: f64 = 0.01;

fn options(seconds: Option<f64>) -> RunOptions {
    RunOptions { lockstep: true, seconds, ..RunOptions::default() }
}

fn check_counting() -> Result<(), Failure> {
    if counting::is_counting() {
        return Ok(());
    }
    Err(Failure::internal("this program does not count its allocations; its main has to name the allocator"))
}

fn row(name: &str, drift: f64) -> BenchResult {
    BenchResult::on_value(name, "share", (drift, 0.0), Some(DRIFT_MAX), Better::Lower)
}

/// Difference of `bytes` from `reference`, relative to a session of `session` bytes.
fn off(bytes: isize, reference: isize, session: isize) -> f64 {
    (bytes - reference).unsigned_abs() as f64 / session.max(1) as f64
}

/// The exercise from start to end, repeatedly: live bytes at the same moment of each run must be equal.
pub fn exercises() -> Result<Vec<BenchResult>, Failure> {
    check_counting()?;
    let app = App::new();
    let scenario = app.scenario(super::exercise::SCENARIO)?;
    let before = counting::held();
    let once = || -> Result<(SimTime, Vec<isize>), Failure> {
        let mut session = run::start(&app, &scenario, &options(None))?;
        let (mut next, mut held) = (LOOK, Vec::new());
        while session.run_until(next) {
            held.push(counting::held());
            next += LOOK;
        }
        let ended = session.now();
        session.finish();
        held.push(counting::held());
        Ok((ended, held))
    };
    // The first run fills permanent caches.
    let (mut simulated, _) = once()?;
    let (length, reference) = once()?;
    simulated += length;
    let mut worst = 0.0_f64;
    while simulated < HOUR {
        let (length, held) = once()?;
        simulated += length;
        // The drift between two sessions has the same bar as that within one.
        let session = reference[0] - before;
        for (bytes, reference) in held.iter().zip(&reference) {
            worst = worst.max(off(*bytes, *reference, session));
        }
    }
    Ok(vec![row("live_bytes_drift_over_an_hour_of_exercises", worst)])
}

/// One session for an hour: live bytes every minute must equal those after five minutes.
pub fn session() -> Result<Vec<BenchResult>, Failure> {
    check_counting()?;
    let app = App::new();
    let scenario = app.scenario("wall")?;
    let before = counting::held();
    let mut session = run::start(&app, &scenario, &options(None))?;
    let (mut next, mut reference, mut worst) = (WARM, None, 0.0_f64);
    while next <= HOUR && session.run_until(next) {
        let held = counting::held() - before;
        let reference = *reference.get_or_insert(held);
        worst = worst.max(off(held, reference, reference));
        next += MINUTE;
    }
    if session.now() < HOUR {
        return Err(Failure::internal(format!("the session ended after {} already", session.now())));
    }
    session.finish();
    Ok(vec![row("live_bytes_drift_over_an_hour_of_one_session", worst)])
}

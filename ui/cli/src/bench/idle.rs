//! Cost of a paused session: processor time of all threads of the process.

use std::time::{Duration, Instant};

use rustix::time::{ClockId, clock_gettime};
use trocar::app::App;
use trocar::run::{self, RunOptions};
use trocar::summary::{BenchResult, Better};
use trocar_kernel::bench::median_and_spread;
use trocar_scene::SimTime;

use crate::failure::Failure;

const BLOCK: Duration = Duration::from_secs(3);
const BLOCKS: usize = 5;
/// Bar on the share of a core.
const SHARE_MAX: f64 = 0.02;

/// Processor time of the whole process \[s\].
fn cpu_secs() -> f64 {
    let time = clock_gettime(ClockId::ProcessCPUTime);
    time.tv_sec as f64 + time.tv_nsec as f64 * 1e-9
}

/// Share of a core that the process uses while this thread sleeps.
fn share() -> f64 {
    let (before, begun) = (cpu_secs(), Instant::now());
    std::thread::sleep(BLOCK);
    (cpu_secs() - before) / begun.elapsed().as_secs_f64()
}

/// The exercise paused in mid-movement, beside the same process without a session.
pub fn paused() -> Result<Vec<BenchResult>, Failure> {
    let app = App::new();
    let scenario = app.scenario(super::exercise::SCENARIO)?;
    let (mut ours, mut floor) = (Vec::new(), Vec::new());
    for _ in 0..BLOCKS {
        floor.push(share());
        let mut session = run::start(&app, &scenario, &RunOptions::default())?;
        session.run_until(SimTime::from_millis(1_000));
        if !session.pause() {
            return Err(Failure::internal("the session could not be paused"));
        }
        ours.push(share());
        // Make sure that the session resumes: a dead session would cost nothing.
        let stood = session.now();
        session.resume();
        session.run_until(stood + SimTime::from_millis(500));
        let ticked = session.reports().iter().map(|row| row.scheduled - row.missed).min();
        if session.finish().outcome.code != 0 || ticked == Some(0) {
            return Err(Failure::internal("the session did not go on after its pause"));
        }
    }
    let figure = median_and_spread(&ours);
    let mut row = BenchResult::on_value(
        "idle_cpu_of_a_paused_session",
        "share",
        figure,
        Some(SHARE_MAX),
        Better::Lower,
    );
    row.floor = Some(median_and_spread(&floor).0);
    Ok(vec![row])
}

//! The whole exercise: its speed in virtual time, and its punctuality in real time.

use std::time::Duration;

use trocar::app::App;
use trocar::run::{RunOptions, RunOutcome};
use trocar::summary::{BenchResult, Better};
use trocar_kernel::bench::{BareRates, bare_rates, median_and_spread};

use crate::failure::Failure;

/// The scenario under test.
pub const SCENARIO: &str = "peg-transfer";
/// Length of a live block \[s\].
const BLOCK_SECS: f64 = 6.0;
/// Number of our blocks, and of the bare loop's blocks between them.
const BLOCKS: usize = 5;

fn run(options: &RunOptions) -> Result<RunOutcome, Failure> {
    let app = App::new();
    let scenario = app.scenario(SCENARIO)?;
    Ok(trocar::run::run(&app, &scenario, options, &mut |_| {})?)
}

/// Simulated time over wall-clock time of the whole exercise, on one core at full rates.
pub fn lockstep() -> Result<Vec<BenchResult>, Failure> {
    let mut speeds = Vec::with_capacity(3);
    for seed in 1..=3 {
        let outcome = run(&RunOptions { lockstep: true, seed, ..RunOptions::default() })?;
        speeds.push(outcome.summary.sim_secs / outcome.summary.wall_secs);
    }
    let row = BenchResult::on_value(
        "exercise_lockstep_speed",
        "× real time",
        median_and_spread(&speeds),
        Some(5.0),
        Better::Higher,
    );
    Ok(vec![row])
}

/// The results of one live block: the worse of the two hands for each figure.
#[derive(Clone, Copy)]
struct Hands {
    on_time: f64,
    late_p99_us: f64,
    cpu_share: f64,
}

fn live_block() -> Result<Hands, Failure> {
    let outcome = run(&RunOptions { seconds: Some(BLOCK_SECS), ..RunOptions::default() })?;
    let hands = outcome.reports.iter().filter(|row| row.name.starts_with("haptics."));
    let best = Hands { on_time: 1.0, late_p99_us: 0.0, cpu_share: 0.0 };
    Ok(hands.fold(best, |worst, row| Hands {
        on_time: worst.on_time.min(row.on_time),
        late_p99_us: worst.late_p99_us.max(row.lateness_us.p99),
        cpu_share: worst.cpu_share.max(row.cpu_share),
    }))
}

/// Two hands at 1 kHz in the live exercise, in blocks that alternate with two bare timer loops.
pub fn live() -> Result<Vec<BenchResult>, Failure> {
    let (mut ours, mut bare): (Vec<Hands>, Vec<BareRates>) = (Vec::new(), Vec::new());
    for _ in 0..BLOCKS {
        bare.push(bare_rates(2, 1_000.0, Duration::from_secs_f64(BLOCK_SECS)));
        ours.push(live_block()?);
    }
    let of = |value: fn(&Hands) -> f64| median_and_spread(&ours.iter().map(value).collect::<Vec<_>>());
    let floor =
        |value: fn(&BareRates) -> f64| median_and_spread(&bare.iter().map(value).collect::<Vec<_>>()).0;
    let on_time = of(|hands| hands.on_time);
    let floor_on_time = floor(|bare| bare.on_time);
    // The stricter of two bars: 99 %, or half a percentage point below the bare loop.
    let bar = (floor_on_time - 0.005).max(0.99);
    let mut first =
        BenchResult::on_value("exercise_hands_on_time", "share", on_time, Some(bar), Better::Higher);
    first.floor = Some(floor_on_time);
    first.ratio = Some(on_time.0 / floor_on_time).filter(|ratio| ratio.is_finite());
    let (late, floor_late) = (of(|hands| hands.late_p99_us), floor(|bare| bare.lateness_us.p99));
    let cpu = of(|hands| hands.cpu_share);
    Ok(vec![
        first,
        BenchResult::on_ratio(
            "exercise_hands_lateness_p99",
            "us",
            late,
            floor_late,
            Some(1.5),
            Better::Lower,
        ),
        BenchResult::on_value("exercise_hand_thread_cpu", "share", cpu, Some(0.10), Better::Lower),
    ])
}

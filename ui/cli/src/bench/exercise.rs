//! The exercise as a whole: how fast it is in virtual time, how well it keeps its rates in real time.

use std::time::{Duration, Instant};

use trocar::app::App;
use trocar::run::{RunOptions, RunOutcome};
use trocar::summary::{BenchResult, Better};
use trocar_kernel::runtime::sched;
use trocar_kernel::supervision::RuntimeClass;

use super::blocks::{interleaved, median, quantile};
use crate::failure::Failure;

const SCENARIO: &str = "peg-transfer";
/// Length of a live block \[s\].
const BLOCK_SECS: f64 = 8.0;
const BLOCKS: usize = 5;
/// A tick that starts later than this is not on time \[µs\].
const LATE_US: f64 = 1_000.0;
/// A bare loop sleeps until so long before it is due, then spins, as the kernel's ticker does.
const LEAD: Duration = Duration::from_micros(30);

fn run(options: &RunOptions) -> Result<RunOutcome, Failure> {
    let app = App::standard()?;
    let scenario = app.scenario(SCENARIO)?;
    Ok(trocar::run::run(&app, &scenario, options, &mut |_| {})?)
}

/// Simulated time per time on the wall of the whole exercise, on one core at full rates.
pub fn lockstep() -> Result<Vec<BenchResult>, Failure> {
    let mut speeds = Vec::with_capacity(3);
    for seed in 1..=3 {
        let outcome = run(&RunOptions { lockstep: true, seed, ..RunOptions::default() })?;
        speeds.push(outcome.summary.sim_secs / outcome.summary.wall_secs);
    }
    let name = "lock-step of the exercise, simulated time per wall time";
    Ok(vec![BenchResult::on_value(name, "×", median(&speeds), Some(5.0), Better::Higher)])
}

/// What one block says about two hands, or two bare loops: the worse of the two each.
#[derive(Clone, Copy, Default)]
struct Block {
    on_time: f64,
    late_p99_us: f64,
    cpu_share: f64,
}

fn live_block() -> Result<Block, Failure> {
    let outcome = run(&RunOptions { seconds: Some(BLOCK_SECS), ..RunOptions::default() })?;
    let hands = outcome.reports.iter().filter(|row| row.name.starts_with("haptics."));
    Ok(hands.fold(Block { on_time: 1.0, ..Block::default() }, |worst, row| Block {
        on_time: worst.on_time.min(row.on_time),
        late_p99_us: worst.late_p99_us.max(row.lateness_us.p99),
        cpu_share: worst.cpu_share.max(row.cpu_share),
    }))
}

/// Two loops at 1 kHz that do nothing, with the priority that haptics has.
fn bare_block() -> Result<Block, Failure> {
    let threads: Vec<_> = (0..2).map(|_| std::thread::spawn(bare_loop)).collect();
    let mut worst = Block { on_time: 1.0, ..Block::default() };
    for thread in threads {
        let mut late = thread.join().map_err(|_| Failure::internal("the bare timer loop panicked"))?;
        let on_time = late.iter().filter(|us| **us < LATE_US).count() as f64 / late.len().max(1) as f64;
        late.sort_by(f64::total_cmp);
        worst.on_time = worst.on_time.min(on_time);
        worst.late_p99_us = worst.late_p99_us.max(quantile(&late, 0.99));
    }
    Ok(worst)
}

/// Lateness of every tick \[µs\]; a tick that never ran counts as infinitely late.
fn bare_loop() -> Vec<f64> {
    sched::promote_current(RuntimeClass::Haptics);
    let period = Duration::from_millis(1);
    let ticks = (BLOCK_SECS / period.as_secs_f64()) as u32;
    let begun = Instant::now();
    let mut late = Vec::with_capacity(ticks as usize);
    let mut tick = 1;
    while tick <= ticks {
        let due = begun + period * tick;
        std::thread::sleep((due - LEAD).saturating_duration_since(Instant::now()));
        while Instant::now() < due {
            std::hint::spin_loop();
        }
        let lateness = due.elapsed();
        late.push(lateness.as_secs_f64() * 1e6);
        // Ticks that are over are skipped, never run in a burst.
        let skipped = (lateness.as_nanos() / period.as_nanos()) as u32;
        late.extend((0..skipped).map(|_| f64::INFINITY));
        tick += 1 + skipped;
    }
    late
}

/// Two hands at 1 kHz in the live exercise beside two bare loops.
pub fn live() -> Result<Vec<BenchResult>, Failure> {
    let (mut ours, mut bare) = (Vec::new(), Vec::new());
    interleaved(
        BLOCKS,
        || live_block().map(|block| ours.push(block)).map(|()| 0.0),
        || bare_block().map(|block| bare.push(block)).map(|()| 0.0),
    )?;
    let of =
        |blocks: &[Block], value: fn(&Block) -> f64| median(&blocks.iter().map(value).collect::<Vec<_>>());
    let percent = |(value, spread): (f64, f64)| (100.0 * value, 100.0 * spread);
    let (on_time, bare_on_time) =
        (percent(of(&ours, |block| block.on_time)), percent(of(&bare, |block| block.on_time)));
    let late = of(&ours, |block| block.late_p99_us);
    let bare_late = of(&bare, |block| block.late_p99_us);
    let cpu = percent(of(&ours, |block| block.cpu_share));
    // The bar is the stricter of the two: 99 %, or half a point below the bare loop.
    let bar = (bare_on_time.0 - 0.5).max(99.0);
    let mut first = BenchResult::on_value(
        "two hands at 1 kHz, on time (the worse one)",
        "%",
        on_time,
        Some(bar),
        Better::Higher,
    );
    first.floor = Some(bare_on_time.0);
    first.ratio = Some(on_time.0 / bare_on_time.0).filter(|ratio| ratio.is_finite());
    Ok(vec![
        first,
        BenchResult::on_ratio(
            "two hands at 1 kHz, p99 lateness (the worse one)",
            "µs",
            late,
            bare_late.0,
            Some(1.5),
            Better::Lower,
        ),
        BenchResult::on_value("CPU of a hand's thread (the larger one)", "%", cpu, Some(10.0), Better::Lower),
    ])
}

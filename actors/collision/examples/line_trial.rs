//! Runs a shaft over a folded organ that heaves and is cut, and compares every segment of every step with brute force:
//! `cargo run --release -p trocar-collision --example line_trial -- STEPS TRIANGLES SEED`.

#[path = "../tests/support/mod.rs"]
mod support;

use support::organ::line_trial::{Trial, run};
use trocar_collision::dynamic_point::LineConfig;

fn main() {
    let mut numbers = std::env::args().skip(1).map(|word| word.parse::<u64>());
    let mut next = |otherwise| numbers.next().and_then(Result::ok).unwrap_or(otherwise);
    let (steps, triangles, seed) = (next(1_000_000) as usize, next(2_000) as usize, next(1));
    let config = LineConfig { segments: 6, radius: 0.0025, margin: 0.0 };
    let trial = Trial {
        triangles,
        steps,
        seed,
        deforms_every: 1,
        cuts_every: 5_000,
        interval_secs: 0.001,
        hand_rests: false,
        config,
    };
    let outcome = run(&trial, |step, outcome| {
        if (step + 1) % 100_000 == 0 {
            eprintln!("{} steps, {} missed", step + 1, outcome.missed);
        }
    });
    let statistics = &outcome.statistics;
    println!(
        "{steps} steps on {triangles} triangles, seed {seed}: {} segments in contact, {} missed, {} invented, \
         distances within {:.1e} m; fell back on {:.2} %, {:.2} exact tests and {:.2} nodes per segment; work of a \
         step p50 {:.0}, p99 {:.0}",
        outcome.in_contact,
        outcome.missed,
        outcome.invented,
        outcome.error,
        100.0 * statistics.fallback_rate(),
        statistics.triangle_tests as f64 / statistics.segment_updates as f64,
        statistics.nodes as f64 / statistics.segment_updates as f64,
        statistics.work.quantile(0.5),
        statistics.work.quantile(0.99),
    );
}

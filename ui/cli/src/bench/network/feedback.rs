//! What a hand feels of a liver that a slave presses for it, over a delay, in virtual time.

use std::path::Path;

use trocar::app::{App, SCENARIOS};
use trocar::run::{self, RunOptions};
use trocar::summary::{BenchResult, Better};

use super::Rows;
use crate::failure::Failure;

const SCENARIO: &str = "tele-palpation";
/// Names in rows, and in scenarios.
const METHODS: [(&str, &str); 3] =
    [("passivity", "passivity"), ("waves", "wave-variables"), ("model", "model-mediated")];
/// From a motion to its force, and the least share that is to be felt \[ms\].
pub const DELAYS: [(u32, f64); 3] = [(100, 0.5), (300, 0.01), (1_000, 0.01)];

/// Mean of the force on the hand over that at the slave, by each method and over each delay.
pub fn force_feedback() -> Rows {
    let mut rows = Vec::new();
    for (name, method) in METHODS {
        for (ms, bar) in DELAYS {
            let (name, value) = (format!("network_felt_by_{name}_{ms}ms"), (felt(method, ms)?, 0.0));
            rows.push(BenchResult::on_value(name, "of the force", value, Some(bar), Better::Higher));
        }
    }
    Ok(rows)
}

/// The share that is felt by this method when a force comes so long after its motion.
pub fn felt(method: &str, delay_ms: u32) -> Result<f64, Failure> {
    let known = SCENARIOS.iter().find(|(name, _)| *name == SCENARIO);
    let (_, text) =
        known.ok_or_else(|| Failure::internal("the scenario of the force feedback is missing"))?;
    let one_way = format!("round_trip_secs = {}\nvaries = false\n", f64::from(delay_ms) * 0.5e-3);
    let text = text
        .replace("round_trip_secs = 0.100\n", &one_way)
        .replace("feedback = \"automatic\"", &format!("feedback = \"{method}\""));
    let app = App::new();
    let scenario = app.scenario_from(Path::new("tele-palpation.toml"), &text)?;
    let options = RunOptions { lockstep: true, ..RunOptions::default() };
    let outcome = run::run(&app, &scenario, &options, &mut |_| {})?;
    let figures = outcome.summary.teleoperation.get("right");
    figures.and_then(|figures| figures.felt_share).ok_or_else(|| Failure::internal("the liver was not felt"))
}

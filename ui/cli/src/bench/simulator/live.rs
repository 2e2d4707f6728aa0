//! Two rates in one scene, live: an implicit organ at 20 Hz, an explicit membrane at 500 Hz, a reader of both at 60 Hz
//! and two hands at 1 kHz, beside bare timer loops of the same run. The claim under test: none disturbs another. And
//! every material scene, live: whether it meets the expectations of its scenario.

use std::time::Duration;

use trocar::app::App;
use trocar::prelude::*;
use trocar::summary::{BenchResult, Better};
use trocar_kernel::bench::{bare_rates, median_and_spread};

use crate::failure::Failure;

/// Length of a block \[s\]: both hands press in the last half of it.
const BLOCK_SECS: f64 = 4.0;
const BLOCKS: usize = 3;
/// Rates that the bodies and the reader must keep \[Hz\].
const KEPT: [(&str, f64); 3] = [("organ", 20.0), ("membrane", 500.0), ("eye", 60.0)];

/// Reads every vertex position, as a viewer would.
struct SceneReader;

impl Controller for SceneReader {
    fn access(&self) -> Access {
        Access::new().reads::<VertexPositions>().reads::<Pose>()
    }

    fn tick(&mut self, _: &Tick<'_>, scene: &Snapshot, _: &mut Commands) -> Result<(), ControllerError> {
        let vertices = scene.iter::<VertexPositions>().flat_map(|(_, body)| body.positions.iter());
        let highest = vertices.map(|vertex| vertex.z).fold(f64::NEG_INFINITY, f64::max);
        std::hint::black_box(highest);
        Ok(())
    }
}

/// Achieved rates, and the punctuality of the hands.
pub fn live() -> Result<Vec<BenchResult>, Failure> {
    let app = App::new().controller_with("eye", |(): &(), _| Ok(SceneReader)).joins("eye", 60.0);
    let scenario = app.scenario("two-rates")?;
    let options = RunOptions { seconds: Some(BLOCK_SECS), ..RunOptions::default() };
    let span = Duration::from_secs_f64(BLOCK_SECS);
    let (mut hands, mut bare) = (Vec::new(), Vec::new());
    let mut achieved = [const { Vec::new() }; KEPT.len()];
    for _ in 0..BLOCKS {
        bare.push(bare_rates(2, 1_000.0, span).on_time);
        let outcome = trocar::run::run(&app, &scenario, &options, &mut |_| {})?;
        let row = |name: &str| {
            let row = outcome.reports.iter().find(|row| row.name == name);
            row.ok_or_else(|| Failure::internal(format!("'{name}' did not run")))
        };
        for ((name, _), achieved) in KEPT.iter().zip(&mut achieved) {
            achieved.push(row(name)?.achieved_hz);
        }
        hands.push(row("haptics.left")?.on_time.min(row("haptics.right")?.on_time));
    }
    let mut rows = Vec::new();
    for ((name, hz), achieved) in KEPT.iter().zip(&achieved) {
        let figure = median_and_spread(achieved);
        let name = format!("simulator_live_{name}_hz");
        rows.push(BenchResult::on_value(name, "Hz", figure, Some(0.99 * hz), Better::Higher));
    }
    let floor = median_and_spread(&bare).0;
    let bar = Some((floor - 0.005).max(0.99));
    let name = "simulator_live_hands_on_time";
    let mut on_time = BenchResult::on_value(name, "share", median_and_spread(&hands), bar, Better::Higher);
    on_time.floor = Some(floor);
    on_time.ratio = Some(on_time.value / floor).filter(|ratio| ratio.is_finite());
    rows.push(on_time);
    Ok(rows)
}

/// The material scenes.
const SCENES: [&str; 10] = [
    "instruments",
    "cloth-cut",
    "tube-loop",
    "fem-liver",
    "soft-stomach",
    "knot",
    "needle-tissue",
    "cautery",
    "bleeding",
    "two-rates",
];

/// The share of its scenario's expectations that each scene meets, with its virtual hands in real time.
pub fn scenes() -> Result<Vec<BenchResult>, Failure> {
    let app = App::new();
    let judged = SCENES.iter().map(|name| {
        let outcome = trocar::run::run(&app, &app.scenario(name)?, &RunOptions::default(), &mut |_| {})?;
        let task = &outcome.summary.task;
        // Frozen bodies count against it, too.
        let share = if task.completed { 1.0 } else { (task.score.unwrap_or(0.0) / 100.0).min(0.99) };
        let name = format!("simulator_live_scene_{}", name.replace('-', "_"));
        Ok(BenchResult::on_value(name, "share", (share, 0.0), Some(1.0), Better::Higher))
    });
    judged.collect()
}

//! A guest that sends a million commands per second in real time, compared with the same session without it.

use trocar::app::App;
use trocar::session::Finished;
use trocar::summary::{BenchResult, Better};
use trocar_kernel::bench::median_and_spread as median;
use trocar_kernel::faults::FaultPlan;
use trocar_kernel::runtime::ControllerReport;

use super::Plan;
use super::hostile::{Floods, Nuisance};
use super::live::{COMPARED_SECS, run, worst_on_time};
use super::lockstep::split;
use crate::failure::Failure;

/// Pairs of sessions, one with the flood and one without.
const PAIRS: usize = 3;
/// The guest's rate \[Hz\], and how many entities it spawns per tick. Each gets a component and is despawned again:
/// three commands.
const RATE_HZ: f64 = 500.0;
const PER_TICK: usize = 700;
/// Bar on the median waiting time of the other batches, relative to the session without the flood.
const QUEUE_AGE_RATIO_MAX: f64 = 1.5;

/// The rows.
pub fn live(plan: &mut Plan<'_>) {
    plan.rows("live flood", |_| flood());
}

fn flood() -> Result<Vec<BenchResult>, Failure> {
    let (mut alone, mut beside, mut costs) = (Vec::new(), Vec::new(), Vec::new());
    let (mut refused, mut others_refused) = (Vec::new(), 0);
    for _ in 0..PAIRS {
        let quiet = run(&App::new(), FaultPlan::new(1), COMPARED_SECS)?;
        let app = App::new().component::<Nuisance>();
        let app = app.controller_with("guest", |(): &(), _| Ok(Floods::new(PER_TICK)));
        let loud = run(&app.joins("guest", RATE_HZ), FaultPlan::new(1), COMPARED_SECS)?;
        let (guest, others) = split(&loud.outcome.controllers, "guest");
        let sum = |row: &ControllerReport| row.dropped + row.rejected + row.lost;
        others_refused += others.iter().map(|row| sum(row)).sum::<u64>();
        refused.push(guest.dropped as f64 / guest.scheduled.max(1) as f64);
        alone.push(queue_age(&quiet));
        beside.push(queue_age(&loud));
        costs.push((worst_on_time(&quiet) - worst_on_time(&loud)) * 100.0);
    }
    let (cost, spread) = median(&costs);
    let refused = median(&refused);
    Ok(vec![
        BenchResult::on_value(
            "live_flood_refused_at_its_own_handle",
            "of its batches",
            refused,
            Some(0.5),
            Better::Higher,
        ),
        BenchResult::on_value(
            "live_flood_others_refused",
            "batches",
            (others_refused as f64, 0.0),
            Some(0.0),
            Better::Lower,
        ),
        BenchResult::on_ratio(
            "live_flood_others_queue_age_p50",
            "us",
            median(&beside),
            median(&alone).0,
            Some(QUEUE_AGE_RATIO_MAX),
            Better::Lower,
        ),
        BenchResult::on_value(
            "live_flood_on_time_lost",
            "points",
            (cost.max(0.0), spread),
            Some(2.0),
            Better::Lower,
        ),
    ])
}

/// Median time for which the batches of the worse hand wait for the Model \[µs\].
fn queue_age(finished: &Finished) -> f64 {
    let hands = finished.outcome.controllers.iter().filter(|row| row.name.starts_with("haptics."));
    hands.map(|row| row.queue_age_us.p50).fold(0.0, f64::max)
}

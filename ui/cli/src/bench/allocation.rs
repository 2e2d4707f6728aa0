//! Allocations of a warmed-up haptic tick.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use trocar::app::App;
use trocar::assembly::Assembly;
use trocar::run::RunOptions;
use trocar::session::Session;
use trocar::summary::{BenchResult, Better};
use trocar_scene::{Access, Commands, Controller, ControllerError, SimTime, Snapshot, Tick};

use super::counting::{counts, is_counting};
use super::exercise::SCENARIO;
use crate::failure::Failure;

/// Warm-up, during which buffers may grow.
const WARM: SimTime = SimTime::from_millis(2_000);
/// End of the measurement.
const END: SimTime = SimTime::from_millis(12_000);

#[derive(Default)]
struct Totals {
    ticks: AtomicU64,
    allocations: AtomicU64,
    frees: AtomicU64,
}

/// A controller whose allocations are counted.
struct Watched {
    inner: Box<dyn Controller>,
    totals: Arc<Totals>,
}

impl Controller for Watched {
    fn access(&self) -> Access {
        self.inner.access()
    }
    fn tick(&mut self, tick: &Tick<'_>, scene: &Snapshot, out: &mut Commands) -> Result<(), ControllerError> {
        let before = counts();
        let result = self.inner.tick(tick, scene, out);
        let after = counts();
        if tick.time >= WARM {
            self.totals.ticks.fetch_add(1, Ordering::Relaxed);
            self.totals.allocations.fetch_add(after.0 - before.0, Ordering::Relaxed);
            self.totals.frees.fetch_add(after.1 - before.1, Ordering::Relaxed);
        }
        result
    }
}

/// Allocations and frees per warmed tick of the haptic controllers, in the exercise.
///
/// # Errors
/// When the program has another allocator: a count of zero would then be meaningless.
pub fn haptic_ticks() -> Result<Vec<BenchResult>, Failure> {
    if !is_counting() {
        return Err(Failure::usage(
            "this program's allocator counts nothing; its main file needs trocar_cli::CountingAllocator",
        ));
    }
    let app = App::new();
    let scenario = app.scenario(SCENARIO)?;
    let options = RunOptions { lockstep: true, seconds: Some(END.as_secs_f64()), ..RunOptions::default() };
    let mut assembly = Assembly::new(&app, &scenario, &options)
        .map_err(|error| Failure::from(trocar::run::RunError::from(error)))?;
    let totals = Arc::new(Totals::default());
    for spec in assembly.spec.controllers.iter_mut().filter(|spec| spec.name.starts_with("haptics.")) {
        let (factory, totals) = (spec.factory.clone(), totals.clone());
        spec.factory = Arc::new(move |context| {
            Ok(Box::new(Watched { inner: factory(context)?, totals: totals.clone() }))
        });
    }
    let mut session = Session::lockstep(assembly)?;
    session.run_until(END);
    session.finish();
    let ticks = totals.ticks.load(Ordering::Relaxed);
    if ticks == 0 {
        return Err(Failure::internal("no haptic tick was watched"));
    }
    let row = |name: &str, count: &AtomicU64| {
        let per_tick = count.load(Ordering::Relaxed) as f64 / ticks as f64;
        BenchResult::on_value(name, "per tick", (per_tick, 0.0), Some(0.0), Better::Lower)
    };
    Ok(vec![row("haptic_tick_allocations", &totals.allocations), row("haptic_tick_frees", &totals.frees)])
}

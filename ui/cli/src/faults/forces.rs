//! How long a driver holds a force after its controller is gone, measured in every step of the driver itself.

use std::sync::Arc;

use trocar::app::App;
use trocar::assembly::Assembly;
use trocar::run::RunError;
use trocar::session::{Finished, Session};
use trocar::soak::FORCE_MAX;
use trocar::summary::{BenchResult, Better};
use trocar_devices::DriverStatistics;
use trocar_kernel::bench::median_and_spread as median;
use trocar_kernel::faults::{FaultPlan, secs};
use trocar_scene::SimTime;

use super::Plan;
use super::live::{TIMES, WARM, watched};
use super::lockstep::{self, RUN_SECS, STALL, options, run, run_with, struck};
use super::zombie::{GENTLE, VICTIM, WRITES, ZombieBehaviour, ZombiePeer, ZombieState, app_with_zombie};
use crate::failure::Failure;

/// Longest age of the last fresh command until its force is zero \[ms\].
const HELD_MS_MAX: f64 = 20.0;
/// The driver's own force: damping of the handle \[N\].
const DAMPING_MAX: f64 = 0.5;

/// Rows in virtual time.
pub fn lockstep(plan: &mut Plan<'_>) {
    plan.row("lockstep_force_held_after_a_kill", |name| {
        lockstep::worst(name, "ms", HELD_MS_MAX, |seed| {
            Ok(held(&run(&App::new(), seed, struck(seed).kill(VICTIM))?.drivers, 0))
        })
    });
    plan.row("lockstep_force_held_after_a_stall", |name| {
        lockstep::worst(name, "ms", HELD_MS_MAX, |seed| {
            let plan = struck(seed).lasting(secs(STALL)).stall(VICTIM);
            Ok(held(&run(&App::new(), seed, plan)?.drivers, 1))
        })
    });
    plan.row("lockstep_force_held_at_the_end", |name| {
        lockstep::worst(name, "ms", HELD_MS_MAX, |seed| {
            // In the middle of a movement, so that the driver holds a force.
            let seconds = Some(6.0 + 0.5 * seed as f64);
            let outcome = run_with(
                &App::new(),
                &trocar::run::RunOptions { seconds, ..options(seed, FaultPlan::new(seed)) },
            )?;
            Ok(held(&outcome.drivers, 1))
        })
    });
    plan.row("lockstep_zombie_commands_100_n", |name| {
        lockstep::violations(name, |seed, wrong| {
            let (silent, _) = with_zombie(seed, false)?;
            let (loud, written) = with_zombie(seed, true)?;
            wrong.check(written == WRITES, "it did not command what it should");
            wrong.check(loud.commands_refused >= WRITES, "some commands of a zombie were not refused");
            wrong.check(loud.outcome.hash == silent.outcome.hash, "the session noticed");
            wrong.check(held(&loud.drivers, 1) <= HELD_MS_MAX, "its last force was held for too long");
            wrong.check(loud.force_newtons_max <= FORCE_MAX, "a force was above its limit");
            wrong.check(loud.outcome.controllers.iter().any(|row| row.restarts == 1), "nobody replaced it");
            Ok(())
        })
    });
}

/// Greatest age of a command while its force was held \[ms\], if the drivers released forces at least that often.
fn held(drivers: &[DriverStatistics], releases: u64) -> f64 {
    let longest = drivers.iter().map(|driver| driver.force_age_max_ns).max().unwrap_or(u64::MAX);
    let enough = drivers.iter().map(|driver| driver.releases).sum::<u64>() >= releases;
    if enough { longest as f64 * 1e-6 } else { f64::INFINITY }
}

/// The exercise with a left hand whose first controller becomes a zombie, and the number of its commands.
fn with_zombie(seed: u64, loud: bool) -> Result<(Finished, u64), Failure> {
    let zombie_state = Arc::<ZombieState>::default();
    let (app, scenario) = app_with_zombie(ZombieBehaviour::Once, &zombie_state)?;
    let plan = FaultPlan::new(seed).between(secs(0.5), secs(1.5)).lasting(secs(STALL)).stall(VICTIM);
    let mut assembly = Assembly::new(&app, &scenario, &options(seed, plan)).map_err(RunError::from)?;
    assembly.spec.peers.push(Box::new(ZombiePeer::new(&zombie_state, loud)));
    let mut session = Session::lockstep(assembly)?;
    session.run_until(SimTime::from_secs_f64(RUN_SECS));
    Ok((session.finish(), zombie_state.written()))
}

/// Rows in real time.
pub fn live(plan: &mut Plan<'_>) {
    plan.rows("live zombies", |_| zombies());
    plan.rows("live_force_held_at_the_end", |_| ends());
}

/// Each instance of the left hand's controller hangs, is replaced, wakes up and commands 100 N for a while.
fn zombies() -> Result<Vec<BenchResult>, Failure> {
    let gap = 0.7;
    let mut plan = FaultPlan::new(1);
    for time in 0..TIMES {
        let at = WARM + gap * time as f64;
        plan = plan.between(secs(at), secs(at + 0.1)).lasting(secs(0.2)).stall(VICTIM);
    }
    let zombie_state = Arc::<ZombieState>::default();
    let (app, scenario) = app_with_zombie(ZombieBehaviour::Always, &zombie_state)?;
    let watched = watched(&app, &scenario, plan, WARM + gap * TIMES as f64 + 1.0)?;
    let drivers = &watched.finished.drivers;
    let refused = watched.finished.commands_refused as f64 / zombie_state.written().max(1) as f64;
    // Of two commands within one step the driver sees the later one.
    let mut share = BenchResult::on_value(
        "live_zombie_commands_of_100_n_refused",
        "of those written",
        (refused, 0.0),
        Some(0.5),
        Better::Higher,
    );
    share.holds &= zombie_state.written() >= WRITES * TIMES as u64 / 2;
    let force = (drivers.first().map_or(f64::NAN, |left| left.force_newtons_max), 0.0);
    let bar = Some(GENTLE + DAMPING_MAX);
    let mut rows = vec![share];
    rows.push(BenchResult::on_value("live_zombie_force_max", "N", force, bar, Better::Lower));
    rows.extend(held_rows("live_force_held_after_a_zombie", &watched.released_ms, drivers));
    Ok(rows)
}

/// The median over the driver's releases, and the longest one beside the bar for this machine.
pub fn held_rows(name: &str, released_ms: &[f64], drivers: &[DriverStatistics]) -> Vec<BenchResult> {
    let median = median(released_ms);
    let mut row =
        BenchResult::on_value(format!("{name}_p50"), "ms", median, Some(HELD_MS_MAX), Better::Lower);
    row.holds &= released_ms.len() >= TIMES;
    vec![row, longest(&format!("{name}_max"), drivers)]
}

/// The longest time for which a driver held any force, beside the guaranteed limit plus the driver's greatest lateness:
/// a driver that is not scheduled holds its force.
pub fn longest(name: &str, drivers: &[DriverStatistics]) -> BenchResult {
    let late = drivers.iter().map(|driver| driver.lateness_max_ns).max().unwrap_or(0);
    let floor = HELD_MS_MAX + late as f64 * 1e-6;
    BenchResult::on_ratio(name, "ms", (held(drivers, 0), 0.0), floor, Some(1.0), Better::Lower)
}

/// Sessions that end in the middle of a movement.
fn ends() -> Result<Vec<BenchResult>, Failure> {
    let (mut released, mut drivers) = (Vec::new(), Vec::new());
    let app = App::new();
    let scenario = app.scenario(lockstep::SCENARIO)?;
    for time in 0..TIMES {
        let watched = watched(&app, &scenario, FaultPlan::new(time as u64), 0.8)?;
        let last = watched.finished.drivers.iter().filter(|driver| driver.releases > 0);
        released.extend(last.map(|driver| driver.release_age_ns as f64 * 1e-6).reduce(f64::max));
        drivers.extend(watched.finished.drivers);
    }
    Ok(held_rows("live_force_held_at_the_end", &released, &drivers))
}

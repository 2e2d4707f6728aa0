//! Tests across crates: scenarios, faults, determinism, benchmarks, tidiness of the sources.
//!
//! This library holds helpers of several of those tests: the standard program, and runs of the peg transfer with parts
//! of the scenario replaced.

pub mod bounded;
pub mod golden;
pub mod load;

use trocar::app::App;
use trocar::run::{RunOptions, RunOutcome, run};
use trocar_scene::scenario::Scenario;
use trocar_scene::{Entity, Snapshot};

/// The program with all built-in components and controllers.
pub fn app() -> App {
    App::new()
}

/// The peg transfer with pieces of its text replaced; every piece must occur.
///
/// # Panics
/// When a piece does not occur or the result is an invalid scenario.
pub fn peg_transfer(app: &App, replacements: &[(&str, &str)]) -> Scenario {
    edited(app, "peg-transfer", replacements)
}

/// One of the program's scenarios with pieces of its text replaced; every piece must occur.
///
/// # Panics
/// When a piece does not occur or the result is an invalid scenario.
pub fn edited(app: &App, name: &str, replacements: &[(&str, &str)]) -> Scenario {
    let (_, text) =
        trocar::app::SCENARIOS.iter().find(|(known, _)| *known == name).expect("a known scenario");
    let mut text = (*text).to_owned();
    for (old, new) in replacements {
        assert!(text.contains(old), "the scenario does not say '{old}'");
        text = text.replace(old, new);
    }
    Scenario::parse("edited.toml".as_ref(), &text, app.registry()).expect("a valid scenario")
}

/// Options of a run in lock-step.
pub fn lockstep(seed: u64) -> RunOptions {
    RunOptions { lockstep: true, seed, ..RunOptions::default() }
}

/// Runs to the end without an observer.
///
/// # Panics
/// When the run cannot start.
pub fn finish(app: &App, scenario: &Scenario, options: &RunOptions) -> RunOutcome {
    run(app, scenario, options, &mut |_| {}).expect("the session starts")
}

/// Applies `work` to every seed on two threads; results are in the order of the seeds.
///
/// # Panics
/// When `work` does.
pub fn for_seeds<T: Send>(seeds: &[u64], work: impl Fn(u64) -> T + Sync) -> Vec<T> {
    let middle = seeds.len().div_ceil(2);
    let (first, second) = seeds.split_at(middle);
    std::thread::scope(|scope| {
        let other = scope.spawn(|| second.iter().map(|seed| work(*seed)).collect::<Vec<T>>());
        let mut results: Vec<T> = first.iter().map(|seed| work(*seed)).collect();
        results.extend(other.join().expect("no seed panics"));
        results
    })
}

/// The instruments and hands of the peg transfer, left and right.
pub struct Names {
    /// The graspers.
    pub instruments: [Entity; 2],
    /// The hands.
    pub hands: [Entity; 2],
}

/// Finds their entities.
pub fn names(scene: &Snapshot) -> Names {
    let find = |name: &str| scene.find(name).expect("a name of the scenario");
    Names {
        instruments: [find("grasper.left"), find("grasper.right")],
        hands: [find("hand.left"), find("hand.right")],
    }
}

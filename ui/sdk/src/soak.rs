//! Soak tests: an exercise under random fault plans in lock-step, and the invariants that must hold.
//!
//! The seed decides the plan, the session and so the outcome. A failure is reproducible.

use std::path::Path;

use rand_pcg::Pcg32;
use rand_pcg::rand_core::RngCore;
use trocar_kernel::faults::{During, FaultKind, FaultPlan, TargetClass, secs};
use trocar_kernel::recorder::{RecorderOptions, Recording, Replay};
use trocar_kernel::spec::{MODEL, RECORDER};
use trocar_scene::scenario::Scenario;
use trocar_scene::{CollisionList, DeviceForce, Pose, SimTime, Snapshot, TaskState, Velocity};

use crate::app::App;
use crate::run::{Progress, RunError, RunOptions, RunOutcome, run};

/// Most faults of one random plan.
const FAULTS_MAX: u32 = 5;
/// Faults strike within this time of the session \[s\].
const WINDOW: (f64, f64) = (1.0, 40.0);
/// Longest random fault of limited duration \[s\].
const LASTING_MAX: f64 = 0.6;
/// Greatest force that any of the exercise's devices may render \[N\].
pub const FORCE_MAX: f64 = 3.3;

/// The outcome for one seed.
#[derive(Clone, Debug)]
pub struct SoakResult {
    /// The seed.
    pub seed: u64,
    /// The injected faults, one name each.
    pub faults: Vec<String>,
    /// Whether the exercise was completed despite the faults.
    pub completed: bool,
    /// Violated invariants, in words; empty when all hold.
    pub violations: Vec<String>,
}

/// A plan of one to five faults of random kinds at random moments, aimed at random targets of the scenario.
pub fn random_plan(scenario: &Scenario, seed: u64) -> FaultPlan {
    let mut random = Pcg32::new(seed, 0xfa17);
    let mut targets: Vec<(String, TargetClass)> =
        vec![(MODEL.to_owned(), TargetClass::Model), (RECORDER.to_owned(), TargetClass::Recorder)];
    let controllers = scenario.controllers.iter().map(|entry| entry.name.clone());
    targets.extend(controllers.map(|name| (name, TargetClass::Controller)));
    let devices = scenario.hands.iter().map(|hand| format!("device.{}", hand.name));
    targets.extend(devices.map(|name| (name, TargetClass::Device)));
    let mut pick = |count: usize| random.next_u32() as usize % count.max(1);
    let mut plan = FaultPlan::new(seed);
    for _ in 0..=pick(FAULTS_MAX as usize) {
        let (target, class) = &targets[pick(targets.len())];
        let kind = class.kinds()[pick(class.kinds().len())];
        let mut at = plan.between(secs(WINDOW.0), secs(WINDOW.1));
        if pick(2) == 1 {
            at = at.during(During::Grasp);
        }
        if kind != FaultKind::Kill {
            at = at.lasting(secs(LASTING_MAX * (1 + pick(20)) as f64 / 20.0));
        }
        let share = 0.05 * (1 + pick(20)) as f64;
        plan = match kind {
            FaultKind::Slow => at.slow(target, secs(0.0005 * (1 + pick(20)) as f64)),
            FaultKind::Drop => at.drop(target, share),
            FaultKind::Duplicate => at.duplicate(target, share),
            FaultKind::Reorder => at.reorder(target, share),
            FaultKind::Corrupt => at.corrupt(target, share),
            FaultKind::Delay => at.jitter(target, secs(0.1 * share), secs(0.05 * share)),
            FaultKind::DiskSlow => at.disk_slow(1e5 * share),
            FaultKind::RateLimit => at.rate_limit(target, 1e5 * share, secs(0.1 * share)),
            kind => at.fault(kind, target),
        };
    }
    plan
}

/// Runs a scenario under the random plan of `seed`, recording into `file`, and checks the invariants.
///
/// # Errors
/// When the session cannot start; plans of this module never cause that.
pub fn soak(
    app: &App,
    scenario: &Scenario,
    seed: u64,
    seconds: Option<f64>,
    file: &Path,
) -> Result<SoakResult, RunError> {
    let plan = random_plan(scenario, seed);
    let faults = plan.faults.iter().map(|fault| fault.id.clone()).collect();
    let options = RunOptions {
        lockstep: true,
        seconds,
        seed,
        faults: Some(plan),
        record: Some(file.to_owned()),
        // What is checked is that no batch is lost.
        recorder: RecorderOptions::exact(),
        ..RunOptions::default()
    };
    let mut violations = Vec::new();
    let outcome = run(app, scenario, &options, &mut |progress| look(progress, &mut violations))?;
    judge(app, &outcome, file, &mut violations);
    Ok(SoakResult { seed, faults, completed: outcome.summary.task.completed, violations })
}

/// The invariants of every moment.
fn look(progress: &Progress<'_>, violations: &mut Vec<String>) {
    let mut wrong = |what: String| {
        // The first few are enough.
        if violations.len() < 8 {
            violations.push(format!("{what} at {} s", progress.now.as_secs_f64()));
        }
    };
    if !is_finite(progress.scene) {
        wrong("a number that is none is in the scene".to_owned());
    }
    for (writer, _) in progress.scene.iter::<CollisionList>() {
        let reports = progress.session.reports();
        let Some(row) = reports.get(usize::from(writer.spawner()).wrapping_sub(1)) else { continue };
        let health = progress.session.health();
        let down =
            health.iter().any(|(name, how)| *name == row.name && matches!(*how, "restarting" | "held"));
        if down {
            wrong(format!("contacts of {}, which is dead, are in the scene", row.name));
        }
    }
}

/// Whether every pose, velocity and force in a scene is finite.
pub fn is_finite(scene: &Snapshot) -> bool {
    scene.iter::<Pose>().all(|(_, pose)| pose.translation.iter().all(|x| x.is_finite()))
        && scene.iter::<Velocity>().all(|(_, velocity)| velocity.linear.iter().all(|x| x.is_finite()))
        && scene.iter::<DeviceForce>().all(|(_, force)| force.force.iter().all(|x| x.is_finite()))
}

/// The invariants at the end.
fn judge(app: &App, outcome: &RunOutcome, file: &Path, violations: &mut Vec<String>) {
    let summary = &outcome.summary;
    let mut wrong = |what: String| violations.push(what);
    if outcome.kernel.code != 0 {
        wrong(format!("the session gave up: {}", outcome.kernel.reason.clone().unwrap_or_default()));
    }
    if summary.force_newtons_max > FORCE_MAX * (1.0 + 1e-9) {
        wrong(format!("{} N at a driver", summary.force_newtons_max));
    }
    for fault in &outcome.kernel.faults {
        let (Some(injected), None) = (fault.injected, fault.resumed) else { continue };
        // A device that is no longer read, or a fault cut off by the end, has no detection time.
        let left = outcome.kernel.sim.since(fault.healed.unwrap_or(injected));
        let told = fault.detected.is_some() || fault.restarted.is_some();
        if told && left > SimTime::from_millis(1_500) && !is_held(outcome, &fault.target) {
            wrong(format!("'{}' was not overcome and nobody says so", fault.id));
        }
    }
    // An exercise that ended without being completed names its errors.
    let over = outcome.kernel.snapshot.iter::<TaskState>().any(|(_, task)| task.over);
    let excused = !summary.task.errors.is_empty() || summary.task.seconds >= 299.0;
    if over && !summary.task.completed && !excused {
        wrong("the exercise failed and does not say why".to_owned());
    }
    match replayed(app, file) {
        Ok((hash, complete)) => {
            if complete != summary.recording_complete {
                wrong(format!("the recording says complete = {complete}, the session otherwise"));
            }
            if complete && Some(hash) != summary.state_hash {
                wrong("the recording replays to another state: a published batch is lost".to_owned());
            }
        }
        Err(error) => wrong(format!("the recording: {error}")),
    }
}

fn is_held(outcome: &RunOutcome, target: &str) -> bool {
    outcome.kernel.held.iter().any(|(name, _)| name == target)
}

fn replayed(app: &App, file: &Path) -> Result<(String, bool), String> {
    let recording = Recording::open(file).map_err(|error| error.to_string())?;
    let mut replay = Replay::new(&recording, app.registry()).map_err(|error| error.to_string())?;
    let hash = replay.run_to_end().map_err(|error| error.to_string())?;
    Ok((hash.to_string(), recording.is_complete()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn plans_are_decided_by_their_seed_and_fit_their_scenario() {
        let app = App::new();
        let scenario = app.scenario("peg-transfer").unwrap();
        let mut kinds = std::collections::BTreeSet::new();
        for seed in 0..300 {
            let plan = random_plan(&scenario, seed);
            assert_eq!(plan, random_plan(&scenario, seed));
            assert!((1..=FAULTS_MAX as usize).contains(&plan.faults.len()));
            kinds.extend(plan.faults.iter().map(|fault| fault.kind));
        }
        // All fault kinds.
        let expected = [
            FaultKind::Kill,
            FaultKind::Stall,
            FaultKind::Slow,
            FaultKind::Unplug,
            FaultKind::Drop,
            FaultKind::Delay,
            FaultKind::Duplicate,
            FaultKind::Reorder,
            FaultKind::Corrupt,
            FaultKind::Partition,
            FaultKind::RateLimit,
            FaultKind::QueueFull,
            FaultKind::Nan,
            FaultKind::DiskFull,
            FaultKind::DiskSlow,
        ];
        assert!(kinds.iter().eq(&expected), "{kinds:?}");
    }
}

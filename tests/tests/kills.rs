//! Kills every kind of actor once in the middle of the exercise, including the Model and the recorder, in a random
//! order at random times: the exercise is completed, and its recording is complete.
//!
//! The seed is printed; `TROCAR_KILL_SEED` sets it.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;

use trocar::run::{RunOptions, RunOutcome};
use trocar_kernel::faults::{FaultPlan, secs};
use trocar_kernel::recorder::{RecorderOptions, Recording, Replay};
use trocar_kernel::runtime::ticker;
use trocar_scene::SimTime;
use trocar_scene::random::SplitMix64;
use trocar_test_support::alone;
use trocar_tests::{app, finish, lockstep, peg_transfer};

/// Default seed of the victims and times.
const SEED: u64 = 7;
/// Every kind of actor; one member of each is chosen.
const KINDS: [&[&str]; 7] = [
    &["haptics.left", "haptics.right"],
    &["engine"],
    &["task"],
    &["autopilot"],
    &["device.left", "device.right"],
    &["model"],
    &["recorder"],
];
/// Period of the kills \[s\]: from the first reach to a time before which no exercise is over.
const FIRST: f64 = 1.0;
const LAST: f64 = 55.0;

fn seed() -> u64 {
    match std::env::var("TROCAR_KILL_SEED") {
        Ok(text) => text.parse().expect("TROCAR_KILL_SEED is a whole number"),
        Err(_) => SEED,
    }
}

/// One kill of each kind, at random times.
fn plan(seed: u64) -> FaultPlan {
    let mut random = SplitMix64::new(seed);
    let mut plan = FaultPlan::new(seed);
    for members in KINDS {
        let victim = members[random.next_u64() as usize % members.len()];
        plan = plan.at(secs(FIRST + random.unit() * (LAST - FIRST))).kill(victim);
    }
    plan
}

/// Runs the exercise under the plan and checks every guarantee except its completion.
fn play(options: RunOptions) -> RunOutcome {
    let seed = seed();
    let plan = plan(seed);
    let described: Vec<&str> = plan.faults.iter().map(|fault| fault.id.as_str()).collect();
    println!("TROCAR_KILL_SEED={seed}: {}", described.join(", "));
    let folder = tempfile::tempdir().expect("a folder for temporary files");
    let file = folder.path().join("killed.mcap");
    let app = app();
    let options = RunOptions {
        faults: Some(plan.clone()),
        record: Some(file.clone()),
        recorder: RecorderOptions::exact(),
        ..options
    };
    let outcome = finish(&app, &peg_transfer(&app, &[]), &options);
    let summary = &outcome.summary;
    if summary.error.is_some() || summary.task.cut_off {
        return outcome;
    }
    for fault in &summary.faults {
        assert!(fault.injected_secs.is_some() && fault.resumed_secs.is_some(), "{fault:?}");
    }
    for fault in plan.faults.iter().filter(|fault| !fault.target.starts_with("device.")) {
        let restarts = match fault.target.as_str() {
            "model" => outcome.kernel.model.restarts,
            name => summary.controllers.iter().find(|row| row.name == name).expect("its row").restarts,
        };
        assert!(restarts >= 1, "{} was not restarted", fault.target);
    }
    assert!(summary.force_newtons_max <= 3.3 + 1e-9, "{} N", summary.force_newtons_max);

    assert!(summary.recording_complete, "{:?}", outcome.kernel.incidents);
    let recording = Recording::open(&file).expect("a readable recording");
    assert!(recording.is_complete());
    let mut replay = Replay::new(&recording, app.registry()).expect("a first keyframe");
    let replayed = replay.run_to_end().expect("every commit applies");
    assert_eq!(Some(replayed.to_string()), summary.state_hash);
    outcome
}

fn told(outcome: &RunOutcome) -> String {
    let summary = &outcome.summary;
    format!(
        "{:?}\n{:?}\n{:?}\n{:?}\n{:?}",
        summary.task, summary.faults, summary.error, outcome.kernel.incidents, summary.controllers
    )
}

/// Measures beside a live session whether the machine is overloaded: a bare loop with the period of the physics.
struct Floor {
    over: Arc<AtomicBool>,
    missed: JoinHandle<(u64, u64)>,
}

/// Period of the physics in the exercise, and how long the loop runs between two checks whether the session is over.
const PERIOD: SimTime = SimTime::from_millis(2);
const SPAN: SimTime = SimTime::from_millis(200);

impl Floor {
    fn begin() -> Self {
        let over = Arc::new(AtomicBool::new(false));
        let seen = Arc::clone(&over);
        let missed = std::thread::spawn(move || {
            let (mut missed, mut scheduled) = (0, 0);
            while !seen.load(Ordering::Relaxed) {
                missed += ticker::bare_loop(PERIOD, SPAN, |_| scheduled += 1).expect("a timer");
            }
            (missed, scheduled + missed)
        });
        Self { over, missed }
    }

    /// Share of missed ticks of the loop.
    fn end(self) -> f64 {
        self.over.store(true, Ordering::Relaxed);
        let (missed, scheduled) = self.missed.join().expect("a loop does not panic");
        missed as f64 / scheduled.max(1) as f64
    }
}

/// Share of missed ticks above which the machine counts as overloaded: a lost grip then says nothing about the program.
const STARVED: f64 = 0.1;

#[test]
fn every_kind_of_actor_is_killed_once_in_lockstep_and_the_exercise_completes() {
    let _alone = alone();
    let outcome = play(lockstep(3));
    assert!(outcome.summary.task.completed, "{}", told(&outcome));
}

/// With enough processor time the exercise completes. Only the bare loop, which is independent of the program, can
/// excuse a failure as overload, and only a limited number of times.
#[test]
fn every_kind_of_actor_is_killed_once_live_and_the_exercise_completes() {
    let _alone = alone();
    let mut starved = Vec::new();
    for _ in 0..3 {
        let floor = Floor::begin();
        let outcome = play(RunOptions { seed: 3, ..RunOptions::default() });
        let missed = floor.end();
        if outcome.summary.task.completed {
            return;
        }
        assert!(missed > STARVED, "a bare loop missed {missed} of its ticks: {}", told(&outcome));
        starved.push((missed, outcome.summary.task));
    }
    panic!("starved three times: {starved:?}");
}

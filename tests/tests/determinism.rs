//! Determinism of lock-step: equal inputs give equal bits, and any difference in the inputs gives different bits.

use std::sync::atomic::{AtomicBool, Ordering};

use trocar::run::RunOptions;
use trocar_kernel::faults::{FaultPlan, secs};
use trocar_kernel::recorder::{RecorderOptions, Recording, Replay};
use trocar_tests::{app, finish, lockstep, peg_transfer};

fn hash_of(options: &RunOptions, replacements: &[(&str, &str)]) -> String {
    let app = app();
    finish(&app, &peg_transfer(&app, replacements), options).summary.state_hash.expect("a hash")
}

fn short(seed: u64) -> RunOptions {
    RunOptions { seconds: Some(8.0), ..lockstep(seed) }
}

#[test]
fn one_seed_gives_one_hash_also_under_load_and_another_seed_another() {
    let alone = hash_of(&short(11), &[]);
    let stop = AtomicBool::new(false);
    let loaded = std::thread::scope(|scope| {
        for _ in 0..4 {
            scope.spawn(|| {
                let mut x = 1_u64;
                while !stop.load(Ordering::Relaxed) {
                    x = std::hint::black_box(x.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1));
                }
            });
        }
        let hash = hash_of(&short(11), &[]);
        stop.store(true, Ordering::Relaxed);
        hash
    });
    assert_eq!(alone, loaded);
    assert_ne!(alone, hash_of(&short(12), &[]));
}

#[test]
fn other_physics_gives_another_hash() {
    assert_ne!(hash_of(&short(11), &[]), hash_of(&short(11), &[("mass = 0.005", "mass = 0.0051")]));
}

#[test]
fn a_replay_of_the_batches_and_a_rerun_of_the_recorded_hands_end_in_the_same_hash() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("run.mcap");
    let app = app();
    // As it is usually kept: hands are exact all the same.
    let options = RunOptions { record: Some(file.clone()), ..short(21) };
    let recorded = finish(&app, &peg_transfer(&app, &[]), &options);
    assert!(recorded.summary.recording_complete);
    let hash = recorded.summary.state_hash.expect("a hash");

    let recording = Recording::open(&file).expect("a readable recording");
    let mut replay = Replay::new(&recording, app.registry()).expect("a first keyframe");
    let replayed = replay.run_to_end().expect("every commit applies");
    let end = recording.end().expect("closed");
    assert_eq!(end.state_hash, hash, "the session's hash is in the file");
    assert_eq!(replayed.to_string(), end.hash, "replaying what is stored");
    let exact = folder.path().join("exact.mcap");
    let recorder = RecorderOptions::exact();
    finish(
        &app,
        &peg_transfer(&app, &[]),
        &RunOptions { record: Some(exact.clone()), recorder, ..short(21) },
    );
    let recording = Recording::open(&exact).expect("a readable recording");
    let mut replay = Replay::new(&recording, app.registry()).expect("a first keyframe");
    let replayed = replay.run_to_end().expect("every commit applies");
    assert_eq!(replayed.to_string(), hash, "replaying every batch");

    let hands = ["left", "right"].map(|hand| (hand.to_owned(), format!("recording:{}", file.display())));
    let rerun = RunOptions { hands: hands.to_vec(), ..short(21) };
    assert_eq!(hash_of(&rerun, &[]), hash, "simulating the recorded hands again");
    let other = hash_of(&rerun, &[("jaw_force_max = 1.0", "jaw_force_max = 1.1")]);
    assert_ne!(other, hash, "with other physics");
}

#[test]
fn recording_changes_nothing_whatever_becomes_of_the_recorder() {
    let folder = tempfile::tempdir().expect("a folder");
    let alone = hash_of(&short(11), &[]);
    let plain = FaultPlan::new(1);
    let killed = FaultPlan::new(1).at(secs(1.2)).kill("recorder").at(secs(5.01)).kill("recorder");
    let stalled = FaultPlan::new(1).at(secs(3.0)).stall("recorder");
    let full = FaultPlan::new(1).at(secs(2.0)).lasting(secs(3.0)).disk_full();
    for (name, plan) in [("plain", plain), ("killed", killed), ("stalled", stalled), ("full", full)] {
        let options = RunOptions { record: Some(folder.path().join(name)), faults: Some(plan), ..short(11) };
        assert_eq!(hash_of(&options, &[]), alone, "{name}");
    }
}

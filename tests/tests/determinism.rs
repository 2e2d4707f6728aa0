//! Determinism of lock-step: equal inputs give equal bits, and any difference in the inputs gives different bits.

use std::sync::atomic::{AtomicBool, Ordering};

use trocar::app::SCENARIOS;
use trocar::run::{RunOptions, run};
use trocar_kernel::faults::{FaultPlan, secs};
use trocar_kernel::recorder::{Item, RecorderOptions, Recording, Replay};
use trocar_scene::{Leaves, RecordPolicy, Snapshot};
use trocar_test_support::thorough;
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

/// Scenes with every kind of body, in a few seconds.
const FEW: [&str; 4] = ["peg-transfer", "cloth-cut", "bleeding", "needle-tissue"];

/// Holds every row of a scene against that of a replay: exact ones to the last bit, sampled ones within the tolerance.
fn same_scene(name: &str, session: &Snapshot, replayed: &Snapshot) {
    let (mut one, mut other) = (Leaves::default(), Leaves::default());
    for (id, entry) in session.registry().iter() {
        let tolerance = match entry.record {
            RecordPolicy::Exact => 0.0,
            RecordPolicy::Sampled(sampling) => sampling.tolerance,
            RecordPolicy::Derived => continue,
        };
        let (column, found) = (session.erased_column(id), replayed.erased_column(id));
        assert_eq!(column.len(), found.len(), "{name}: rows of {}", entry.name);
        column.for_each_entity(&mut |entity| {
            let what = || format!("{name}: {} of {}", entry.name, session.name(entity));
            assert!(column.leaves(entity, &mut one).expect("it can be recorded"));
            assert!(found.leaves(entity, &mut other).expect("it was read"), "{}", what());
            assert_eq!((&one.shape, &one.text), (&other.shape, &other.text), "{}", what());
            let kinds = one.shape.iter().filter(|run| run.kind.is_leaf());
            let kinds = kinds.flat_map(|run| std::iter::repeat_n(run.kind, run.count as usize));
            for (kind, (a, b)) in kinds.zip(one.bits.iter().zip(&other.bits)) {
                let off = (f64::from_bits(*a) - f64::from_bits(*b)).abs();
                let is_near = kind.is_float() && tolerance > 0.0 && off <= tolerance;
                assert!(a == b || is_near, "{}: {a:x} became {b:x}", what());
            }
        });
    }
    assert!(session.entities().eq(replayed.entities()), "{name}: entities");
    let events = |scene: &Snapshot| {
        scene.events().since(0).map(|(number, event)| format!("{number} {event:?}")).collect::<Vec<_>>()
    };
    assert_eq!(events(session), events(replayed), "{name}: events");
}

#[test]
fn a_replay_ends_in_the_scene_of_the_session() {
    let folder = tempfile::tempdir().expect("a folder");
    let app = app();
    for (name, _) in SCENARIOS.iter().filter(|(name, _)| thorough() || FEW.contains(name)) {
        let file = folder.path().join(format!("{name}.mcap"));
        let options = RunOptions {
            lockstep: true,
            seconds: Some(if thorough() { 12.0 } else { 2.0 }),
            record: Some(file.clone()),
            ..RunOptions::default()
        };
        let scenario = app.scenario(name).expect("it is shipped");
        let outcome = run(&app, &scenario, &options, &mut |_| {}).expect("it runs");
        assert!(outcome.summary.recording_complete, "{name}");
        let recording = Recording::open(&file).expect("opens");
        let mut replay = Replay::new(&recording, app.registry()).expect("has a keyframe");
        let hash = replay.run_to_end().unwrap_or_else(|error| panic!("{name}: {error}"));
        let end = recording.end().expect("closed");
        assert_eq!(hash.to_string(), end.hash, "{name}");
        assert_eq!(Some(&end.state_hash), outcome.summary.state_hash.as_ref(), "{name}");
        same_scene(name, &outcome.kernel.snapshot, replay.view());
        // Every keyframe loads, and the scene behind it can be looked at without what lies before.
        let mut keyframes = 0;
        for item in recording.items() {
            if let Item::Keyframe(keyframe) = item.expect("whole") {
                keyframe.load(app.registry()).unwrap_or_else(|error| panic!("{name}: {error}"));
                keyframes += 1;
            }
        }
        assert!(keyframes >= if thorough() && outcome.summary.sim_secs > 10.5 { 2 } else { 1 }, "{name}");
    }
}

//! Recordings of real scenes: what a replay ends in is the scene of the session.

use trocar::app::{App, SCENARIOS};
use trocar::run::{RunOptions, run};
use trocar_kernel::recorder::{Item, Recording, Replay};
use trocar_scene::{Leaves, RecordPolicy, Snapshot};
use trocar_test_support::thorough;

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
    let app = App::new();
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

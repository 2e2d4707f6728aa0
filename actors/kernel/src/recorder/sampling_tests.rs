//! What a recording keeps: exact components to the last bit, samples within their tolerance, and in its keyframes the
//! scene to which what it keeps leads.

use proptest::prelude::*;
use trocar_scene::random::SplitMix64;
use trocar_scene::{
    Access, Commands, Component, Controller, ControllerError, Entity, EntityAllocator, EntitySet, Name, Pose,
    Puts, RecordPolicy, SimTime, Snapshot, Store, Tick,
};

use super::tests::{Folder, head, registry, scene};
use super::{Item, Recorder, RecorderOptions, Recording, Replay};
use crate::faults::{FaultPlan, secs};
use crate::lockstep::LockstepSession;
use crate::spec::{ControllerSpec, RECORDER, SessionOutcome, SessionSpec};
use crate::state_hash::CommitKind;
use crate::supervision::RuntimeClass;
use crate::testing::{Count, Pairs};

/// Does everything that a writer can do, at random.
struct Chaos {
    random: SplitMix64,
    own: Vec<Entity>,
}

impl Controller for Chaos {
    fn access(&self) -> Access {
        Access::new()
            .writes::<Count>(EntitySet::Own)
            .writes::<Pose>(EntitySet::Own)
            .writes::<Name>(EntitySet::Own)
            .contributes::<Pairs>()
            .spawns()
    }
    fn tick(&mut self, tick: &Tick<'_>, _: &Snapshot, out: &mut Commands) -> Result<(), ControllerError> {
        let random = &mut self.random;
        let pose = |random: &mut SplitMix64| {
            let mut x = || 10.0 * random.unit() - 5.0;
            Pose::at(x(), x(), x())
        };
        if random.below(40) == 0 {
            let entity = out.spawn();
            out.put(entity, pose(random));
            out.put(entity, Name(format!("one of {}", tick.number)));
            self.own.push(entity);
        }
        for entity in self.own.clone() {
            match random.below(30) {
                0 => out.remove::<Pose>(entity),
                1 => out.put(entity, pose(random)),
                // Moves by less than the tolerance: nothing new to store.
                2 => out.put(entity, Pose::at(1.0 + 1e-9 * random.unit(), 2.0, 3.0)),
                3 | 4 => {
                    out.put(entity, Count(random.next_u64()));
                }
                5 => out.event("seen", entity, None, random.unit()),
                _ => {}
            }
        }
        if self.own.len() > 4 && random.below(50) == 0 {
            let gone = self.own.remove(random.below(self.own.len() as u64) as usize);
            out.despawn(gone);
        }
        if random.below(3) == 0 {
            out.contribute(Pairs((0..random.below(6) as u32).collect()));
        }
        Ok(())
    }
}

fn recorded(seed: u64, options: RecorderOptions, plan: FaultPlan) -> (Recording, SessionOutcome, Folder) {
    let folder = Folder::new();
    let file = folder.file("a.mcap");
    let scene = scene();
    let recorder = Recorder::create(&file, &head(), scene.view(), options).expect("writable");
    let chaos = ControllerSpec::new("chaos", 1, RuntimeClass::Simulation, 500.0, move |_| {
        Ok(Box::new(Chaos { random: SplitMix64::new(seed), own: Vec::new() }))
    });
    let mut spec = SessionSpec::new("toy", seed, scene, vec![chaos]);
    recorder.install(&mut spec);
    spec.faults = plan;
    let mut session = LockstepSession::new(spec).expect("starts");
    session.step_until(secs(3.0));
    let outcome = session.finish();
    (Recording::open(&file).expect("opens"), outcome, folder)
}

fn options(exact: bool) -> RecorderOptions {
    RecorderOptions { exact, keyframe_period: secs(0.7), ..RecorderOptions::default() }
}

/// The rows of a scene as JSON, by component and entity; events and entities as well.
fn rows(scene: &Snapshot) -> Vec<(String, Entity, String)> {
    let mut rows = Vec::new();
    for (id, entry) in scene.registry().iter() {
        let column = scene.erased_column(id);
        column.for_each_entity(&mut |entity| {
            let json = column.row_json(entity).expect("it is there");
            rows.push((entry.name.to_owned(), entity, json.to_string()));
        });
    }
    rows.extend(scene.entities().map(|entity| ("entity".to_owned(), entity, String::new())));
    let events = scene.events().since(0);
    rows.extend(
        events.map(|(number, event)| ("event".to_owned(), event.subject, format!("{number} {event:?}"))),
    );
    rows
}

/// Plays a recording by hand and holds every keyframe against the scene that the commits before it lead to.
fn keyframes_are_what_the_commits_lead_to(recording: &Recording) -> usize {
    let registry = registry();
    let (mut store, mut seen): (Option<Store>, usize) = (None, 0);
    let mut commands = Commands::new(registry.clone(), EntityAllocator::new(0, 0));
    for item in recording.items() {
        match (item.expect("whole"), &mut store) {
            (Item::Keyframe(keyframe), store) => {
                let loaded = keyframe.load(&registry).expect("sound");
                if let Some(store) = store {
                    assert_eq!(rows(store.view()), rows(loaded.view()), "at {}", keyframe.time);
                    seen += 1;
                }
                *store = Some(loaded);
            }
            (Item::Commits(group), Some(store)) => {
                for commit in group.commits() {
                    commands.clear();
                    commands.decode(commit.payload).expect("sound");
                    commands.seal();
                    store.apply_as(&mut commands, commit.provenance.time, commit.revision);
                }
            }
            (item, _) => panic!("{item:?}"),
        }
    }
    seen
}

/// What was put of an exact component (time, entity, value), and how many samples there are.
fn puts_of_counts(recording: &Recording) -> (Vec<(SimTime, Entity, u64)>, usize) {
    let mut commands = Commands::new(registry(), EntityAllocator::new(0, 0));
    let (mut found, mut samples) = (Vec::new(), 0);
    for item in recording.items() {
        let Item::Commits(group) = item.expect("whole") else { continue };
        for commit in group.commits() {
            samples += usize::from(commit.kind == CommitKind::Sample);
            commands.clear();
            commands.decode(commit.payload).expect("sound");
            for (_, puts) in commands.puts() {
                let Some(puts) = puts.as_any().downcast_ref::<Puts<Count>>() else { continue };
                let time = commit.provenance.time;
                found.extend(puts.rows().iter().map(|(entity, count)| (time, *entity, count.0)));
            }
        }
    }
    (found, samples)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(12))]
    #[test]
    fn exact_rows_come_back_to_the_last_bit_and_sampled_ones_within_their_tolerance(seed in any::<u64>()) {
        let (recording, outcome, _folder) = recorded(seed, options(false), FaultPlan::new(1));
        prop_assert!(recording.is_complete());
        prop_assert!(keyframes_are_what_the_commits_lead_to(&recording) >= 3);
        // Every put of an exact component, in order, as in the log of the same session.
        let (exact, log, _folder) = recorded(seed, options(true), FaultPlan::new(1));
        prop_assert_eq!(log.hash, outcome.hash);
        let (found, samples) = puts_of_counts(&recording);
        let (expected, _) = puts_of_counts(&exact);
        prop_assert!(found.len() > 100 && found == expected, "{} puts of {}", found.len(), expected.len());
        // 60 Hz, and not every change.
        prop_assert!((100..=200).contains(&samples), "{} samples", samples);
        // The last scene.
        let mut replay = Replay::new(&recording, &registry()).expect("has a keyframe");
        replay.run_to_end().expect("its own hash");
        let (view, last) = (replay.view(), &outcome.snapshot);
        let RecordPolicy::Sampled(sampling) = Pose::RECORD else { panic!("poses are sampled") };
        prop_assert_eq!(view.iter::<Pose>().count(), last.iter::<Pose>().count());
        for (entity, pose) in last.iter::<Pose>() {
            let found = view.get::<Pose>(entity).expect("stored");
            let off = (found.translation - pose.translation).amax();
            prop_assert!(off <= sampling.tolerance, "{} m", off);
        }
        let others = |scene: &Snapshot| {
            let mut rows = rows(scene);
            rows.retain(|(name, ..)| name != Pose::NAME);
            rows
        };
        prop_assert_eq!(others(view), others(last));
    }

    #[test]
    fn a_recorder_that_is_killed_keeps_the_same_rows(seed in any::<u64>(), at in 0.05..2.9_f64) {
        let plan = FaultPlan::new(1).at(secs(at)).kill(RECORDER);
        let (recording, _, _folder) = recorded(seed, options(false), plan);
        prop_assert!(recording.is_complete());
        prop_assert!(keyframes_are_what_the_commits_lead_to(&recording) >= 3);
        let mut replay = Replay::new(&recording, &registry()).expect("has a keyframe");
        prop_assert_eq!(replay.run_to_end().expect("agrees").to_string(), recording.end().unwrap().hash.clone());
    }

    #[test]
    fn an_exact_recording_is_the_log_of_the_session(seed in any::<u64>()) {
        let (recording, outcome, _folder) = recorded(seed, options(true), FaultPlan::new(1));
        prop_assert!(keyframes_are_what_the_commits_lead_to(&recording) >= 3);
        let mut replay = Replay::new(&recording, &registry()).expect("has a keyframe");
        prop_assert_eq!(replay.run_to_end().expect("agrees"), outcome.hash);
        prop_assert_eq!(rows(replay.view()), rows(&outcome.snapshot));
        prop_assert_eq!(&recording.end().unwrap().state_hash, &recording.end().unwrap().hash);
    }
}

#[test]
fn the_file_says_how_each_component_is_kept_and_what_was_committed() {
    let (recording, _, _folder) = recorded(3, options(false), FaultPlan::new(1));
    let components = &recording.metadata().components;
    assert!(components["pose"].ends_with("sampled 60 Hz ±2.5e-7"), "{}", components["pose"]);
    assert!(components["test_count"].ends_with("exact"));
    let found = recording.statistics().expect("whole");
    let pose = found.components.iter().find(|component| component.name == "pose").expect("it was put");
    assert!(pose.committed.expect("told").count > pose.blocks.count && pose.keyframes.count > 0);
    let parts: u64 = found.topics.values().map(|bytes| bytes.bytes).sum();
    assert_eq!(parts + found.framing, found.file);
    assert!(found.committed > Some(found.writers["chaos"].bytes - 1), "{found:?}");
    let (exact, _, _folder) = recorded(3, options(true), FaultPlan::new(1));
    assert!(exact.metadata().components["pose"].ends_with("exact"));
}

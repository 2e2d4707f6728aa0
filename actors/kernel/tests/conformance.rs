//! The two drivers agree: what a live session took in, in the order in which it was applied, gives the same
//! revisions and the same hash in a fresh Model that is driven in lock-step.

use std::sync::atomic::Ordering;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use crate::support::toys::{count, eventually, let_go, registry, session, toy};
use trocar_kernel::faults::{FaultPlan, secs};
use trocar_kernel::live::LiveSession;
use trocar_kernel::recorder::{Recorder, RecorderOptions, Recording, RecordingHead, Replay};
use trocar_kernel::spec::{CommitSink, SessionOutcome, SessionSpec};
use trocar_kernel::{CommitBuffer, CommitKind, LockstepSession, ModelCore, Outcome, StateHash};
use trocar_scene::{
    Batch, Commands, Entity, EntityAllocator, Provenance, Revision, SimTime, Snapshot, Store,
};
use trocar_test_support::alone;

/// One applied batch or fence as the Model committed it.
struct Entry {
    kind: CommitKind,
    revision: Revision,
    provenance: Provenance,
    hash: StateHash,
    payload: Vec<u8>,
}

/// Keeps the intake log.
#[derive(Clone, Default)]
struct Log(Arc<Mutex<Vec<Entry>>>);

impl CommitSink for Log {
    fn committed(&mut self, _: &Arc<Snapshot>, mut commits: CommitBuffer) -> CommitBuffer {
        let mut log = self.0.lock().expect("not poisoned");
        log.extend(commits.iter().map(|commit| Entry {
            kind: commit.kind,
            revision: commit.revision,
            provenance: commit.provenance,
            hash: commit.hash,
            payload: commit.payload.to_vec(),
        }));
        commits.clear();
        commits
    }
    fn close(&mut self, _: Duration) -> bool {
        true
    }
}

fn two_toys() -> SessionSpec {
    let mut spec = session(vec![toy("fast", 1, 1_000.0).0, toy("slow", 2, 100.0).0]);
    spec.faults = FaultPlan::new(1)
        .at(secs(0.15))
        .kill("fast")
        .at(secs(0.25))
        .kill("model")
        .at(secs(0.35))
        .lasting(secs(0.05))
        .nan("slow");
    spec
}

fn run_live(spec: SessionSpec) -> SessionOutcome {
    let session = LiveSession::start(spec).expect("starts");
    assert!(!session.wait(Duration::from_millis(600)), "nothing ends it");
    session.stop(0)
}

#[test]
fn a_live_log_gives_the_same_revisions_and_hash_in_lock_step() {
    let _alone = alone();
    let log = Log::default();
    let mut spec = two_toys();
    spec.commit_sink = Some(Box::new(log.clone()));
    let outcome = run_live(spec);

    let mut core = ModelCore::new(Store::new(registry()), 0).expect("encodes");
    for controller in two_toys().controllers {
        let empty = Store::new(registry()).snapshot();
        let context = trocar_scene::BuildContext {
            scene: &empty,
            time: SimTime::ZERO,
            period: controller.period(),
            name: &controller.name,
            me: Entity::of_writer(0, controller.writer),
            epoch: 1,
            seed: 1,
        };
        let access = (controller.factory)(&context).expect("builds").access();
        core.declare(&controller.name, trocar_scene::WriterId(controller.writer), &access).expect("fits");
    }
    let log = log.0.lock().expect("not poisoned");
    for entry in log.iter() {
        let Provenance { writer, epoch, time, .. } = entry.provenance;
        if entry.kind == CommitKind::Fence {
            assert!(core.fence(writer, epoch, time));
        } else {
            let mut commands =
                Commands::new(core.view().registry().clone(), EntityAllocator::new(0, writer.0));
            assert!(commands.decode(&entry.payload).expect("own bytes").is_empty());
            commands.seal();
            let mut batch = Batch { provenance: entry.provenance, commands };
            let applied = core.apply(&mut batch, time);
            assert_eq!(applied, Outcome::Applied { revision: entry.revision });
        }
        assert_eq!((core.view().revision(), core.hash()), (entry.revision, entry.hash));
    }
    assert_eq!(core.hash(), outcome.hash);
    assert_eq!(core.view().revision(), outcome.snapshot.revision());
    assert!(log.len() > 300, "both ticked: {}", log.len());
    assert_eq!(log.iter().filter(|entry| entry.kind == CommitKind::Fence).count(), 1, "one life ended");
    for id in [1, 2] {
        assert_eq!(count(core.view(), id), count(&outcome.snapshot, id));
    }
}

#[test]
fn a_live_recording_replays_to_the_hash_of_the_session() {
    let _alone = alone();
    let folder = tempfile::tempdir().expect("a folder for temporary files");
    let file = folder.path().join("live.mcap");
    let mut spec = two_toys();
    let head = RecordingHead { scenario: "toys".into(), mode: "live".into(), ..RecordingHead::default() };
    let recorder = Recorder::create(&file, &head, spec.scene.view(), RecorderOptions::exact());
    recorder.expect("begins").install(&mut spec);
    let outcome = run_live(spec);
    assert_eq!(outcome.recording_complete, Some(true));
    let recording = Recording::open(&file).expect("opens");
    assert!(recording.is_complete());
    let mut replay = Replay::new(&recording, &registry()).expect("has a keyframe");
    assert_eq!(replay.run_to_end().expect("agrees"), outcome.hash);
    assert_eq!(count(replay.view(), 1), count(&outcome.snapshot, 1));
}

#[test]
fn the_same_session_description_runs_in_both_drivers() {
    let _alone = alone();
    let live = run_live(two_toys());
    let mut session = LockstepSession::new(two_toys()).expect("starts");
    session.step_until(secs(0.6));
    let lockstep = session.finish();
    for outcome in [&live, &lockstep] {
        assert_eq!(outcome.code, 0, "{:?}", outcome.reason);
        let restarts: Vec<u32> = outcome.controllers.iter().map(|row| row.restarts).collect();
        assert_eq!(restarts, [1, 0]);
        assert_eq!(outcome.model.restarts, 1);
        assert!(outcome.controllers[1].rejected >= 1, "the batches with a NaN");
        for row in &outcome.faults {
            assert!(row.injected.is_some() && row.detected.is_some() && row.resumed.is_some(), "{row:?}");
        }
    }
}

#[test]
fn a_recording_goes_on_when_a_model_that_hangs_is_replaced() {
    let _alone = alone();
    let folder = tempfile::tempdir().expect("a folder for temporary files");
    let file = folder.path().join("live.mcap");
    let (spec, wish) = toy("fast", 1, 1_000.0);
    let mut spec = session(vec![spec]);
    let head = RecordingHead::default();
    let recorder = Recorder::create(&file, &head, spec.scene.view(), RecorderOptions::exact());
    recorder.expect("begins").install(&mut spec);
    let session = LiveSession::start(spec).expect("starts");
    eventually("it counts", || count(&session.snapshot(), 1) > 50);
    wish.trap.store(2, Ordering::Relaxed);
    eventually("the Model is replaced", || session.zombies() == 1);
    let then = count(&session.snapshot(), 1);
    eventually("it counts again", || count(&session.snapshot(), 1) > then + 50);
    let_go();
    let outcome = session.stop(0);
    let recording = Recording::open(&file).expect("opens");
    let mut replay = Replay::new(&recording, &registry()).expect("has a keyframe");
    assert_eq!(replay.run_to_end().expect("one chain from end to end"), outcome.hash);
}

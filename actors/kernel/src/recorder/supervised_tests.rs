//! Tests of the recorder's guarantees under failure and supervision, one per guarantee.

use std::cell::Cell;
use std::fs::File;
use std::io;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicU8, Ordering};
use std::time::{Duration, Instant};

use serde::{Deserialize, Serialize, Serializer};
use trocar_scene::{
    Access, Commands, Component, Controller, ControllerError, EntityAllocator, EntitySet, RecordPolicy,
    RegistryBuilder, SimTime, Snapshot, Store, Tick,
};

use super::tests::{Folder, Mover, RING, head, registry, scene};
use super::write_buffer::{Disk, WriteBuffer};
use super::{Recorder, RecorderOptions, Recording, Replay};
use crate::faults::{FaultPlan, secs};
use crate::live::LiveSession;
use crate::lockstep::LockstepSession;
use crate::spec::{ControllerSpec, FaultKind, RECORDER, SessionOutcome, SessionSpec, StopWhen};
use crate::supervision::{Cause, Health, RuntimeClass};
use crate::testing::Count;

fn mover(rate_hz: f64) -> ControllerSpec {
    ControllerSpec::new("mover", 1, RuntimeClass::Simulation, rate_hz, |_| Ok(Box::new(Mover)))
}

fn session(scene: Store, plan: FaultPlan) -> SessionSpec {
    let mut spec = SessionSpec::new("toy", 42, scene, vec![mover(1_000.0)]);
    spec.faults = plan;
    spec
}

fn installed(file: &Path, options: RecorderOptions, mut spec: SessionSpec) -> SessionSpec {
    let recorder = Recorder::create(file, &head(), spec.scene.view(), options).expect("begins");
    recorder.install(&mut spec);
    spec
}

fn record(file: &Path, until: f64, options: RecorderOptions, plan: FaultPlan) -> SessionOutcome {
    let spec = installed(file, options, session(scene(), plan));
    let mut session = LockstepSession::new(spec).expect("starts");
    session.step_until(secs(until));
    session.finish()
}

/// Every message of a file as another program reads it, by its index: topic, number, time and content.
fn messages(file: &Path) -> Vec<(String, u32, u64, Vec<u8>)> {
    let bytes = std::fs::read(file).expect("written");
    let summary = mcap::Summary::read(&bytes).expect("sound").expect("has a summary");
    let statistics = summary.stats.as_ref().expect("has statistics");
    let chunks = summary.chunk_indexes.iter();
    let indexed: Vec<_> = chunks
        .flat_map(|index| summary.stream_chunk(&bytes, index).expect("stands there"))
        .map(|message| message.expect("sound"))
        .map(|m| (m.channel.topic.clone(), m.sequence, m.log_time, m.data.into_owned()))
        .collect();
    let linear = mcap::MessageStream::new(&bytes).expect("sound").map(|message| message.expect("sound"));
    assert_eq!(
        linear.map(|m| m.sequence).collect::<Vec<_>>(),
        indexed.iter().map(|m| m.1).collect::<Vec<_>>()
    );
    assert_eq!(indexed.len() as u64, statistics.message_count);
    indexed
}

/// Replays the file to the session's hash, without a gap.
fn holds_everything(file: &Path, outcome: &SessionOutcome) {
    assert_eq!(outcome.recording_complete, Some(true), "{:?}", outcome.incidents);
    let recording = Recording::open(file).expect("opens");
    assert!(recording.is_complete() && recording.truncation().is_none());
    let mut replay = Replay::new(&recording, outcome.snapshot.registry()).expect("has a keyframe");
    assert_eq!(replay.run_to_end().expect("agrees"), outcome.hash);
    assert!(replay.gaps().is_empty());
}

fn row_of(outcome: &SessionOutcome) -> &crate::runtime::ControllerReport {
    outcome.controllers.iter().find(|row| row.name == RECORDER).expect("its row")
}

#[test]
fn a_killed_recorder_goes_on_with_the_same_file_and_loses_nothing() {
    let folder = Folder::new();
    let (whole, file) = (folder.file("whole.mcap"), folder.file("killed.mcap"));
    let bare = record(&whole, 8.0, RecorderOptions::exact(), FaultPlan::new(1));
    assert_eq!((row_of(&bare).scheduled, row_of(&bare).restarts), (400, 0));
    let expected = messages(&whole);
    for kills in [vec![3.3], vec![7.91], vec![0.0, 2.711, 7.3], vec![2.0, 2.02, 2.04, 6.5]] {
        let plan = kills.iter().fold(FaultPlan::new(1), |plan, at| plan.at(secs(*at)).kill(RECORDER));
        let outcome = record(&file, 8.0, RecorderOptions::exact(), plan);
        assert_eq!(outcome.hash, bare.hash);
        holds_everything(&file, &outcome);
        assert!(messages(&file) == expected, "message by message, killed at {kills:?}");
        assert_eq!(row_of(&outcome).restarts as usize, kills.len());
        for row in &outcome.faults {
            assert!(row.restarted.is_some() && row.recovery().expect("resumed") < secs(1.0), "{row:?}");
        }
    }
}

#[test]
fn a_recorder_that_stalls_is_left_behind_and_one_that_is_slow_is_not() {
    let folder = Folder::new();
    let (whole, file) = (folder.file("whole.mcap"), folder.file("a.mcap"));
    let bare = record(&whole, 8.0, RecorderOptions::exact(), FaultPlan::new(1));
    let stall = FaultPlan::new(1).at(secs(2.0)).lasting(secs(4.0)).stall(RECORDER);
    let slow = FaultPlan::new(1).at(secs(2.0)).lasting(secs(2.0)).slow(RECORDER, secs(0.03));
    let short = FaultPlan::new(1).at(secs(2.0)).lasting(secs(0.5)).stall(RECORDER);
    for (plan, restarts) in [(stall, 1), (slow, 0), (short, 0)] {
        let outcome = record(&file, 8.0, RecorderOptions::exact(), plan);
        assert_eq!(outcome.hash, bare.hash);
        holds_everything(&file, &outcome);
        assert!(messages(&file) == messages(&whole), "message by message");
        assert_eq!((row_of(&outcome).restarts, row_of(&outcome).rejected, outcome.zombies), (restarts, 0, 0));
        let row = &outcome.faults[0];
        assert!(row.detected.is_some() || restarts == 0, "{row:?}");
        assert!(row.resumed.is_some(), "{row:?}");
    }
}

/// A derived component whose encoding panics in the next keyframe when the thread asks for it.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize, Component)]
#[component(name = "test_brittle", record = RecordPolicy::Derived)]
struct Brittle(u8);
thread_local! {
    static BREAK: Cell<bool> = const { Cell::new(false) };
}
impl Serialize for Brittle {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        assert!(!BREAK.replace(false), "a component's own code");
        serializer.serialize_newtype_struct("Brittle", &self.0)
    }
}

#[test]
fn a_recorder_that_panics_inside_of_a_publication_declares_a_gap_with_a_keyframe_after_it() {
    let folder = Folder::new();
    let file = folder.file("a.mcap");
    let mut builder = RegistryBuilder::new();
    for (_, entry) in registry().iter() {
        assert_ne!(entry.name, Brittle::NAME);
    }
    builder.register::<Count>().expect("new").register::<Brittle>().expect("new");
    let mut scene = Store::new(builder.build());
    let mut commands = Commands::new(scene.view().registry().clone(), EntityAllocator::new(0, 0));
    commands.spawn();
    commands.put(RING, Brittle(1));
    scene.apply(&mut commands, SimTime::ZERO);
    let counter = ControllerSpec::new("counter", 1, RuntimeClass::Task, 1_000.0, |_| Ok(Box::new(Counter)));
    let spec = SessionSpec::new("toy", 42, scene, vec![counter]);
    let spec =
        installed(&file, RecorderOptions { keyframe_period: secs(5.0), ..RecorderOptions::exact() }, spec);
    let mut session = LockstepSession::new(spec).expect("starts");
    session.step_until(secs(4.5));
    // The next keyframe is due at 5 s.
    BREAK.set(true);
    session.step_until(secs(7.0));
    assert!(!BREAK.get(), "it was written");
    let outcome = session.finish();
    assert_eq!((outcome.code, row_of(&outcome).restarts), (0, 1));
    assert!(matches!(&outcome.incidents[0].cause, Cause::Panic(text) if text.contains("own code")));
    assert_eq!(outcome.recording_complete, Some(false), "it says so");
    let recording = Recording::open(&file).expect("opens");
    assert!(recording.truncation().is_none() && !recording.is_complete());
    let mut replay = Replay::new(&recording, outcome.snapshot.registry()).expect("has a keyframe");
    assert_eq!(replay.run_to_end().expect("nothing torn is in the file"), outcome.hash);
    let [gap] = replay.gaps() else { panic!("one gap: {:?}", replay.gaps()) };
    assert!(gap.reason.contains("panicked") && gap.until > gap.after, "{gap:?}");
    assert!(gap.until.0 - gap.after.0 <= 20, "one publication and the one whose keyframe ends it: {gap:?}");
    messages(&file);
}

/// Counts in the scene.
struct Counter;
impl Controller for Counter {
    fn access(&self) -> Access {
        Access::new().writes::<Count>(EntitySet::Of(vec![RING]))
    }
    fn tick(&mut self, tick: &Tick<'_>, _: &Snapshot, out: &mut Commands) -> Result<(), ControllerError> {
        out.put(RING, Count(tick.number));
        Ok(())
    }
}

#[test]
fn a_recorder_that_dies_on_a_full_disk_goes_on_when_there_is_room() {
    let folder = Folder::new();
    let file = folder.file("a.mcap");
    let small = RecorderOptions { backlog_max: 8_000, ..RecorderOptions::exact() };
    let plan = |span| {
        FaultPlan::new(1)
            .at(secs(2.0))
            .lasting(secs(span))
            .disk_full()
            .at(secs(2.4))
            .kill(RECORDER)
            .at(secs(2.0 + span - 0.1))
            .kill(RECORDER)
    };
    for (span, missing) in [(0.8, false), (4.0, true)] {
        let outcome = record(&file, 9.0, small, plan(span));
        assert_eq!(outcome.recording_complete, Some(!missing));
        for row in &outcome.faults {
            assert!(row.detected.is_some() && row.recovery().expect("resumed") < secs(1.0), "{row:?}");
        }
        let disk = outcome.faults.iter().find(|row| row.kind == FaultKind::DiskFull).expect("its row");
        assert!(disk.restarted.is_none() && disk.resumed > Some(secs(2.0 + span)), "{disk:?}");
        let recording = Recording::open(&file).expect("opens");
        let mut replay = Replay::new(&recording, &registry()).expect("has a keyframe");
        assert_eq!(replay.run_to_end().expect("agrees"), outcome.hash);
        assert_eq!(replay.gaps().len(), usize::from(missing));
        messages(&file);
    }
}

/// A disk with injectable faults.
struct Moody {
    file: File,
    mood: Arc<AtomicU8>,
}
const WELL: u8 = 0;
/// Writes half of its input once, and panics.
const PANIC: u8 = 1;
/// Blocks until its mood changes.
const HANG: u8 = 2;

impl Disk for Moody {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        if self.mood.compare_exchange(PANIC, WELL, Ordering::Relaxed, Ordering::Relaxed).is_ok() {
            io::Write::write_all(&mut self.file, &bytes[..bytes.len() / 2])?;
            panic!("in the middle of a write");
        }
        while self.mood.load(Ordering::Relaxed) == HANG {
            std::thread::sleep(Duration::from_millis(1));
        }
        io::Write::write(&mut self.file, bytes)
    }
    fn sync(&mut self) -> io::Result<()> {
        self.file.sync_data()
    }
    fn rewind(&mut self, length: u64) -> io::Result<()> {
        Disk::rewind(&mut self.file, length)
    }
}

fn moody(file: &Path, mut spec: SessionSpec) -> (SessionSpec, Arc<AtomicU8>) {
    let mood = Arc::new(AtomicU8::new(WELL));
    let disk = Moody { file: File::create(file).expect("writable"), mood: mood.clone() };
    let write_buffer = WriteBuffer::new(Box::new(disk));
    let recorder = Recorder::begin(write_buffer, &head(), spec.scene.view(), RecorderOptions::exact());
    recorder.expect("begins").install(&mut spec);
    (spec, mood)
}

#[test]
fn a_write_that_ends_in_a_panic_is_done_again() {
    let folder = Folder::new();
    let (whole, file) = (folder.file("whole.mcap"), folder.file("a.mcap"));
    let run = |file: &Path, harm: u8| {
        let (spec, mood) = moody(file, session(scene(), FaultPlan::new(1)));
        let mut session = LockstepSession::new(spec).expect("starts");
        for at in [1.7, 3.1] {
            session.step_until(secs(at));
            mood.store(harm, Ordering::Relaxed);
        }
        session.step_until(secs(6.0));
        session.finish()
    };
    run(&whole, WELL);
    let outcome = run(&file, PANIC);
    assert_eq!(row_of(&outcome).restarts, 2);
    holds_everything(&file, &outcome);
    assert!(messages(&file) == messages(&whole), "message by message");
}

#[test]
fn the_state_hash_does_not_know_whether_somebody_records() {
    // Failures with jittered pauses, a stop condition, and odd rates: any dependence on other controllers' due times or
    // failures would show.
    let faults = |plan: FaultPlan| {
        // Five in two seconds: as many as the group tolerates, with growing pauses.
        let kills = [0.5, 0.6, 0.7, 1.9, 2.3].into_iter();
        kills.fold(plan, |plan, at| plan.at(secs(at)).kill("mover")).at(secs(1.1)).kill("model")
    };
    let described = |plan: FaultPlan| {
        let mut spec = session(scene(), plan);
        spec.controllers[0] = mover(733.3);
        let odd = ControllerSpec::new("odd", 2, RuntimeClass::Task, 7.3, |_| {
            Ok(Box::new(Odd) as Box<dyn Controller>)
        });
        spec.controllers.push(odd);
        let check = |scene: &Snapshot| scene.get::<Count>(RING).is_some_and(|count| count.0 > 2_500);
        spec.stop_when = Some(StopWhen { every: SimTime::from_millis(33), check: Arc::new(check) });
        spec
    };
    let run = |spec: SessionSpec| {
        let mut session = LockstepSession::new(spec).expect("starts");
        while session.step_until(session.now() + SimTime::from_millis(170)) {}
        let outcome = session.finish();
        assert!(outcome.sim < secs(6.0), "the goal was reached at {}", outcome.sim);
        outcome
    };
    let without = run(described(faults(FaultPlan::new(1))));
    assert_eq!((without.recording_complete, without.controllers.len()), (None, 2));
    let folder = Folder::new();
    let plain = FaultPlan::new(1);
    let killed = [0.55, 0.65, 0.651, 1.05, 2.31]
        .into_iter()
        .fold(FaultPlan::new(1), |plan, at| plan.at(secs(at)).kill(RECORDER));
    let stalled = FaultPlan::new(1).at(secs(0.4)).stall(RECORDER);
    let slowed = FaultPlan::new(1).at(secs(0.4)).lasting(secs(1.0)).slow(RECORDER, secs(0.0171));
    for (name, plan) in [("plain", plain), ("killed", killed), ("stalled", stalled), ("slowed", slowed)] {
        let file = folder.file(name);
        let outcome = run(installed(&file, RecorderOptions::exact(), described(faults(plan))));
        assert_eq!(outcome.hash, without.hash, "{name}");
        assert_eq!(outcome.snapshot.revision(), without.snapshot.revision(), "{name}");
        holds_everything(&file, &outcome);
    }
}

/// Writes now and then on its own entity.
struct Odd;
impl Controller for Odd {
    fn access(&self) -> Access {
        Access::new().contributes::<Count>()
    }
    fn tick(&mut self, tick: &Tick<'_>, scene: &Snapshot, out: &mut Commands) -> Result<(), ControllerError> {
        out.contribute(Count(tick.number + scene.get::<Count>(RING).map_or(0, |count| count.0)));
        Ok(())
    }
}

#[test]
fn without_a_recording_there_is_no_recorder_to_strike() {
    let plan = FaultPlan::new(1).at(secs(1.0)).kill(RECORDER);
    let error = LockstepSession::new(session(scene(), plan.clone())).err().expect("refused").to_string();
    assert!(error.contains("unknown target 'recorder'") && error.contains("model, mover"), "{error}");
    let error = LiveSession::start(session(scene(), plan)).err().expect("refused").to_string();
    assert!(error.contains("unknown target 'recorder'"), "{error}");
}

fn eventually(why: &str, mut what: impl FnMut() -> bool) {
    let until = Instant::now() + Duration::from_secs(20);
    while !what() {
        assert!(Instant::now() < until, "{why}");
        std::thread::sleep(Duration::from_millis(2));
    }
}

#[test]
fn a_live_recorder_that_is_killed_three_times_loses_nothing() {
    let folder = Folder::new();
    let file = folder.file("a.mcap");
    let plan =
        [0.2, 0.45, 0.8].into_iter().fold(FaultPlan::new(1), |plan, at| plan.at(secs(at)).kill(RECORDER));
    let spec = installed(&file, RecorderOptions::exact(), session(scene(), plan));
    let session = LiveSession::start(spec).expect("starts");
    eventually("it is back", || session.faults().iter().filter(|row| row.resumed.is_some()).count() == 3);
    let outcome = session.stop(0);
    assert_eq!((outcome.code, row_of(&outcome).restarts, outcome.controllers[0].restarts), (0, 3, 0));
    holds_everything(&file, &outcome);
    messages(&file);
}

#[test]
fn a_live_recorder_that_stalls_is_left_behind_and_writes_no_more() {
    let folder = Folder::new();
    let file = folder.file("a.mcap");
    let plan = FaultPlan::new(1).at(secs(0.2)).lasting(secs(2.0)).stall(RECORDER);
    let spec = installed(&file, RecorderOptions::exact(), session(scene(), plan));
    let session = LiveSession::start(spec).expect("starts");
    eventually("it is replaced", || session.faults().first().is_some_and(|row| row.resumed.is_some()));
    eventually("its thread comes back and ends", || session.zombies() == 0);
    let outcome = session.stop(0);
    assert!(
        outcome.incidents.iter().any(|incident| incident.cause == Cause::Stall),
        "{:?}",
        outcome.incidents
    );
    assert_eq!(outcome.code, 0);
    holds_everything(&file, &outcome);
    messages(&file);
}

#[test]
fn a_disk_that_hangs_costs_the_recording_and_not_the_session() {
    let folder = Folder::new();
    let file = folder.file("a.mcap");
    let (spec, mood) = moody(&file, session(scene(), FaultPlan::new(1)));
    let session = LiveSession::start(spec).expect("starts");
    eventually("it records", || std::fs::metadata(&file).is_ok_and(|file| file.len() > 20_000));
    mood.store(HANG, Ordering::Relaxed);
    let waits = |cause: &Cause| matches!(cause, Cause::Error(text) if text.contains("waits for the disk"));
    eventually("it is replaced in vain", || session.incidents().iter().any(|i| waits(&i.cause)));
    assert_ne!(session.health_of(RECORDER), Some(Health::Healthy));
    let count = || session.snapshot().get::<Count>(RING).map_or(0, |count| count.0);
    let before = count();
    eventually("the others go on", || count() > before + 100);
    let begun = Instant::now();
    let outcome = session.stop(0);
    assert!(begun.elapsed() < Duration::from_secs(2), "{:?}", begun.elapsed());
    assert_eq!((outcome.code, outcome.recording_complete), (0, Some(false)));
    assert!(outcome.incidents.iter().all(|incident| incident.child == RECORDER), "{:?}", outcome.incidents);
    let recording = Recording::open(&file).expect("what was written before can be read");
    assert!(recording.truncation().is_some() && !recording.is_complete());
    mood.store(WELL, Ordering::Relaxed);
}

#[test]
fn a_disk_that_hung_for_a_while_costs_nothing() {
    let folder = Folder::new();
    let file = folder.file("a.mcap");
    let (spec, mood) = moody(&file, session(scene(), FaultPlan::new(1)));
    let session = LiveSession::start(spec).expect("starts");
    eventually("it records", || std::fs::metadata(&file).is_ok_and(|file| file.len() > 20_000));
    mood.store(HANG, Ordering::Relaxed);
    eventually("it is left behind", || session.zombies() == 1);
    mood.store(WELL, Ordering::Relaxed);
    eventually("it is back", || {
        session.incidents().last().is_some_and(|incident| incident.resumed.is_some())
    });
    let outcome = session.stop(0);
    holds_everything(&file, &outcome);
    messages(&file);
}

#[test]
fn the_recorder_is_closed_within_the_limit_whatever_the_disk_does() {
    let folder = Folder::new();
    let file = folder.file("a.mcap");
    let (spec, mood) = moody(&file, session(scene(), FaultPlan::new(1)));
    let session = LiveSession::start(spec).expect("starts");
    eventually("it counts", || session.snapshot().get::<Count>(RING).is_some_and(|count| count.0 > 50));
    mood.store(HANG, Ordering::Relaxed);
    let begun = Instant::now();
    let outcome = session.stop(0);
    assert!(begun.elapsed() < Duration::from_secs(2), "{:?}", begun.elapsed());
    assert_eq!((outcome.code, outcome.recording_complete), (0, Some(false)));
    mood.store(WELL, Ordering::Relaxed);
}

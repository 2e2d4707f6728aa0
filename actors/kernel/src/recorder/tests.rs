//! Tests of the recorder's guarantees, one per guarantee.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

use proptest::prelude::*;
use trocar_scene::{
    Access, Commands, Controller, ControllerError, Entity, EntityAllocator, EntitySet, Name, Pose, Registry,
    RegistryBuilder, SimTime, Snapshot, Store, Tick,
};

use super::mcap::container::{CHECKSUM, checksum};
use super::reading::metadata::metadata_record;
use super::{Item, Recorder, RecorderOptions, Recording, RecordingError, RecordingHead, Replay};
use crate::commit::CommitBuffer;
use crate::faults::{FaultPlan, secs};
use crate::lockstep::LockstepSession;
use crate::spec::{CommitSink, ControllerSpec, SessionOutcome, SessionSpec};
use crate::supervision::RuntimeClass;
use crate::testing::{Count, Pairs, Shadow};

pub(super) const RING: Entity = Entity::new(0, 0, 1);
const STEP: SimTime = SimTime::from_millis(1);

pub(super) fn registry() -> Arc<Registry> {
    let mut builder = RegistryBuilder::new();
    trocar_scene::register_all!(&mut builder; Count, Pairs, Shadow, Name, Pose).expect("new");
    builder.build()
}

pub(super) fn scene() -> Store {
    let registry = registry();
    let mut scene = Store::new(registry.clone());
    let mut commands = Commands::new(registry, EntityAllocator::new(0, 0));
    commands.spawn();
    commands.put(RING, Name("ring".into()));
    commands.put(RING, Pose::at(0.0, 0.0, 0.0));
    scene.apply(&mut commands, SimTime::ZERO);
    scene
}

/// Moves a ring, counts, and emits an event now and then.
pub(super) struct Mover;
impl Controller for Mover {
    fn access(&self) -> Access {
        Access::new()
            .writes::<Count>(EntitySet::Of(vec![RING]))
            .writes::<Pose>(EntitySet::Of(vec![RING]))
            .contributes::<Pairs>()
            .contributes::<Shadow>()
            .spawns()
    }
    fn tick(&mut self, tick: &Tick<'_>, scene: &Snapshot, out: &mut Commands) -> Result<(), ControllerError> {
        let count = scene.get::<Count>(RING).map_or(0, |count| count.0);
        out.put(RING, Count(count + 1));
        out.put(RING, Pose::at(tick.time.as_secs_f64(), 0.0, 0.1));
        out.contribute(Pairs(vec![tick.number as u32]));
        out.contribute(Shadow(1.0));
        if tick.number % 100 == 50 {
            let entity = out.spawn();
            out.event("dropped", RING, Some(entity), 1.5);
        }
        Ok(())
    }
}

pub(crate) fn head() -> RecordingHead {
    RecordingHead {
        scenario: "toy".into(),
        scenario_text: "schema = 1\nname = \"toy\"\n".into(),
        seed: 42,
        station: 0,
        begin: SimTime::ZERO,
        mode: "lockstep".into(),
        devices: BTreeMap::from([("left".to_owned(), serde_json::json!({"force_newtons_max": 3.3}))]),
        extra: BTreeMap::new(),
    }
}

fn session(path: &Path, options: RecorderOptions, plan: FaultPlan) -> LockstepSession {
    session_from(SimTime::ZERO, path, options, plan)
}

fn session_from(begin: SimTime, path: &Path, options: RecorderOptions, plan: FaultPlan) -> LockstepSession {
    let scene = scene();
    let head = RecordingHead { begin, ..head() };
    let recorder =
        Recorder::create(path, &head, scene.view(), options).expect("the folder can be written to");
    let mover = ControllerSpec::new("mover", 1, RuntimeClass::Simulation, 1_000.0, |_| Ok(Box::new(Mover)));
    let mut spec = SessionSpec::new("toy", 42, scene, vec![mover]);
    recorder.install(&mut spec);
    spec.faults = plan;
    spec.begin = begin;
    LockstepSession::new(spec).expect("starts")
}

pub(super) fn record(path: &Path, until: f64, options: RecorderOptions, plan: FaultPlan) -> SessionOutcome {
    let mut session = session(path, options, plan);
    session.step_until(secs(until));
    session.finish()
}

pub(crate) struct Folder(tempfile::TempDir);
impl Folder {
    pub(crate) fn new() -> Self {
        Self(tempfile::tempdir().expect("a folder for temporary files"))
    }
    pub(crate) fn file(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }
}

#[test]
fn a_replay_ends_in_the_same_hash_and_scene() {
    let folder = Folder::new();
    let file = folder.file("a.mcap");
    let plan = FaultPlan::new(1).at(secs(3.3)).kill("mover");
    let outcome = record(&file, 12.0, RecorderOptions::exact(), plan);
    assert_eq!(outcome.recording_complete, Some(true));
    let recording = Recording::open(&file).expect("opens");
    assert!(recording.is_complete() && recording.truncation().is_none());
    let metadata = recording.metadata();
    assert_eq!((metadata.scenario.as_str(), metadata.seed), ("toy", 42));
    assert_eq!(metadata.scenario_text, head().scenario_text);
    assert!(metadata.devices["left"].contains("3.3"));
    assert!(metadata.components["test_shadow"].ends_with("derived"));
    let mut replay = Replay::new(&recording, &registry()).expect("has a keyframe");
    assert_eq!(replay.run_to_end().expect("agrees"), outcome.hash);
    assert_eq!(recording.end().expect("closed").hash, outcome.hash.to_string());
    assert_eq!(replay.view().get::<Count>(RING), outcome.snapshot.get::<Count>(RING));
    assert_eq!(replay.view().revision(), outcome.snapshot.revision());
    assert_eq!(replay.view().entities().count(), outcome.snapshot.entities().count());
}

#[test]
fn a_recording_begins_when_its_session_does() {
    let folder = Folder::new();
    let (file, begin) = (folder.file("a.mcap"), secs(1_234.567_8));
    let mut session = session_from(begin, &file, RecorderOptions::exact(), FaultPlan::new(1));
    session.step_until(begin + secs(12.0));
    let outcome = session.finish();
    let recording = Recording::open(&file).expect("opens");
    assert!(recording.is_complete());
    let mut replay = Replay::new(&recording, &registry()).expect("has a keyframe");
    assert_eq!(replay.time(), begin, "that of the first keyframe");
    assert_eq!(replay.run_to_end().expect("agrees"), outcome.hash);
    let start = recording.snapshot_at(&registry(), begin).expect("is in it");
    assert_eq!(start.get::<Count>(RING), scene().view().get::<Count>(RING));
    let keyframes = recording.items().filter(|item| matches!(item, Ok(Item::Keyframe(_))));
    assert_eq!(keyframes.count(), 2, "one for each begun ten seconds");
}

#[test]
fn any_moment_can_be_looked_at_without_playing_from_the_start() {
    let folder = Folder::new();
    let file = folder.file("a.mcap");
    record(&file, 13.0, RecorderOptions::exact(), FaultPlan::new(1));
    let recording = Recording::open(&file).expect("opens");
    for at in [0.0, 0.0105, 4.999, 5.0, 7.3, 12.9995, 99.0] {
        let scene = recording.snapshot_at(&registry(), secs(at)).expect("is there");
        let ticks = ((at * 1_000.0).floor() as u64 + 1).min(13_000);
        // Publications are replayed whole, and in lock-step one of them holds up to 10 ms.
        let count = scene.get::<Count>(RING).map_or(0, |count| count.0);
        assert!((ticks..ticks + 11).contains(&count), "{at} s: {count} of {ticks}");
    }
    let mut replay = Replay::seek(&recording, &registry(), secs(11.0)).expect("seeks");
    assert!(replay.time() >= secs(9.9), "begins at a keyframe nearby");
    assert!(replay.run_to_end().is_ok());
}

#[test]
fn a_recorded_component_comes_back_as_a_series() {
    let folder = Folder::new();
    let file = folder.file("a.mcap");
    record(&file, 6.0, RecorderOptions::exact(), FaultPlan::new(1));
    let recording = Recording::open(&file).expect("opens");
    let series = recording.series::<Pose>(&registry(), RING).expect("is there");
    assert_eq!(series.len(), 6_001, "the scene at the start and one per tick");
    assert!(series.windows(2).all(|pair| pair[0].0 <= pair[1].0));
    let (time, pose) = &series[4_001];
    assert_eq!((*time, pose.translation.x), (secs(4.0), 4.0));
}

#[test]
fn a_file_that_was_cut_off_anywhere_gives_what_it_has() {
    let folder = Folder::new();
    let file = folder.file("a.mcap");
    record(&file, 6.0, RecorderOptions::exact(), FaultPlan::new(1));
    let bytes = std::fs::read(&file).expect("written");
    let mut last = 0;
    for part in 1..=20 {
        let cut = folder.file("cut.mcap");
        std::fs::write(&cut, &bytes[..bytes.len() * part / 20 - 1]).expect("written");
        let recording = Recording::open(&cut).expect("opens");
        assert!(recording.truncation().expect("says so").contains("the file ends at byte"));
        assert!(!recording.is_complete());
        let Ok(mut replay) = Replay::new(&recording, &registry()) else { continue };
        replay.run_to_end().expect("what is there is sound");
        let count = replay.view().get::<Count>(RING).map_or(0, |count| count.0);
        assert!(count >= last);
        last = count;
    }
    assert!(last >= 5_400, "no more than half a second is lost: {last}");
}

#[test]
fn a_process_that_is_killed_leaves_all_but_the_last_second() {
    let folder = Folder::new();
    let file = folder.file("a.mcap");
    let mut session = session(&file, RecorderOptions::exact(), FaultPlan::new(1));
    session.step_until(secs(4.0));
    // Abandoned: neither closed nor dropped.
    std::mem::forget(session);
    let recording = Recording::open(&file).expect("opens");
    assert!(recording.truncation().is_some() && recording.end().is_none());
    let mut replay = Replay::new(&recording, &registry()).expect("has a keyframe");
    replay.run_to_end().expect("sound");
    assert!(replay.time() >= secs(3.0), "{}", replay.time());
}

#[test]
fn a_disk_that_is_full_for_a_while_costs_nothing_and_longer_a_declared_gap() {
    let folder = Folder::new();
    let plan = |span| FaultPlan::new(1).at(secs(2.0)).lasting(secs(span)).disk_full();
    let small = RecorderOptions { backlog_max: 8_000, ..RecorderOptions::exact() };
    let bare = record(&folder.file("bare.mcap"), 9.0, small, FaultPlan::new(1));
    for (span, missing) in [(0.5, false), (4.0, true)] {
        let file = folder.file("full.mcap");
        let outcome = record(&file, 9.0, small, plan(span));
        assert_eq!(outcome.hash, bare.hash, "the simulation is untouched");
        assert_eq!(outcome.recording_complete, Some(!missing));
        let row = &outcome.faults[0];
        assert!(row.detected.is_some() && row.recovery().expect("resumed") < secs(1.0), "{row:?}");
        let recording = Recording::open(&file).expect("opens");
        assert_eq!(recording.is_complete(), !missing);
        let mut replay = Replay::new(&recording, &registry()).expect("has a keyframe");
        assert_eq!(replay.run_to_end().expect("agrees"), outcome.hash, "also behind the gap");
        assert_eq!(replay.gaps().len(), usize::from(missing));
        for gap in replay.gaps() {
            assert!(gap.until > gap.after && gap.reason.contains("no space"), "{gap:?}");
        }
    }
}

#[test]
fn a_flood_never_keeps_the_model_waiting_and_is_a_declared_gap() {
    let folder = Folder::new();
    let file = folder.file("a.mcap");
    let mut core = crate::ModelCore::new(scene(), 0).expect("encodes");
    core.keep_commits(true);
    core.declare("mover", trocar_scene::WriterId(1), &Mover.access()).expect("fits");
    let options = RecorderOptions { queue_max: 4, ..RecorderOptions::exact() };
    // The recorder is never ticked, as if it were stalled.
    let mut sink = Recorder::create(&file, &head(), core.view(), options).expect("begins").into_sink();
    let mut buffer = CommitBuffer::new();
    let mut longest = Duration::ZERO;
    for tick in 0..5_000u64 {
        let mut commands = Commands::new(core.view().registry().clone(), EntityAllocator::new(0, 1));
        commands.put(RING, Count(tick));
        commands.seal();
        let provenance = trocar_scene::Provenance {
            writer: trocar_scene::WriterId(1),
            epoch: 1,
            tick,
            time: SimTime(tick * STEP.0),
            based_on: core.view().revision(),
        };
        let mut batch = trocar_scene::Batch { provenance, commands };
        assert!(matches!(core.apply(&mut batch, provenance.time), crate::Outcome::Applied { .. }));
        let snapshot = core.publish();
        let commits = core.swap_commits(buffer);
        let begun = Instant::now();
        buffer = sink.committed(&snapshot, commits);
        longest = longest.max(begun.elapsed());
        assert!(buffer.is_empty());
    }
    assert!(longest < Duration::from_millis(200), "waited {longest:?}");
    assert!(!sink.close(Duration::from_secs(10)), "something is missing");
    let recording = Recording::open(&file).expect("opens");
    assert!(recording.truncation().is_none() && !recording.is_complete());
    let mut replay = Replay::new(&recording, &registry()).expect("has a keyframe");
    assert_eq!(replay.run_to_end().expect("agrees"), core.hash(), "a keyframe ends the gap");
    let [gap] = replay.gaps() else { panic!("one gap: {:?}", replay.gaps()) };
    assert_eq!((gap.until, gap.until.0 - gap.after.0), (core.view().revision(), 5_000 - 4));
    assert!(gap.reason.contains("queue was full"), "{gap:?}");
}

#[test]
fn another_schema_or_an_unknown_component_is_named() {
    let folder = Folder::new();
    let file = folder.file("a.mcap");
    record(&file, 0.1, RecorderOptions::exact(), FaultPlan::new(1));
    let mut bytes = std::fs::read(&file).expect("written");
    // The first metadata record stands behind the file's header, whose profile has the same name.
    let at = 8 + 9 + u64::from_le_bytes(bytes[9..17].try_into().expect("eight bytes")) as usize;
    let length = u64::from_le_bytes(bytes[at + 1..at + 9].try_into().expect("eight bytes")) as usize;
    let (name, mut pairs) = metadata_record(&bytes[at + 9..at + 9 + length]).expect("whole");
    pairs.insert("schema".to_owned(), "9".to_owned());
    pairs.insert(CHECKSUM.to_owned(), checksum(&pairs));
    let mut record = Vec::new();
    super::mcap::records::metadata(&name, &pairs, &mut record);
    bytes[at..at + 9 + length].copy_from_slice(&record);
    let other = folder.file("other.mcap");
    std::fs::write(&other, &bytes).expect("written");
    let text = Recording::open(&other).expect_err("refused").to_string();
    assert!(text.contains("other.mcap") && text.contains("schema 9") && text.contains("metadata"), "{text}");
    let recording = Recording::open(&file).expect("opens");
    let mut poor = RegistryBuilder::new();
    poor.register::<Count>().expect("new");
    let text = Replay::new(&recording, &poor.build()).err().expect("refused").to_string();
    assert!(text.contains("test_pairs") && text.contains("pose"), "{text}");
}

#[test]
fn what_is_no_recording_is_refused_by_name() {
    let folder = Folder::new();
    let file = folder.file("x.mcap");
    assert!(matches!(Recording::open(&file), Err(RecordingError::Io { .. })));
    for bytes in [&b""[..], b"hello, this is a text", b"\x89MCAP0\r\n"] {
        std::fs::write(&file, bytes).expect("written");
        let text = Recording::open(&file).expect_err("refused").to_string();
        assert!(text.contains("x.mcap") && text.contains("not a recording"), "{text}");
    }
}

#[test]
fn one_flipped_bit_in_a_commit_is_found() {
    let folder = Folder::new();
    let file = folder.file("a.mcap");
    record(&file, 8.0, RecorderOptions::exact(), FaultPlan::new(1));
    let mut bytes = std::fs::read(&file).expect("written");
    // Among the commits: schemas and indexes are short beside eight seconds of them.
    let at = bytes.len() / 2;
    bytes[at] ^= 1;
    std::fs::write(&file, &bytes).expect("written");
    let recording = Recording::open(&file).expect("the structure is sound");
    let mut replay = Replay::new(&recording, &registry()).expect("has a keyframe");
    replay.run_to_end().expect("the rest is whole");
    let [damage] = replay.damage() else { panic!("one place: {:?}", replay.damage()) };
    assert!(damage.contains("checksum") && damage.contains("byte"), "{damage}");
}

#[test]
fn the_mcap_library_reads_it_too() {
    let folder = Folder::new();
    let file = folder.file("a.mcap");
    record(&file, 2.0, RecorderOptions::exact(), FaultPlan::new(1));
    let bytes = std::fs::read(&file).expect("written");
    let summary = mcap::Summary::read(&bytes).expect("sound").expect("has a summary");
    let statistics = summary.stats.as_ref().expect("has statistics");
    assert!(statistics.message_count > 90, "{} messages", statistics.message_count);
    let indexed: usize = summary
        .chunk_indexes
        .iter()
        .map(|index| summary.stream_chunk(&bytes, index).expect("stands there").filter(Result::is_ok).count())
        .sum();
    assert_eq!(indexed as u64, statistics.message_count, "by the index");
    let [attachment] = &summary.attachment_indexes[..] else { panic!("one attachment") };
    let attachment = mcap::read::attachment(&bytes, attachment).expect("stands there");
    assert_eq!((&*attachment.name, &*attachment.data), ("scenario.toml", head().scenario_text.as_bytes()));
    let names: Vec<String> = summary
        .metadata_indexes
        .iter()
        .map(|index| mcap::read::metadata(&bytes, index).expect("stands there").name)
        .collect();
    assert_eq!(names, ["trocar", "trocar.devices", "trocar.bytes", "trocar.end"]);
    let (mut frames, mut events) = (0, 0);
    for message in mcap::MessageStream::new(&bytes).expect("sound") {
        let message = message.expect("sound");
        let json: serde_json::Value = match message.channel.topic.as_str() {
            "/tf" | "/events" => serde_json::from_slice(&message.data).expect("JSON"),
            _ => continue,
        };
        if message.channel.topic == "/tf" {
            frames += 1;
            assert_eq!(json["transforms"][0]["child_frame_id"], "ring");
            assert_eq!(message.channel.schema.as_ref().expect("has one").name, "foxglove.FrameTransforms");
        } else {
            events += 1;
            assert_eq!((json["name"].as_str(), json["subject"].as_str()), (Some("dropped"), Some("ring")));
        }
    }
    assert_eq!(events, 20);
    assert!((55..=65).contains(&frames), "30 Hz for 2 s: {frames}");
}

fn small_recording() -> &'static [u8] {
    static BYTES: std::sync::OnceLock<Vec<u8>> = std::sync::OnceLock::new();
    BYTES.get_or_init(|| {
        let folder = Folder::new();
        let file = folder.file("a.mcap");
        record(&file, 0.2, RecorderOptions::exact(), FaultPlan::new(1));
        std::fs::read(&file).expect("written")
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]
    #[test]
    fn no_damage_panics_or_allocates_without_limit(
        flips in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..8),
        cut in any::<prop::sample::Index>(),
        fix_checksums in any::<bool>(),
    ) {
        let mut bytes = small_recording().to_vec();
        for (at, value) in flips {
            let at = at.index(bytes.len());
            bytes[at] = value;
        }
        if cut.index(4) == 0 {
            bytes.truncate(cut.index(bytes.len()));
        }
        if fix_checksums {
            clear_checksums(&mut bytes);
        }
        let folder = Folder::new();
        let file = folder.file("bad.mcap");
        std::fs::write(&file, &bytes).expect("written");
        if let Ok(recording) = Recording::open(&file) {
            for item in recording.items() {
                if let Ok(Item::Keyframe(keyframe)) = item {
                    let _ = keyframe.load(&registry());
                }
            }
            let _ = Replay::new(&recording, &registry()).and_then(|mut replay| replay.run_to_end());
            let _ = recording.series::<Pose>(&registry(), RING);
        }
    }
}

/// Sets the checksum of every chunk to "none", so that damage reaches the decoders behind it.
fn clear_checksums(bytes: &mut [u8]) {
    let mut at = 8;
    while at + 9 <= bytes.len() {
        let mut length = [0; 8];
        length.copy_from_slice(&bytes[at + 1..at + 9]);
        if bytes[at] == 0x06 && at + 37 <= bytes.len() {
            bytes[at + 33..at + 37].fill(0);
        }
        let Ok(length) = usize::try_from(u64::from_le_bytes(length)) else { return };
        let Some(next) = at.checked_add(9).and_then(|at| at.checked_add(length)) else { return };
        at = next;
    }
}

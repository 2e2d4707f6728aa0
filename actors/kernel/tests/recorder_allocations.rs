//! What the Model gives to the recorder after each publication costs it nothing: no allocation, no free, once
//! as many buffers are in circulation as there are publications between two ticks of the recorder.

use serde::{Deserialize, Serialize};
use trocar_kernel::recorder::{Recorder, RecorderOptions, Recording, RecordingHead, Replay};
use trocar_kernel::spec::SessionSpec;
use trocar_kernel::{CommitBuffer, ModelCore, Outcome};
use trocar_scene::{
    Access, Batch, BuildContext, Commands, Component, Entity, EntityAllocator, EntitySet, Events, Jobs,
    Provenance, RegistryBuilder, SimTime, Store, Tick, WriterId,
};
use trocar_test_support::allocations::touches;

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Component)]
#[component(name = "toy_count")]
struct Count(u64);

#[test]
fn a_warmed_publication_reaches_the_recorder_without_touching_the_heap() {
    const WRITER: WriterId = WriterId(1);
    let folder = tempfile::tempdir().expect("a folder for temporary files");
    let file = folder.path().join("a.mcap");
    let mut builder = RegistryBuilder::new();
    builder.register::<Count>().expect("new");
    let store = Store::new(builder.build());
    let mut spec = SessionSpec::new("toy", 1, Store::from_snapshot(store.view()), Vec::new());
    let options = RecorderOptions::exact();
    let recorder = Recorder::create(&file, &RecordingHead::default(), store.view(), options);
    recorder.expect("begins").install(&mut spec);
    let mut sink = spec.commit_sink.take().expect("installed");
    let recorder = spec.controllers.pop().expect("installed");
    let (me, registry) = (Entity::of_writer(0, recorder.writer), store.view().registry().clone());
    let (time, period, seed) = (SimTime::ZERO, recorder.period(), 1);
    let context =
        BuildContext { scene: store.view(), time, period, name: &recorder.name, me, epoch: 1, seed };
    let mut life = (recorder.factory)(&context).expect("nobody else has the file");

    let mut core = ModelCore::new(store, 0).expect("encodes");
    core.keep_commits(true);
    core.declare("counter", WRITER, &Access::new().writes::<Count>(EntitySet::Own)).expect("fits");
    let mut spare = CommitBuffer::new();
    let mut touched = Vec::new();
    for tick in 0..4_000_u64 {
        let now = SimTime::from_micros(500 * tick);
        let mut commands = Commands::new(registry.clone(), EntityAllocator::new(0, WRITER.0));
        commands.put(Entity::of_writer(0, WRITER.0), Count(tick));
        commands.seal();
        let based_on = core.view().revision();
        let provenance = Provenance { writer: WRITER, epoch: 1, tick, time: now, based_on };
        let applied = core.apply(&mut Batch { provenance, commands }, now);
        assert!(matches!(applied, Outcome::Applied { .. }), "{applied:?}");
        let snapshot = core.publish();
        let commits = core.swap_commits(spare);
        let before = touches();
        spare = sink.committed(&snapshot, commits);
        touched.push(touches() - before);
        if tick % 40 == 39 {
            let mut out = Commands::new(registry.clone(), EntityAllocator::new(0, recorder.writer));
            let events = Events::new(core.view().events(), 0);
            let jobs = Jobs::default();
            let (period, number) = (recorder.period(), tick / 40);
            let tick = Tick { time: now, period, number, me, epoch: 1, events, jobs: &jobs };
            life.tick(&tick, core.view(), &mut out).expect("records");
            assert!(out.is_empty(), "it writes nothing into the scene");
        }
    }
    assert_eq!(touched[400..].iter().sum::<u64>(), 0);
    assert!(sink.close(std::time::Duration::from_secs(10)), "nothing is missing");
    let mut out = Commands::new(registry.clone(), EntityAllocator::new(0, recorder.writer));
    let (time, events, jobs) =
        (SimTime::from_millis(9_000), Events::new(core.view().events(), 0), Jobs::default());
    let tick = Tick { time, period: recorder.period(), number: 450, me, epoch: 1, events, jobs: &jobs };
    assert!(life.tick(&tick, core.view(), &mut out).is_err(), "nobody writes into a closed recording");
    let recording = Recording::open(&file).expect("opens");
    let mut replay = Replay::new(&recording, &registry).expect("has a keyframe");
    assert_eq!(replay.run_to_end().expect("agrees"), core.hash());
}

//! Tests of sessions that begin later than at zero, one per guarantee.

use std::sync::{Arc, Mutex, OnceLock};
use std::time::Duration;

use trocar_scene::{
    Access, Commands, Controller, ControllerError, Entity, EntityAllocator, EntitySet, Registry, SimTime,
    Snapshot, Store, Tick,
};

use super::{LockstepSession, SessionError};
use crate::commit::CommitBuffer;
use crate::faults::{FaultPlan, secs};
use crate::spec::{BEGIN_MAX, CommitSink, ControllerSpec, Peer, SessionSpec, StopWhen};
use crate::supervision::RuntimeClass;
use crate::testing::{self, Count, Pairs};

const BEGIN: SimTime = SimTime(12_345_600_000);
const RING: Entity = Entity::new(0, 0, 1);
/// Rates \[Hz\] and phases of the controllers, in the order of their writers. The first ticks at the begin exactly, the
/// last for the first time long after it.
const BEATS: [(f64, SimTime); 6] = [
    (10_000.0, SimTime::ZERO),
    (1_000.0, SimTime::ZERO),
    (333.0, SimTime::from_micros(700)),
    (60.0, SimTime::ZERO),
    (7.0, SimTime::from_millis(100)),
    (2.0, SimTime::from_millis(13_000)),
];

/// The registry of this test program.
fn registry() -> Arc<Registry> {
    static REGISTRY: OnceLock<Arc<Registry>> = OnceLock::new();
    REGISTRY.get_or_init(testing::registry).clone()
}

/// Writer, number and time of each tick, in order.
type Ticks = Arc<Mutex<Vec<(u16, u64, SimTime)>>>;

/// Counts its ticks in the scene, which holds all its state, and notes each with the events that it hears.
struct Counter {
    writer: u16,
    built: SimTime,
    ticks: Ticks,
}
impl Controller for Counter {
    fn access(&self) -> Access {
        Access::new().writes::<Count>(EntitySet::Own).contributes::<Pairs>()
    }
    fn tick(&mut self, tick: &Tick<'_>, scene: &Snapshot, out: &mut Commands) -> Result<(), ControllerError> {
        assert!(self.built <= tick.time, "built at {}", self.built);
        self.ticks.lock().expect("whole").push((self.writer, tick.number, tick.time));
        let count = scene.get::<Count>(tick.me).map_or(0, |count| count.0);
        out.put(tick.me, Count(count + 1));
        out.contribute(Pairs(tick.events.iter().map(|event| event.value as u32).collect()));
        Ok(())
    }
}

/// A session with all [`BEATS`], in a scene with an event that was told long before.
fn spec(begin: SimTime, ticks: &Ticks) -> SessionSpec {
    let mut scene = Store::new(registry());
    let mut commands = Commands::new(registry(), EntityAllocator::new(0, 0));
    commands.spawn();
    commands.event("told", RING, None, 77.0);
    scene.apply(&mut commands, SimTime::ZERO);
    let controllers = BEATS.iter().enumerate().map(|(index, (rate_hz, phase))| {
        let (writer, ticks) = (index as u16 + 1, ticks.clone());
        let name = format!("{rate_hz} Hz");
        let mut spec =
            ControllerSpec::new(name, writer, RuntimeClass::Simulation, *rate_hz, move |context| {
                Ok(Box::new(Counter { writer, built: context.time, ticks: ticks.clone() }))
            });
        spec.phase = *phase;
        spec
    });
    let controllers = controllers.collect();
    SessionSpec { begin, ..SessionSpec::new("toy", 42, scene, controllers) }
}

fn start(begin: SimTime) -> (LockstepSession, Ticks) {
    let ticks = Ticks::default();
    (LockstepSession::new(spec(begin, &ticks)).expect("starts"), ticks)
}

fn heard(session: &LockstepSession, writer: u16) -> Vec<u32> {
    session.view().get::<Pairs>(Entity::of_writer(0, writer)).expect("told").0.clone()
}

#[test]
fn first_ticks_are_those_that_are_due_first_with_the_numbers_of_a_session_from_zero() {
    let (mut late, ticks) = start(BEGIN);
    assert_eq!((late.begin(), late.now()), (BEGIN, BEGIN));
    late.step_until(secs(14.0));
    let (mut early, all) = start(SimTime::ZERO);
    early.step_until(secs(14.0));
    let (ticks, mut all) = (ticks.lock().expect("whole").clone(), all.lock().expect("whole").clone());
    all.retain(|(.., time)| *time >= BEGIN);
    assert_eq!(ticks, all);
    let first = |writer: u16| *ticks.iter().find(|(of, ..)| *of == writer).expect("ticked");
    assert_eq!(first(1), (1, 123_456, BEGIN), "one that is due at the begin runs");
    assert_eq!(first(2), (2, 12_346, secs(12.346)));
    assert_eq!(first(6), (6, 0, secs(13.0)));
}

/// Notes the times of its steps.
struct Metronome(Arc<Mutex<Vec<SimTime>>>);
impl Peer for Metronome {
    fn name(&self) -> &str {
        "metronome"
    }
    fn period_ns(&self) -> u64 {
        3_000_000
    }
    fn step(&mut self, now: SimTime) {
        self.0.lock().expect("whole").push(now);
    }
}

/// Notes the times of publications, which are those of the 10 kHz controller's last tick.
struct Noting(Arc<Mutex<Vec<SimTime>>>);
impl CommitSink for Noting {
    fn committed(&mut self, snapshot: &Arc<Snapshot>, commits: CommitBuffer) -> CommitBuffer {
        self.0.lock().expect("whole").push(snapshot.time());
        commits
    }
    fn close(&mut self, _: Duration) -> bool {
        true
    }
}

#[test]
fn peers_publications_and_stop_checks_stay_on_their_grids_and_the_end_is_a_session_time() {
    let [steps, publications, checks] = [(); 3].map(|()| Arc::<Mutex<Vec<SimTime>>>::default());
    let mut spec = spec(BEGIN, &Ticks::default());
    spec.peers.push(Box::new(Metronome(steps.clone())));
    spec.commit_sink = Some(Box::new(Noting(publications.clone())));
    let looks = checks.clone();
    spec.stop_when = Some(StopWhen {
        every: SimTime::from_millis(20),
        check: Arc::new(move |scene| {
            looks.lock().expect("whole").push(scene.time());
            false
        }),
    });
    spec.until = Some(secs(12.4));
    let mut session = LockstepSession::new(spec).expect("starts");
    assert!(!session.step_until(secs(20.0)), "it has ended");
    assert_eq!(session.now(), secs(12.4));
    let first = |times: &Mutex<Vec<SimTime>>| times.lock().expect("whole")[..2].to_vec();
    assert_eq!(first(&steps), [secs(12.348), secs(12.351)]);
    assert_eq!(first(&publications), [secs(12.35), secs(12.36)]);
    assert_eq!(first(&checks), [secs(12.36), secs(12.38)]);
}

#[test]
fn it_has_the_same_bits_every_time_and_others_than_one_from_zero() {
    let hash = |begin: SimTime| {
        let (mut session, _) = start(begin);
        session.step_until(begin + secs(0.5));
        session.finish().hash
    };
    assert_eq!(hash(BEGIN), hash(BEGIN));
    assert_ne!(hash(BEGIN), hash(SimTime::ZERO));
}

#[test]
fn rates_count_from_the_begin() {
    let (mut session, _) = start(BEGIN);
    session.step_until(BEGIN + secs(1.0));
    let outcome = session.finish();
    assert_eq!((outcome.begin, outcome.sim), (BEGIN, BEGIN + secs(1.0)));
    for (row, (rate_hz, phase)) in outcome.controllers.iter().zip(&BEATS) {
        if *phase < BEGIN {
            assert!((row.achieved_hz / rate_hz - 1.0).abs() < 1e-6, "{row:?}");
            assert!((row.scheduled as f64 - rate_hz).abs() <= 1.0, "{row:?}");
        }
        assert_eq!(row.missed, 0);
    }
}

#[test]
fn a_branch_ends_where_its_parent_does_from_the_begin_on() {
    for after in [0.0, 0.0004, 0.25] {
        let (mut parent, ticks) = start(BEGIN);
        parent.step_until(BEGIN + secs(after));
        let its = Ticks::default();
        let mut branch = LockstepSession::resume(spec(BEGIN, &its), parent.present()).expect("resumes");
        assert_eq!((branch.begin(), branch.now()), (BEGIN, parent.now()));
        let before = ticks.lock().expect("whole").len();
        for session in [&mut parent, &mut branch] {
            session.step_until(secs(14.0));
        }
        assert_eq!(its.lock().expect("whole")[..], ticks.lock().expect("whole")[before..]);
        assert_eq!(branch.hash(), parent.hash(), "{after} s after the begin");
    }
}

#[test]
fn the_scene_of_the_start_is_branched_at_the_begin() {
    let (mut session, _) = start(BEGIN);
    let first = session.view().clone();
    session.step_until(secs(13.0));
    let moment = session.moment_of(&first).expect("fits");
    assert_eq!(moment.at(), BEGIN);
    let ticks = Ticks::default();
    let mut again = LockstepSession::resume(spec(BEGIN, &ticks), moment).expect("resumes");
    again.step_until(secs(13.0));
    assert_eq!(ticks.lock().expect("whole")[0], (1, 123_456, BEGIN));
    assert_eq!(again.view().get::<Count>(Entity::of_writer(0, 2)), Some(&Count(654)));
}

#[test]
fn what_the_scene_tells_of_the_time_before_is_heard_by_nobody() {
    let (mut session, _) = start(BEGIN);
    session.apply(|out| out.event("told", RING, None, 78.0)).expect("applied");
    session.step_until(secs(12.345_65));
    assert_eq!(heard(&session, 1), [78]);
    session.step_until(secs(12.346_05));
    assert_eq!((heard(&session, 1), heard(&session, 2)), (vec![], vec![78]));
    let (mut early, _) = start(SimTime::ZERO);
    early.step_until(secs(0.00005));
    assert_eq!(heard(&early, 1), [77]);
}

#[test]
fn of_the_faults_before_the_begin_only_those_that_still_last_are_injected() {
    let mut spec = spec(BEGIN, &Ticks::default());
    spec.faults = FaultPlan::new(1)
        .at(secs(3.0))
        .kill("1000 Hz")
        .at(secs(12.0))
        .lasting(secs(0.1))
        .queue_full("1000 Hz")
        .at(secs(12.0))
        .lasting(secs(0.5))
        .queue_full("333 Hz")
        .at(secs(12.6))
        .kill("10000 Hz");
    let mut session = LockstepSession::new(spec).expect("starts");
    session.step_until(secs(13.0));
    let outcome = session.finish();
    let injected: Vec<Option<SimTime>> = outcome.faults.iter().map(|row| row.injected).collect();
    assert_eq!(injected, [None, None, Some(BEGIN), Some(secs(12.6))]);
    assert_eq!(outcome.faults[2].healed, Some(secs(12.5)));
    let failed: Vec<&str> = outcome.incidents.iter().map(|incident| incident.child.as_str()).collect();
    assert_eq!(failed, ["10000 Hz"]);
    let dropped: Vec<u64> = outcome.controllers[..3].iter().map(|row| row.dropped).collect();
    assert_eq!(dropped, [0, 0, 52], "333 Hz for 0.1544 s");
}

#[test]
fn a_begin_that_no_session_can_have_is_refused_and_the_latest_is_not() {
    let refused = LockstepSession::new(spec(BEGIN_MAX + SimTime(1), &Ticks::default()));
    assert!(matches!(refused, Err(SessionError::Begin(at)) if at > BEGIN_MAX));
    let (mut session, ticks) = start(BEGIN_MAX);
    session.step_until(BEGIN_MAX + secs(1.0));
    let ticks = ticks.lock().expect("whole");
    for (writer, (rate_hz, phase)) in (1..).zip(&BEATS) {
        let own: Vec<_> = ticks.iter().filter(|(of, ..)| *of == writer).collect();
        assert!((own.len() as f64 - rate_hz).abs() <= 1.0, "{rate_hz} Hz: {}", own.len());
        assert!(own.windows(2).all(|pair| pair[1].1 == pair[0].1 + 1));
        let (_, number, time) = *own[0];
        let exact = (number as f64).mul_add(1e9 / rate_hz, phase.0 as f64);
        assert!(time >= BEGIN_MAX && (time.0 as f64 - exact).abs() <= 4.0, "{rate_hz} Hz: {time}");
    }
}

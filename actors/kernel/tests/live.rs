//! Sessions in real time with toy controllers: what fails is replaced, what does not goes on.

use crate::support::toys;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};
use trocar_test_support::alone;

use crate::support::toys::{Trap, count, eventually, let_go, session, toy};
use trocar_kernel::commit::CommitBuffer;
use trocar_kernel::faults::{FaultPlan, secs};
use trocar_kernel::live::{LiveError, LiveSession};
use trocar_kernel::spec::{CommitSink, ControllerSpec, Fence, StopWhen};
use trocar_kernel::supervision::{Backoff, Cause, EXIT_GAVE_UP, GroupSpec, Health, RuntimeClass, Strategy};
use trocar_scene::{Access, Commands, Controller, ControllerError, Job, SimTime, Snapshot, Tick};

fn ms(millis: u64) -> SimTime {
    SimTime::from_millis(millis)
}

#[test]
fn controllers_tick_write_and_report() {
    let _alone = alone();
    let (a, _) = toy("a", 1, 500.0);
    let (b, _) = toy("b", 2, 100.0);
    let live = LiveSession::start(session(vec![b, a])).expect("starts");
    eventually("both count", || count(&live.snapshot(), 1) > 50 && count(&live.snapshot(), 2) > 10);
    assert!(live.health().iter().all(|(_, health)| matches!(health, Health::Healthy | Health::Late)));
    let outcome = live.stop(0);
    assert_eq!((outcome.code, outcome.reason), (0, None));
    let names: Vec<&str> = outcome.controllers.iter().map(|row| row.name.as_str()).collect();
    assert_eq!(names, ["b", "a"], "in the order of the session");
    let row = &outcome.controllers[1];
    assert!(row.scheduled > 50 && row.achieved_hz > 50.0 && row.achieved_hz < 600.0, "{row:?}");
    assert_eq!((row.rejected, row.dropped, row.conflicts, row.restarts), (0, 0, 0, 0));
    assert!(row.lateness_us.p50 <= row.lateness_us.p99 && row.lateness_us.p99 <= row.lateness_us.max);
    assert_ne!(outcome.hash.0, [0; 32]);
    // The last word of everybody is in the last snapshot, as long as it had read the one before.
    assert!(count(&outcome.snapshot, 1) > 50);
}

struct Recorded(Arc<AtomicU32>);
impl Fence for Recorded {
    fn raise(&self, epoch: u32) {
        self.0.store(epoch, Ordering::Relaxed);
    }
}

#[test]
fn a_panic_is_fenced_and_rebuilt_from_the_scene_and_nobody_else_notices() {
    let _alone = alone();
    let (mut a, wish) = toy("a", 1, 500.0);
    let (b, other) = toy("b", 2, 500.0);
    let fenced = Arc::new(AtomicU32::new(0));
    a.fences.push(Arc::new(Recorded(fenced.clone())));
    let live = LiveSession::start(session(vec![a, b])).expect("starts");
    eventually("it counts", || count(&live.snapshot(), 1) > 20);
    let before = count(&live.snapshot(), 1);
    wish.panic.store(true, Ordering::Relaxed);
    eventually("it is rebuilt", || wish.epoch.load(Ordering::Relaxed) == 2);
    eventually("it goes on", || count(&live.snapshot(), 1) > before + 20);
    assert_eq!(fenced.load(Ordering::Relaxed), 2);
    assert_eq!(other.epoch.load(Ordering::Relaxed), 1);
    let outcome = live.stop(0);
    assert_eq!(outcome.controllers[0].restarts, 1);
    assert_eq!(outcome.controllers[1].restarts, 0);
    assert_eq!(outcome.zombies, 0);
    let incident = &outcome.incidents[0];
    assert!(matches!(&incident.cause, Cause::Panic(text) if text.contains("as wished")), "{incident:?}");
    let resumed = incident.resumed.expect("resumed").since(incident.detected);
    assert!(resumed < ms(1_000), "{resumed}");
}

#[test]
fn errors_failed_constructions_and_panics_in_drop_are_survived() {
    let _alone = alone();
    let (a, wish) = toy("a", 1, 500.0);
    let live = LiveSession::start(session(vec![a])).expect("starts");
    eventually("it counts", || count(&live.snapshot(), 1) > 5);
    wish.fail_builds.store(2, Ordering::Relaxed);
    wish.panic_in_drop.store(true, Ordering::Relaxed);
    wish.fail.store(true, Ordering::Relaxed);
    eventually("the fourth life ticks", || wish.epoch.load(Ordering::Relaxed) == 4);
    let outcome = live.stop(0);
    let causes: Vec<bool> = outcome.incidents.iter().map(|i| matches!(i.cause, Cause::Error(_))).collect();
    assert_eq!(causes, [true; 3], "{:?}", outcome.incidents);
    assert_eq!(outcome.code, 0);
}

#[test]
fn an_endless_loop_is_fenced_left_behind_and_replaced() {
    let _alone = alone();
    let (mut a, wish) = toy("a", 1, 500.0);
    let (b, _) = toy("b", 2, 500.0);
    a.child = a.child.with_heartbeat_limit(ms(50));
    let live = LiveSession::start(session(vec![a, b])).expect("starts");
    eventually("it counts", || count(&live.snapshot(), 1) > 20);
    wish.hang.store(true, Ordering::Relaxed);
    eventually("the watchdog sees it", || live.zombies() == 1);
    let others = count(&live.snapshot(), 2);
    eventually("the other goes on meanwhile", || count(&live.snapshot(), 2) > others + 20);
    let before = count(&live.snapshot(), 1);
    wish.hang.store(false, Ordering::Relaxed);
    eventually("a replacement counts on", || count(&live.snapshot(), 1) > before + 20);
    eventually("the old thread ends after all", || live.zombies() == 0);
    let outcome = live.stop(0);
    assert!(outcome.incidents.iter().any(|i| i.child == "a" && i.cause == Cause::Stall));
    assert!(outcome.controllers[0].restarts >= 1);
    assert_eq!(outcome.controllers[1].restarts, 0);
    assert!(outcome.controllers[0].missed > 0, "the time without it counts as missed");
}

#[test]
fn a_long_first_step_is_no_stall_unless_it_holds_hands_and_a_long_later_one_is() {
    let _alone = alone();
    /// Takes four limits over its first step, and hangs in its twentieth until it is let go.
    struct Builder {
        done: Arc<AtomicU32>,
        let_go: Arc<AtomicBool>,
    }
    impl Controller for Builder {
        fn access(&self) -> Access {
            Access::new()
        }
        fn tick(&mut self, _: &Tick<'_>, _: &Snapshot, _: &mut Commands) -> Result<(), ControllerError> {
            let begun = Instant::now();
            let step = self.done.load(Ordering::Relaxed);
            while step == 0 && begun.elapsed() < Duration::from_millis(400)
                || step == 19 && !self.let_go.load(Ordering::Relaxed)
            {
                std::thread::sleep(Duration::from_millis(1));
            }
            self.done.fetch_add(1, Ordering::Relaxed);
            Ok(())
        }
    }
    for (class, first_stall) in [(RuntimeClass::Simulation, 19), (RuntimeClass::Haptics, 0)] {
        let (done, let_go) = (Arc::new(AtomicU32::new(0)), Arc::new(AtomicBool::new(false)));
        let (counter, flag) = (done.clone(), let_go.clone());
        let mut spec = ControllerSpec::new("builder", 1, class, 500.0, move |_| {
            Ok(Box::new(Builder { done: counter.clone(), let_go: flag.clone() }) as Box<dyn Controller>)
        });
        spec.child = spec.child.with_heartbeat_limit(ms(100));
        let live = LiveSession::start(session(vec![spec])).expect("starts");
        eventually("a step counts as a stall", || {
            live.incidents().iter().any(|row| row.cause == Cause::Stall)
        });
        assert_eq!(done.load(Ordering::Relaxed), first_stall, "{class:?}");
        let_go.store(true, Ordering::Relaxed);
        assert_eq!(live.stop(0).code, 0);
    }
}

#[test]
fn the_model_resumes_after_a_panic_and_does_not_try_the_batch_again() {
    let _alone = alone();
    let (a, wish) = toy("a", 1, 500.0);
    let (b, other) = toy("b", 2, 500.0);
    let live = LiveSession::start(session(vec![a, b])).expect("starts");
    eventually("it counts", || count(&live.snapshot(), 1) > 20);
    let revision = live.snapshot().revision();
    wish.trap.store(1, Ordering::Relaxed);
    eventually("the Model restarts", || live.incidents().iter().any(|i| i.child == "model"));
    eventually("the Model resumes", || live.incidents().iter().all(|i| i.resumed.is_some()));
    let (one, two) = (count(&live.snapshot(), 1), count(&live.snapshot(), 2));
    eventually("both go on", || {
        count(&live.snapshot(), 1) > one + 20 && count(&live.snapshot(), 2) > two + 20
    });
    assert!(live.snapshot().revision() >= revision);
    assert_eq!((wish.epoch.load(Ordering::Relaxed), other.epoch.load(Ordering::Relaxed)), (1, 1));
    let outcome = live.stop(0);
    assert!(outcome.snapshot.get::<Trap>(trocar_scene::Entity::of_writer(0, 1)).is_none());
    assert_eq!((outcome.controllers[0].rejected, outcome.model.restarts), (1, 1));
    let incident = &outcome.incidents[0];
    let pause = incident.resumed.expect("resumed").since(incident.detected);
    assert!(pause < ms(1_000), "{pause}");
}

#[test]
fn a_model_that_hangs_is_replaced_and_what_it_says_later_does_not_count() {
    let _alone = alone();
    let (a, wish) = toy("a", 1, 500.0);
    let (b, other) = toy("b", 2, 500.0);
    let live = LiveSession::start(session(vec![a, b])).expect("starts");
    eventually("it counts", || count(&live.snapshot(), 1) > 20);
    wish.trap.store(2, Ordering::Relaxed);
    eventually("the watchdog sees it", || live.zombies() == 1);
    let (one, two) = (count(&live.snapshot(), 1), count(&live.snapshot(), 2));
    eventually("both go on", || {
        count(&live.snapshot(), 1) > one + 20 && count(&live.snapshot(), 2) > two + 20
    });
    let_go();
    eventually("the old Model ends", || live.zombies() == 0);
    let (one, two) = (count(&live.snapshot(), 1), count(&live.snapshot(), 2));
    eventually("both still go on", || {
        count(&live.snapshot(), 1) > one + 20 && count(&live.snapshot(), 2) > two + 20
    });
    assert_eq!((wish.epoch.load(Ordering::Relaxed), other.epoch.load(Ordering::Relaxed)), (1, 1));
    assert_eq!(live.stop(0).code, 0);
}

#[test]
fn a_session_stops_within_two_seconds_although_a_step_never_ends() {
    let _alone = alone();
    let (mut a, wish) = toy("a", 1, 200.0);
    // Nobody notices the stall before the session is stopped.
    a.child = a.child.with_heartbeat_limit(ms(60_000));
    let (b, _) = toy("b", 2, 200.0);
    let mut spec = session(vec![a, b]);
    let zeroed = Arc::new(AtomicBool::new(false));
    let flag = zeroed.clone();
    spec.zero_forces.push(Arc::new(move || flag.store(true, Ordering::Relaxed)));
    let live = LiveSession::start(spec).expect("starts");
    eventually("it counts", || count(&live.snapshot(), 1) > 5);
    wish.hang.store(true, Ordering::Relaxed);
    let before = wish.ticks.load(Ordering::Relaxed);
    eventually("it hangs", || wish.ticks.load(Ordering::Relaxed) > before);
    let begun = Instant::now();
    let outcome = live.stop(0);
    let took = begun.elapsed();
    wish.hang.store(false, Ordering::Relaxed);
    assert!(took < Duration::from_secs(2), "{took:?}");
    assert!(zeroed.load(Ordering::Relaxed));
    assert_eq!((outcome.code, outcome.zombies), (0, 1));
    assert!(count(&outcome.snapshot, 2) > 0);
}

#[test]
fn a_session_whose_controller_cannot_be_built_does_not_start() {
    let _alone = alone();
    let (a, wish) = toy("a", 1, 500.0);
    wish.fail_builds.store(1, Ordering::Relaxed);
    let Err(LiveError::Start(reason)) = LiveSession::start(session(vec![a])) else {
        panic!("it started");
    };
    assert!(reason.contains("'a'") || reason.contains("a did not start"), "{reason}");
    assert!(reason.contains("not today"), "{reason}");
}

#[test]
fn controllers_that_write_the_same_rows_are_refused_at_the_start() {
    let _alone = alone();
    struct Everything;
    impl Controller for Everything {
        fn access(&self) -> Access {
            Access::new().writes::<toys::Count>(trocar_scene::EntitySet::All)
        }
        fn tick(&mut self, _: &Tick<'_>, _: &Snapshot, _: &mut Commands) -> Result<(), ControllerError> {
            Ok(())
        }
    }
    let greedy = |name: &str, id| {
        ControllerSpec::new(name, id, RuntimeClass::Task, 100.0, |_| {
            Ok(Box::new(Everything) as Box<dyn Controller>)
        })
    };
    let Err(error) = LiveSession::start(session(vec![greedy("a", 1), greedy("b", 2)])) else {
        panic!("it started");
    };
    assert!(error.to_string().contains("'b' and 'a' both write toy_count"), "{error}");
}

#[test]
fn sessions_that_make_no_sense_are_refused() {
    let _alone = alone();
    let error = |controllers| LiveSession::start(session(controllers)).err().expect("refused").to_string();
    let mut slow = toy("a", 1, 100.0).0;
    slow.rate_hz = -5.0;
    assert!(error(vec![slow]).contains("-5 Hz"));
    assert!(error(vec![toy("a", 0, 1.0).0]).contains("1 to 65535"));
    assert!(error(vec![toy("a", 1, 1.0).0, toy("a", 2, 1.0).0]).contains("two of this name"));
    assert!(error(vec![toy("a", 1, 1.0).0, toy("b", 1, 1.0).0]).contains("like 'a'"));
}

#[test]
fn a_child_that_keeps_failing_ends_the_session_with_forces_at_zero() {
    let _alone = alone();
    let (a, wish) = toy("a", 1, 500.0);
    let mut spec = session(vec![a]);
    let backoff = Backoff { base: SimTime::ZERO, max: SimTime::ZERO, ..Backoff::default() };
    let mut root = GroupSpec::new("root", Strategy::RestForOne).with_backoff(backoff);
    for child in spec.children() {
        root = root.child(child);
    }
    spec.tree = Some(root.with_intensity(1, ms(60_000)));
    let zeroed = Arc::new(AtomicBool::new(false));
    let flag = zeroed.clone();
    spec.zero_forces.push(Arc::new(move || flag.store(true, Ordering::Relaxed)));
    let live = LiveSession::start(spec).expect("starts");
    for life in 1..=2 {
        eventually("it ticks", || wish.epoch.load(Ordering::Relaxed) == life);
        wish.panic.store(true, Ordering::Relaxed);
    }
    assert!(live.wait(Duration::from_secs(10)), "it gives up");
    let outcome = live.stop(0);
    assert_eq!(outcome.code, EXIT_GAVE_UP);
    assert!(zeroed.load(Ordering::Relaxed));
    assert!(outcome.reason.is_some_and(|reason| reason.contains("as wished")));
}

#[test]
fn every_fault_of_a_plan_is_noticed_and_overcome() {
    let _alone = alone();
    let (mut a, _) = toy("a", 1, 200.0);
    a.child = a.child.with_heartbeat_limit(ms(60));
    let (b, _) = toy("b", 2, 200.0);
    let mut spec = session(vec![a, b]);
    spec.faults = FaultPlan::new(7)
        .at(secs(0.1))
        .kill("a")
        .at(secs(0.3))
        .stall("a")
        .at(secs(0.3))
        .lasting(secs(0.2))
        .queue_full("b")
        .at(secs(0.6))
        .lasting(secs(0.2))
        .nan("b")
        .at(secs(0.9))
        .lasting(secs(0.2))
        .slow("b", ms(20))
        .at(secs(1.2))
        .kill("model");
    let live = LiveSession::start(spec).expect("starts");
    std::thread::sleep(Duration::from_millis(1_500));
    let outcome = live.stop(0);
    assert_eq!(outcome.faults.len(), 6);
    for row in &outcome.faults {
        assert!(row.injected.is_some() && row.detected.is_some() && row.resumed.is_some(), "{row:?}");
        assert!(row.detected >= row.injected && row.resumed >= row.detected, "{row:?}");
    }
    assert!(outcome.controllers[1].dropped > 0 && outcome.controllers[1].rejected > 0);
    assert_eq!(outcome.controllers[1].restarts, 0);
    assert_eq!(outcome.model.restarts, 1);
    assert_eq!(outcome.code, 0);
}

#[test]
fn an_unknown_fault_target_is_refused_with_the_valid_ones() {
    let _alone = alone();
    let mut spec = session(vec![toy("a", 1, 100.0).0]);
    spec.faults = FaultPlan::new(7).at(secs(1.0)).kill("b");
    let error = LiveSession::start(spec).err().expect("refused").to_string();
    assert!(error.contains("'b'") && error.contains("a, model"), "{error}");
}

#[test]
fn long_work_runs_elsewhere_and_comes_back() {
    let _alone = alone();
    struct Worker(Arc<Mutex<Vec<u64>>>);
    impl Controller for Worker {
        fn access(&self) -> Access {
            Access::new()
        }
        fn tick(&mut self, tick: &Tick<'_>, _: &Snapshot, _: &mut Commands) -> Result<(), ControllerError> {
            if let Some(sum) = tick.jobs.take(1).and_then(|output| output.downcast::<u64>().ok()) {
                self.0.lock().expect("not poisoned").push(*sum);
            }
            if tick.number.is_multiple_of(10) {
                let work = Box::new(|| Box::new((0..1_000_u64).sum::<u64>()) as trocar_scene::JobOutput);
                tick.jobs.submit(Job { key: 1, takes: ms(1), work });
            }
            Ok(())
        }
    }
    let sums = Arc::new(Mutex::new(Vec::new()));
    let given = sums.clone();
    let spec = ControllerSpec::new("worker", 1, RuntimeClass::Simulation, 500.0, move |_| {
        Ok(Box::new(Worker(given.clone())) as Box<dyn Controller>)
    });
    let live = LiveSession::start(session(vec![spec])).expect("starts");
    eventually("three outputs come", || sums.lock().expect("not poisoned").len() >= 3);
    assert!(sums.lock().expect("not poisoned").iter().all(|sum| *sum == 499_500));
    assert_eq!(live.stop(0).incidents, []);
}

#[test]
fn no_event_is_missed_by_a_slow_reader_nor_seen_twice() {
    let _alone = alone();
    struct Crier;
    impl Controller for Crier {
        fn access(&self) -> Access {
            Access::new()
        }
        fn tick(&mut self, tick: &Tick<'_>, _: &Snapshot, out: &mut Commands) -> Result<(), ControllerError> {
            out.event("cry", tick.me, None, tick.number as f64);
            Ok(())
        }
    }
    struct Listener(Arc<Mutex<Vec<u64>>>, Arc<AtomicBool>);
    impl Controller for Listener {
        fn access(&self) -> Access {
            Access::new()
        }
        fn tick(&mut self, tick: &Tick<'_>, _: &Snapshot, _: &mut Commands) -> Result<(), ControllerError> {
            if self.1.swap(false, Ordering::Relaxed) {
                panic!("before it has listened");
            }
            let mut heard = self.0.lock().expect("not poisoned");
            heard.extend(tick.events.iter().map(|event| event.value as u64));
            Ok(())
        }
    }
    let (heard, panic) = (Arc::new(Mutex::new(Vec::new())), Arc::new(AtomicBool::new(false)));
    let (given, flag) = (heard.clone(), panic.clone());
    let crier = ControllerSpec::new("crier", 1, RuntimeClass::Task, 500.0, |_| {
        Ok(Box::new(Crier) as Box<dyn Controller>)
    });
    let listener = ControllerSpec::new("listener", 2, RuntimeClass::Task, 30.0, move |_| {
        Ok(Box::new(Listener(given.clone(), flag.clone())) as Box<dyn Controller>)
    });
    let live = LiveSession::start(session(vec![listener, crier])).expect("starts");
    eventually("it hears", || heard.lock().expect("not poisoned").len() > 50);
    panic.store(true, Ordering::Relaxed);
    eventually("it hears again", || heard.lock().expect("not poisoned").len() > 200);
    drop(live);
    let heard = heard.lock().expect("not poisoned");
    assert!(heard.windows(2).all(|pair| pair[0] < pair[1]), "in order, each once");
}

#[test]
fn a_held_controller_rests_without_being_taken_for_dead() {
    let _alone = alone();
    let (a, wish) = toy("a", 1, 500.0);
    let live = LiveSession::start(session(vec![a])).expect("starts");
    eventually("it counts", || count(&live.snapshot(), 1) > 5);
    assert!(live.hold("a", true) && !live.hold("b", true));
    eventually("it is held", || live.health_of("a") == Some(Health::Held));
    std::thread::sleep(Duration::from_millis(20));
    let ticks = wish.ticks.load(Ordering::Relaxed);
    std::thread::sleep(Duration::from_millis(200));
    assert_eq!(wish.ticks.load(Ordering::Relaxed), ticks);
    assert!(live.hold("a", false));
    eventually("it goes on", || wish.ticks.load(Ordering::Relaxed) > ticks + 5);
    assert_eq!(live.stop(0).incidents, []);
}

#[test]
fn a_session_ends_at_its_time_or_at_its_goal() {
    let _alone = alone();
    let mut spec = session(vec![toy("a", 1, 200.0).0]);
    spec.until = Some(ms(200));
    let live = LiveSession::start(spec).expect("starts");
    assert!(live.wait(Duration::from_secs(10)), "it ends by itself");
    let outcome = live.stop(1);
    assert_eq!(outcome.code, 0);
    assert!(outcome.sim >= ms(200));

    let mut spec = session(vec![toy("a", 1, 200.0).0]);
    spec.stop_when = Some(StopWhen { every: ms(5), check: Arc::new(|scene| count(scene, 1) >= 10) });
    let live = LiveSession::start(spec).expect("starts");
    assert!(live.wait(Duration::from_secs(10)), "it reaches its goal");
    assert!(count(&live.stop(1).snapshot, 1) >= 10);
}

#[test]
fn the_recorder_gets_every_commit_in_order_and_is_closed() {
    let _alone = alone();
    #[derive(Default)]
    struct Tape {
        revisions: Vec<u64>,
        closed: bool,
    }
    struct Recorder(Arc<Mutex<Tape>>);
    impl CommitSink for Recorder {
        fn committed(&mut self, snapshot: &Arc<Snapshot>, mut commits: CommitBuffer) -> CommitBuffer {
            let mut tape = self.0.lock().expect("not poisoned");
            tape.revisions.extend(commits.iter().map(|commit| commit.revision.0));
            assert_eq!(tape.revisions.last(), Some(&snapshot.revision().0));
            commits.clear();
            commits
        }
        fn close(&mut self, _: Duration) -> bool {
            self.0.lock().expect("not poisoned").closed = true;
            true
        }
    }
    let tape = Arc::new(Mutex::new(Tape::default()));
    let (a, wish) = toy("a", 1, 500.0);
    let mut spec = session(vec![a, toy("b", 2, 300.0).0]);
    spec.commit_sink = Some(Box::new(Recorder(tape.clone())));
    let live = LiveSession::start(spec).expect("starts");
    eventually("it counts", || count(&live.snapshot(), 1) > 50);
    wish.trap.store(1, Ordering::Relaxed);
    eventually("the Model resumes", || live.incidents().iter().any(|i| i.resumed.is_some()));
    let outcome = live.stop(0);
    let tape = tape.lock().expect("not poisoned");
    assert!(tape.closed && outcome.recording_complete == Some(true));
    assert!(tape.revisions.windows(2).all(|pair| pair[1] == pair[0] + 1), "without a gap");
    assert_eq!(tape.revisions.last(), Some(&outcome.snapshot.revision().0));
}

#[test]
fn a_session_at_rest_uses_hardly_any_cpu() {
    let _alone = alone();
    let (mut a, _) = toy("a", 1, 5.0);
    a.child = a.child.with_heartbeat_limit(ms(1_000));
    let live = LiveSession::start(session(vec![a])).expect("starts");
    std::thread::sleep(Duration::from_millis(600));
    let outcome = live.stop(0);
    assert!(outcome.controllers[0].cpu_share < 0.1, "{}", outcome.controllers[0].cpu_share);
    assert!(outcome.model.cpu_share < 0.1, "{}", outcome.model.cpu_share);
}

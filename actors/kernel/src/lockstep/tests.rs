//! Tests of the guarantees of lock-step, one per guarantee.

use std::sync::atomic::{AtomicU32, AtomicU64, Ordering};
use std::sync::{Arc, Mutex};

use trocar_scene::controller::JOBS_MAX;
use trocar_scene::{
    Access, Commands, Controller, ControllerError, Entity, EntityAllocator, EntitySet, Job, SimTime,
    Snapshot, Store, Tick,
};

use super::{LockstepSession, SessionError};
use crate::faults::{FaultPlan, secs};
use crate::spec::{ControllerSpec, Fence, Peer, SessionOutcome, SessionSpec, StopWhen};
use crate::supervision::{Cause, GroupSpec, RuntimeClass, Strategy};
use crate::testing::{Count, Level, Pairs, registry};

const RING: Entity = Entity::new(0, 0, 1);
const PEG: Entity = Entity::new(0, 0, 2);

/// Counts in the scene, which holds all its state for a restart.
struct Counter {
    on: Entity,
}
impl Controller for Counter {
    fn access(&self) -> Access {
        Access::new().writes::<Count>(EntitySet::Of(vec![self.on])).contributes::<Pairs>()
    }
    fn tick(&mut self, tick: &Tick<'_>, scene: &Snapshot, out: &mut Commands) -> Result<(), ControllerError> {
        let count = scene.get::<Count>(self.on).map_or(0, |count| count.0);
        out.put(self.on, Count(count + 1));
        out.contribute(Pairs(vec![tick.number as u32]));
        Ok(())
    }
}

/// Writes the commands of a closure.
struct Does<F>(Access, F);
impl<F> Controller for Does<F>
where
    F: FnMut(&Tick<'_>, &Snapshot, &mut Commands) -> Result<(), ControllerError> + Send + 'static,
{
    fn access(&self) -> Access {
        self.0.clone()
    }
    fn tick(&mut self, tick: &Tick<'_>, scene: &Snapshot, out: &mut Commands) -> Result<(), ControllerError> {
        (self.1)(tick, scene, out)
    }
}

fn counter(name: &str, writer: u16, rate_hz: f64, on: Entity) -> ControllerSpec {
    ControllerSpec::new(name, writer, RuntimeClass::Simulation, rate_hz, move |_| {
        Ok(Box::new(Counter { on }))
    })
}

fn hand(name: &str, writer: u16, rate_hz: f64, on: Entity) -> ControllerSpec {
    ControllerSpec::new(name, writer, RuntimeClass::Haptics, rate_hz, move |_| Ok(Box::new(Counter { on })))
}

fn spec(controllers: Vec<ControllerSpec>) -> SessionSpec {
    let registry = registry();
    let mut scene = Store::new(registry.clone());
    let mut commands = Commands::new(registry.clone(), EntityAllocator::new(0, 0));
    commands.spawn();
    commands.spawn();
    scene.apply(&mut commands, SimTime::ZERO);
    let mut spec = SessionSpec::new("toy", 42, scene, controllers);
    spec.zombies_max = 8;
    spec
}

fn two_counters() -> SessionSpec {
    spec(vec![hand("hand", 1, 1_000.0, RING), counter("engine", 2, 500.0, PEG)])
}

fn start(spec: SessionSpec) -> LockstepSession {
    LockstepSession::new(spec).expect("starts")
}

fn start_with(mut spec: SessionSpec, plan: &FaultPlan) -> LockstepSession {
    spec.faults = plan.clone();
    start(spec)
}

fn run(spec: SessionSpec, plan: &FaultPlan, until: f64) -> SessionOutcome {
    let mut session = start_with(spec, plan);
    session.step_until(secs(until));
    session.finish()
}

#[test]
fn ticks_are_rate_times_time_exactly() {
    let rates = [1_000.0, 500.0, 333.0, 60.0, 7.5];
    let controllers = rates
        .iter()
        .zip(1..)
        .map(|(rate, writer)| {
            counter(&format!("c{writer}"), writer, *rate, Entity::new(0, 0, 1 + u32::from(writer)))
        })
        .collect();
    let mut spec = spec(controllers);
    let allocator = EntityAllocator::new(0, 0);
    allocator.skip_to(3);
    let mut commands = Commands::new(spec.registry.clone(), allocator);
    (0..8).for_each(|_| {
        commands.spawn();
    });
    spec.scene.apply(&mut commands, SimTime::ZERO);
    let report = run(spec, &FaultPlan::new(0), 40.0);
    for (row, rate) in report.controllers.iter().zip(rates) {
        assert_eq!(row.scheduled, (rate * 40.0) as u64, "{}", row.name);
        assert_eq!((row.missed, row.rejected, row.restarts), (0, 0, 0), "{}", row.name);
    }
    assert_eq!(report.sim, secs(40.0));
}

#[test]
fn the_same_seed_gives_the_same_bits_and_one_flipped_bit_does_not() {
    let noisy = |seed: u64, flip: u64| {
        let mut spec =
            spec(vec![ControllerSpec::new("noise", 1, RuntimeClass::Simulation, 1_000.0, move |context| {
                let mut state = context.seed;
                Ok(Box::new(Does(
                    Access::new().writes::<Level>(EntitySet::Of(vec![RING])),
                    move |tick: &Tick<'_>, _: &Snapshot, out: &mut Commands| {
                        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
                        let value = (state >> 11) as f64;
                        let flipped =
                            if tick.number == 77 { value.to_bits() ^ flip } else { value.to_bits() };
                        out.put(RING, Level(f64::from_bits(flipped)));
                        Ok(())
                    },
                )))
            })]);
        spec.seed = seed;
        run(spec, &FaultPlan::new(0), 1.0).hash
    };
    assert_eq!(noisy(1, 0), noisy(1, 0));
    assert_ne!(noisy(1, 0), noisy(2, 0));
    assert_ne!(noisy(1, 0), noisy(1, 1));
}

#[test]
fn the_length_of_a_stride_changes_nothing() {
    let hash = |strides: &[f64]| {
        let mut session = start(two_counters());
        for stride in strides {
            session.step_until(secs(*stride));
        }
        session.finish().hash
    };
    assert_eq!(hash(&[1.0]), hash(&[0.0001, 0.0015, 0.3, 0.3, 0.9999, 1.0]));
}

#[test]
fn within_an_instant_peers_come_first_and_controllers_in_order() {
    struct Driver(Arc<AtomicU64>);
    impl Peer for Driver {
        fn name(&self) -> &str {
            "device"
        }
        fn period_ns(&self) -> u64 {
            1_000_000
        }
        fn step(&mut self, now: SimTime) {
            self.0.store(now.0 + 1, Ordering::Relaxed);
        }
    }
    let sample = Arc::new(AtomicU64::new(0));
    let seen = Arc::new(Mutex::new(Vec::new()));
    let (from_device, log) = (sample.clone(), seen.clone());
    let reader = ControllerSpec::new("reader", 2, RuntimeClass::Haptics, 1_000.0, move |_| {
        let (from_device, log) = (from_device.clone(), log.clone());
        Ok(Box::new(Does(Access::new(), move |tick: &Tick<'_>, scene: &Snapshot, _: &mut Commands| {
            let count = scene.get::<Count>(RING).map_or(0, |count| count.0);
            log.lock().expect("one thread").push((tick.time.0, from_device.load(Ordering::Relaxed), count));
            Ok(())
        })))
    });
    let mut spec = spec(vec![counter("first", 1, 1_000.0, RING), reader]);
    spec.peers.push(Box::new(Driver(sample)));
    let mut session = start(spec);
    session.step_until(secs(0.003));
    let seen = seen.lock().expect("one thread");
    assert_eq!(*seen, [(0, 1, 1), (1_000_000, 1_000_001, 2), (2_000_000, 2_000_001, 3)]);
}

#[test]
fn a_killed_controller_is_rebuilt_from_the_scene_and_goes_on_counting() {
    let plan = FaultPlan::new(1).at(secs(0.5)).kill("engine");
    let report = run(two_counters(), &plan, 1.0);
    let engine = &report.controllers[1];
    assert_eq!((engine.restarts, engine.missed, engine.scheduled), (1, 0, 500));
    let row = &report.faults[0];
    assert_eq!(row.injected, Some(secs(0.5)));
    assert_eq!(row.detected, Some(secs(0.5)));
    assert_eq!(row.restarted, Some(secs(0.5)), "no pause before the first restart");
    assert_eq!(row.resumed, Some(secs(0.5)), "the new life takes the tick that the old one died in");
    assert!(matches!(&report.incidents[0].cause, Cause::Panic(text) if text.contains("fault")));
    assert_eq!(report.controllers[0].restarts, 0, "the hand is in another group");
}

#[test]
fn a_panic_in_a_tick_ends_that_life_only_and_its_contribution_leaves_the_scene() {
    let lives = Arc::new(AtomicU32::new(0));
    let counted = lives.clone();
    let engine = ControllerSpec::new("engine", 1, RuntimeClass::Simulation, 100.0, move |context| {
        counted.fetch_add(1, Ordering::Relaxed);
        let epoch = context.epoch;
        assert_eq!(context.scene.get::<Pairs>(context.me), None, "nothing of the corpse is left");
        Ok(Box::new(Does(
            Access::new().contributes::<Pairs>(),
            move |tick: &Tick<'_>, _: &Snapshot, out: &mut Commands| {
                assert_eq!(tick.epoch, epoch);
                out.contribute(Pairs(vec![tick.epoch]));
                if tick.number == 30 {
                    panic!("a bug");
                }
                Ok(())
            },
        )))
    });
    let mut session = start(spec(vec![engine, hand("hand", 2, 1_000.0, RING)]));
    session.step_until(secs(0.3));
    assert_eq!(session.view().iter::<Pairs>().count(), 2);
    session.step_until(secs(0.3001));
    assert_eq!(session.view().iter::<Pairs>().count(), 1, "fenced at once");
    session.step_until(secs(1.0));
    assert_eq!(session.view().get::<Pairs>(Entity::of_writer(0, 1)), Some(&Pairs(vec![3])));
    assert_eq!(
        lives.load(Ordering::Relaxed),
        3,
        "the second life died of the same tick, the third passed it over"
    );
    let report = session.finish();
    assert!(matches!(&report.incidents[0].cause, Cause::Panic(text) if text.starts_with("a bug")));
}

#[test]
fn a_stalled_controller_is_fenced_replaced_and_its_late_words_are_refused() {
    struct Driver(AtomicU32);
    impl Fence for Driver {
        fn raise(&self, epoch: u32) {
            self.0.fetch_max(epoch, Ordering::Relaxed);
        }
    }
    let driver = Arc::new(Driver(AtomicU32::new(0)));
    let mut hand = hand("hand", 1, 1_000.0, RING);
    hand.fences.push(driver.clone());
    let limit = hand.child.heartbeat_limit;
    let plan = FaultPlan::new(1).at(secs(0.2)).lasting(secs(0.3)).stall("hand");
    let mut session = start_with(spec(vec![hand]), &plan);
    session.step_until(secs(0.2) + limit);
    assert_eq!(driver.0.load(Ordering::Relaxed), 1);
    session.step_until(secs(0.2) + limit + SimTime(1));
    assert_eq!(driver.0.load(Ordering::Relaxed), 2, "the device is fenced the moment the stall is seen");
    assert_eq!(session.supervisor().zombies(), 1);
    session.step_until(secs(1.0));
    assert_eq!(session.supervisor().zombies(), 0, "it came to its end after all");
    let report = session.finish();
    let (row, hand) = (&report.faults[0], &report.controllers[0]);
    assert_eq!(row.detected, Some(secs(0.2) + limit));
    assert!(row.recovery().expect("resumed") <= limit + SimTime::from_millis(2), "{row:?}");
    assert_eq!((hand.restarts, hand.rejected), (1, 1), "the zombie's batch was refused");
    assert_eq!(hand.missed, limit.0 / 1_000_000 - 1, "from the stuck tick to the first of the next life");
}

#[test]
fn a_short_stall_only_costs_ticks() {
    let plan = FaultPlan::new(1).at(secs(0.2)).lasting(secs(0.0105)).stall("hand");
    let report = run(two_counters(), &plan, 1.0);
    let hand = &report.controllers[0];
    assert_eq!((hand.restarts, hand.missed, hand.rejected), (0, 10, 0));
    assert_eq!(report.faults[0].resumed, Some(secs(0.2105)));
}

#[test]
fn slow_queue_full_and_nan_are_noticed_survived_and_reported() {
    let plan = FaultPlan::new(1)
        .at(secs(0.1))
        .lasting(secs(0.1))
        .slow("engine", SimTime::from_micros(4_500))
        .at(secs(0.3))
        .lasting(secs(0.05))
        .queue_full("hand")
        .at(secs(0.5))
        .lasting(secs(0.05))
        .nan("hand");
    let mut session = start_with(two_counters(), &plan);
    session.step_until(secs(1.0));
    assert_eq!(session.view().get::<Count>(RING), Some(&Count(900)), "1,000 less 50 dropped, 50 refused");
    let report = session.finish();
    let (hand, engine) = (&report.controllers[0], &report.controllers[1]);
    assert_eq!((hand.dropped, hand.rejected, hand.missed), (50, 50, 0));
    assert!((30..40).contains(&engine.missed), "two of three ticks for 0.1 s: {}", engine.missed);
    for row in &report.faults {
        let (injected, healed) = (row.injected.expect("begun"), row.healed.expect("ended"));
        assert!(row.detected.expect("noticed") >= injected, "{row:?}");
        assert!(row.detected.expect("noticed").since(injected) <= SimTime::from_millis(3), "{row:?}");
        assert!(row.resumed.expect("well again").since(healed) <= SimTime::from_millis(7), "{row:?}");
    }
}

#[test]
fn the_model_dies_and_nobody_elses_work_is_lost() {
    let plan = FaultPlan::new(1).at(secs(0.5)).kill("model").at(secs(0.6)).kill("model");
    let mut session = start_with(two_counters(), &plan);
    session.step_until(secs(1.0));
    assert_eq!(session.view().revision().0, 1 + 1_000 + 500, "every batch is applied");
    let report = session.finish();
    assert_eq!(report.model.restarts, 2);
    assert_eq!(report.controllers.iter().map(|row| row.restarts + row.dropped as u32).sum::<u32>(), 0);
    for row in &report.faults {
        assert!(row.recovery().expect("resumed") < SimTime::from_millis(40), "{row:?}");
    }
}

#[test]
fn a_batch_that_panics_the_model_is_quarantined() {
    let bomber = ControllerSpec::new("bomber", 1, RuntimeClass::Task, 100.0, |_| {
        let access = Access::new().writes::<crate::testing::Bomb>(EntitySet::Of(vec![RING]));
        Ok(Box::new(Does(access, |tick: &Tick<'_>, _: &Snapshot, out: &mut Commands| {
            if tick.number == 10 {
                out.put(RING, crate::testing::Bomb::new(13));
            }
            Ok(())
        })))
    });
    let mut session = start(spec(vec![bomber, counter("engine", 2, 1_000.0, PEG)]));
    session.step_until(secs(0.5));
    assert_eq!(session.model().counts(trocar_scene::WriterId(1)).expect("declared").quarantined, 1);
    assert_eq!(session.view().get::<Count>(PEG), Some(&Count(500)));
    assert_eq!(session.finish().model.restarts, 1);
}

#[test]
fn a_controller_that_keeps_failing_takes_the_session_down_with_forces_at_zero_and_exit_70() {
    let zeroed = Arc::new(AtomicU32::new(0));
    let counted = zeroed.clone();
    let broken = ControllerSpec::new("broken", 1, RuntimeClass::Task, 1_000.0, |_| {
        Ok(Box::new(Does(Access::new(), |_: &Tick<'_>, _: &Snapshot, _: &mut Commands| {
            Err(ControllerError::Failed("no luck".into()))
        })))
    });
    let mut spec = spec(vec![broken, counter("engine", 2, 500.0, PEG)]);
    let root = GroupSpec::new("root", Strategy::OneForOne).with_intensity(3, secs(1.0));
    spec.tree = Some(spec.children().into_iter().fold(root, GroupSpec::child));
    spec.zero_forces.push(Arc::new(move || {
        counted.fetch_add(1, Ordering::Relaxed);
    }));
    let mut session = start(spec);
    assert!(!session.step_until(secs(100.0)));
    assert_eq!(zeroed.load(Ordering::Relaxed), 1);
    let report = session.finish();
    assert_eq!(report.code, 70);
    assert!(report.reason.expect("said").contains("broken no luck"));
    assert_eq!(report.incidents.len(), 4);
}

#[test]
fn a_session_that_cannot_start_says_why() {
    let error = |spec: SessionSpec| LockstepSession::new(spec).err().expect("wrong").to_string();
    let text = error(spec(vec![counter("a", 1, 10.0, RING), counter("b", 2, 10.0, RING)]));
    assert!(text.contains("'b' and 'a' both write test_count"), "{text}");
    let text = error(spec(vec![ControllerSpec::new("c", 1, RuntimeClass::Task, 10.0, |_| {
        Err(ControllerError::Scene("there is no peg board".into()))
    })]));
    assert!(text.contains("c did not start") && text.contains("peg board"), "{text}");
    for rate in [0.0, -5.0, f64::NAN, 1e9] {
        let mut wrong = counter("a", 1, 10.0, RING);
        wrong.rate_hz = rate;
        assert!(matches!(LockstepSession::new(spec(vec![wrong])), Err(SessionError::Rate { .. })), "{rate}");
    }
}

#[test]
fn jobs_arrive_when_they_said_they_would() {
    let arrived = Arc::new(AtomicU64::new(0));
    let log = arrived.clone();
    let worker = ControllerSpec::new("worker", 1, RuntimeClass::Simulation, 1_000.0, move |_| {
        let log = log.clone();
        Ok(Box::new(Does(Access::new(), move |tick: &Tick<'_>, _: &Snapshot, _: &mut Commands| {
            if tick.number == 10 {
                let takes = SimTime::from_micros(4_200);
                assert!(tick.jobs.submit(Job { key: 7, takes, work: Box::new(|| Box::new(42_u64)) }));
            }
            if let Some(output) = tick.jobs.take(7) {
                assert_eq!(output.downcast_ref(), Some(&42_u64));
                log.store(tick.number, Ordering::Relaxed);
            }
            Ok(())
        })))
    });
    start(spec(vec![worker])).step_until(secs(0.1));
    assert_eq!(arrived.load(Ordering::Relaxed), 15);
}

#[test]
fn a_job_that_panics_ends_the_life_that_waits_for_it_and_the_next_one_asks_again() {
    let (asked, arrived) = (Arc::new(AtomicU64::new(0)), Arc::new(AtomicU64::new(0)));
    let logs = (asked.clone(), arrived.clone());
    let worker = ControllerSpec::new("worker", 1, RuntimeClass::Simulation, 1_000.0, move |_| {
        let (asked, arrived) = logs.clone();
        let mut submitted = false;
        Ok(Box::new(Does(Access::new(), move |tick: &Tick<'_>, _: &Snapshot, _: &mut Commands| {
            if !submitted {
                let first = asked.fetch_add(1, Ordering::Relaxed) == 0;
                let work = move || {
                    assert!(!first, "a matrix that is singular the first time");
                    Box::new(42_u64) as trocar_scene::JobOutput
                };
                let takes = SimTime::from_micros(4_200);
                submitted = tick.jobs.submit(Job { key: 7, takes, work: Box::new(work) });
            }
            if tick.jobs.take(7).is_some() {
                arrived.store(tick.number, Ordering::Relaxed);
            }
            Ok(())
        })))
    });
    let mut session = start(spec(vec![worker]));
    session.step_until(secs(0.1));
    assert_eq!(asked.load(Ordering::Relaxed), 2);
    let row = &session.finish().controllers[0];
    // Reported at the time of delivery, so that lock-step ends as a live session does.
    assert_eq!(row.restarts, 1);
    assert!((7..=20).contains(&arrived.load(Ordering::Relaxed)), "{}", arrived.load(Ordering::Relaxed));
}

#[test]
fn no_job_is_forgotten_however_many_are_due_at_once() {
    let all = 3 * JOBS_MAX as u64;
    let arrived = Arc::new(AtomicU64::new(0));
    let log = arrived.clone();
    let worker = ControllerSpec::new("worker", 1, RuntimeClass::Simulation, 1_000.0, move |_| {
        let log = log.clone();
        let mut left: Vec<u64> = (0..all).collect();
        let mut next = 0;
        Ok(Box::new(Does(Access::new(), move |tick: &Tick<'_>, _: &Snapshot, _: &mut Commands| {
            // All of them are due at 20 ms.
            let takes = SimTime(SimTime::from_millis(20).0.saturating_sub(tick.time.0));
            while next < all && tick.jobs.submit(Job { key: next, takes, work: Box::new(|| Box::new(())) }) {
                next += 1;
            }
            left.retain(|key| tick.jobs.take(*key).is_none());
            log.store(all - left.len() as u64, Ordering::Relaxed);
            Ok(())
        })))
    });
    start(spec(vec![worker])).step_until(secs(0.1));
    assert_eq!(arrived.load(Ordering::Relaxed), all);
}

#[test]
fn a_goal_or_a_time_ends_the_session() {
    let mut wanted = two_counters();
    wanted.stop_when = Some(StopWhen {
        every: SimTime::from_millis(5),
        check: Arc::new(|scene| scene.get::<Count>(RING).is_some_and(|count| count.0 >= 103)),
    });
    let mut session = start(wanted);
    assert!(!session.step_until(secs(10.0)));
    assert_eq!(session.finish().sim, secs(0.105));
    let mut timed = two_counters();
    timed.until = Some(secs(0.25));
    let mut session = start(timed);
    assert!(session.step_until(secs(0.1)));
    assert!(!session.step_until(secs(10.0)));
    let report = session.finish();
    assert_eq!((report.sim, report.controllers[0].scheduled), (secs(0.25), 250));
}

/// Not a benchmark (see `trocar bench`), but a guard against a slowdown by an order of magnitude.
#[test]
fn overhead_per_tick_is_microseconds() {
    let mut session = start(two_counters());
    session.step_until(secs(1.0));
    let begun = std::time::Instant::now();
    session.step_until(secs(21.0));
    let nanos = begun.elapsed().as_nanos() as f64 / 30_000.0;
    println!("{nanos:.0} ns per tick");
    assert!(nanos < 50_000.0, "{nanos} ns per tick");
}

/// Checks that every batch of every writer was applied, refused, or counted as lost.
fn nothing_is_unaccounted_for(report: &SessionOutcome) {
    for row in &report.controllers {
        assert_eq!(row.unaccounted(), 0, "{row:?}");
    }
}

#[test]
fn a_model_that_hangs_is_replaced_and_what_waited_for_it_is_applied() {
    let plan = FaultPlan::new(1).at(secs(0.5)).lasting(secs(0.3)).stall("model");
    let mut session = start_with(two_counters(), &plan);
    let limit =
        session.supervisor().spec(session.supervisor().find("model").unwrap()).unwrap().heartbeat_limit;
    session.step_until(secs(0.5) + limit);
    assert_eq!(session.supervisor().zombies(), 0, "not yet");
    session.step_until(secs(0.5) + limit + SimTime(1));
    assert_eq!(session.supervisor().zombies(), 1);
    session.step_until(secs(1.0));
    assert_eq!(session.supervisor().zombies(), 0, "it came to its end after all");
    assert_eq!(session.view().revision().0, 1 + 1_000 + 500, "every batch is applied");
    let report = session.finish();
    let row = &report.faults[0];
    assert_eq!((row.detected, row.restarted), (Some(secs(0.5) + limit), Some(secs(0.5) + limit)));
    assert!(row.resumed.expect("resumed") <= secs(0.5) + limit + SimTime::from_millis(2), "{row:?}");
    assert_eq!((report.model.restarts, report.code), (1, 0));
    nothing_is_unaccounted_for(&report);
}

#[test]
fn a_model_that_hangs_for_a_moment_goes_on_by_itself() {
    let plan =
        FaultPlan::new(1).at(secs(0.5)).lasting(secs(0.02)).stall("model").at(secs(0.51)).kill("model");
    let mut session = start_with(two_counters(), &plan);
    session.step_until(secs(1.0));
    assert_eq!(session.view().revision().0, 1 + 1_000 + 500, "every batch is applied");
    let report = session.finish();
    assert_eq!(report.faults[0].healed, Some(secs(0.52)));
    assert_eq!(report.faults[1].detected, Some(secs(0.52)), "who hangs cannot be killed before");
    assert_eq!(report.model.restarts, 1);
}

#[test]
fn bad_links_lose_delay_double_and_garble_their_own_writers_batches_and_all_is_told() {
    let plan = FaultPlan::new(3)
        .at(secs(0.1))
        .lasting(secs(0.1))
        .drop("hand", 0.3)
        .at(secs(0.3))
        .lasting(secs(0.1))
        .jitter("hand", SimTime::from_millis(10), SimTime::from_millis(5))
        .at(secs(0.5))
        .lasting(secs(0.1))
        .duplicate("hand", 0.3)
        .at(secs(0.7))
        .lasting(secs(0.05))
        .reorder("hand", 0.3)
        .at(secs(0.8))
        .lasting(secs(0.05))
        .corrupt("hand", 0.3)
        .at(secs(0.9))
        .lasting(secs(0.05))
        .partition("hand");
    let report = run(two_counters(), &plan, 1.2);
    let again = run(two_counters(), &plan, 1.2);
    assert_eq!(report.hash, again.hash, "the seed decides");
    let (hand, engine) = (&report.controllers[0], &report.controllers[1]);
    assert!((15..50).contains(&(hand.lost - 50)), "of 100 dropped and 50 garbled, after 50: {}", hand.lost);
    assert!((100..130).contains(&hand.delayed) && (15..50).contains(&hand.duplicated), "{hand:?}");
    assert_eq!((engine.lost, engine.delayed, engine.duplicated, engine.applied), (0, 0, 0, 600));
    nothing_is_unaccounted_for(&report);
    for row in &report.faults {
        let (injected, healed) = (row.injected.expect("begun"), row.healed.expect("ended"));
        assert!(row.detected.expect("noticed").since(injected) <= SimTime::from_millis(20), "{row:?}");
        assert!(row.resumed.expect("well again").since(healed) <= SimTime::from_millis(16), "{row:?}");
    }
}

#[test]
fn who_commands_too_much_is_refused_at_its_own_handle() {
    let loud = ControllerSpec::new("loud", 2, RuntimeClass::Task, 100.0, |_| {
        let access = Access::new().writes::<Count>(EntitySet::Own).spawns();
        Ok(Box::new(Does(access, |_: &Tick<'_>, _: &Snapshot, out: &mut Commands| {
            for _ in 0..9_000 {
                out.spawn();
            }
            Ok(())
        })))
    });
    let report = run(spec(vec![hand("hand", 1, 1_000.0, RING), loud]), &FaultPlan::new(0), 1.0);
    let (hand, loud) = (&report.controllers[0], &report.controllers[1]);
    assert_eq!((loud.dropped, loud.sent, loud.applied), (100, 0, 0));
    assert_eq!((hand.dropped, hand.applied), (0, 1_000));
}

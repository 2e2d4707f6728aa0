//! Those who take part without being ticked: guests, and plain actix actors that act through one.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::time::{Duration, Instant};

use crate::support::toys::{Count, Trap, count, eventually, let_go, session, toy};
use actix::prelude::{Actor, AsyncContext, Context};
use trocar_kernel::Submitted;
use trocar_kernel::live::{Guest, LiveSession};
use trocar_scene::{Access, Entity, EntitySet, WriterId};
use trocar_test_support::alone;

/// Number of the guests among the writers.
const GUEST: u16 = 900;

fn own_count() -> Access {
    Access::new().reads::<Count>().writes::<Count>(EntitySet::Own)
}

fn guest(live: &LiveSession) -> Guest {
    live.guest("guest", WriterId(GUEST), &own_count(), 16).expect("is let in")
}

/// One more in the guest's own count.
fn count_on(guest: &mut Guest) -> Submitted {
    let me = guest.me();
    let sent = guest.write(|scene, out| {
        let before = scene.get::<Count>(me).map_or(0, |count| count.0);
        out.put(me, Count(before + 1));
    });
    sent.expect("a sound command")
}

#[test]
fn a_guest_reads_writes_and_hears_each_event_once() {
    let _alone = alone();
    let (a, _) = toy("a", 1, 500.0);
    let live = LiveSession::start(session(vec![a])).expect("starts");
    let mut visitor = guest(&live);
    assert_eq!(count_on(&mut visitor), Submitted::Sent);
    eventually("it is seen", || count(&live.snapshot(), GUEST) == 1);
    let me = visitor.me();
    for value in [1.0, 2.0] {
        visitor.write(|_, out| out.event("said", me, None, value)).expect("a sound event");
        eventually("it is in the log", || live.snapshot().events().next() as f64 >= value);
    }
    let heard: Vec<f64> = visitor.events().iter().map(|event| event.value).collect();
    assert_eq!(heard, [1.0, 2.0]);
    assert!(visitor.events().is_empty());
    let wrong = visitor.write(|_, out| out.event("said", me, None, f64::NAN)).expect_err("refused at once");
    assert!(wrong.to_string().contains("'said'"), "{wrong}");
    assert!(!visitor.has_ended());
    let outcome = live.stop(0);
    assert!(visitor.has_ended());
    assert_eq!(outcome.controllers[0].restarts, 0);
}

#[test]
fn a_guest_that_claims_what_others_write_is_refused() {
    let _alone = alone();
    let (a, _) = toy("a", 1, 100.0);
    let live = LiveSession::start(session(vec![a])).expect("starts");
    let greedy = Access::new().writes::<Count>(EntitySet::All);
    let error = live.guest("guest", WriterId(GUEST), &greedy, 16).expect_err("refused");
    assert!(error.to_string().contains("both write toy_count"), "{error}");
}

#[test]
fn a_guest_that_wants_answers_hears_what_the_model_says_of_each_batch() {
    let _alone = alone();
    let (a, _) = toy("a", 1, 100.0);
    let live = LiveSession::start(session(vec![a])).expect("starts");
    let mut visitor = live.guest_with_answers("guest", WriterId(GUEST), &own_count(), 16).expect("is let in");
    let of_another = Entity::of_writer(0, 1);
    assert_eq!(count_on(&mut visitor), Submitted::Sent);
    visitor.write(|_, out| out.put(of_another, Count(7))).expect("a sound command");
    let mut answers = Vec::new();
    eventually("both are answered", || {
        answers.extend(std::iter::from_fn(|| visitor.answer()));
        answers.len() == 2
    });
    let applied = answers[0].as_ref().expect("it is in the scene");
    assert!(live.snapshot().revision() >= *applied);
    assert_eq!(count(&live.snapshot(), GUEST), 1);
    let refused = answers[1].as_ref().expect_err("it is another's").to_string();
    assert!(refused.contains("toy_count"), "{refused}");
    // Others hear nothing.
    let mut plain = live.guest("plain", WriterId(GUEST + 1), &own_count(), 16).expect("is let in");
    count_on(&mut plain);
    eventually("it is seen", || count(&live.snapshot(), GUEST + 1) == 1);
    assert!(plain.answer().is_none());
    live.stop(0);
}

#[test]
fn a_flood_of_a_guest_is_refused_at_its_own_ring() {
    let _alone = alone();
    let (a, wish) = toy("a", 1, 500.0);
    let live = LiveSession::start(session(vec![a])).expect("starts");
    let mut visitor = guest(&live);
    let ticks = wish.ticks.load(Ordering::Relaxed);
    eventually("its ring is full now and then, while others tick", || {
        for _ in 0..1_000 {
            count_on(&mut visitor);
        }
        visitor.dropped() > 0 && wish.ticks.load(Ordering::Relaxed) > ticks + 20
    });
    let outcome = live.stop(0);
    assert_eq!((outcome.controllers[0].dropped, outcome.controllers[0].rejected), (0, 0));
}

#[test]
fn a_guest_introduces_itself_to_a_model_that_takes_over() {
    let _alone = alone();
    let (a, wish) = toy("a", 1, 500.0);
    let live = LiveSession::start(session(vec![a])).expect("starts");
    let mut visitor = guest(&live);
    assert_eq!(count_on(&mut visitor), Submitted::Sent);
    eventually("it is seen", || count(&live.snapshot(), GUEST) == 1);
    wish.trap.store(2, Ordering::Relaxed);
    eventually("the Model hangs and is left behind", || live.zombies() == 1);
    eventually("the next one hears the guest", || {
        count_on(&mut visitor);
        count(&live.snapshot(), GUEST) > 5
    });
    let_go();
    // What it hangs on stays out of the scene.
    assert!(live.snapshot().iter::<Trap>().all(|(_, trap)| trap.0 != 2));
}

/// Counts in its own row, every millisecond, and does what it is asked to.
struct Counter {
    guest: Guest,
    panic: Arc<AtomicBool>,
    hang: Arc<AtomicBool>,
}
impl Actor for Counter {
    type Context = Context<Self>;
    fn started(&mut self, ctx: &mut Self::Context) {
        ctx.run_interval(Duration::from_millis(1), |actor, _| {
            if actor.panic.swap(false, Ordering::Relaxed) {
                panic!("as wished");
            }
            while actor.hang.load(Ordering::Relaxed) {
                std::hint::spin_loop();
            }
            count_on(&mut actor.guest);
        });
    }
}

#[test]
fn an_actor_that_panics_is_built_again_and_goes_on_from_the_scene() {
    let _alone = alone();
    let (a, _) = toy("a", 1, 500.0);
    let live = LiveSession::start(session(vec![a])).expect("starts");
    let (panic, hang) = (Arc::new(AtomicBool::new(false)), Arc::default());
    let asked = panic.clone();
    let actor = live
        .actor("counter", WriterId(GUEST), &own_count(), move |guest| Counter {
            guest,
            panic: asked.clone(),
            hang: Arc::clone(&hang),
        })
        .expect("starts");
    eventually("it counts", || count(&live.snapshot(), GUEST) > 5);
    let before = count(&live.snapshot(), GUEST);
    panic.store(true, Ordering::Relaxed);
    eventually("it is built again", || actor.restarts() == 1);
    eventually("it counts on", || count(&live.snapshot(), GUEST) > before + 5);
    assert!(actor.is_alive() && actor.given_up().is_none());
    let outcome = live.stop(0);
    assert_eq!(outcome.controllers[0].restarts, 0, "nobody else notices");
    assert!(actor.end(), "it ends with the session");
}

#[test]
fn an_actor_that_hangs_stalls_nobody_and_is_left_behind() {
    let _alone = alone();
    let (a, wish) = toy("a", 1, 500.0);
    let live = LiveSession::start(session(vec![a])).expect("starts");
    let hang = Arc::new(AtomicBool::new(false));
    let asked = hang.clone();
    let actor = live
        .actor("counter", WriterId(GUEST), &own_count(), move |guest| Counter {
            guest,
            panic: Arc::default(),
            hang: asked.clone(),
        })
        .expect("starts");
    eventually("it counts", || count(&live.snapshot(), GUEST) > 5);
    hang.store(true, Ordering::Relaxed);
    let ticks = wish.ticks.load(Ordering::Relaxed);
    eventually("the others tick", || wish.ticks.load(Ordering::Relaxed) > ticks + 50);
    let begun = Instant::now();
    let outcome = live.stop(0);
    assert!(!actor.end(), "it hangs");
    assert!(begun.elapsed() < Duration::from_secs(2), "{:?}", begun.elapsed());
    assert_eq!(outcome.controllers[0].restarts, 0);
    hang.store(false, Ordering::Relaxed);
}

#[test]
fn an_actor_that_always_fails_is_given_up_and_the_rest_runs_on() {
    let _alone = alone();
    let (a, wish) = toy("a", 1, 500.0);
    let live = LiveSession::start(session(vec![a])).expect("starts");
    let builds = Arc::new(AtomicU32::new(0));
    let seen = builds.clone();
    let actor = live
        .actor("counter", WriterId(GUEST), &own_count(), move |_: Guest| -> Counter {
            seen.fetch_add(1, Ordering::Relaxed);
            panic!("no such thing")
        })
        .expect("starts");
    eventually("it is given up", || actor.given_up().is_some());
    assert!(actor.given_up().is_some_and(|why| why.contains("no such thing")));
    assert_eq!(builds.load(Ordering::Relaxed), actor.restarts() + 1);
    let ticks = wish.ticks.load(Ordering::Relaxed);
    eventually("the others tick", || wish.ticks.load(Ordering::Relaxed) > ticks + 20);
    assert_eq!(live.stop(0).code, 0);
}

//! An operator beside a live session: it is answered, waits for nobody too long, and disturbs nobody.

use std::sync::atomic::Ordering;
use std::time::Duration;

use crate::support::toys::{Count, Trap, count, eventually, let_go, session, toy};
use trocar_kernel::OperatorError;
use trocar_kernel::live::{LiveSession, OPERATORS_MAX};
use trocar_scene::Entity;
use trocar_test_support::alone;

const LIMIT: Duration = Duration::from_secs(5);

#[test]
fn an_operator_of_a_live_session_is_told_what_became_of_its_batch() {
    let _alone = alone();
    let (a, _) = toy("a", 1, 500.0);
    let live = LiveSession::start(session(vec![a])).expect("starts");
    let mut operator = live.operator().expect("the first");
    let me = Entity::of_writer(0, 1);
    let revision = operator.apply(LIMIT, |out| out.put(me, Count(1_000_000))).expect("applied");
    let scene = live.snapshot();
    assert!(scene.revision() >= revision && count(&scene, 1) >= 1_000_000, "what is answered is published");
    eventually("its writer goes on from there", || count(&live.snapshot(), 1) > 1_000_010);
    let unknown = operator.apply(LIMIT, |out| out.put(Entity::new(0, 0, 7), Count(1)));
    assert!(unknown.expect_err("refused").to_string().contains("0:0:7 does not exist"));
    // From another thread, and two at a time.
    let mut second = live.operator().expect("the second");
    let threads = std::thread::spawn(move || {
        (0..100_u64).map(|n| second.apply(LIMIT, |out| out.put(me, Count(n)))).all(|answer| answer.is_ok())
    });
    let mine = (0..100_u64).map(|n| operator.apply(LIMIT, |out| out.put(me, Count(n))));
    assert!(mine.map(|answer| answer.expect("applied")).is_sorted());
    assert!(threads.join().expect("no panic"));
    let row = live.stop(0).controllers.remove(0);
    assert_eq!((row.rejected, row.conflicts, row.dropped), (0, 0, 0));
    assert_eq!(operator.apply(LIMIT, |out| out.put(me, Count(1))), Err(OperatorError::Ended));
}

#[test]
fn a_batch_that_kills_the_model_is_answered_and_the_next_one_is_applied() {
    let _alone = alone();
    let (a, _) = toy("a", 1, 500.0);
    let live = LiveSession::start(session(vec![a])).expect("starts");
    let mut operator = live.operator().expect("the first");
    let me = Entity::of_writer(0, 1);
    assert_eq!(operator.apply(LIMIT, |out| out.put(me, Trap(1))), Err(OperatorError::Quarantined));
    operator.apply(LIMIT, |out| out.put(me, Count(1_000_000))).expect("the next Model takes it");
    let outcome = live.stop(0);
    assert_eq!((outcome.code, outcome.model.restarts), (0, 1));
}

#[test]
fn a_model_that_hangs_is_not_waited_for_and_its_successor_is_found() {
    let _alone = alone();
    let (a, wish) = toy("a", 1, 500.0);
    let live = LiveSession::start(session(vec![a])).expect("starts");
    let mut operator = live.operator().expect("the first");
    let me = Entity::of_writer(0, 1);
    operator.apply(LIMIT, |out| out.put(me, Count(5_000))).expect("applied");
    let limit = Duration::from_millis(30);
    assert_eq!(operator.apply(limit, |out| out.put(me, Trap(2))), Err(OperatorError::NoAnswer(limit)));
    eventually("the Model is replaced", || live.zombies() == 1);
    eventually("the operator finds it", || operator.apply(LIMIT, |out| out.put(me, Count(9_000))).is_ok());
    eventually("and so does everybody", || count(&live.snapshot(), 1) > 9_005);
    assert_eq!(wish.epoch.load(Ordering::Relaxed), 1, "nobody else was restarted");
    let_go();
    assert_eq!(live.stop(0).code, 0);
}

#[test]
fn operators_are_bounded_and_their_places_come_back() {
    let _alone = alone();
    let (a, _) = toy("a", 1, 100.0);
    let live = LiveSession::start(session(vec![a])).expect("starts");
    let all: Vec<_> = (0..OPERATORS_MAX).map(|_| live.operator().expect("room")).collect();
    assert_eq!(live.operator().err(), Some(OperatorError::TooMany(OPERATORS_MAX)));
    drop(all);
    assert!(live.operator().is_ok());
}

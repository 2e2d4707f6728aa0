//! A session that rests: nobody ticks, nothing is missed, nobody counts as stalled, and it goes on where it stood.

use std::sync::atomic::Ordering;
use std::time::Duration;

use crate::support::toys::{eventually, session, toy};
use trocar_kernel::live::LiveSession;
use trocar_kernel::supervision::Health;
use trocar_test_support::alone;

#[test]
fn a_paused_session_stands_still_and_goes_on_without_a_missed_tick_or_a_stall() {
    let _alone = alone();
    let (a, fast) = toy("a", 1, 500.0);
    let (b, slow) = toy("b", 2, 2.0);
    let live = LiveSession::start(session(vec![a, b])).expect("starts");
    eventually("both tick", || {
        fast.ticks.load(Ordering::Relaxed) > 20 && slow.ticks.load(Ordering::Relaxed) > 0
    });
    assert!(!live.resume(), "it does not rest");
    let mut quiet = false;
    assert!(live.pause(|| quiet = true) && quiet && live.is_paused());
    assert!(!live.pause(|| unreachable!("it rests already")));
    let (ticks, time, missed) = (fast.ticks.load(Ordering::Relaxed), live.elapsed(), live.stats()[0].missed);
    // Longer than every limit of a heart.
    std::thread::sleep(Duration::from_millis(1_500));
    assert_eq!((fast.ticks.load(Ordering::Relaxed), live.elapsed()), (ticks, time));
    assert!(live.incidents().is_empty(), "{:?}", live.incidents());

    assert!(live.resume() && !live.is_paused());
    eventually("it goes on", || fast.ticks.load(Ordering::Relaxed) > ticks + 50);
    let passed = live.elapsed() - time;
    let outcome = live.stop(0);
    assert!(outcome.incidents.is_empty() && outcome.zombies == 0 && outcome.code == 0);
    let row = &outcome.controllers[0];
    // 750 ticks would have fallen into the pause; none of them is scheduled, and whatever was missed before or after
    // it took its time.
    let scheduled = row.scheduled - (ticks + missed);
    assert!(scheduled <= passed.as_nanos() * 500 / 1_000_000_000 + 50, "{scheduled} ticks in {passed}");
}

#[test]
fn who_keeps_something_alive_is_called_on_within_a_pause_and_lives_again_if_it_dies_there() {
    let _alone = alone();
    let (a, wish) = toy("a", 1, 500.0);
    let live = LiveSession::start(session(vec![a])).expect("starts");
    eventually("it ticks", || wish.ticks.load(Ordering::Relaxed) > 5);
    assert_eq!(wish.rests.load(Ordering::Relaxed), 0);
    assert!(live.pause(|| {}));
    let (ticks, time) = (wish.ticks.load(Ordering::Relaxed), live.elapsed());
    eventually("it is called on", || wish.rests.load(Ordering::Relaxed) > 4);
    assert!(wish.rested_ns.load(Ordering::Relaxed) >= 150_000_000, "by a clock that runs on");
    wish.panic.store(true, Ordering::Relaxed);
    let before = wish.rests.load(Ordering::Relaxed);
    eventually("its next life is called on as well", || wish.rests.load(Ordering::Relaxed) > before + 3);
    assert_eq!((wish.ticks.load(Ordering::Relaxed), live.elapsed()), (ticks, time), "time stands still");
    assert!(live.resume());
    eventually("it goes on", || wish.ticks.load(Ordering::Relaxed) > ticks + 5);
    let outcome = live.stop(0);
    assert_eq!((outcome.code, outcome.zombies), (0, 0));
}

#[test]
fn a_paused_session_can_be_ended() {
    let _alone = alone();
    let (a, wish) = toy("a", 1, 500.0);
    let live = LiveSession::start(session(vec![a])).expect("starts");
    eventually("it ticks", || wish.ticks.load(Ordering::Relaxed) > 5);
    assert!(live.pause(|| {}));
    assert_eq!(live.health_of("a"), Some(Health::Healthy));
    let outcome = live.stop(0);
    assert_eq!((outcome.code, outcome.zombies), (0, 0));
    assert!(outcome.incidents.is_empty(), "{:?}", outcome.incidents);
}

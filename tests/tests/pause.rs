//! Pausing a session with hands in it: no force while it is paused, and afterwards the exercise goes on.

use std::time::Duration;

use trocar::run::{RunOptions, start};
use trocar::session::Session;
use trocar_scene::SimTime;
use trocar_test_support::alone;
use trocar_tests::app;

fn forces(session: &Session) -> Vec<f64> {
    session.hands().iter().map(|hand| hand.monitor.sample().applied.force.norm()).collect()
}

#[test]
fn a_paused_hand_feels_nothing_and_the_exercise_goes_on_where_it_stood() {
    let _alone = alone();
    let app = app();
    let scenario = app.scenario("wall").expect("it comes with the program");
    // A device that is pushed against the wall with 2 N.
    let hands = vec![("right".to_owned(), "virtual:impedance=off,push_z=2".to_owned())];
    let mut session = start(&app, &scenario, &RunOptions { hands, ..RunOptions::default() }).expect("starts");
    let mut until = SimTime::from_millis(100);
    while forces(&session)[0] < 1.0 {
        assert!(until < SimTime::from_millis(20_000) && session.run_until(until), "it presses");
        until += SimTime::from_millis(10);
    }
    assert!(session.pause());
    let (time, revision) = (session.now(), session.snapshot().revision());
    for _ in 0..20 {
        assert_eq!(forces(&session), [0.0], "a force while it rests");
        std::thread::sleep(Duration::from_millis(25));
    }
    assert!(session.run_until(time + SimTime::from_millis(1)), "it has not ended, and nobody waits for it");
    assert_eq!((session.now(), session.snapshot().revision()), (time, revision));

    assert!(session.resume());
    assert!(session.run_until(time + SimTime::from_millis(3_000)));
    assert!(session.snapshot().revision() > revision);
    // And the wall is felt again. The force at one moment is not checked: a free device that is pushed against a wall
    // takes time to come to rest.
    let mut until = time + SimTime::from_millis(3_000);
    while forces(&session)[0] < 0.5 {
        let limit = time + SimTime::from_millis(20_000);
        assert!(until < limit && session.run_until(until), "it presses again: {:?}", forces(&session));
        until += SimTime::from_millis(10);
    }
    let pressed = session.hands()[0].monitor.sample().statistics;
    assert!(pressed.since_command_ns < 1_000_000_000, "the controller serves its device again: {pressed:?}");
    let finished = session.finish();
    assert!(finished.outcome.incidents.is_empty(), "{:?}", finished.outcome.incidents);
    assert!(finished.driver_errors.is_empty() && finished.outcome.code == 0);
}

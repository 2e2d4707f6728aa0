//! Shipped scenarios live, at their own rates. Punctuality depends on the machine, and is measured by
//! `trocar bench simulator`.

use trocar::app::SCENARIOS;
use trocar::prelude::*;
use trocar_test_support::{alone, thorough};
use trocar_tests::{app, edited, finish, lockstep};

#[test]
fn two_rates_come_to_the_same_and_feel_the_same_live_as_in_virtual_time() {
    let _alone = alone();
    let app = app();
    let scenario = edited(&app, "two-rates", &[]);
    let live = finish(&app, &scenario, &RunOptions::default());
    let task = &live.summary.task;
    assert!(task.completed, "{task:?} {:?}", live.summary.error);
    let row = |name: &str| live.summary.controllers.iter().find(|row| row.name == name).expect("it acts");
    for name in ["organ", "membrane", "haptics.left", "haptics.right"] {
        let row = row(name);
        assert_eq!((row.restarts, row.rejected), (0, 0), "{name}");
    }
    // None blocks another: each has its own rate, in the order of their targets.
    let rates = ["organ", "membrane", "haptics.left"].map(|name| row(name).achieved_hz);
    assert!(rates.windows(2).all(|pair| pair[0] < pair[1]), "{rates:?} Hz");
    // In live time a hand may begin to press at any phase of the organ's steps of 50 ms: its force must be in the range
    // over all phases.
    let begins = "seconds = 1.5, to = [-0.050, 0.0, 0.0]";
    let phases = ["1.50", "1.51", "1.52", "1.53", "1.54"].map(|seconds| {
        let later = begins.replace("1.5,", &format!("{seconds},"));
        finish(&app, &edited(&app, "two-rates", &[(begins, &later)]), &lockstep(1))
    });
    let felt = |of: &trocar::run::RunOutcome, measure: &str| of.summary.task.metrics["outcome"][measure];
    for (measure, tolerance) in [
        ("hand.left.felt_stiffness_n_per_m.mean", 0.1),
        ("hand.right.felt_stiffness_n_per_m.mean", 0.15),
        ("organ.contact_force_n.largest", 0.1),
        // Which of the membrane's steps coincides with the turn of the stroke is chance, and changes the peak by a tenth.
        ("membrane.contact_force_n.largest", 0.15),
    ] {
        let found = felt(&live, measure);
        let expected = phases.each_ref().map(|run| felt(run, measure));
        let (low, high) = expected.iter().fold((f64::INFINITY, 0.0_f64), |(l, h), &f| (l.min(f), h.max(f)));
        println!("{measure}: {found} live, {expected:?} in virtual time");
        assert!(
            (1.0 - tolerance) * low < found && found < (1.0 + tolerance) * high,
            "{measure}: {found} live, {expected:?} otherwise"
        );
    }
}

/// Every shipped exercise in a thorough run, the shortest one by default.
#[test]
fn each_exercise_is_completed_live_unless_the_machine_was_too_slow() {
    let _alone = alone();
    let app = app();
    let shortest = |name: &str| name == "instruments";
    let mut wrong = Vec::new();
    let exercises = SCENARIOS.iter().filter(|(_, text)| text.contains("\n[task]"));
    for (name, _) in exercises.filter(|(name, _)| thorough() || shortest(name)) {
        let scenario = edited(&app, name, &[]);
        let outcome = finish(&app, &scenario, &RunOptions::default());
        let (task, told) = (&outcome.summary.task, outcome.summary.too_slow());
        println!("{name}: completed {}; {told:?}", task.completed);
        assert_eq!(task.disturbed, told.is_some(), "{name}");
        // An exercise may fail only when an actor is named that was too slow.
        if !task.completed && told.is_none() {
            wrong.push(format!("{name}: {task:?} {:?}", outcome.summary.error));
        }
        if outcome.kernel.model.restarts > 0 {
            wrong.push(format!("{name}: the Model starved: {:?}", outcome.kernel.incidents));
        }
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
}

//! Under load a session stays bounded, and completes its exercise or says which actors were too slow.
//!
//! The load is [`PER_PROCESSOR`](trocar_tests::load::PER_PROCESSOR) busy threads per processor beside the session.

use trocar::app::SCENARIOS;
use trocar::prelude::*;
use trocar::run::run;
use trocar_test_support::{alone, thorough};
use trocar_tests::app;
use trocar_tests::bounded::{Bounded, REACH};
use trocar_tests::load::under_load;

/// Longest session time of a scenario in a thorough run, and of the one that is run by default \[s\].
const SECONDS: f64 = 30.0;
const SECONDS_BY_DEFAULT: f64 = 1.5;

#[test]
fn under_load_bodies_stay_bounded_and_who_was_too_slow_is_told() {
    let _alone = alone();
    let app = app();
    let all = SCENARIOS.iter().map(|(name, _)| *name);
    let names: Vec<&str> = if thorough() { all.collect() } else { vec!["omentum"] };
    let seconds = Some(if thorough() { SECONDS } else { SECONDS_BY_DEFAULT });
    let mut wrong = Vec::new();
    for name in names {
        let scenario = app.scenario(name).expect("a shipped scenario");
        let options = RunOptions { seconds, ..RunOptions::default() };
        let mut seen = None;
        let outcome = under_load(|| {
            run(&app, &scenario, &options, &mut |progress| {
                let seen = seen.get_or_insert_with(|| Bounded::around(progress.scene));
                // The stones of the gallery are thrown through the detectors and fly on.
                seen.reach_max = if name == "collision-gallery" { f64::INFINITY } else { REACH };
                seen.look(progress.scene);
            })
        });
        let outcome = outcome.expect("the session starts");
        if outcome.kernel.model.restarts > 0 {
            wrong.push(format!("{name}: the Model starved: {:?}", outcome.kernel.incidents));
        }
        let summary = outcome.summary;
        let seen = seen.expect("it was looked at");
        let told = summary.too_slow();
        println!(
            "{name}: {:.2} m/s ({}), {:.1} mm ({}); {told:?} {:?}",
            seen.speed,
            seen.fastest,
            seen.reach * 1e3,
            seen.farthest,
            seen.wrong
        );
        wrong.extend(seen.wrong.iter().map(|wrong| format!("{name}: {wrong}")));
        // A driver that the machine keeps waiting holds its force meanwhile, but no command of an actor counts for longer.
        if !(summary.task.completed || summary.task.cut_off || told.is_some()) {
            wrong.push(format!("{name}: not completed, and nobody was too slow: {:?}", summary.task));
        }
        assert_eq!(summary.task.disturbed, told.is_some());
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
}

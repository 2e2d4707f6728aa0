//! The peg transfer as a whole, in lock-step.

use trocar::prelude::*;
use trocar::summary::Exit;
use trocar_test_support::{median, thorough};
use trocar_tests::{app, finish, for_seeds, lockstep, peg_transfer};

/// The scenario with our impulse-based rigid bodies instead of the engine's.
const BY_IMPULSES: (&str, &str) = (r#"kind = "rapier""#, r#"kind = "rigid-bodies""#);

#[test]
fn an_expert_completes_the_exercise_within_the_physical_limits() {
    for replacements in [&[][..], &[BY_IMPULSES]] {
        completes(replacements);
    }
}

fn completes(replacements: &[(&str, &str)]) {
    let app = app();
    let outcome = finish(&app, &peg_transfer(&app, replacements), &lockstep(1));
    let summary = &outcome.summary;
    assert!(summary.task.completed, "{:?}", summary.task);
    assert!(
        summary.task.errors.iter().all(|error| error.kind != "drop_out_of_view"),
        "{:?}",
        summary.task.errors
    );
    assert!((60.0..=150.0).contains(&summary.task.seconds), "{} s", summary.task.seconds);
    assert!(summary.task.score.is_some_and(|score| score > 40.0), "{:?}", summary.task.score);
    assert!(summary.penetration_max <= 1e-4, "penetration {} m", summary.penetration_max);
    assert!(summary.force_newtons_max <= 3.3 + 1e-9, "force {} N", summary.force_newtons_max);
    for row in &summary.controllers {
        assert_eq!((row.missed, row.dropped, row.rejected, row.restarts), (0, 0, 0, 0), "{}", row.name);
        let ticks = (summary.sim_secs * row.target_hz).ceil() as u64;
        assert!(row.scheduled.abs_diff(ticks) <= 1, "{}: {} ticks for {ticks}", row.name, row.scheduled);
    }
}

/// A referee that ends the exercise before everything was done, as when a ring has fallen out of reach.
struct Referee;
impl Controller for Referee {
    fn access(&self) -> Access {
        Access::new().contributes::<TaskState>()
    }
    fn tick(&mut self, tick: &Tick, _: &Snapshot, out: &mut Commands) -> Result<(), ControllerError> {
        let over = tick.time >= SimTime::from_millis(500);
        out.contribute(TaskState { over, score: Some(42.0), ..TaskState::default() });
        Ok(())
    }
}

#[test]
fn an_exercise_that_ends_uncompleted_ends_the_session_and_is_a_failure() {
    let app = App::new().controller_with("referee", |(): &(), _| Ok(Referee)).joins("referee", 100.0);
    let scenario = app.scenario("wall").expect("a scenario");
    let summary = finish(&app, &scenario, &RunOptions { seconds: Some(5.0), ..lockstep(1) }).summary;
    assert!(summary.sim_secs < 1.0, "nobody waits for the end of its time: {} s", summary.sim_secs);
    assert!(!summary.task.completed && !summary.task.cut_off, "{:?}", summary.task);
    assert_eq!((summary.task.score, summary.exit(false)), (Some(42.0), Exit::Failed));
}

#[test]
fn a_left_handed_expert_completes_the_mirrored_exercise() {
    let app = app();
    let mut options = lockstep(2);
    options.left_handed = true;
    let outcome = finish(&app, &peg_transfer(&app, &[]), &options);
    assert!(outcome.summary.task.completed, "{:?}", outcome.summary.task);
    assert!(outcome.summary.task.errors.iter().all(|error| error.kind != "wrong_hand"));
}

/// The scorer reads poses only, never the skill. Seeds of each skill, compared by their medians: one, or twenty in a
/// thorough run.
#[test]
fn score_and_motion_rank_expert_above_intermediate_above_novice() {
    let app = app();
    let scenario = peg_transfer(&app, &[]);
    let seeds: Vec<u64> = (100..100 + if thorough() { 20 } else { 1 }).collect();
    let mut rows = Vec::new();
    for skill in ["expert", "intermediate", "novice"] {
        let figures = for_seeds(&seeds, |seed| {
            let mut options = lockstep(seed);
            options.skill = Some(skill.to_owned());
            let task = finish(&app, &scenario, &options).summary.task;
            let path: f64 = task.metrics.values().filter_map(|hand| hand.get("path_length_m")).sum();
            (task.score.unwrap_or(0.0), task.seconds, path)
        });
        let column =
            |pick: fn(&(f64, f64, f64)) -> f64| median(&figures.iter().map(pick).collect::<Vec<_>>());
        rows.push((column(|f| f.0), column(|f| f.1), column(|f| f.2)));
        println!(
            "{skill}: score {:.1}, {:.1} s, path {:.2} m",
            rows[rows.len() - 1].0,
            rows[rows.len() - 1].1,
            rows[rows.len() - 1].2
        );
    }
    assert!(rows[0].0 > rows[1].0 && rows[1].0 > rows[2].0, "scores {rows:?}");
    assert!(rows[0].1 < rows[1].1 && rows[1].1 < rows[2].1, "times {rows:?}");
    assert!(rows[0].2 < rows[2].2, "paths {rows:?}");
    // Paths of neighbouring skills are so alike that it takes twenty seeds to rank them.
    assert!(!thorough() || (rows[0].2 < rows[1].2 && rows[1].2 < rows[2].2), "paths {rows:?}");
    assert!((60.0..=150.0).contains(&rows[0].1), "median expert time {} s", rows[0].1);
}

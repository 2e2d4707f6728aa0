//! Tele-surgery over a packet reflector: the paper's experiment in virtual time, and with real datagrams.

mod copies;
mod current;
mod feedback;
mod robots;
mod scaling;

use trocar::run::{RunOptions, RunOutcome, run, start};
use trocar::session::Session;
use trocar::summary::TeleoperationFigures;
use trocar_scene::{Hand, SimTime, SlaveOrder, SlaveState, Teleoperation};
use trocar_tests::{app, edited, finish, lockstep};

fn figures(outcome: &RunOutcome) -> TeleoperationFigures {
    *outcome.summary.teleoperation.get("right").expect("a slave")
}

/// The round trip of [`over`] in these tests \[s\].
const PATH: f64 = 0.150;

/// The trainee does this in place of what the scenario says.
fn steps(steps: &str) -> (String, String) {
    let text = scenario_text();
    let begin = text.find("\nstep = [").expect("a path") + 1;
    let end = begin + text[begin..].find("\n]\n").expect("its end") + 3;
    (text[begin..end].to_owned(), format!("step = [\n{steps}\n]\n"))
}

/// A path of this mean round trip, with these further lines.
fn over(lines: &str, round_trip_secs: f64) -> (String, String) {
    ("round_trip_secs = 0.15057".to_owned(), format!("{lines}\nround_trip_secs = {round_trip_secs}"))
}

fn scenario_text() -> &'static str {
    let (_, text) = trocar::app::SCENARIOS
        .iter()
        .find(|(name, _)| *name == "tele-liver")
        .expect("it is part of the program");
    text
}

/// A session in virtual time of the scenario with pieces of it replaced.
fn starting(replacements: &[(String, String)]) -> Session {
    let app = app();
    let replacements: Vec<(&str, &str)> =
        replacements.iter().map(|(from, to)| (from.as_str(), to.as_str())).collect();
    start(&app, &edited(&app, "tele-liver", &replacements), &lockstep(1)).expect("it starts")
}

/// A few seconds of the scenario, with pieces of it replaced.
fn part(seconds: f64, replacements: &[(&str, &str)]) -> RunOutcome {
    let app = app();
    let options = RunOptions { seconds: Some(seconds), ..lockstep(1) };
    finish(&app, &edited(&app, "tele-liver", replacements), &options)
}

#[test]
fn the_experiment_of_the_paper_holds_its_bars_in_virtual_time() {
    let app = app();
    let outcome = finish(&app, &edited(&app, "tele-liver", &[]), &lockstep(1));
    assert!(outcome.summary.task.completed, "{:?}", outcome.summary.task);
    assert_eq!(outcome.summary.contacts_not_kept, 0, "{:?}", outcome.summary.unkept_contacts);
    let figures = figures(&outcome);
    println!("{figures:?}");
    let known = |value: Option<f64>| value.expect("it is known");
    assert!((known(figures.round_trip_mean) - 0.150_57).abs() < 0.001);
    assert!(known(figures.delay_error_max) < 1e-6 && known(figures.applied_error_max) < 1e-6);
    // What a constant lag leaves is the variation of the path; without it the slave is a round trip behind.
    let (rms, left) = (known(figures.rms), known(figures.constant_lag_rms));
    assert!(left < 0.0005 && rms > 10.0 * left, "{rms} m, {left} m");
    // The round trip, and two steps of drivers.
    assert!((known(figures.constant_lag) - known(figures.round_trip_mean)).abs() < 0.003);
    assert_eq!((figures.late, figures.refused, figures.limited), (0, 0, 0));
    // One packet a millisecond, and those of the last round trip are under way.
    assert!(figures.sent - figures.received < 200 && figures.received > 35_000, "{figures:?}");
    // The current was on for as long as the foot was down: 0.3 s, 3 s, and 2 s.
    assert!(
        (figures.energised - 5.3).abs() < 0.05 && (figures.stops, figures.silences) == (0, 0),
        "{figures:?}"
    );
    // Both figures of the report have their lines.
    let trace = &outcome.trace.teleoperations["right"];
    assert!(trace.master_x.len() > 500 && trace.slave_x.len() > 500 && trace.round_trip.len() > 500);
}

#[test]
fn the_same_seed_gives_the_same_bits_and_another_path_another_motion() {
    let hash = |replacements: &[(&str, &str)]| part(2.0, replacements).summary.state_hash;
    let one = hash(&[]);
    assert_eq!(one, hash(&[]));
    assert_ne!(one, hash(&[("seed = 1\n", "seed = 2\n")]));
    assert_ne!(one, hash(&[("round_trip_secs = 0.15057", "round_trip_secs = 0.3")]));
}

#[test]
fn a_bad_path_costs_packets_and_never_makes_the_slave_jump() {
    let path = "seed = 1\nloss = 0.05\nburst = 5\nduplicate = 0.02\nreorder = 0.02\ncorrupt = 0.02\n";
    let outcome = part(5.0, &[("seed = 1\n", path)]);
    let figures = figures(&outcome);
    let lost = 1.0 - figures.received as f64 / figures.sent as f64;
    // 5 % lost, 2 % damaged, and a round trip of them under way.
    assert!((0.07..0.14).contains(&lost), "{lost}");
    assert!(figures.refused > 50 && figures.late > 20, "{figures:?}");
    assert!(figures.applied_error_max.expect("known") < 0.001, "{figures:?}");
}

#[test]
fn a_slave_that_is_too_slow_is_behind_and_says_so() {
    let slow = part(5.0, &[("linear_speed = 1.0", "linear_speed = 0.03")]);
    let figures = figures(&slow);
    assert!(figures.applied_error_max.expect("known") > 0.002 && figures.limited > 500, "{figures:?}");
}

#[test]
fn an_emergency_stop_holds_the_slave_where_it_is() {
    let app = app();
    let mut session = start(&app, &edited(&app, "tele-liver", &[]), &lockstep(1)).expect("it starts");
    session.run_until(SimTime::from_millis(3_000));
    let hand = session.snapshot().iter::<Hand>().next().expect("a hand").0;
    let row = |session: &mut trocar::session::Session| {
        session.snapshot().get::<Teleoperation>(hand).cloned().expect("it is told")
    };
    assert_eq!(row(&mut session).state, SlaveState::Following);
    session.apply(|out| out.put(hand, SlaveOrder { stop: true })).expect("it is written");
    session.step(SimTime::from_millis(20));
    let stopped = row(&mut session);
    session.step(SimTime::from_millis(500));
    let later = row(&mut session);
    assert_eq!((stopped.state, later.state), (SlaveState::Stopped, SlaveState::Stopped));
    assert_eq!(stopped.slave_in_world.translation, later.slave_in_world.translation);
    assert_ne!(stopped.master_in_world.translation, later.master_in_world.translation);
    // It follows again from where it is, and does not go to where the master is.
    session.apply(|out| out.put(hand, SlaveOrder { stop: false })).expect("it is written");
    session.step(SimTime::from_millis(10));
    let resumed = row(&mut session);
    assert_eq!(resumed.state, SlaveState::Following);
    let moved = (resumed.slave_in_world.translation - later.slave_in_world.translation).norm();
    assert!(moved < 0.002, "{moved} m");
}

#[test]
fn live_the_packets_go_through_real_sockets_and_take_at_least_their_time() {
    let app = app();
    let scenario = edited(&app, "tele-liver", &[]);
    let options = RunOptions { seconds: Some(2.5), ..RunOptions::default() };
    let outcome = run(&app, &scenario, &options, &mut |_| {}).expect("it starts");
    let figures = figures(&outcome);
    println!("{figures:?}");
    assert!(figures.received > 100, "{figures:?}");
    // However late the machine is, no packet is early: the shortest delay of the trace is above 140 ms.
    assert!(figures.round_trip_min.expect("known") > 0.140, "{figures:?}");
    assert_eq!(figures.refused, 0);
}

#[test]
fn what_a_scenario_says_of_its_reflector_is_checked_with_its_place() {
    let app = app();
    let refused = |from: &str, to: &str| {
        let scenario = edited(&app, "tele-liver", &[(from, to)]);
        start(&app, &scenario, &lockstep(1)).err().expect("it is refused").to_string()
    };
    for (from, to, says) in [
        ("hands = [\"right\"]", "hands = [\"left\"]", "no hand is called 'left'; there are: right"),
        ("hands = [\"right\"]", "hands = []", "names the hands behind it; there are: right"),
        ("round_trip_secs = 0.15057", "round_trip_secs = 61.0", "round_trip_secs: 61 is out of range"),
        ("seed = 1\n", "seed = 1\nloss = 2.0\n", "loss: 2 is out of range (0 to 1)"),
        ("linear_speed = 1.0", "linear_speed = 0.0", "linear_speed = 0 is out of range"),
        ("force_max = 3.0", "force_max = 30.0", "a device tells no more than it can render"),
        ("force_max = 3.0", "forse_max = 3.0", "forse_max"),
    ] {
        let error = refused(from, to);
        assert!(error.contains(says), "{to}: {error}");
    }
    let options = RunOptions { reflector: Some(([127, 0, 0, 1], 9).into()), ..RunOptions::default() };
    let error = start(&app, &edited(&app, "wall", &[]), &options).err().expect("it is refused").to_string();
    assert!(error.contains("no hand of this scenario") && error.contains("tele-liver"), "{error}");
}

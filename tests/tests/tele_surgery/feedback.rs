//! What the master's hand feels of what its slave touches, over a delay: as much as without a network, and nothing swings.
//!
//! The hand is the virtual one, an arm of 500 N/m at a device of 3.3 N, and the instrument's coupling to the wall has
//! 1,000 N/m. The delay is the loop's: from a motion of the hand to the force that it gets for it, there and back.

use nalgebra::Vector3;
use trocar::session::Session;
use trocar_scene::{DeviceState, ForceFeedback, Hand, SimTime, SlaveOrder, Teleoperation};
use trocar_test_support::thorough;
use trocar_tests::{app, edited, lockstep};

/// Moves in the free, presses 6 mm into the wall twice, and is in the free again.
const PRESSES: &str = r#"
[task]
seconds = 30.0
[[controller]]
name = "trainee"
kind = "path"
rate_hz = 200
[controller.params]
hand = "hand.right"
step = [
    { seconds = 1.5 },
    { seconds = 0.5, to = [0.010, 0.0, 0.020] },
    { seconds = 0.5, to = [-0.010, 0.0, 0.020] },
    { seconds = 0.5, to = [0.0, 0.0, 0.010] },
    { seconds = 1.0, to = [0.0, 0.0, -0.006] },
    { seconds = 4.0 },
    { seconds = 1.0, to = [0.0, 0.0, 0.010] },
    { seconds = 1.0 },
    { seconds = 1.0, to = [0.0, 0.0, -0.006] },
    { seconds = 9.0 },
    { seconds = 1.0, to = [0.0, 0.0, 0.010] },
    { seconds = 4.0 },
]
"#;
/// When the first press ends, and when the second does \[ms\].
const ENDS: [u64; 2] = [7_900, 19_900];
/// When the hand is in the free again \[ms\].
const FREE: u64 = 25_000;

/// The wall with that trainee, with these lines, and with replacements.
fn wall_with(lines: &str, replacements: &[(&str, &str)]) -> Session {
    let app = app();
    let controllers = "[[controller]]\nname = \"haptics.right\"";
    let text = format!("{lines}\n{PRESSES}\n{controllers}");
    let all = [&[(controllers, text.as_str())], replacements].concat();
    trocar::run::start(&app, &edited(&app, "wall", &all), &lockstep(1)).expect("it starts")
}

fn wall(lines: &str) -> Session {
    wall_with(lines, &[])
}

/// A reflector that brings every packet back after half of the loop's delay.
fn reflector(loop_secs: f64, more: &str) -> String {
    let one_way = 0.5 * loop_secs;
    format!("[network.reflector]\nhands = [\"right\"]\nvaries = false\nround_trip_secs = {one_way}\n{more}")
}

fn over(loop_secs: f64, more: &str) -> Session {
    wall(&reflector(loop_secs, more))
}

fn told(session: &mut Session) -> Option<Teleoperation> {
    let scene = session.snapshot();
    let (hand, _) = scene.iter::<Hand>().next().expect("a hand");
    scene.get::<Teleoperation>(hand).cloned()
}

/// What comes of a session.
#[derive(Debug, Default)]
struct Outcome {
    /// Force over depth of the hand at the end of each press [N/m].
    stiffness: [f64; 2],
    /// Difference of the largest and the least force, while the hand presses for the second time, in its first two seconds
    /// and in its last two \[N\].
    swing: [f64; 2],
    /// Energy that the hand has got from its device, at most \[J\].
    gained: f64,
    /// Force in the free, at the end \[N\].
    left: f64,
}

fn direct() -> Outcome {
    let mut session = wall("");
    let mut outcome = Outcome::default();
    for (stiffness, end) in outcome.stiffness.iter_mut().zip(ENDS) {
        session.run_until(SimTime::from_millis(end));
        let scene = session.snapshot();
        let (_, device) = scene.iter::<DeviceState>().next().expect("a hand");
        // The device's z axis points down, and the tip is 10 mm above the wall at its origin.
        *stiffness = -device.applied_force.z / (device.handle_in_device.translation.z - 0.010);
    }
    outcome
}

fn outcome(mut session: Session) -> Outcome {
    let mut outcome = Outcome::default();
    let (mut work, mut before, mut range) = (0.0, None, [(f64::INFINITY, f64::NEG_INFINITY); 2]);
    for ms in (0..FREE).step_by(2) {
        session.run_until(SimTime::from_millis(ms));
        let Some(row) = told(&mut session) else { continue };
        let place = row.master_in_world.translation;
        if let Some((held, was)) = before.replace((row.felt_in_world, place)) {
            let (held, was): (Vector3<f64>, Vector3<f64>) = (held, was);
            work -= held.dot(&(place - was));
            outcome.gained = outcome.gained.max(-work);
        }
        for (stiffness, _) in outcome.stiffness.iter_mut().zip(ENDS).filter(|(_, end)| *end == ms) {
            *stiffness = row.felt_in_world.z / -place.z;
        }
        for (range, from) in range.iter_mut().zip([ENDS[1] - 9_000, ENDS[1] - 2_000]) {
            if (from..from + 2_000).contains(&ms) {
                *range = (range.0.min(row.felt_in_world.z), range.1.max(row.felt_in_world.z));
            }
        }
        outcome.left = row.felt_in_world.norm();
    }
    outcome.swing = range.map(|(low, high)| high - low);
    outcome
}

#[test]
fn a_wall_is_felt_over_every_delay_and_the_hand_gets_no_energy() {
    let undelayed = direct();
    let methods = ["passivity", "wave-variables", "model-mediated"];
    let loops: &[f64] = if thorough() { &[0.0, 0.05, 0.1, 0.3, 1.0] } else { &[0.1, 1.0] };
    let paths: &[&str] =
        if thorough() { &["", "loss = 0.05", "loss = 0.2", "loss = 0.1\nburst = 10"] } else { &[""] };
    for method in methods {
        for &loop_secs in loops {
            for path in paths {
                let felt = outcome(over(loop_secs, &format!("feedback = \"{method}\"\n{path}")));
                let shares = [0, 1].map(|press| felt.stiffness[press] / undelayed.stiffness[press]);
                let case = format!("{method} {loop_secs} s {path}: {shares:.2?} {felt:?}");
                println!("{case}");
                assert!(felt.gained <= 1e-3, "{case}");
                // Waves go to and fro in the line for a while.
                assert!(felt.swing[1] <= felt.swing[0].max(0.05) && felt.left < 1e-3, "{case}");
                // A model is as stiff as what it is a model of, once it is known; of waves a stiff arm loses most in bursts.
                let least = match method {
                    "model-mediated" => 0.95,
                    "wave-variables" if path.contains("burst") => 0.02,
                    _ if loop_secs <= 0.1 => 0.5,
                    _ => 0.02,
                };
                assert!(shares[1] > least && shares[1] < 1.2, "{case}");
            }
        }
    }
}

#[test]
fn automatic_is_passive_by_energy_over_a_short_path_and_by_a_model_over_a_long_one() {
    for (loop_secs, method) in [(0.2, ForceFeedback::Passivity), (0.6, ForceFeedback::ModelMediated)] {
        let mut session = over(loop_secs, "feedback = \"automatic\"");
        session.run_until(SimTime::from_millis(ENDS[0]));
        let row = told(&mut session).expect("it is told");
        assert_eq!(row.feedback, method);
        assert!(row.words().contains(method.words()), "{}", row.words());
        assert!(row.felt_in_world.z > 0.3, "{}", row.felt_in_world);
    }
}

#[test]
fn the_force_of_a_slave_that_moves_half_as_far_is_felt_as_half() {
    let feedback = "feedback = \"model-mediated\"\nslave = { scale = 0.5, force_max = 3.0 }";
    // The slave is at half of where the hand is, from where both began.
    let mut session = over(0.2, feedback);
    session.run_until(SimTime::from_millis(ENDS[1]));
    let row = told(&mut session).expect("it is told");
    assert!(row.force_in_world.z == 0.0, "8 mm down are not down to the wall: {}", row.force_in_world);
    let mut session = wall_with(&reflector(0.2, feedback), &[("-0.006]", "-0.018]")]);
    session.run_until(SimTime::from_millis(ENDS[1]));
    let row = told(&mut session).expect("it is told");
    let (felt, there) = (row.felt_in_world.z, row.force_in_world.z);
    assert!(there > 0.5 && (felt / there - 0.5).abs() < 0.03, "{felt} N of {there} N");
    let share = row.figures.felt_share.expect("it was felt");
    assert!((0.7..1.05).contains(&share), "{share}");
}

#[test]
fn a_slave_that_was_stopped_at_a_wall_is_not_felt_and_one_that_follows_again_is() {
    for method in ["passivity", "wave-variables", "model-mediated"] {
        let mut session = over(0.2, &format!("feedback = \"{method}\""));
        let order = |session: &mut Session, stop: bool, until: u64| {
            let hand = session.snapshot().iter::<Hand>().next().expect("a hand").0;
            session.apply(|out| out.put(hand, SlaveOrder { stop })).expect("it is written");
            session.run_until(SimTime::from_millis(until));
            told(session).expect("it is told").felt_in_world.norm()
        };
        session.run_until(SimTime::from_millis(5_500));
        let before = told(&mut session).expect("it is told").felt_in_world.norm();
        assert!(before > 0.5, "{method}: {before} N");
        let stopped = order(&mut session, true, 7_500);
        assert!(stopped < 0.05, "{method}: {stopped} N");
        let again = order(&mut session, false, ENDS[1]);
        assert!(again > 0.5, "{method}: {again} N");
    }
}

//! What the master's hand feels of what its slave touches, over a delay: as much as without a network, and nothing swings.
//!
//! The hand is the virtual one, an arm of 500 N/m at a device of 3.3 N, and the instrument's coupling to the wall has
//! 1,000 N/m. The delay is the loop's: from a motion of the hand to the force that it gets for it, there and back.

use trocar::session::Session;
use trocar_scene::{DeviceState, ForceFeedback, Hand, SimTime, SlaveOrder, Teleoperation};
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
const ENDS: [u64; 2] = [8_900, 19_900];
/// When the hand is in the free again \[ms\].
const FREE: u64 = 25_000;

/// The wall with that trainee, and with these lines.
fn wall(lines: &str) -> Session {
    let app = app();
    let controllers = "[[controller]]\nname = \"haptics.right\"";
    let text = format!("{lines}\n{PRESSES}\n{controllers}");
    let scenario = edited(&app, "wall", &[(controllers, &text)]);
    trocar::run::start(&app, &scenario, &lockstep(1)).expect("it starts")
}

/// The wall behind a reflector that brings every packet back after half of the loop's delay.
fn over(loop_secs: f64, more: &str) -> Session {
    wall(&format!(
        "[network.reflector]\nhands = [\"right\"]\nvaries = false\nround_trip_secs = {}\n{more}",
        0.5 * loop_secs
    ))
}

fn row(session: &mut Session) -> Teleoperation {
    let scene = session.snapshot();
    let (hand, _) = scene.iter::<Hand>().next().expect("a hand");
    scene.get::<Teleoperation>(hand).cloned().expect("it is told")
}

/// Force on the hand, upwards \[N\], and how deep the hand is below the wall's surface \[m\].
fn felt(session: &mut Session, direct: bool) -> (f64, f64) {
    if !direct {
        let row = row(session);
        return (row.felt_in_world.z, -row.master_in_world.translation.z);
    }
    let scene = session.snapshot();
    let (_, device) = scene.iter::<DeviceState>().next().expect("a hand");
    // The device's z axis points down, and the tip is 10 mm above the wall at its origin.
    (-device.applied_force.z, device.handle_in_device.translation.z - 0.010)
}

/// What comes of a session.
#[derive(Debug)]
struct Outcome {
    /// Force over depth of the hand at the end of each press [N/m].
    stiffness: [f64; 2],
    /// Largest difference of two forces in the last second of each press \[N\].
    ripple: [f64; 2],
    /// Energy that the hand has got from its device, at most \[J\].
    gained: f64,
    /// Force in the free, at the end \[N\].
    left: f64,
}

fn outcome(mut session: Session, direct: bool) -> Outcome {
    let mut outcome = Outcome { stiffness: [0.0; 2], ripple: [0.0; 2], gained: 0.0, left: 0.0 };
    let (mut work, mut before): (f64, Option<(f64, f64)>) = (0.0, None);
    for ms in (0..FREE).step_by(2) {
        session.run_until(SimTime::from_millis(ms));
        if ms < 1_500 {
            continue;
        }
        let (force, depth) = felt(&mut session, direct);
        if let Some((held, was)) = before.replace((force, depth)) {
            work += held * (depth - was);
            outcome.gained = outcome.gained.max(-work);
        }
        for press in 0..2 {
            if (ENDS[press] - 1_000..=ENDS[press]).contains(&ms) {
                outcome.stiffness[press] = force / depth;
                let [low, high] = &mut [outcome.ripple[press], force];
                outcome.ripple[press] = low.max(high.abs());
            }
        }
        outcome.left = force;
    }
    outcome
}

#[test]
fn a_wall_is_felt_over_every_delay_by_every_method() {
    let direct = outcome(wall(""), true);
    println!("direct {direct:?}");
    for method in ["passivity", "wave-variables", "model-mediated", "automatic"] {
        for loop_secs in [0.0, 0.1, 0.3, 1.0] {
            let over = outcome(over(loop_secs, &format!("feedback = \"{method}\"")), false);
            println!(
                "{method} {loop_secs} {:.2} {:.2} {over:?}",
                over.stiffness[0] / direct.stiffness[0],
                over.stiffness[1] / direct.stiffness[1]
            );
        }
    }
}

//! A slave with scaled motions, a tremor filter and a clutch, over the whole path.

use trocar::session::Session;
use trocar_scene::{Hand, SimTime, SlaveState, Teleoperation};

use super::{over, starting, steps};

/// The master goes to and fro; between, its button is up while it goes back (indexing).
const INDEXING: &str = "
    { seconds = 0.3, buttons = 1 },
    { seconds = 0.8, to = [0.020, -0.005, 0.060] },
    { seconds = 0.2 },
    { seconds = 0.2, buttons = 0 },
    { seconds = 0.8, to = [-0.020, -0.005, 0.054] },
    { seconds = 0.2 },
    { seconds = 0.2, buttons = 1 },
    { seconds = 0.8, to = [0.020, -0.005, 0.060] },
    { seconds = 0.5 },
";

fn row(session: &mut Session) -> Teleoperation {
    let scene = session.snapshot();
    let (hand, _) = scene.iter::<Hand>().next().expect("a hand");
    scene.get::<Teleoperation>(hand).cloned().expect("it is told")
}

fn slave(more: &str) -> (String, String) {
    let from = "slave = { linear_speed = 1.0, force_max = 3.0 }".to_owned();
    (from, format!("slave = {{ linear_speed = 1.0, force_max = 3.0, {more} }}"))
}

#[test]
fn scaled_filtered_and_clutched_the_slave_is_within_a_tenth_of_a_millimetre_of_what_it_applies() {
    for (more, round_trip_secs) in [
        ("scale = 0.3, pedal = 0", 0.15057),
        ("scale = 0.3, pedal = 0, tremor_cutoff_hz = 2.5", 0.15057),
        ("scale = 0.3, pedal = 0, tremor_cutoff_hz = 2.5", 1.0),
    ] {
        let mut session = starting(&[steps(INDEXING), slave(more), over("", round_trip_secs)]);
        let delay = SimTime::from_secs_f64(round_trip_secs + 0.05);
        session.run_until(SimTime::from_millis(1_400) + delay);
        let forth = row(&mut session);
        session.run_until(SimTime::from_millis(2_400) + delay);
        let back = row(&mut session);
        assert_eq!(back.state, SlaveState::PedalUp);
        session.run_until(SimTime::from_millis(4_000) + delay);
        let again = row(&mut session);
        let x = |row: &Teleoperation| row.slave_in_world.translation.x;
        // 0.3 of 40 mm each time, and nothing while the master goes back.
        let [first, between, second] = [x(&forth) + 0.020, x(&back) - x(&forth), x(&again) - x(&back)];
        assert!((first - 0.012).abs() < 5e-4, "{more}: {first}");
        assert!(between.abs() < 1e-6, "{more}: {between}");
        assert!((second - 0.012).abs() < 5e-4, "{more}: {second}");
        let error = again.figures.applied_error_max.expect("it is known");
        assert!(error <= 1e-4, "{more}: {error} m");
        assert_eq!(again.figures.limited, 0, "{more}");
    }
}

//! Console and robot over a link that loses packets: the fault of increments, measured.

use nalgebra::UnitQuaternion;
use trocar_scene::SimTime;
use trocar_scene::random::SplitMix64;

use super::packet::CONSOLE_MATRIX_BYTES;
use super::peer_tests::hands;
use super::*;

/// A minute at a kilohertz.
const TICKS: u64 = 60_000;

/// What a minute over a link with this share of losses left.
struct Left {
    console: Console,
    robot: Robot,
    /// Sum of the increments that were lost or not applied, of both arms \[µm\].
    unapplied_um: [[i64; 3]; ARMS],
    lost: u64,
}

impl Left {
    /// Where each arm is, seen from where the console has it \[µm\].
    fn offset_um(&self) -> [[i64; 3]; ARMS] {
        [0, 1].map(|arm| {
            let [robot, sent] = [self.robot.arm(arm), self.console.sent(arm)];
            [0, 1, 2].map(|axis| robot.position_um_in_robot[axis] - sent.position_um_in_robot[axis])
        })
    }

    /// Angle between where each arm is turned and where the console has it \[rad\].
    fn turned_apart(&self) -> [f64; ARMS] {
        [0, 1].map(|arm| {
            let rotation: &UnitQuaternion<f64> = &self.robot.arm(arm).rotation_in_robot;
            rotation.angle_to(&self.console.sent(arm).rotation_in_robot)
        })
    }
}

/// Two hands move for a minute; the pedal is pressed after 20 ms. Losses end 10 ms before the minute does.
fn minute(dialect: Dialect, lenient: bool, loss: f64) -> Left {
    let mut console =
        Console::new(ConsoleConfig { dialect, ..ConsoleConfig::default() }).expect("it makes sense");
    let config = RobotConfig { dialect, lenient, ..RobotConfig::default() };
    let mut robot = Robot::new(config).expect("it makes sense");
    robot.set_condition(Condition::Ready);
    let mut random = SplitMix64::new(22);
    let (mut unapplied_um, mut lost, mut after_loss) = ([[0; 3]; ARMS], 0, false);
    for tick in 0..TICKS {
        let before = [0, 1].map(|arm| console.sent(arm).position_um_in_robot);
        let packet = console.command(&hands(tick as f64 * 1e-3), tick >= 20);
        // The first packets set up both ends.
        let is_lost = random.unit() < loss && (20..TICKS - 10).contains(&tick);
        if !is_lost {
            let mut out = [0; CONSOLE_MATRIX_BYTES];
            robot.receive(packet.encode(&mut out), SimTime::from_millis(tick)).expect("it is a packet");
        }
        if is_lost || (after_loss && !lenient) {
            for arm in 0..ARMS {
                for axis in 0..3 {
                    let sent = console.sent(arm).position_um_in_robot[axis];
                    unapplied_um[arm][axis] += sent - before[arm][axis];
                }
            }
        }
        lost += u64::from(is_lost);
        after_loss = is_lost;
    }
    Left { console, robot, unapplied_um, lost }
}

#[test]
fn a_minute_with_one_percent_of_loss_leaves_exactly_the_unapplied_increments() {
    for lenient in [false, true] {
        let left = minute(Dialect::RAVEN, lenient, 0.01);
        // Binomial, n = 60,000 and p = 0.01: four standard deviations are 97.
        assert!((503..=697).contains(&left.lost), "{} lost", left.lost);
        let offset_um = left.offset_um();
        for (offset, unapplied) in offset_um.as_flattened().iter().zip(left.unapplied_um.as_flattened()) {
            assert!((offset + unapplied).abs() <= 1, "{offset} µm, {unapplied} µm were not applied");
        }
        assert!(offset_um.as_flattened().iter().any(|um| um.abs() > 500), "{offset_um:?}: a visible fault");
        assert!(left.turned_apart().iter().all(|angle| *angle > 1e-3), "{:?}", left.turned_apart());
        let counts = left.robot.counts();
        assert_eq!((counts.missed, counts.after_gap > 0), (left.lost, !lenient), "{counts:?}");
    }
}

#[test]
fn with_absolute_poses_the_same_losses_leave_nothing() {
    let absolute = Dialect { position: Meaning::Absolute, rotation: Meaning::Absolute, ..Dialect::RAVEN };
    for dialect in [absolute, Dialect::RAVEN_SIM] {
        let left = minute(dialect, false, 0.01);
        assert!(left.lost > 500 && left.robot.counts().after_gap > 0);
        assert_eq!(left.offset_um(), [[0; 3]; ARMS]);
        assert!(left.turned_apart().iter().all(|angle| *angle < 1e-6));
    }
}

#[test]
fn without_loss_a_minute_of_roundings_leaves_less_than_a_micrometre_to_the_hand() {
    let left = minute(Dialect::RAVEN, false, 0.0);
    assert_eq!(left.offset_um(), [[0; 3]; ARMS]);
    let (began, ended) = (hands(0.020), hands((TICKS - 1) as f64 * 1e-3));
    for arm in 0..ARMS {
        let moved =
            ended[arm].pose_in_console.translation.vector - began[arm].pose_in_console.translation.vector;
        let pose = left.robot.arm(arm).pose_in_robot();
        assert!((pose.translation.vector - moved).amax() <= 0.6e-6, "{pose} for {moved}");
        let turned = ended[arm].pose_in_console.rotation * began[arm].pose_in_console.rotation.inverse();
        assert!(pose.rotation.angle_to(&turned) < 1e-6);
        assert!((left.robot.arm(arm).jaw() - ended[arm].jaw).abs() <= 0.6e-3);
    }
}

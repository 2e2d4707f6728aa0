//! Tests of the console.

use nalgebra::{Quaternion, Translation3};
use proptest::prelude::*;

use super::*;
use crate::itp::peer_tests::hands;
use crate::itp::{Condition, Robot, RobotConfig};

fn console(config: ConsoleConfig) -> Console {
    Console::new(config).expect("it makes sense")
}

fn hand_at(x: f64) -> ConsoleHand {
    ConsoleHand {
        pose_in_console: Isometry3::from_parts(Translation3::new(x, 0.0, 0.0), UnitQuaternion::identity()),
        jaw: 0.0,
        squeeze: 0.0,
        buttons: 0,
    }
}

/// Increments of the left arm along x for a hand at these places, with the pedal down.
fn increments(console: &mut Console, places: &[f64]) -> Vec<i32> {
    places.iter().map(|x| console.command(&[hand_at(*x); ARMS], true).position_um[0][0]).collect()
}

#[test]
fn what_is_rounded_off_goes_out_later() {
    let mut console = console(ConsoleConfig { scale: 0.3, ..ConsoleConfig::default() });
    // 0.3 µm a packet.
    let places: Vec<f64> = (0..=10_000).map(|step| f64::from(step) * 1e-6).collect();
    let sent = increments(&mut console, &places);
    assert!(sent.iter().all(|um| (0..=1).contains(um)));
    assert_eq!(sent.iter().sum::<i32>(), 3_000);
}

#[test]
fn a_released_pedal_lets_the_hand_go_home() {
    let mut console = console(ConsoleConfig::default());
    assert_eq!(increments(&mut console, &[0.5, 0.5001, 0.5002]), [0, 100, 100]);
    let lifted = console.command(&[hand_at(0.3); ARMS], false);
    assert_eq!((lifted.position_um, lifted.surgeon_mode), ([[0; 3]; ARMS], 0));
    assert_eq!(lifted.rotations, Rotations::Quaternions([[0.0, 0.0, 0.0, 1.0]; ARMS]));
    assert_eq!(increments(&mut console, &[0.1, 0.1003]), [0, 300], "the press is no motion");
    assert_eq!(console.sent(0).position_um_in_robot, [500, 0, 0]);
    assert_eq!(console.command(&[hand_at(0.1003); ARMS], true).surgeon_mode, 1);
}

#[test]
fn a_hand_that_is_too_fast_is_followed_later_and_not_at_all_once_the_pedal_is_up() {
    let mut console = console(ConsoleConfig::default());
    assert_eq!(increments(&mut console, &[0.0, 0.0025, 0.0025, 0.0025, 0.0025]), [0, 1_000, 1_000, 500, 0]);
    assert_eq!(increments(&mut console, &[1e300]), [1_000]);
    console.command(&[hand_at(0.0); ARMS], false);
    assert_eq!(increments(&mut console, &[0.0, 0.0]), [0, 0], "what was not sent is forgotten");
    let mut turned = hand_at(0.0);
    turned.pose_in_console.rotation = UnitQuaternion::from_euler_angles(0.05, 0.0, 0.0);
    let angles = [0; 4].map(|_| {
        console.command(&[turned; ARMS], true).rotations.rotation(0).expect("it is a rotation").angle()
    });
    for (angle, expected) in angles.into_iter().zip([0.02, 0.02, 0.01, 0.0]) {
        assert!((angle - expected).abs() < 1e-7, "{angles:?}");
    }
}

#[test]
fn rotations_are_not_scaled_and_turn_about_the_axes_of_the_robot() {
    let mut console = console(ConsoleConfig { scale: 0.1, rotation_max: 1.0, ..ConsoleConfig::default() });
    let pose = |yaw: f64| {
        let start = UnitQuaternion::from_euler_angles(1.0, 0.5, -0.2);
        let yaw = UnitQuaternion::from_euler_angles(0.0, 0.0, yaw);
        let mut hand = hand_at(0.0);
        hand.pose_in_console.rotation = yaw * start;
        [hand; ARMS]
    };
    console.command(&pose(0.0), true);
    let packet = console.command(&pose(0.3), true);
    let turned = packet.rotations.rotation(1).expect("it is a rotation");
    assert!(turned.angle_to(&UnitQuaternion::from_euler_angles(0.0, 0.0, 0.3)) < 1e-7);
}

#[test]
fn a_hand_without_a_pose_holds_its_arm_and_then_begins_anew() {
    let mut console = console(ConsoleConfig::default());
    increments(&mut console, &[0.0, 0.0004]);
    let mut lost = hand_at(f64::NAN);
    lost.jaw = f64::INFINITY;
    let packet = console.command(&[lost, hand_at(0.0005)], true);
    assert_eq!(packet.position_um, [[0; 3], [100, 0, 0]], "the other hand goes on");
    assert_eq!(increments(&mut console, &[0.3, 0.3001]), [0, 100], "it comes back elsewhere");
    let mut zero = hand_at(0.0);
    zero.pose_in_console.rotation = UnitQuaternion::new_unchecked(Quaternion::from([0.0; 4]));
    assert_eq!(console.command(&[zero; ARMS], true).position_um, [[0; 3]; ARMS]);
    assert!(console.command(&[hand_at(0.0); ARMS], true).rotations.rotation(0).is_some());
}

#[test]
fn jaws_go_as_torque_as_increment_or_as_angle() {
    let hand = ConsoleHand { jaw: 0.050, squeeze: 0.5, ..hand_at(0.0) };
    let grasps = |grasp: GraspMeaning| {
        let dialect = Dialect { grasp, ..Dialect::RAVEN };
        let mut console = console(ConsoleConfig { dialect, ..ConsoleConfig::default() });
        let down = [0; 4].map(|_| console.command(&[hand; ARMS], true).grasp[1]);
        (down, console.command(&[hand; ARMS], false).grasp[1])
    };
    assert_eq!(grasps(GraspMeaning::Torque), ([16_384; 4], 0));
    assert_eq!(grasps(GraspMeaning::AngleIncrement), ([-20, -20, -10, 0], 0));
    assert_eq!(grasps(GraspMeaning::Angle), ([20, 40, 50, 50], 50));
}

#[test]
fn numbers_go_on_at_one_after_the_last_one() {
    let mut console = console(ConsoleConfig::default());
    assert_eq!(console.command(&hands(0.0), false).sequence, 1);
    console.resume_after(u32::MAX - 1);
    let numbers = [0; 3].map(|_| console.command(&hands(0.0), false).sequence);
    assert_eq!(numbers, [u32::MAX, 1, 2]);
}

#[test]
fn the_newest_reply_counts_and_its_forces_fade_when_no_other_comes() {
    let mut robot = Robot::new(RobotConfig::default()).expect("it makes sense");
    robot.set_condition(Condition::Ready);
    let mut console = console(ConsoleConfig { check_checksum: true, ..ConsoleConfig::default() });
    let ms = SimTime::from_millis;
    assert_eq!(console.forces_in_robot(ms(0)), [Vector3::zeros(); ARMS]);
    let replies =
        [1.0, 2.0].map(|newton| robot.reply(&[Vector3::x() * newton, Vector3::z() * -newton], 5).encode());
    assert_eq!(console.receive(&replies[1], ms(10)), Ok(true));
    assert_eq!(console.receive(&replies[0], ms(11)), Ok(false), "it was overtaken");
    assert_eq!(console.receive(&replies[1], ms(12)), Ok(false), "it came twice");
    let report = *console.report().expect("it came");
    assert_eq!((report.runlevel, report.joint_flags), (Some(Runlevel::PedalUp), 5));
    assert_eq!(console.forces_in_robot(ms(60)), [Vector3::x() * 2.0, Vector3::z() * -2.0]);
    let [half, _] = console.forces_in_robot(ms(85));
    assert!((half - Vector3::x()).amax() < 1e-9, "{half}");
    for late in [110, 5_000] {
        assert_eq!(console.forces_in_robot(ms(late)), [Vector3::zeros(); ARMS]);
    }
    assert!(console.receive(&replies[0][1..], ms(120)).is_err());
    // A robot that was started again begins at 1.
    let far = RobotPacket { sequence: 5_000, ..robot.reply(&[Vector3::zeros(); ARMS], 0) };
    assert_eq!(console.receive(&far.encode(), ms(130)), Ok(true));
    assert_eq!(console.receive(&replies[0], ms(140)), Ok(true));
}

#[test]
fn parameters_without_sense_are_named() {
    let with = |change: fn(&mut ConsoleConfig)| {
        let mut config = ConsoleConfig::default();
        change(&mut config);
        Console::new(config).expect_err("it makes no sense").to_string()
    };
    assert!(with(|config| config.scale = f64::NAN).contains("scale is NaN"));
    assert!(with(|config| config.scale = 0.0).contains("at most 10"));
    assert!(with(|config| config.increment_um_max = 0).contains("1 to 100000 µm"));
    assert!(with(|config| config.rotation_max = -1.0).contains("-1 rad"));
    assert!(with(|config| config.start_jaw[1] = f64::NAN).contains("arm 1"));
    assert!(with(|config| config.start_in_robot[0].translation.x = 1e9).contains("arm 0"));
}

proptest! {
    #[test]
    fn increments_add_up_to_the_hands_way_whatever_the_scale(
        scale in 0.05..3.0_f64,
        steps in proptest::collection::vec(-250e-6..250e-6_f64, 1..400),
    ) {
        let mut console = console(ConsoleConfig { scale, ..ConsoleConfig::default() });
        let mut place = 0.0;
        let places: Vec<f64> = std::iter::once(0.0).chain(steps.iter().map(|step| { place += step; place })).collect();
        let sum: i32 = increments(&mut console, &places).iter().sum();
        prop_assert!((f64::from(sum) - place * scale * 1e6).abs() <= 0.5 + 1e-6);
    }

    #[test]
    fn no_hand_makes_a_packet_that_a_robot_refuses(
        numbers in proptest::collection::vec(proptest::array::uniform10(any::<f64>()), 1..20),
    ) {
        let mut console = console(ConsoleConfig::default());
        for [x, y, z, a, b, c, d, jaw, squeeze, _] in numbers {
            let mut hand = hand_at(x);
            hand.pose_in_console.translation.vector = Vector3::new(x, y, z);
            let rotation = Quaternion::new(a, b, c, d);
            hand.pose_in_console.rotation = if x > 0.0 {
                UnitQuaternion::new_normalize(rotation)
            } else {
                UnitQuaternion::new_unchecked(rotation)
            };
            (hand.jaw, hand.squeeze) = (jaw, squeeze);
            let packet = console.command(&[hand; ARMS], true);
            prop_assert!(packet.position_um.as_flattened().iter().all(|um| um.abs() <= 1_000));
            for arm in 0..ARMS {
                prop_assert!(packet.rotations.rotation(arm).is_some_and(|turn| turn.angle() <= 0.021));
            }
        }
    }
}

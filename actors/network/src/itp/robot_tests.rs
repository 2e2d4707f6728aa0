//! Tests of the robot.

use proptest::prelude::*;

use super::*;
use crate::itp::packet::CONSOLE_MATRIX_BYTES;
use crate::itp::{ConsolePacket, RotationLayout, Rotations};

const REST: Rotations = Rotations::Quaternions([[0.0, 0.0, 0.0, 1.0]; ARMS]);

/// A packet with the pedal down that moves both arms by these micrometres along x.
fn moving(sequence: u32, um: i32) -> ConsolePacket {
    ConsolePacket {
        sequence,
        packet_type: 0,
        version: 0,
        position_um: [[um, 0, 0]; ARMS],
        rotations: REST,
        buttons: [1, 2],
        grasp: [0, 0],
        surgeon_mode: 1,
    }
}

fn lifted(sequence: u32) -> ConsolePacket {
    ConsolePacket { surgeon_mode: 0, ..moving(sequence, 0) }
}

fn ready(config: RobotConfig) -> Robot {
    let mut robot = Robot::new(config).expect("it makes sense");
    robot.set_condition(Condition::Ready);
    robot
}

/// A robot that has heard packet 1 with the pedal up, at the start of the session.
fn listening(config: RobotConfig) -> Robot {
    let mut robot = ready(config);
    assert_eq!(give(&mut robot, &lifted(1), 0), Ok(Verdict::Applied));
    robot
}

fn give(robot: &mut Robot, packet: &ConsolePacket, ms: u64) -> Result<Verdict, Refusal> {
    let mut out = [0; CONSOLE_MATRIX_BYTES];
    robot.receive(packet.encode(&mut out), SimTime::from_millis(ms))
}

fn x_um(robot: &Robot) -> i64 {
    robot.arm(0).position_um_in_robot[0]
}

#[test]
fn numbers_are_judged_as_the_raven_does() {
    let mut robot = listening(RobotConfig::default());
    let mut judge = |sequence| (give(&mut robot, &moving(sequence, 10), 1).expect("it is one"), x_um(&robot));
    assert_eq!(judge(2), (Verdict::Applied, 10));
    assert_eq!(judge(2), (Verdict::Duplicate, 10));
    assert_eq!(
        judge(5),
        (Verdict::Gap { missed: 2, applied: false }, 10),
        "the packet after a gap is dropped"
    );
    assert_eq!(judge(6), (Verdict::Applied, 20));
    assert_eq!(judge(4), (Verdict::OutOfOrder, 20));
    assert_eq!(judge(0), (Verdict::Question, 20));
    assert_eq!(judge(1_500), (Verdict::Gap { missed: 1_493, applied: false }, 20));
    assert_eq!(judge(500), (Verdict::OutOfOrder, 20), "1,000 behind");
    assert_eq!(judge(499), (Verdict::Reset, 20), "1,001 behind");
    assert_eq!(judge(500).0, Verdict::Applied);
    let RobotCounts { applied, after_gap, missed, duplicates, out_of_order, resets, questions, .. } =
        *robot.counts();
    assert_eq!(
        [applied, after_gap, missed, duplicates, out_of_order, resets, questions],
        [4, 2, 1_495, 1, 2, 1, 1]
    );
    assert_eq!(robot.reply(&[Vector3::zeros(); ARMS], 0).last_sequence, 500);
}

#[test]
fn a_lenient_robot_applies_the_packet_after_a_gap() {
    let mut robot = listening(RobotConfig { lenient: true, ..RobotConfig::default() });
    assert_eq!(give(&mut robot, &moving(4, 10), 1), Ok(Verdict::Gap { missed: 2, applied: true }));
    assert_eq!((x_um(&robot), robot.counts().applied, robot.counts().after_gap), (10, 2, 0));
}

#[test]
fn a_robot_that_joins_late_waits_for_one_packet() {
    let mut robot = ready(RobotConfig::default());
    let first = give(&mut robot, &lifted(u32::MAX), 0);
    assert_eq!(first, Ok(Verdict::Gap { missed: u32::MAX - 1, applied: false }));
    assert_eq!(
        give(&mut robot, &lifted(1), 1),
        Ok(Verdict::Applied),
        "after the last number comes the first"
    );
    assert_eq!(give(&mut robot, &moving(2, 10), 2), Ok(Verdict::Applied));
}

#[test]
fn arms_move_only_while_the_robot_is_ready_and_the_pedal_down() {
    let mut robot = Robot::new(RobotConfig::default()).expect("it makes sense");
    let mut number = 0;
    let mut step = |robot: &mut Robot, down: bool| {
        number += 1;
        let packet =
            if down { moving(number, 10) } else { ConsolePacket { surgeon_mode: 0, ..moving(number, 10) } };
        assert_eq!(give(robot, &packet, u64::from(number)), Ok(Verdict::Applied));
        (robot.runlevel(), x_um(robot))
    };
    assert_eq!(step(&mut robot, false), (Runlevel::Initialising, 0));
    assert_eq!(step(&mut robot, true), (Runlevel::Initialising, 0));
    robot.set_condition(Condition::Ready);
    assert_eq!(step(&mut robot, false), (Runlevel::PedalUp, 0));
    assert_eq!(step(&mut robot, true), (Runlevel::PedalDown, 10));
    assert_eq!([robot.buttons(0), robot.buttons(1)], [1, 2]);
    assert_eq!(step(&mut robot, false), (Runlevel::PedalUp, 10));
    assert_eq!(robot.buttons(0), 0, "no energy with the pedal up");
    assert_eq!(step(&mut robot, true), (Runlevel::PedalDown, 20));
    robot.set_condition(Condition::Stopped);
    assert_eq!(step(&mut robot, true), (Runlevel::EmergencyStop, 20));
    robot.set_condition(Condition::Ready);
    assert_eq!(step(&mut robot, true), (Runlevel::PedalUp, 20), "the pedal was never lifted");
    assert_eq!(step(&mut robot, false), (Runlevel::PedalUp, 20));
    assert_eq!(step(&mut robot, true), (Runlevel::PedalDown, 30));
}

#[test]
fn only_one_says_that_the_pedal_is_down() {
    let mut robot = listening(RobotConfig::default());
    for (number, surgeon_mode) in [(2, 2), (3, -1), (4, i32::MAX)] {
        let packet = ConsolePacket { surgeon_mode, ..moving(number, 10) };
        assert_eq!(give(&mut robot, &packet, 1), Ok(Verdict::Applied));
        assert_eq!((robot.runlevel(), x_um(&robot)), (Runlevel::PedalUp, 0));
    }
}

#[test]
fn silence_releases_the_pedal_and_it_has_to_be_pressed_again() {
    let mut robot = listening(RobotConfig::default());
    give(&mut robot, &moving(2, 10), 1).expect("it is one");
    robot.poll(SimTime::from_millis(101));
    assert_eq!(robot.runlevel(), Runlevel::PedalDown);
    robot.poll(SimTime::from_millis(102));
    assert_eq!((robot.runlevel(), robot.counts().silences), (Runlevel::PedalUp, 1));
    give(&mut robot, &moving(3, 10), 200).expect("it is one");
    assert_eq!((robot.runlevel(), x_um(&robot)), (Runlevel::PedalUp, 10));
    give(&mut robot, &lifted(4), 201).expect("it is one");
    give(&mut robot, &moving(5, 10), 202).expect("it is one");
    assert_eq!((robot.runlevel(), x_um(&robot)), (Runlevel::PedalDown, 20));
    // Silence that nobody polled is noticed by the packet that ends it.
    give(&mut robot, &moving(6, 10), 500).expect("it is one");
    assert_eq!((robot.runlevel(), robot.counts().silences), (Runlevel::PedalUp, 2));
}

#[test]
fn the_raven_waits_five_seconds_and_then_follows_at_once() {
    let mut robot = listening(RobotConfig::raven());
    give(&mut robot, &moving(2, 10), 1).expect("it is one");
    for tick in 2..=SILENCE_TICKS + 1 {
        robot.poll(SimTime::from_millis(tick));
        assert_eq!(robot.runlevel(), Runlevel::PedalDown);
    }
    robot.poll(SimTime::from_millis(SILENCE_TICKS + 2));
    assert_eq!(robot.runlevel(), Runlevel::PedalUp);
    give(&mut robot, &moving(3, 10), 6_000).expect("it is one");
    assert_eq!((robot.runlevel(), x_um(&robot)), (Runlevel::PedalDown, 20));
}

#[test]
fn what_moves_too_far_or_is_no_rotation_is_refused_whole_and_counts_as_silence() {
    let mut robot = listening(RobotConfig::default());
    give(&mut robot, &moving(2, 10), 1).expect("it is one");
    let before = [*robot.arm(0), *robot.arm(1)];
    let turn = |angle: f64| [(0.5 * angle).sin(), 0.0, 0.0, (0.5 * angle).cos()];
    let rest = turn(0.0);
    let far = moving(3, 10);
    let position_um = [[0, 0, 0], [0, 2_001, -2_000]];
    let at = |sequence, rotations| ConsolePacket {
        rotations: Rotations::Quaternions(rotations),
        ..moving(sequence, 10)
    };
    let cases = [
        (ConsolePacket { position_um, ..far }, "moves arm 1 by 2001 µm; at most 2000 µm"),
        (
            ConsolePacket { position_um: [[i32::MIN, 0, 0]; ARMS], ..moving(4, 0) },
            "moves arm 0 by -2147483648 µm",
        ),
        (at(5, [rest, turn(0.051)]), "turns arm 1 by 0.051 rad"),
        (at(6, [rest, turn(-3.0)]), "turns arm 1 by 3.000 rad"),
        (at(7, [[f64::NAN; 4], rest]), "rotation of arm 0 in ITP packet 7 is none"),
        (at(8, [rest, [0.0; 4]]), "rotation of arm 1 in ITP packet 8"),
    ];
    for (place, (packet, message)) in cases.iter().enumerate() {
        let refusal = give(&mut robot, packet, 10 + place as u64).expect_err("it is refused");
        assert!(refusal.to_string().contains(message), "{refusal}");
    }
    assert_eq!([*robot.arm(0), *robot.arm(1)], before);
    assert_eq!((robot.counts().too_far, robot.counts().no_rotation, robot.counts().applied), (4, 2, 2));
    robot.poll(SimTime::from_millis(102));
    assert_eq!(robot.runlevel(), Runlevel::PedalUp);
    // They were in order, so the next one is no gap; and a pedal that is up counts whatever comes with it.
    let lifted = ConsolePacket { surgeon_mode: 0, ..at(9, [[f64::NAN; 4]; ARMS]) };
    assert_eq!(give(&mut robot, &lifted, 103), Ok(Verdict::Applied));
    let largest =
        ConsolePacket { position_um: [[2_000, -2_000, 2_000]; ARMS], ..at(10, [turn(0.0499), rest]) };
    assert_eq!(give(&mut robot, &largest, 104), Ok(Verdict::Applied));
    assert_eq!(robot.runlevel(), Runlevel::PedalDown);
}

#[test]
fn a_wrong_checksum_is_refused_unless_nobody_looks() {
    for (config, refused) in [(RobotConfig::default(), true), (RobotConfig::raven(), false)] {
        let mut robot = listening(config);
        let mut out = [0; CONSOLE_MATRIX_BYTES];
        let mut bytes = moving(2, 10).encode(&mut out).to_vec();
        bytes[120] ^= 1;
        let outcome = robot.receive(&bytes, SimTime::from_millis(1));
        assert_eq!(
            (outcome.is_err(), robot.counts().malformed),
            (refused, u64::from(refused)),
            "{outcome:?}"
        );
        assert_eq!(x_um(&robot), if refused { 0 } else { 10 });
    }
}

#[test]
fn an_arm_stops_at_its_reach() {
    let mut robot = listening(RobotConfig { reach_um: 1_000, ..RobotConfig::default() });
    let places = [(2, 700), (3, 700), (4, -100)].map(|(number, um)| {
        give(&mut robot, &moving(number, um), 1).expect("it is one");
        x_um(&robot)
    });
    assert_eq!((places, robot.counts().beyond_reach), ([700, 1_000, 900], 1));
    let dialect = Dialect { position: Meaning::Absolute, ..Dialect::RAVEN };
    let mut robot = listening(RobotConfig { dialect, ..RobotConfig::default() });
    give(&mut robot, &moving(2, i32::MIN), 1).expect("it is one");
    assert_eq!((x_um(&robot), robot.counts().beyond_reach), (-1_000_000, 1));
}

#[test]
fn increments_of_rotation_are_multiplied_from_the_left_and_absolute_ones_are_taken() {
    let turned = UnitQuaternion::from_euler_angles(0.4, 0.0, 0.0);
    let step = UnitQuaternion::from_euler_angles(0.0, 0.0, 0.04);
    let start_in_robot = [Isometry3::from_parts(nalgebra::Translation3::identity(), turned); ARMS];
    for (rotation, expected) in [(Meaning::Increment, step * turned), (Meaning::Absolute, step)] {
        for layout in [RotationLayout::Quaternions, RotationLayout::Matrices] {
            let dialect = Dialect { rotation, layout, ..Dialect::RAVEN };
            let mut robot = ready(RobotConfig { dialect, start_in_robot, ..RobotConfig::default() });
            let rotations = Rotations::new(layout, &[step; ARMS]);
            for packet in [lifted(1), moving(2, 0)] {
                give(&mut robot, &ConsolePacket { rotations, ..packet }, 1).expect("it is one");
            }
            assert!(robot.arm(1).rotation_in_robot.angle_to(&expected) < 1e-7, "{rotation:?} {layout:?}");
        }
    }
}

#[test]
fn jaws_follow_torque_increment_or_angle_within_their_limits() {
    let grasped = |grasp: GraspMeaning, numbers: &[i32]| {
        let dialect = Dialect { grasp, ..Dialect::RAVEN };
        let mut robot = listening(RobotConfig { dialect, ..RobotConfig::default() });
        let given = numbers.iter().zip(2..).map(|(number, sequence)| {
            let packet = ConsolePacket { grasp: [*number; ARMS], ..moving(sequence, 0) };
            give(&mut robot, &packet, 1).expect("it is one");
            (robot.arm(0).jaw_mrad, robot.torque(0))
        });
        given.collect::<Vec<_>>()
    };
    let (min, max) = (i32::MIN, i32::MAX);
    let torques = grasped(GraspMeaning::Torque, &[32_767, -32_767, -32_768, max]);
    assert_eq!(torques, [(0, 1.0), (0, -1.0), (0, -1.0), (0, 1.0)]);
    let angles = grasped(GraspMeaning::AngleIncrement, &[-500, 100, min, max]);
    assert_eq!(angles, [(500, 0.0), (400, 0.0), (1_570, 0.0), (-174, 0.0)]);
    let angles = grasped(GraspMeaning::Angle, &[500, 100, min, max]);
    assert_eq!(angles, [(500, 0.0), (100, 0.0), (-174, 0.0), (1_570, 0.0)]);
}

#[test]
fn replies_have_forces_in_thousandths_and_numbers_of_their_own() {
    let mut robot = listening(RobotConfig::default());
    let forces = [Vector3::new(1.2345, -0.0004, f64::NAN), Vector3::new(1e300, f64::NEG_INFINITY, -2.5)];
    let reply = robot.reply(&forces, 0x8001);
    assert_eq!(reply.force_mn, [[1_235, 0, 0], [i32::MAX, i32::MIN, -2_500]]);
    assert_eq!((reply.sequence, reply.last_sequence, reply.runlevel, reply.joint_flags), (1, 1, 2, 0x8001));
    assert_eq!(robot.reply(&forces, 0).sequence, 2);
    for number in 0..=3 {
        assert_eq!(Runlevel::from_number(number).map(Runlevel::number), Some(number));
    }
    assert_eq!([Runlevel::from_number(-1), Runlevel::from_number(4)], [None, None]);
}

#[test]
fn a_console_that_was_started_again_has_to_lift_the_pedal_first() {
    for (config, runlevel) in
        [(RobotConfig::default(), Runlevel::PedalUp), (RobotConfig::raven(), Runlevel::PedalDown)]
    {
        let mut robot = listening(config);
        give(&mut robot, &lifted(5_000), 1).expect("a gap");
        give(&mut robot, &moving(5_001, 0), 2).expect("it is one");
        assert_eq!(give(&mut robot, &moving(1, 0), 3), Ok(Verdict::Reset));
        give(&mut robot, &moving(2, 0), 4).expect("it is one");
        assert_eq!(robot.runlevel(), runlevel);
    }
}

#[test]
fn parameters_without_sense_are_named() {
    let with = |change: fn(&mut RobotConfig)| {
        let mut config = RobotConfig::default();
        change(&mut config);
        Robot::new(config).expect_err("it makes no sense").to_string()
    };
    assert!(with(|config| config.reach_um = 0).contains("reach is 0 µm"));
    assert!(with(|config| config.increment_um_max = 200_000).contains("1 to 100000 µm"));
    assert!(with(|config| config.rotation_max = f64::INFINITY).contains("inf rad"));
    assert!(with(|config| config.start_in_robot[1].translation.x = 1.5).contains("arm 1"));
}

/// A packet of numbers that a stranger chooses, often near those that matter.
fn any_packet() -> impl Strategy<Value = ConsolePacket> {
    let number = prop_oneof![any::<i32>(), -3_000..3_000_i32];
    let sequence = prop_oneof![any::<u32>(), 0..20_u32, u32::MAX - 20..=u32::MAX];
    let small = proptest::array::uniform4(-0.02..0.02_f64).prop_map(|[x, y, z, w]| [x, y, z, 1.0 + 0.02 * w]);
    let quaternion = prop_oneof![proptest::array::uniform4(any::<f64>()), small];
    let positions = proptest::array::uniform2(proptest::array::uniform3(number));
    let pairs = (any::<[i32; 2]>(), any::<[i32; 2]>());
    (sequence, positions, proptest::array::uniform2(quaternion), pairs, 0..2_i32).prop_map(
        |(sequence, position_um, quaternions, (buttons, grasp), surgeon_mode)| ConsolePacket {
            sequence,
            packet_type: 0,
            version: 0,
            position_um,
            rotations: Rotations::Quaternions(quaternions),
            buttons,
            grasp,
            surgeon_mode,
        },
    )
}

proptest! {
    #[test]
    fn a_strangers_packets_leave_the_arms_within_every_limit(
        packets in proptest::collection::vec(any_packet(), 1..60),
        absolute: bool,
        lenient: bool,
    ) {
        let position = if absolute { Meaning::Absolute } else { Meaning::Increment };
        let dialect = Dialect { position, ..Dialect::RAVEN };
        let mut robot = ready(RobotConfig { dialect, lenient, press_again: false, ..RobotConfig::default() });
        for packet in &packets {
            let before = *robot.arm(0);
            let outcome = give(&mut robot, packet, 1);
            let pose = robot.arm(0);
            if outcome.is_err() {
                prop_assert_eq!(*pose, before);
            }
            for (um, was) in pose.position_um_in_robot.iter().zip(before.position_um_in_robot) {
                prop_assert!(um.abs() <= 1_000_000 && (absolute || (um - was).abs() <= 2_000));
            }
            prop_assert!((pose.rotation_in_robot.norm() - 1.0).abs() < 1e-9);
            prop_assert!(pose.rotation_in_robot.angle_to(&before.rotation_in_robot) <= 0.0501);
            prop_assert!((GRASP_MIN_MRAD..=GRASP_MAX_MRAD).contains(&pose.jaw_mrad));
        }
    }

    #[test]
    fn a_whole_stream_is_applied_across_the_end_of_the_numbers(
        start in u32::MAX - 50..=u32::MAX,
        lost in proptest::collection::btree_set(2..100_usize, 0..5),
    ) {
        let mut robot = ready(RobotConfig { lenient: true, ..RobotConfig::default() });
        let mut sequence = start;
        let mut moved = 0;
        for place in 0..100 {
            if !lost.contains(&place) {
                let packet = if place == 1 { lifted(sequence) } else { moving(sequence, 7) };
                let verdict = give(&mut robot, &packet, place as u64).expect("it is one");
                let is_applied = matches!(verdict, Verdict::Applied | Verdict::Gap { applied: true, .. });
                prop_assert!(is_applied, "{:?} at {}", verdict, sequence);
                moved += if place > 1 { 7 } else { 0 };
            }
            sequence = cycle::next(sequence);
        }
        prop_assert_eq!(x_um(&robot), moved);
        let tail = lost.iter().rev().zip((0..100).rev()).take_while(|(lost, place)| *lost == place).count();
        prop_assert_eq!(robot.counts().missed, u64::from(start - 1) + (lost.len() - tail) as u64);
    }
}

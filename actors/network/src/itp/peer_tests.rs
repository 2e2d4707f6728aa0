//! Tests of both ends against a console and a robot in Python, which share no line with them.

use std::io::{Seek, SeekFrom, Write};
use std::path::Path;
use std::process::{Command, Stdio};

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use trocar_scene::SimTime;
use trocar_scene::random::SplitMix64;

use super::packet::CONSOLE_MATRIX_BYTES;
use super::*;

/// Runs the independent program with this input; returns what it prints.
pub(super) fn peer(arguments: &[&str], input: &str) -> String {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/peers/itp_peer.py");
    let mut file = tempfile::tempfile().expect("a file for the input");
    file.write_all(input.as_bytes())
        .and_then(|()| file.seek(SeekFrom::Start(0)))
        .expect("the input is written");
    let mut command = Command::new("python3");
    command.arg(script).args(arguments).stdin(Stdio::from(file));
    let output =
        command.output().expect("python3 is needed for this test; it is in every image of the checks");
    assert!(output.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).expect("it prints text")
}

/// The value of a field in a line of JSON as Python's `json` writes it: of a text what is between the quotes, of a list all
/// between the outer brackets.
pub(super) fn field<'line>(line: &'line str, name: &str) -> &'line str {
    let start = line.find(&format!("\"{name}\": ")).expect("the field is there") + name.len() + 4;
    let value = &line[start..];
    let end = match value.as_bytes()[0] {
        b'"' => return value[1..].split('"').next().expect("a text ends"),
        b'[' => value.find("]]").map_or_else(|| value.find(']').expect("a list ends") + 1, |at| at + 2),
        _ => value.find([',', '}']).expect("a number ends"),
    };
    &value[..end]
}

/// The numbers of a list, and of the lists in it, one after the other.
fn numbers(list: &str) -> Vec<f64> {
    let numbers = list.split(['[', ']', ',', ' ']).filter(|number| !number.is_empty());
    numbers.map(|number| number.parse().expect("it is a number")).collect()
}

pub(super) fn bytes_of_hex(hex: &str) -> Vec<u8> {
    data_encoding::HEXLOWER.decode(hex.as_bytes()).expect("digits")
}

/// Two hands that draw curves and turn to and fro, at this time \[s\].
pub(super) fn hands(secs: f64) -> [ConsoleHand; ARMS] {
    [0.0, 1.0].map(|phase| {
        let at = |rate: f64| (rate * secs + phase).sin();
        ConsoleHand {
            pose_in_console: Isometry3::from_parts(
                Translation3::new(0.05 * at(1.3), 0.04 * at(2.1), 0.03 * at(0.7)),
                UnitQuaternion::from_scaled_axis(Vector3::new(at(0.9), 0.5 * at(1.7), 0.3 * at(0.4))),
            ),
            jaw: 0.5 + 0.4 * at(3.0),
            squeeze: at(2.0),
            buttons: u32::from(at(1.0) > 0.0),
        }
    })
}

fn tick(number: u64) -> SimTime {
    SimTime::from_millis(number)
}

fn same_rotation(numbers: &[f64], rotation: &UnitQuaternion<f64>) -> bool {
    let other = unit_rotation([numbers[0], numbers[1], numbers[2], numbers[3]]).expect("it is a rotation");
    other.angle_to(rotation) < 1e-6
}

#[test]
fn our_robot_and_theirs_judge_and_move_alike_whatever_the_link_does() {
    let mut console = Console::new(ConsoleConfig::default()).expect("it makes sense");
    let mut random = SplitMix64::new(5);
    let mut stream: Vec<Vec<u8>> = Vec::new();
    for step in 0..3_000_u64 {
        let pedal_down = step > 20 && step % 700 < 600;
        let mut out = [0; CONSOLE_MATRIX_BYTES];
        let bytes = console.command(&hands(step as f64 * 1e-3), pedal_down).encode(&mut out).to_vec();
        match random.below(100) {
            0..3 => {}
            3..5 => stream.extend([bytes.clone(), bytes]),
            5..7 => stream.insert(stream.len().saturating_sub(1), bytes),
            7 => stream.push(bytes[..random.below(124) as usize].to_vec()),
            _ => stream.push(bytes),
        }
        if step == 2_000 {
            console = Console::new(ConsoleConfig::default()).expect("it makes sense");
        }
    }
    stream.insert(500, [0; 124].to_vec());
    let lines: String = stream.iter().map(|bytes| data_encoding::HEXLOWER.encode(bytes) + "\n").collect();
    let printed = peer(&["robot"], &lines);
    assert_eq!(printed.lines().count(), stream.len());

    let mut robot = Robot::new(RobotConfig::raven()).expect("it makes sense");
    robot.set_condition(Condition::Ready);
    for (number, (bytes, line)) in stream.iter().zip(printed.lines()).enumerate() {
        let verdict = match robot.receive(bytes, tick(number as u64)) {
            Ok(Verdict::Applied) => "applied",
            Ok(Verdict::Gap { applied: false, .. }) => "gap",
            Ok(Verdict::Duplicate) => "duplicate",
            Ok(Verdict::OutOfOrder) => "out of order",
            Ok(Verdict::Reset) => "reset",
            Ok(Verdict::Question) => "question",
            Err(Refusal::Packet(PacketError::Size { .. })) => "malformed",
            other => panic!("{other:?}"),
        };
        assert_eq!(verdict, field(line, "verdict"), "datagram {number}");
        let um = numbers(field(line, "position_um"));
        let ours = [0, 1].map(|arm| robot.arm(arm).position_um_in_robot);
        assert!(um.iter().eq(ours.as_flattened().iter().map(|um| *um as f64).collect::<Vec<_>>().iter()));
        let rotations = numbers(field(line, "rotation"));
        assert!((0..ARMS).all(|arm| same_rotation(&rotations[4 * arm..], &robot.arm(arm).rotation_in_robot)));
        let jaws = numbers(field(line, "jaw_mrad"));
        assert!((0..ARMS).all(|arm| jaws[arm] == f64::from(robot.arm(arm).jaw_mrad)), "datagram {number}");
        assert_eq!(field(line, "runlevel"), robot.runlevel().number().to_string(), "datagram {number}");
    }
    let counts = robot.counts();
    assert!(counts.applied > 1_000 && counts.after_gap > 20 && counts.duplicates > 20, "{counts:?}");
    assert!(counts.out_of_order > 10 && counts.malformed > 10, "{counts:?}");
    assert_eq!((counts.resets, counts.questions), (1, 1));

    // Their replies are read by our console.
    let last = printed.lines().last().expect("it replied");
    let reply = bytes_of_hex(field(last, "reply"));
    assert_eq!(console.receive(&reply, tick(1)), Ok(true));
    let report = console.report().expect("it came");
    assert_eq!(report.runlevel, Some(robot.runlevel()));
    for arm in 0..ARMS {
        // A spring of 100 N/m.
        let spring = -100.0 * robot.arm(arm).pose_in_robot().translation.vector;
        assert!((report.forces_in_robot[arm] - spring).amax() <= 1e-3);
    }
}

#[test]
fn our_console_and_theirs_send_the_same_motion_and_our_robot_follows_theirs() {
    // Theirs knows no jaws and no buttons.
    let still = |hand: ConsoleHand| ConsoleHand { jaw: 0.0, squeeze: 0.0, buttons: 0, ..hand };
    let moments: Vec<_> = (0..2_000_u64)
        .map(|step| (hands(step as f64 * 1e-3).map(still), step > 20 && step % 700 < 600))
        .collect();
    let lines: String = moments.iter().map(|(hands, pedal_down)| line_of(hands, *pedal_down)).collect();
    let printed = peer(&["console"], &lines);
    assert_eq!(printed.lines().count(), moments.len());

    let mut console = Console::new(ConsoleConfig::default()).expect("it makes sense");
    let mut robot = Robot::new(RobotConfig::default()).expect("it makes sense");
    robot.set_condition(Condition::Ready);
    for (number, ((hands, pedal_down), line)) in moments.iter().zip(printed.lines()).enumerate() {
        let bytes = bytes_of_hex(field(line, "hex"));
        let theirs =
            ConsolePacket::decode(&bytes, RotationLayout::Quaternions, true).expect("it is a packet");
        let ours = console.command(hands, *pedal_down);
        assert_eq!(ConsolePacket { rotations: ours.rotations, ..theirs }, ours, "packet {number}");
        for arm in 0..ARMS {
            let pair =
                [&ours, &theirs].map(|packet| packet.rotations.rotation(arm).expect("it is a rotation"));
            assert!(pair[0].angle_to(&pair[1]) < 1e-7, "packet {number}");
        }
        assert_eq!(robot.receive(&bytes, tick(number as u64)), Ok(Verdict::Applied));
    }
    assert!(robot.arm(0).position_um_in_robot.iter().all(|um| um.abs() > 1_000));
    for arm in 0..ARMS {
        assert_eq!(robot.arm(arm).position_um_in_robot, console.sent(arm).position_um_in_robot);
        let turned = robot.arm(arm).rotation_in_robot;
        assert!(turned.angle_to(&console.sent(arm).rotation_in_robot) < 1e-6 && turned.angle() > 0.1);
    }
}

/// Two hands as the independent console reads them.
fn line_of(hands: &[ConsoleHand; ARMS], pedal_down: bool) -> String {
    let [left, right] = hands.map(|hand| {
        let Isometry3 { translation, rotation } = hand.pose_in_console;
        let position: [f64; 3] = translation.vector.into();
        let rotation: [f64; 4] = rotation.coords.into();
        format!("{{\"position\": {position:?}, \"rotation\": {rotation:?}}}")
    });
    format!("{{\"hands\": [{left}, {right}], \"pedal\": {pedal_down}}}\n")
}

//! Tests of ITP over sockets, against the independent console in Python.

use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use trocar_devices::{HapticDevice, Wrench};
use trocar_scene::SimTime;

use super::*;
use crate::itp::{ConsoleHand, LedHand, Runlevel};
use crate::teleoperation::{ItpHand, SlaveConfig};

fn loopback() -> ItpAddress {
    ItpAddress { port: 0, bind: None, peer: None, reply_port: None }
}

/// The numbers of a list in a line of JSON, such as `[[1, 2], [3, 4]]`, behind a key.
fn numbers(line: &str, key: &str) -> Vec<i64> {
    let list = line.split_once(&format!("\"{key}\": ")).expect("the key").1;
    let list = &list[..list.find("]]").map_or(list.len(), |at| at + 2)];
    let parts = list.split(|c: char| !(c.is_ascii_digit() || c == '-')).filter(|part| !part.is_empty());
    parts.map(|part| part.parse().expect("a number")).collect()
}

#[test]
fn a_console_in_python_moves_our_robot_over_a_real_socket_and_hears_its_forces() {
    let port = RobotPort::open(&loopback(), RobotConfig::default()).expect("a port of the loopback");
    assert!(port.local().ip().is_loopback());
    let mut hand = ItpHand::new(port.take(0).expect("the left arm"), SlaveConfig::default()).expect("valid");
    assert!(port.take(0).is_none(), "an arm has one hand");
    hand.open(0).expect("it opens");
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/peers/itp_peer.py");
    let mut command = Command::new("python3");
    command.arg(script).args(["console", "--udp", &port.local().port().to_string(), "--packets", "600"]);
    let child = command.stdout(Stdio::piped()).spawn().expect("python3 is there");
    let console = std::thread::spawn(move || child.wait_with_output().expect("it ends"));
    let (begun, mut shown) = (Instant::now(), hand.read(0).expect("it is read"));
    assert!(!shown.connected, "before a console is heard there is no hand");
    // Beyond the console's end, so that the last packet is applied.
    let mut ended: Option<Instant> = None;
    while ended.is_none_or(|ended| ended.elapsed() < Duration::from_millis(100)) {
        let now_ns = begun.elapsed().as_nanos() as u64;
        shown = hand.read(now_ns).expect("it is read");
        hand.write(now_ns, &Wrench::from_force(nalgebra::Vector3::new(0.0, 0.125, 0.0))).expect("it is open");
        if ended.is_none() && console.is_finished() {
            ended = Some(Instant::now());
        }
        std::thread::sleep(Duration::from_millis(1));
    }
    let output = console.join().expect("it did not panic");
    let printed = String::from_utf8(output.stdout).expect("text");
    assert!(output.status.success(), "{printed}");
    // Over the loopback nothing is lost: the arm is where the console's sums say.
    let last = printed.lines().last().expect("a line");
    let sent = numbers(last, "position_um");
    let place = shown.pose_in_device.translation.vector * 1e6;
    for axis in 0..3 {
        assert!((place[axis] - sent[axis] as f64).abs() < 0.5, "{place} instead of {sent:?}");
    }
    assert!(sent[0].abs() > 10_000, "it moved: {sent:?}");
    let replies: Vec<&str> = printed.lines().filter(|line| line.contains("runlevel")).collect();
    assert!(replies.len() > 500, "{} replies", replies.len());
    assert!(replies.iter().any(|line| line.contains("\"runlevel\": 3") && line.contains("125")), "{last}");
}

#[test]
fn our_console_moves_a_robot_in_python_over_a_real_socket_and_hears_its_forces() {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/peers/itp_peer.py");
    let mut command = Command::new("python3");
    command.arg(script).args(["robot", "--udp", "0", "--packets", "2500"]).stdout(Stdio::piped());
    let mut child = command.spawn().expect("python3 is there");
    let mut lines = BufReader::new(child.stdout.take().expect("it prints")).lines();
    let first = lines.next().expect("its port").expect("text");
    let digits: String = first.chars().filter(char::is_ascii_digit).collect();
    let robot = SocketAddr::from((Ipv4Addr::LOCALHOST, digits.parse().expect("a port")));
    let port = ConsolePort::open(robot, None, ConsoleConfig::default()).expect("the loopback");
    let mut arm = port.take(0).expect("the left arm");
    assert!(port.take(0).is_none(), "an arm has one hand");
    // With the pedal up until the robot is heard; down where the hands are until it follows; then 10 mm along x.
    let printed = std::thread::spawn(move || lines.map(|line| line.expect("text")).last());
    let hand =
        ConsoleHand { pose_in_console: nalgebra::Isometry3::identity(), jaw: 0.0, squeeze: 0.0, buttons: 0 };
    let mut led = LedHand { hand, pedal_down: false };
    let (mut farthest, mut longest) = (0.0_f64, None);
    while !printed.is_finished() {
        arm.lead(Some(led));
        if let Some(report) = arm.report() {
            farthest = farthest.min(report.robot.forces_in_robot[0].x);
            longest = longest.max(report.round_trip);
            led.pedal_down = true;
            if report.robot.runlevel == Some(Runlevel::PedalDown) {
                led.hand.pose_in_console.translation.x = 0.010;
            }
        }
        std::thread::sleep(Duration::from_millis(1));
    }
    assert!(longest.is_some_and(|trip| trip > SimTime::ZERO), "{longest:?}");
    child.wait().expect("it ends");
    let last = printed.join().expect("it did not panic").expect("it heard packets");
    assert_eq!(numbers(&last, "position_um"), [10_000, 0, 0, 0, 0, 0], "{last}");
    // Its spring of 100 N/m.
    assert!((farthest + 1.0).abs() < 1e-9, "{farthest} N");
}

#[test]
fn the_port_stays_on_the_loopback_unless_both_ends_are_named() {
    let far: IpAddr = Ipv4Addr::new(192, 0, 2, 7).into();
    for (bind, peer) in [(Some(far), None), (None, Some(far)), (Some(Ipv4Addr::UNSPECIFIED.into()), None)] {
        let address = ItpAddress { bind, peer, ..loopback() };
        let error = RobotPort::open(&address, RobotConfig::default()).err().expect("it is refused");
        assert!(matches!(error, ItpPortError::Unprotected), "{error}");
        assert!(error.to_string().contains("bind=") && error.to_string().contains("peer="));
    }
    let robot = SocketAddr::new(far, 36_000);
    let console = ConsolePort::open(robot, None, ConsoleConfig::default()).err();
    assert!(matches!(console, Some(ItpPortError::Unprotected)), "a console beyond the loopback");
    let any = Some(Ipv4Addr::UNSPECIFIED.into());
    let named = ItpAddress { bind: any, peer: Some(far), ..loopback() };
    let port = RobotPort::open(&named, RobotConfig::default()).expect("both ends are named");
    assert!(port.local().ip().is_unspecified());
}

#[test]
fn a_port_that_is_taken_is_named() {
    let first = RobotPort::open(&loopback(), RobotConfig::default()).expect("a port");
    let taken = ItpAddress { port: first.local().port(), ..loopback() };
    let error = RobotPort::open(&taken, RobotConfig::default()).err().expect("it is taken").to_string();
    assert!(error.contains(&first.local().port().to_string()) && error.contains("in use"), "{error}");
}

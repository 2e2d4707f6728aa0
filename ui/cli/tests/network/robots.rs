//! Tele-surgery between programs: a console and a robot, each with its own Model, joined by ITP over real sockets; and either
//! of them with a peer in Python.

use std::net::UdpSocket;
use std::path::Path;
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

use serde_json::Value;

use crate::support::projects::repository;
use crate::support::{here, object, stderr, trocar};

/// A hand with a dissector that carries current, over a floor; the trainee goes to and fro and presses the pedal meanwhile.
const SCENARIO: &str = r#"
schema = 1
name = "bench"
title = "Bench"
description = "A dissector over a floor."
gravity = [0.0, 0.0, -9.81]

[[entity]]
name = "floor"
pose = { translation = [0.0, 0.0, -0.010] }
shape = { box = { half_extents = [0.2, 0.2, 0.010] } }

[[entity]]
name = "grasper.right"
electrode = { power = 30.0, contact_area = 1e-6 }
pose = { translation = [0.0, 0.0, 0.050], rotation = [1.0, 0.0, 0.0, 0.0] }
instrument = { kind = "grasper", shaft_length = 0.15, mass = 0.03 }

[[entity]]
name = "hand.right"
press_target = {}
[entity.hand]
side = "right"
instrument = "grasper.right"
world_from_device = { translation = [0.0, 0.0, 0.200], rotation = [1.0, 0.0, 0.0, 0.0] }

[[controller]]
name = "haptics.right"
kind = "haptics"
rate_hz = 1000
params = { hand = "right" }

[[controller]]
name = "instruments"
kind = "instruments"
rate_hz = 1000

[[controller]]
name = "trainee"
kind = "path"
rate_hz = 200
[controller.params]
hand = "hand.right"
step = [
    { seconds = 3.0 },
    { seconds = 1.5, to = [0.030, 0.0, 0.050] },
    { seconds = 2.0, level = 1.0, jaws = 0.5 },
    { seconds = 1.5, to = [0.0, 0.0, 0.050], level = 0.0 },
    { seconds = 60.0 },
]

[[hand]]
name = "right"
entity = "hand.right"
device = "virtual"
renderer = { kind = "proxy" }
"#;

/// A port that was free a moment ago.
fn free_port() -> u16 {
    let socket = UdpSocket::bind(("127.0.0.1", 0)).expect("a port of the loopback");
    socket.local_addr().expect("it is bound").port()
}

/// Waits until somebody has this port.
fn until_taken(port: u16) {
    let begun = Instant::now();
    while UdpSocket::bind(("127.0.0.1", port)).is_ok() {
        assert!(begun.elapsed() < Duration::from_secs(30), "nobody takes port {port}");
        std::thread::sleep(Duration::from_millis(20));
    }
}

fn start(folder: &Path, arguments: &[&str]) -> Child {
    std::fs::write(folder.join("bench.toml"), SCENARIO).expect("it can be written");
    let mut command = Command::new(env!("CARGO_BIN_EXE_trocar"));
    command.args(["run", "bench.toml", "--headless", "--json", "--no-record", "--no-report"]);
    command.args(arguments).current_dir(folder).stdout(Stdio::piped()).stderr(Stdio::piped());
    command.spawn().expect("the program starts")
}

fn python(arguments: &[&str]) -> Child {
    let script = repository().join("tests/peers/itp_peer.py");
    let mut command = Command::new("python3");
    command.arg(script).args(arguments).stdout(Stdio::piped()).spawn().expect("python3 is there")
}

/// The figures of the hand in the summary of a run that went well.
fn figures(output: &Output) -> Value {
    assert_eq!(output.status.code(), Some(0), "{}", stderr(output));
    object(output)["teleoperation"]["right"].clone()
}

fn number(figures: &Value, name: &str) -> f64 {
    figures[name].as_f64().unwrap_or_else(|| panic!("{name} of {figures}"))
}

#[test]
fn a_console_and_a_robot_are_two_programs_each_with_its_own_model() {
    let folder = here();
    let port = free_port();
    let robot = start(folder.path(), &["--hand", &format!("right=itp:{port},arm=right"), "--seconds", "11"]);
    until_taken(port);
    let address = format!("right=itp:127.0.0.1:{port},arm=right");
    let console = start(folder.path(), &["--console", &address, "--seconds", "9"]);
    let (console, robot) =
        (console.wait_with_output().expect("an end"), robot.wait_with_output().expect("an end"));
    // Only the robot has the physics of the scene, and only the console its trainee's wishes in its hands.
    let names = |output: &Output| -> Vec<String> {
        let rows = object(output)["controllers"].as_array().expect("rows").clone();
        rows.iter().map(|row| row["name"].as_str().expect("a name").to_owned()).collect()
    };
    let (at_console, at_robot) = (figures(&console), figures(&robot));
    assert_eq!(names(&console), ["haptics.right", "instruments", "trainee", "teleoperation"]);
    assert!(names(&robot).contains(&"teleoperation".to_owned()), "{:?}", names(&robot));
    println!("console {at_console}\nrobot {at_robot}");
    // The robot heard the console and was heard. Where nothing was late, it moved as the console did, and had its current on
    // for as long as its foot was down; at the end it hears the silence.
    assert!(number(&at_robot, "received") > 1_000.0 && number(&at_console, "received") > 1_000.0);
    assert!(number(&at_console, "round_trip_mean") > 0.0);
    if number(&at_robot, "silences") <= 1.0 && number(&at_robot, "received") == number(&at_robot, "sent") {
        let range = number(&at_robot, "x_range");
        assert!((range - 0.030).abs() < 0.002, "{range} m");
        let (there, here) = (number(&at_robot, "energised"), number(&at_console, "energised"));
        assert!((there - here).abs() < 0.2 && here > 1.0, "{there} s and {here} s");
    }
    assert!(stderr(&robot).contains("unprotected") || object(&robot)["losses"].to_string().contains("ITP"));
}

#[test]
fn our_console_leads_a_robot_in_python_and_hears_of_its_emergency_stop() {
    let folder = here();
    let port = free_port();
    let packets = "7500";
    let robot =
        python(&["robot", "--udp", &port.to_string(), "--packets", packets, "--stop", "6000", "6600"]);
    // What it prints is taken as it comes: a pipe that is full would stop it.
    let robot = std::thread::spawn(move || robot.wait_with_output());
    until_taken(port);
    let address = format!("right=itp:127.0.0.1:{port}");
    let console = start(folder.path(), &["--console", &address, "--seconds", "14"]);
    let console = console.wait_with_output().expect("an end");
    let printed = robot.join().expect("a thread").expect("an end");
    let printed = String::from_utf8(printed.stdout).expect("text");
    let figures = figures(&console);
    println!("{figures}");
    let lines: Vec<Value> = printed.lines().map(|line| serde_json::from_str(line).expect("JSON")).collect();
    assert!(lines.len() > 7_000, "{} lines", lines.len());
    // Bits 16 to 18 of the buttons: it has pedals, and that of the current is down.
    let cuts = lines.iter().filter(|line| line["buttons"][0] == 0x3_0000).count();
    let rests = lines.iter().filter(|line| line["buttons"][0] == 0x1_0000).count();
    assert!(cuts > 500 && rests > 500, "{cuts} packets with the current on, {rests} with it off");
    let farthest = lines.iter().filter_map(|line| line["position_um"][0][0].as_i64()).max();
    assert!(farthest.is_some_and(|um| um > 5_000), "{farthest:?} um");
    assert_eq!(number(&figures, "stops"), 1.0, "{figures}");
    assert!(number(&figures, "round_trip_mean") > 0.0 && number(&figures, "energised") > 0.5, "{figures}");
}

#[test]
fn a_console_in_python_moves_our_robot_and_its_pedal_switches_the_current() {
    let folder = here();
    let port = free_port();
    let robot = start(folder.path(), &["--hand", &format!("right=itp:{port}"), "--seconds", "12"]);
    until_taken(port);
    // Bits 16 and 17 of the buttons: there are pedals, and that of the current is down.
    let udp = port.to_string();
    let press = ["--press", "196608", "2000", "4000"];
    let arguments = [&["console", "--udp", &udp, "--packets", "6000"][..], &press].concat();
    let printed = python(&arguments).wait_with_output().expect("an end");
    let printed = String::from_utf8(printed.stdout).expect("text");
    assert!(printed.lines().any(|line| line.contains("\"runlevel\": 3")), "it follows");
    let robot = robot.wait_with_output().expect("an end");
    let figures = figures(&robot);
    println!("{figures}");
    assert!(number(&figures, "received") > 500.0, "{figures}");
    let energised = number(&figures, "energised");
    assert!((0.5..6.0).contains(&energised), "{energised} s");
}

#[test]
fn what_is_no_robot_is_told_with_what_is() {
    let folder = here();
    std::fs::write(folder.path().join("bench.toml"), SCENARIO).expect("it can be written");
    for (arguments, says) in [
        (&["--console", "right=36000"][..], "itp:HOST:PORT is expected"),
        (&["--console", "left=itp:127.0.0.1:9"], "no hand is called 'left'; there are: right"),
        (&["--console", "right=itp:192.0.2.1:9"], "bind=OWN-ADDRESS"),
        (&["--console", "right=itp:127.0.0.1:9", "--lockstep"], "cannot be used with"),
    ] {
        let output = trocar(folder.path(), &[&["run", "bench.toml"][..], arguments].concat());
        assert_eq!(output.status.code(), Some(2), "{}", stderr(&output));
        assert!(stderr(&output).contains(says), "{arguments:?}: {}", stderr(&output));
    }
}

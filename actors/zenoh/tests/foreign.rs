//! A client of another make (the one from PyPI) reads poses, and commands a hand if it has the right.
//!
//! `TROCAR_ZENOH_PYTHON` names a Python that has it, as `tests/run` does; without it nothing is asked of this machine, and the
//! step of `tests/run` is what shows it.

use std::path::Path;
use std::process::Command;

use serde_json::Value;
use trocar_zenoh::certificates::make;
use trocar_zenoh::rights::Rights;

use crate::support::{Running, free_port};

fn peer(python: &str, endpoint: &str, more: &[&str]) -> Value {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/peers/zenoh_peer.py");
    let mut command = Command::new(python);
    command.arg(script).args(["--connect", endpoint, "--session", "wall"]).args(more);
    let output = command.output().expect("Python runs");
    let told = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "{told}");
    serde_json::from_slice(&output.stdout).unwrap_or_else(|error| panic!("{error}: {told}"))
}

#[test]
fn the_client_from_pypi_reads_poses_and_commands_a_hand_if_it_may() {
    let Ok(python) = std::env::var("TROCAR_ZENOH_PYTHON") else {
        println!("TROCAR_ZENOH_PYTHON names no Python with eclipse-zenoh: tests/run makes one");
        return;
    };
    let endpoint = format!("tcp/127.0.0.1:{}", free_port());
    let running = Running::start(&endpoint, &Rights::default(), Some("right"));
    let told = peer(&python, &endpoint, &["--hand", "right", "--seconds", "3"]);
    println!("{told}");
    assert!(told["claimed"] == true && told["alive"] == true && told["info"]["scenario"] == "wall");
    let count = |kind: &str| told["messages"][kind].as_u64().unwrap_or(0);
    assert!(count("pose") >= 30 && count("hand") >= 30 && count("health") >= 1, "{told}");
    assert!(told["moving"].as_array().is_some_and(|names| names.contains(&"probe.right".into())), "{told}");
    // To and fro by 20 mm each way, at 0.5 Hz.
    let range = told["range"].as_f64().expect("a number");
    assert!((0.02..=0.0401).contains(&range), "{told}");
    drop(running);

    let temporary = tempfile::tempdir().expect("a folder");
    let folder = temporary.path();
    for name in ["host", "ana", "bo"] {
        make(folder, name, &[]).expect("a certificate");
    }
    let file = |name: &str| folder.join(name).display().to_string();
    let text = "readers = [\"bo\"]\n[tls]\nauthority = \"authority.pem\"\ncertificate = \"host.pem\"\nkey = \"host.key\"\n\
                [[hand]]\nname = \"right\"\nwho = [\"ana\"]\n";
    std::fs::write(folder.join("zenoh.toml"), text).expect("a file");
    let rights = Rights::read(&folder.join("zenoh.toml")).expect("rights");
    let endpoint = format!("tls/127.0.0.1:{}", free_port());
    let running = Running::start(&endpoint, &rights, Some("right"));
    for (name, may) in [("bo", false), ("ana", true)] {
        let [authority, certificate, key] =
            ["authority.pem", &format!("{name}.pem"), &format!("{name}.key")].map(&file);
        let tls = ["--authority", &authority, "--certificate", &certificate, "--key", &key];
        let told = peer(&python, &endpoint, &[&tls[..], &["--hand", "right", "--seconds", "2"]].concat());
        println!("{name}: {told}");
        assert_eq!(told["claimed"], may, "{name}: {told}");
        assert_eq!(told["range"].as_f64().is_some_and(|range| range > 0.01), may, "{name}: {told}");
        assert!(told["messages"]["pose"].as_u64().is_some_and(|count| count > 0), "{name} reads: {told}");
    }
    drop(running);
}

//! A new user's crates: `trocar new` writes every template outside of this repository, where all of them are built,
//! tested and run.
//!
//! They stand in one workspace, with this one's lock file and profile and in its target folder, so that libraries
//! that are built already serve them as well, and nothing comes from a network.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use serde_json::Value;
use trocar_test_support::alone;

/// A crate's name, the template, what its program runs for how many seconds, and the controller that must have
/// ticked in it, with its rate \[Hz\].
const PROJECTS: [(&str, &str, &str, f64, &str, f64); 5] = [
    ("my-controller", "controller", "scenario.toml", 5.0, "breathing", 100.0),
    ("my-component", "component", "scenario.toml", 5.0, "bleeder", 50.0),
    ("my-device", "device", "wall", 1.0, "engine", 500.0),
    ("my-actor", "actor", "peg-transfer", 1.0, "engine", 500.0),
    ("my-engine", "engine", "scenario.toml", 2.0, "chain", 500.0),
];

/// The crates of this repository that take longest to optimise.
const OURS: [&str; 10] = [
    "trocar",
    "trocar-cli",
    "trocar-collision",
    "trocar-dynamics",
    "trocar-engine",
    "trocar-input",
    "trocar-kernel",
    "trocar-scene",
    "trocar-simulator",
    "trocar-viewer",
];

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

fn assert_ok(what: &str, output: &Output) {
    assert!(output.status.success(), "{what}:\n{}\n{}", text(&output.stdout), text(&output.stderr));
}

/// The root of this repository.
fn repository() -> PathBuf {
    let cli = Path::new(env!("CARGO_MANIFEST_DIR"));
    cli.ancestors().nth(2).expect("the program lies two folders deep").to_owned()
}

/// The target folder and the profile in which this test was built.
fn target() -> PathBuf {
    let program = Path::new(env!("CARGO_BIN_EXE_trocar"));
    program.ancestors().nth(2).expect("target/profile/trocar").to_owned()
}

/// A folder outside of the repository with every template in it, as one workspace.
fn written() -> tempfile::TempDir {
    let folder = tempfile::tempdir().expect("a folder");
    assert!(!folder.path().starts_with(repository()), "the projects must lie outside of the repository");
    for (name, template, ..) in PROJECTS {
        let output = Command::new(env!("CARGO_BIN_EXE_trocar"))
            .args(["new", name, "--template", template, "--trocar"])
            .arg(repository())
            .current_dir(folder.path())
            .output()
            .expect("the program starts");
        assert_ok(template, &output);
        assert!(text(&output.stdout).contains("cargo test --release"), "{}", text(&output.stdout));
    }
    let root = std::fs::read_to_string(repository().join("Cargo.toml")).expect("this workspace's manifest");
    let section =
        |head: &str| root.split_once(head).unwrap_or_else(|| panic!("{head} is not in the manifest")).1;
    let profiles = section("[profile.release]\n");
    let members: Vec<String> = PROJECTS.iter().map(|(name, ..)| format!("{name:?}")).collect();
    let members = members.join(", ");
    let manifest = format!(
        "[workspace]\nresolver = \"3\"\nmembers = [\"libraries\", {members}]\n\n[profile.release]\n{profiles}"
    );
    // Asks for every library as this workspace does. Cargo unites what is asked for, and so takes the libraries that
    // are built already instead of building some of them, and all that depends on them, once more.
    let libraries = section("[workspace.dependencies]\n").split("\n[").next().unwrap_or_default();
    let libraries: Vec<&str> = libraries.lines().filter(|line| !line.starts_with("trocar")).collect();
    let libraries = format!(
        "[package]\nname = \"libraries\"\nedition = \"2024\"\n\n[dependencies]\n{}\n",
        libraries.join("\n")
    );
    std::fs::create_dir_all(folder.path().join("libraries/src")).expect("a folder");
    std::fs::write(folder.path().join("libraries/Cargo.toml"), libraries).expect("a manifest");
    std::fs::write(folder.path().join("libraries/src/lib.rs"), "").expect("a source");
    std::fs::write(folder.path().join("Cargo.toml"), manifest).expect("a manifest");
    std::fs::copy(repository().join("Cargo.lock"), folder.path().join("Cargo.lock")).expect("a lock file");
    folder
}

fn cargo(folder: &Path, arguments: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO"));
    // What the cargo that runs this test has told its children is not meant for the projects of somebody else.
    for (name, _) in std::env::vars_os() {
        let name = name.to_string_lossy().into_owned();
        if name.starts_with("CARGO_PKG_") || name.starts_with("CARGO_BIN_") || name == "CARGO_MANIFEST_DIR" {
            command.env_remove(name);
        }
    }
    // Told so, some libraries would be built once more.
    command.env_remove("RUSTC_BOOTSTRAP");
    // Cargo builds the crates of this repository once more for another workspace. What is shown here needs them to work,
    // not to be fast.
    for name in OURS {
        command.args(["--config", &format!("profile.release.package.{name}.opt-level = 1")]);
    }
    command
        .args(arguments)
        .args(["--release", "--offline"])
        .current_dir(folder)
        .env("CARGO_TARGET_DIR", target())
        .output()
        .expect("cargo runs")
}

#[test]
fn every_template_builds_passes_its_tests_and_runs_outside_of_the_repository() {
    let _alone = alone();
    let folder = written();
    let tested = cargo(folder.path(), &["test", "--workspace", "--no-fail-fast"]);
    assert_ok("cargo test", &tested);
    let out = text(&tested.stdout);
    let passed: usize = out
        .lines()
        .filter_map(|line| line.strip_prefix("test result: ok. "))
        .filter_map(|line| line.split(' ').next()?.parse::<usize>().ok())
        .sum();
    assert!(passed >= 20, "{passed} tests ran:\n{out}");
    // The compiler's own summary, such as: warning: `my-device` (lib) generated 1 warning
    let untidy =
        text(&tested.stderr).lines().find(|line| line.starts_with("warning: `my-")).map(str::to_owned);
    assert_eq!(untidy, None, "a template has warnings:\n{}", text(&tested.stderr));
    for (name, _, scenario, seconds, controller, rate_hz) in PROJECTS {
        let program = target().join("release").join(name);
        let seconds_text = seconds.to_string();
        let arguments = [
            "run",
            scenario,
            "--lockstep",
            "--seconds",
            &seconds_text,
            "--json",
            "--no-report",
            "--no-record",
        ];
        let output = Command::new(&program)
            .args(arguments)
            .current_dir(folder.path().join(name))
            .output()
            .unwrap_or_else(|error| panic!("{}: {error}", program.display()));
        assert_ok(name, &output);
        let summary: Value = serde_json::from_slice(&output.stdout).expect("one object");
        assert_eq!(summary["error"], Value::Null, "{name}: {summary}");
        let rows = summary["controllers"].as_array().expect("rows");
        let row =
            rows.iter().find(|row| row["name"] == controller).unwrap_or_else(|| panic!("{name}: {summary}"));
        assert_eq!(row["scheduled"].as_f64(), Some(seconds * rate_hz), "{name}: {row}");
        assert_eq!((&row["rejected"], &row["restarts"]), (&0.into(), &0.into()), "{name}: {row}");
    }
    let device = Command::new(target().join("release/my-device")).args(["list", "devices"]).output();
    assert!(text(&device.expect("it runs").stdout).contains("stylus:ADDRESS:PORT"));
}

#[test]
fn templates_are_listed_and_what_cannot_be_written_is_refused() {
    let _alone = alone();
    let folder = tempfile::tempdir().expect("a folder");
    let trocar = |arguments: &[&str]| {
        let output =
            Command::new(env!("CARGO_BIN_EXE_trocar")).args(arguments).current_dir(folder.path()).output();
        output.expect("the program starts")
    };
    let listed = text(&trocar(&["list", "templates"]).stdout);
    for (_, template, ..) in PROJECTS {
        assert!(listed.contains(template), "{template} is not in: {listed}");
    }
    let refused = |arguments: &[&str], code: i32, named: &str| {
        let output = trocar(arguments);
        let message = text(&output.stderr);
        assert_eq!(output.status.code(), Some(code), "{arguments:?}: {message}");
        assert!(message.contains(named), "{arguments:?}: '{named}' is not in: {message}");
    };
    refused(&["new", "sim", "--template", "contoller"], 2, "did you mean 'controller'");
    refused(&["new", "My Sim"], 2, "lower-case letters");
    refused(&["new", "sim", "--trocar", "/"], 4, "no checkout of Trocar");
    assert_eq!(std::fs::read_dir(folder.path()).expect("a folder").count(), 0, "something was written");
    assert!(trocar(&["new", "sim"]).status.success());
    refused(&["new", "sim"], 4, "nothing is overwritten");
}

//! Projects that `trocar new` writes.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use serde_json::Value;

/// A project's name, its template, what its program runs for how many seconds, and the controller that must have
/// ticked in it, with its rate \[Hz\].
pub type Project = (&'static str, &'static str, &'static str, f64, &'static str, f64);

/// One of each template.
pub const PROJECTS: [Project; 5] = [
    ("my-controller", "controller", "scenario.toml", 5.0, "breathing", 100.0),
    ("my-component", "component", "scenario.toml", 5.0, "bleeder", 50.0),
    ("my-device", "device", "wall", 1.0, "engine", 500.0),
    ("my-actor", "actor", "peg-transfer", 1.0, "engine", 500.0),
    ("my-engine", "engine", "scenario.toml", 2.0, "chain", 500.0),
];

/// Output as text.
pub fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

/// Panics with the whole output when the program failed.
pub fn assert_ok(what: &str, output: &Output) {
    assert!(output.status.success(), "{what}:\n{}\n{}", text(&output.stdout), text(&output.stderr));
}

/// The root of this repository.
pub fn repository() -> PathBuf {
    let cli = Path::new(env!("CARGO_MANIFEST_DIR"));
    cli.ancestors().nth(2).expect("the program lies two folders deep").to_owned()
}

/// The target folder of this test.
pub fn target() -> PathBuf {
    let program = Path::new(env!("CARGO_BIN_EXE_trocar"));
    program.ancestors().nth(2).expect("target/profile/trocar").to_owned()
}

/// Runs a project's program in its folder, and checks that its controller has ticked.
pub fn assert_it_runs(program: &Path, folder: &Path, project: &Project) {
    let &(name, template, scenario, seconds, controller, rate_hz) = project;
    let run = |arguments: &[&str]| {
        let output = Command::new(program).args(arguments).current_dir(folder).output();
        output.unwrap_or_else(|error| panic!("{}: {error}; is the workspace built?", program.display()))
    };
    let options = ["--lockstep", "--json", "--no-report", "--no-record"];
    let output = run(&[&["run", scenario, "--seconds", &seconds.to_string()], &options[..]].concat());
    assert_ok(name, &output);
    let summary: Value = serde_json::from_slice(&output.stdout).expect("one object");
    assert_eq!(summary["error"], Value::Null, "{name}: {summary}");
    let rows = summary["controllers"].as_array().expect("rows");
    let row = rows.iter().find(|row| row["name"] == controller);
    let row = row.unwrap_or_else(|| panic!("{name}: {summary}"));
    assert_eq!(row["scheduled"].as_f64(), Some(seconds * rate_hz), "{name}: {row}");
    assert_eq!((&row["rejected"], &row["restarts"]), (&0.into(), &0.into()), "{name}: {row}");
    if template == "device" {
        assert!(text(&run(&["list", "devices"]).stdout).contains("stylus:ADDRESS:PORT"));
    }
}

/// Writes one project into a folder, which depends on Trocar in this repository.
pub fn write_project(folder: &Path, name: &str, template: &str) {
    let output = Command::new(env!("CARGO_BIN_EXE_trocar"))
        .args(["new", name, "--template", template, "--trocar"])
        .arg(repository())
        .current_dir(folder)
        .output()
        .expect("the program starts");
    assert_ok(template, &output);
    assert!(text(&output.stdout).contains("cargo test --release"), "{}", text(&output.stdout));
}

/// Cargo in a project of somebody else: without what the cargo that runs this test has told its children.
pub fn cargo(folder: &Path) -> Command {
    let mut command = Command::new(env!("CARGO"));
    for (name, _) in std::env::vars_os() {
        let name = name.to_string_lossy().into_owned();
        if name.starts_with("CARGO_PKG_") || name.starts_with("CARGO_BIN_") || name == "CARGO_MANIFEST_DIR" {
            command.env_remove(name);
        }
    }
    // Told so, some libraries would be built once more.
    command.env_remove("RUSTC_BOOTSTRAP").current_dir(folder);
    command
}

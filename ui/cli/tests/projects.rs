//! A new user's projects, built: `trocar new` writes every template outside of this repository, where all of them are
//! compiled, tested and run. As members of this workspace the templates are tested in every `tests/run`; here all of
//! Trocar is compiled once more, which takes minutes.
//!
//! The projects are one workspace, with this one's lock file and profile and in its target folder, so that libraries
//! that are built already serve them as well, and nothing comes from a network.

use std::path::Path;
use std::process::Output;

use crate::support::projects::{
    PROJECTS, assert_it_runs, assert_ok, cargo, repository, target, text, write_project,
};

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

/// A folder outside of the repository with every template in it, as one workspace.
fn written() -> tempfile::TempDir {
    let folder = tempfile::tempdir().expect("a folder");
    assert!(!folder.path().starts_with(repository()), "the projects must lie outside of the repository");
    for (name, template, ..) in PROJECTS {
        write_project(folder.path(), name, template);
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

fn build(folder: &Path, arguments: &[&str]) -> Output {
    let mut command = cargo(folder);
    // Cargo builds the crates of this repository once more for another workspace. What is shown here needs them to work,
    // not to be fast.
    for name in OURS {
        command.args(["--config", &format!("profile.release.package.{name}.opt-level = 1")]);
    }
    command.args(arguments).args(["--release", "--offline"]).env("CARGO_TARGET_DIR", target());
    command.output().expect("cargo runs")
}

#[test]
fn every_template_builds_passes_its_tests_and_runs_outside_of_the_repository() {
    let folder = written();
    let tested = build(folder.path(), &["test", "--workspace", "--no-fail-fast"]);
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
    for project in PROJECTS {
        let name = project.0;
        assert_it_runs(&target().join("release").join(name), &folder.path().join(name), &project);
    }
}

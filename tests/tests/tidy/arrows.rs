//! Allowed dependencies: between crates, on restricted libraries, and the crates' folders.

use std::collections::{BTreeMap, BTreeSet};

use cargo_metadata::{DependencyKind, Metadata, MetadataCommand, Package};

use super::{ROOMS, refuse, root};

/// The allowed dependencies of each crate on its neighbours. All others are forbidden.
const ARROWS: [(&str, &[&str]); 18] = [
    ("trocar-scene", &["trocar-scene-derive"]),
    ("trocar-scene-derive", &[]),
    ("trocar-devices", &[]),
    ("trocar-kernel", &["trocar-scene"]),
    ("trocar-engine", &["trocar-scene", "trocar-dynamics"]),
    ("trocar-collision", &["trocar-scene"]),
    ("trocar-dynamics", &["trocar-scene", "trocar-collision"]),
    ("trocar-simulator", &["trocar-scene", "trocar-collision", "trocar-dynamics"]),
    ("trocar-network", &["trocar-scene", "trocar-devices", "trocar-kernel"]),
    ("trocar-tasks", &["trocar-scene"]),
    ("trocar-zenoh", &["trocar-scene", "trocar-devices", "trocar-kernel", "trocar-network"]),
    ("trocar-haptics", &["trocar-scene", "trocar-devices"]),
    ("trocar-input", &["trocar-scene", "trocar-devices", "trocar-tasks"]),
    (
        "trocar",
        &[
            "trocar-scene",
            "trocar-devices",
            "trocar-kernel",
            "trocar-engine",
            "trocar-collision",
            "trocar-dynamics",
            "trocar-simulator",
            "trocar-haptics",
            "trocar-input",
            "trocar-network",
            "trocar-tasks",
        ],
    ),
    ("trocar-viewer", &["trocar-scene"]),
    (
        "trocar-cli",
        &[
            "trocar",
            "trocar-viewer",
            "trocar-scene",
            "trocar-devices",
            "trocar-kernel",
            "trocar-collision",
            "trocar-dynamics",
            "trocar-simulator",
            "trocar-zenoh",
        ],
    ),
    ("trocar-test-support", &[]),
    (
        "trocar-tests",
        &[
            "trocar",
            "trocar-scene",
            "trocar-devices",
            "trocar-kernel",
            "trocar-engine",
            "trocar-collision",
            "trocar-haptics",
            "trocar-input",
            "trocar-tasks",
        ],
    ),
];

/// Libraries that only some crates may depend on directly. `*` matches any ending.
const RESERVED: [(&str, &[&str]); 11] = [
    ("actix*", &["trocar-kernel"]),
    ("tokio*", &["trocar-kernel"]),
    ("rapier*", &["trocar-engine"]),
    ("wgpu*", &["trocar-viewer"]),
    ("winit", &["trocar-viewer"]),
    ("egui*", &["trocar-viewer"]),
    ("rayon*", &["trocar-simulator", "trocar-cli"]),
    ("axum*", &[]),
    ("zenoh*", &["trocar-zenoh"]),
    ("clap*", &["trocar-cli"]),
    ("indicatif", &["trocar-cli"]),
];

/// Projects that `trocar new` writes: whoever copies one lives outside of the house.
fn is_template(package: &Package) -> bool {
    package.name.starts_with("template-")
}

/// The crates of the house.
fn crates() -> Vec<Package> {
    metadata().packages.into_iter().filter(|package| !is_template(package)).collect()
}

fn metadata() -> Metadata {
    let manifest = root().join("Cargo.toml");
    MetadataCommand::new()
        .manifest_path(manifest)
        .no_deps()
        .other_options(["--offline".to_owned()])
        .exec()
        .expect("cargo metadata answers")
}

#[test]
fn dependencies_point_only_where_the_house_allows() {
    let allowed: BTreeMap<&str, &[&str]> = ARROWS.into_iter().collect();
    let crates = crates();
    let ours: BTreeSet<&str> = crates.iter().map(|package| package.name.as_str()).collect();
    let mut wrong = Vec::new();
    for package in &crates {
        let Some(arrows) = allowed.get(package.name.as_str()) else {
            wrong.push(format!("{} has no place in the house", package.name));
            continue;
        };
        for dependency in &package.dependencies {
            // Tests may depend on more than the crate itself.
            let counts = dependency.kind == DependencyKind::Normal && ours.contains(dependency.name.as_str());
            if counts && !arrows.contains(&dependency.name.as_str()) {
                wrong.push(format!("{} → {}", package.name, dependency.name));
            }
        }
    }
    refuse("arrows that the design does not have", wrong);
    assert_eq!(ours.len(), ROOMS.len(), "crates and rooms differ: {ours:?}");
}

#[test]
fn some_libraries_are_known_to_one_crate_only() {
    let matches = |pattern: &str, name: &str| match pattern.strip_suffix('*') {
        Some(stem) => name.starts_with(stem),
        None => name == pattern,
    };
    let mut wrong = Vec::new();
    for package in crates() {
        for dependency in &package.dependencies {
            for (pattern, owners) in RESERVED {
                if matches(pattern, &dependency.name) && !owners.contains(&package.name.as_str()) {
                    wrong.push(format!("{} → {}", package.name, dependency.name));
                }
            }
        }
    }
    refuse("libraries that these crates may not know", wrong);
}

#[test]
fn every_crate_lies_in_its_room_and_takes_the_lints_of_the_workspace() {
    let root = root();
    let rooms: BTreeMap<&str, &str> = ROOMS.into_iter().collect();
    for package in crates() {
        let folder = package.manifest_path.parent().expect("a manifest lies somewhere");
        let folder = folder.strip_prefix(&root).expect("below the root").as_str().to_owned();
        assert_eq!(rooms.get(package.name.as_str()).copied(), Some(folder.as_str()), "{}", package.name);
        let manifest = std::fs::read_to_string(&package.manifest_path).expect("a readable manifest");
        assert!(manifest.contains("[lints]\nworkspace = true"), "{} has lints of its own", package.name);
    }
}

#[test]
fn a_template_knows_no_crate_beside_the_two_that_a_project_is_written_for() {
    let metadata = metadata();
    let templates: Vec<&Package> = metadata.packages.iter().filter(|package| is_template(package)).collect();
    assert!(templates.len() >= 5, "{} templates", templates.len());
    let mut wrong = Vec::new();
    for package in templates {
        for dependency in &package.dependencies {
            let name = dependency.name.as_str();
            if name.starts_with("trocar") && !["trocar", "trocar-cli"].contains(&name) {
                wrong.push(format!("{} → {name}", package.name));
            }
        }
        let manifest = std::fs::read_to_string(&package.manifest_path).expect("a readable manifest");
        if manifest.contains("workspace = true") {
            wrong.push(format!("{} takes something from this workspace, which no project has", package.name));
        }
    }
    refuse("what a project outside of the repository does not have", wrong);
}

/// The drawing leaves out arrows that follow from others.
#[test]
fn the_drawing_of_the_crates_shows_the_arrows_of_the_house() {
    let page = std::fs::read_to_string(root().join("docs/architecture.md")).expect("a readable page");
    let (_, drawing) = page.split_once("```mermaid\n").expect("the page has a drawing");
    let (drawing, _) = drawing.split_once("```").expect("which ends");
    let drawn: Vec<(&str, &str)> =
        drawing.lines().filter_map(|line| line.trim().split_once(" --> ")).collect();
    let mut wrong: Vec<String> = drawn
        .iter()
        .filter(|(from, to)| !ARROWS.iter().any(|(name, known)| name == from && known.contains(to)))
        .map(|(from, to)| format!("{from} → {to} is drawn, and not allowed"))
        .collect();
    for (from, known) in ARROWS {
        let mut reached = BTreeSet::from([from]);
        let mut last = 0;
        while reached.len() > last {
            last = reached.len();
            let more: Vec<&str> =
                drawn.iter().filter(|(from, _)| reached.contains(from)).map(|(_, to)| *to).collect();
            reached.extend(more);
        }
        let missing = known.iter().filter(|to| !reached.contains(*to));
        wrong.extend(missing.map(|to| format!("{from} → {to} is allowed, and neither drawn nor implied")));
    }
    refuse("the drawing in docs/architecture.md", wrong);
}

//! Architecture tests on the sources: allowed dependencies, forbidden constructs, sizes of files and folders, and the
//! truth of the documentation.

mod absent;
mod additions;
mod arrows;
mod circles;
mod graph;
mod links;
mod pages;
mod size;

use std::path::{Path, PathBuf};

/// The crates' folders: crate → folder.
pub(super) const ROOMS: [(&str, &str); 18] = [
    ("trocar-scene", "scene"),
    ("trocar-scene-derive", "scene/derive"),
    ("trocar-devices", "devices"),
    ("trocar-kernel", "actors/kernel"),
    ("trocar-engine", "actors/engine"),
    ("trocar-collision", "actors/collision"),
    ("trocar-dynamics", "actors/dynamics"),
    ("trocar-simulator", "actors/simulator"),
    ("trocar-haptics", "actors/haptics"),
    ("trocar-input", "actors/input"),
    ("trocar-network", "actors/network"),
    ("trocar-tasks", "actors/tasks"),
    ("trocar-zenoh", "actors/zenoh"),
    ("trocar", "ui/sdk"),
    ("trocar-viewer", "ui/viewer"),
    ("trocar-cli", "ui/cli"),
    ("trocar-tests", "tests"),
    ("trocar-test-support", "tests/support"),
];

pub(super) fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().expect("the tests lie in the workspace").to_owned()
}

/// Every Rust source below a folder, with its path from the root.
pub(super) fn sources(folder: &str) -> Vec<(String, String)> {
    fn walk(folder: &Path, found: &mut Vec<PathBuf>) {
        let entries =
            std::fs::read_dir(folder).unwrap_or_else(|error| panic!("{}: {error}", folder.display()));
        for entry in entries {
            let path = entry.expect("a readable entry").path();
            let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
            if path.is_dir() && name != "target" && !name.starts_with('.') {
                walk(&path, found);
            } else if path.extension().is_some_and(|ending| ending == "rs") {
                found.push(path);
            }
        }
    }
    let root = root();
    let mut found = Vec::new();
    walk(&root.join(folder), &mut found);
    found.sort();
    found
        .into_iter()
        .map(|path| {
            let name = path.strip_prefix(&root).expect("below the root").display().to_string();
            (name, std::fs::read_to_string(&path).expect("a readable source"))
        })
        .collect()
}

/// Code without line comments and without the unit tests at the end of a file.
pub(super) fn production(text: &str) -> String {
    let code = text.split("#[cfg(test)]\nmod tests {").next().unwrap_or_default();
    code.lines().map(|line| line.split("//").next().unwrap_or_default()).collect::<Vec<_>>().join("\n")
}

/// Production code of a crate: its `src` without modules for tests only.
pub(super) fn production_sources(folder: &str) -> Vec<(String, String)> {
    let test_only = |name: &str| name.ends_with("tests.rs") || name.ends_with("testing.rs");
    sources(&format!("{folder}/src"))
        .into_iter()
        .filter(|(name, _)| !test_only(name))
        .map(|(name, text)| (name, production(&text)))
        .collect()
}

pub(super) fn refuse(what: &str, found: Vec<String>) {
    assert!(found.is_empty(), "{what}:\n  {}", found.join("\n  "));
}

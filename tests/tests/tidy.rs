//! The invariants of the design that can be read off the sources: who depends on whom, what is absent where.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use cargo_metadata::{DependencyKind, Metadata, MetadataCommand};

/// Rooms of the house: crate → folder.
const ROOMS: [(&str, &str); 14] = [
    ("trocar-scene", "scene"),
    ("trocar-devices", "devices"),
    ("trocar-kernel", "actors/kernel"),
    ("trocar-engine", "actors/engine"),
    ("trocar-collision", "actors/collision"),
    ("trocar-dynamics", "actors/dynamics"),
    ("trocar-simulator", "actors/simulator"),
    ("trocar-haptics", "actors/haptics"),
    ("trocar-input", "actors/input"),
    ("trocar-tasks", "actors/tasks"),
    ("trocar", "ui/sdk"),
    ("trocar-viewer", "ui/viewer"),
    ("trocar-cli", "ui/cli"),
    ("trocar-tests", "tests"),
];

/// Whom each crate may know of its neighbours. What is not listed is not allowed.
const ARROWS: [(&str, &[&str]); 14] = [
    ("trocar-scene", &[]),
    ("trocar-devices", &[]),
    ("trocar-kernel", &["trocar-scene"]),
    ("trocar-engine", &["trocar-scene", "trocar-dynamics"]),
    ("trocar-collision", &["trocar-scene"]),
    ("trocar-dynamics", &["trocar-scene", "trocar-collision"]),
    ("trocar-simulator", &["trocar-scene", "trocar-collision", "trocar-dynamics"]),
    ("trocar-tasks", &["trocar-scene"]),
    ("trocar-haptics", &["trocar-scene", "trocar-devices"]),
    ("trocar-input", &["trocar-scene", "trocar-devices"]),
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
        ],
    ),
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

/// Libraries that only some crates may know directly. `*` stands for any ending.
const RESERVED: [(&str, &[&str]); 10] = [
    ("actix*", &["trocar-kernel"]),
    ("tokio*", &["trocar-kernel"]),
    ("rapier*", &["trocar-engine"]),
    ("wgpu*", &["trocar-viewer"]),
    ("winit", &["trocar-viewer"]),
    ("egui*", &["trocar-viewer"]),
    ("rayon*", &["trocar-simulator", "trocar-cli"]),
    ("axum*", &[]),
    ("clap*", &["trocar-cli"]),
    ("indicatif", &["trocar-cli"]),
];

/// Crates that are pure: no clock, no thread, no socket of their own.
const PURE: [&str; 7] = [
    "scene",
    "actors/dynamics",
    "actors/engine",
    "actors/collision",
    "actors/simulator",
    "actors/haptics",
    "actors/tasks",
];
/// Lines of a file beyond which a newcomer loses the way.
const LINES_MAX: usize = 600;
/// Modules with a hash map that is only looked up in, never walked.
const LOOKUPS: [&str; 4] = [
    "scene/src/registry.rs",
    "scene/src/mesh/gmsh.rs",
    "scene/src/mesh/gmsh_v4.rs",
    "ui/viewer/src/gpu/passes.rs",
];
/// Modules in which unsafe code is allowed: scheduling, timers, what the kernel says of event devices, counting
/// allocations, a foreign engine's ABI, an X display that is lost.
const UNSAFE: [&str; 6] = [
    "devices/src/gamepad/evdev.rs",
    "devices/src/sched.rs",
    "actors/kernel/src/runtime/sched.rs",
    "ui/cli/src/bench/counting.rs",
    "ui/sdk/templates/engine/src/ffi.rs",
    "ui/viewer/src/window/display.rs",
];

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().expect("the tests lie in the workspace").to_owned()
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

/// Every Rust source below a folder, with its path from the root.
fn sources(folder: &str) -> Vec<(String, String)> {
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
fn production(text: &str) -> String {
    let code = text.split("#[cfg(test)]\nmod tests {").next().unwrap_or_default();
    code.lines().map(|line| line.split("//").next().unwrap_or_default()).collect::<Vec<_>>().join("\n")
}

/// Production code of a crate: what lies in its `src`, without modules that exist for tests only.
fn production_sources(folder: &str) -> Vec<(String, String)> {
    let test_only = |name: &str| name.ends_with("tests.rs") || name.ends_with("testing.rs");
    sources(&format!("{folder}/src"))
        .into_iter()
        .filter(|(name, _)| !test_only(name))
        .map(|(name, text)| (name, production(&text)))
        .collect()
}

fn refuse(what: &str, found: Vec<String>) {
    assert!(found.is_empty(), "{what}:\n  {}", found.join("\n  "));
}

#[test]
fn dependencies_point_only_where_the_house_allows() {
    let allowed: BTreeMap<&str, &[&str]> = ARROWS.into_iter().collect();
    let metadata = metadata();
    let ours: BTreeSet<&str> = metadata.packages.iter().map(|package| package.name.as_str()).collect();
    let mut wrong = Vec::new();
    for package in &metadata.packages {
        let Some(arrows) = allowed.get(package.name.as_str()) else {
            wrong.push(format!("{} has no place in the house", package.name));
            continue;
        };
        for dependency in &package.dependencies {
            // A test may look at more than the crate itself.
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
    for package in metadata().packages {
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
    for package in metadata().packages {
        let folder = package.manifest_path.parent().expect("a manifest lies somewhere");
        let folder = folder.strip_prefix(&root).expect("below the root").as_str().to_owned();
        assert_eq!(rooms.get(package.name.as_str()).copied(), Some(folder.as_str()), "{}", package.name);
        let manifest = std::fs::read_to_string(&package.manifest_path).expect("a readable manifest");
        assert!(manifest.contains("[lints]\nworkspace = true"), "{} has lints of its own", package.name);
    }
}

#[test]
fn the_readmes_sessions_are_the_examples_that_the_tests_build() {
    let read = |name: &str| std::fs::read_to_string(root().join(name)).expect("a readable file");
    let readme = read("README.md");
    for name in ["ui/sdk/examples/slippery.rs", "ui/cli/examples/eye.rs"] {
        let example = read(name);
        let (_, program) = example.split_once("\n\n").expect("a head and a program");
        assert!(
            readme.contains(&format!("```rust\n{program}```\n")),
            "the README shows something else than {name}"
        );
    }
}

#[test]
fn the_readmes_program_is_the_example_that_the_tests_build() {
    let read = |name: &str| std::fs::read_to_string(root().join(name)).expect("a readable file");
    let (readme, example) = (read("README.md"), read("ui/cli/examples/haste.rs"));
    let (_, shown) = readme.split_once("```rust\n").expect("the README shows a program");
    let (shown, _) = shown.split_once("\n```").expect("which ends");
    assert!(
        example.ends_with(&format!("{shown}\n")),
        "the README shows something else than examples/haste.rs"
    );
    let counts = |line: &&str| !line.trim().is_empty() && !line.trim_start().starts_with("//");
    assert!(shown.lines().filter(counts).count() <= 25, "a new behaviour takes 25 lines at most");
}

#[test]
fn no_file_is_longer_than_a_newcomer_can_follow() {
    let folders = ["scene", "devices", "actors", "ui", "tests"];
    let long: Vec<String> = folders
        .iter()
        .flat_map(|folder| sources(folder))
        .map(|(name, text)| (name, text.lines().count()))
        .filter(|(_, lines)| *lines > LINES_MAX)
        .map(|(name, lines)| format!("{name}: {lines} lines"))
        .collect();
    refuse("files that should be split", long);
}

#[test]
fn algorithms_have_no_clock_no_thread_and_no_socket() {
    const ABSENT: [&str; 9] = [
        "Instant::now",
        "SystemTime",
        "std::time::Instant",
        "std::thread",
        "thread::spawn",
        "std::net",
        "UdpSocket",
        "TcpStream",
        "std::process",
    ];
    let mut found = Vec::new();
    for folder in PURE.iter().chain(&["actors/input"]) {
        for (name, code) in production_sources(folder) {
            found.extend(
                ABSENT.iter().filter(|word| code.contains(**word)).map(|word| format!("{name}: {word}")),
            );
        }
    }
    refuse("what an algorithm may not have", found);
}

#[test]
fn nothing_random_is_unseeded_and_no_order_comes_from_a_hash_map() {
    let mut found = Vec::new();
    for folder in
        ["scene", "actors/dynamics", "actors/engine", "actors/haptics", "actors/tasks", "actors/input"]
    {
        for (name, code) in production_sources(folder) {
            let hashed = ["HashMap", "HashSet"].into_iter().filter(|_| !LOOKUPS.contains(&name.as_str()));
            for word in ["thread_rng", "rand::rng()", "from_entropy", "from_os_rng"].into_iter().chain(hashed)
            {
                if code.contains(word) {
                    found.push(format!("{name}: {word}"));
                }
            }
        }
    }
    refuse("what makes two runs differ", found);
}

#[test]
fn unsafe_code_stands_in_named_modules_only_and_says_why_it_is_sound() {
    let mut found = Vec::new();
    for folder in ["scene", "devices", "actors", "ui"] {
        for (name, text) in sources(folder) {
            let production = production(&text);
            let code = production.replace("unsafe_code", "").replace("unsafe_op_in_unsafe_fn", "");
            let blocks = code
                .split(|c: char| !c.is_alphanumeric() && c != '_')
                .filter(|word| *word == "unsafe")
                .count();
            if blocks == 0 {
                continue;
            }
            let is_test = name.contains("/tests/");
            if !UNSAFE.contains(&name.as_str()) && !is_test {
                found.push(format!("{name}: unsafe code"));
            }
            if text.matches("// SAFETY:").count() == 0 {
                found.push(format!("{name}: no SAFETY comment"));
            }
        }
    }
    refuse("unsafe code where none is allowed", found);
    let pure = std::fs::read_to_string(root().join("scene/src/lib.rs")).expect("a readable source");
    assert!(pure.contains("#![forbid(unsafe_code)]"), "scene forbids unsafe code");
}

#[test]
fn every_queue_is_bounded() {
    const UNBOUNDED: [&str; 4] = ["unbounded_channel", "mpsc::channel(", "channel::unbounded", ".do_send("];
    let mut found = Vec::new();
    for folder in ["scene", "devices", "actors", "ui"] {
        for (name, text) in sources(folder) {
            let code = production(&text);
            found.extend(
                UNBOUNDED.iter().filter(|word| code.contains(**word)).map(|word| format!("{name}: {word}")),
            );
        }
    }
    refuse("queues without a bound", found);
}

#[test]
fn nothing_is_left_unfinished() {
    // Written apart, so that this file does not find itself.
    let marks = [
        ["to", "do!("].concat(),
        ["unimple", "mented!("].concat(),
        ["FIX", "ME"].concat(),
        ["#[ig", "nore"].concat(),
    ];
    let mut found = Vec::new();
    for folder in ["scene", "devices", "actors", "ui", "tests"] {
        for (name, text) in sources(folder) {
            found.extend(
                marks
                    .iter()
                    .filter(|mark| text.contains(mark.as_str()))
                    .map(|mark| format!("{name}: {mark}")),
            );
        }
    }
    refuse("unfinished work", found);
}

#[test]
fn the_readme_shows_the_rooms_that_exist() {
    let readme = std::fs::read_to_string(root().join("README.md")).expect("a readable README");
    let tree = readme
        .split("```")
        .find(|block| block.contains("scene/") && block.contains("devices/"))
        .expect("the README has a tree of rooms");
    for (name, folder) in ROOMS {
        assert!(root().join(folder).join("Cargo.toml").exists(), "{folder} does not exist");
        let shown = tree.lines().any(|line| {
            let mut words = line.split_whitespace();
            let last = folder.rsplit('/').next().unwrap_or(folder);
            words.next() == Some(&format!("{last}/")) && words.next() == Some(name)
        });
        assert!(shown, "the README's tree does not show {folder} as {name}");
    }
    // Nothing is shown that does not exist.
    for line in tree.lines() {
        if let Some(folder) = line.split_whitespace().next().and_then(|word| word.strip_suffix('/')) {
            let exists = ["", "actors/", "ui/"].iter().any(|above| root().join(above).join(folder).is_dir());
            assert!(exists, "the README shows {folder}/, which does not exist");
        }
    }
    assert!(
        readme.contains("is clinically validated") && readme.contains("No score"),
        "the README says what a score is not"
    );
}

#[test]
fn the_readme_and_the_checks_name_the_same_commands() {
    let readme = std::fs::read_to_string(root().join("README.md")).expect("a readable README");
    let checks = std::fs::read_to_string(root().join(".ci/run")).expect("a readable script");
    assert!(readme.contains("\ntests/run\n"), "the README's test command is tests/run");
    assert_eq!(checks.lines().rfind(|line| !line.is_empty()), Some("tests/run"));
    assert!(readme.contains("cargo run --release -- run peg-transfer"));
}

#[test]
fn every_test_that_the_guarantees_and_the_validation_name_exists() {
    for (page, least) in [("docs/guarantees.md", 20), ("docs/validation.md", 40)] {
        let text = std::fs::read_to_string(root().join(page)).expect("a readable page");
        let (mut file, mut named) = (None, 0);
        // Between backticks stands a test file, or a test of the file named before.
        for word in text.split('`').skip(1).step_by(2) {
            if word.ends_with(".rs") {
                let text = std::fs::read_to_string(root().join(word));
                file = Some((word, text.unwrap_or_else(|error| panic!("{page}: {word}: {error}"))));
            } else if word.contains('_') && word.chars().all(|c| c.is_ascii_lowercase() || c == '_') {
                let (name, text) = file.as_ref().expect("a file before its tests");
                assert!(text.contains(&format!("fn {word}(")), "{page}: {name} has no test {word}");
                named += 1;
            }
        }
        assert!(named >= least, "{page}: {named} tests are named");
    }
}

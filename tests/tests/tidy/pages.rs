//! The README and the pages of `docs/`: the files that they show exist, and their statements hold.

use super::{ROOMS, root};

#[test]
fn the_sessions_of_the_manual_are_the_examples_that_the_tests_build() {
    let read = |name: &str| std::fs::read_to_string(root().join(name)).expect("a readable file");
    for (page, name) in [
        ("docs/sessions.md", "ui/sdk/examples/slippery.rs"),
        ("docs/pictures.md", "ui/cli/examples/offscreen.rs"),
    ] {
        let (page_text, example) = (read(page), read(name));
        let (_, program) = example.split_once("\n\n").expect("a head and a program");
        assert!(
            page_text.contains(&format!("```rust\n{program}```\n")),
            "{page} shows something else than {name}"
        );
    }
}

#[test]
fn the_behaviour_of_the_manual_is_the_example_that_the_tests_build() {
    let read = |name: &str| std::fs::read_to_string(root().join(name)).expect("a readable file");
    let (page, example) = (read("docs/behaviours.md"), read("ui/cli/examples/haste.rs"));
    let (_, shown) = page.split_once("```rust\n").expect("the page shows a program");
    let (shown, _) = shown.split_once("\n```").expect("which ends");
    assert!(
        example.ends_with(&format!("{shown}\n")),
        "docs/behaviours.md shows something else than examples/haste.rs"
    );
    let counts = |line: &&str| !line.trim().is_empty() && !line.trim_start().starts_with("//");
    assert!(shown.lines().filter(counts).count() <= 25, "a new behaviour takes 25 lines at most");
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
    // Every file in the tree must exist.
    for line in tree.lines() {
        if let Some(folder) = line.split_whitespace().next().and_then(|word| word.strip_suffix('/')) {
            let exists = ["", "scene/", "actors/", "ui/", "tests/"]
                .iter()
                .any(|above| root().join(above).join(folder).is_dir());
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
        // Backticks hold a test file, or a test of the file named before.
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

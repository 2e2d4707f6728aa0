//! The inventory of tests: `tests/inventory.toml` lists every test of the workspace with where it runs and its
//! duration, and is compared with the sources, so that no test vanishes unseen. `tests/inventory` rewrites it.

mod sources;

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write;
use std::path::{Path, PathBuf};

use sources::{Test, programs, tests};

/// With the value `accept` this variable rewrites the inventory.
const ACCEPT: &str = "TROCAR_INVENTORY";
/// The output of `tests/run --times`, from which durations are taken.
const LOG: &str = "TROCAR_TEST_LOG";
/// A separate workspace whose tests `tests/run` runs as well.
const BESIDE: &str = "tests/loom";
const HEAD: &str = "\
# Every test of the workspace, by the program that it is in: how long it took [s], beside what ran at the same time.
# `ci` runs in every `tests/run`, `thorough` only with `--thorough`. Written by tests/inventory; a test compares it with
# the sources.
";

/// Durations by program, place, and name.
type Inventory = BTreeMap<String, BTreeMap<String, BTreeMap<String, f64>>>;

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().expect("the tests lie in the workspace").to_owned()
}

fn file() -> PathBuf {
    root().join("tests/inventory.toml")
}

/// Every test in the sources.
fn in_the_sources() -> Vec<Test> {
    let root = root();
    let manifest = std::fs::read_to_string(root.join("Cargo.toml")).expect("a manifest");
    let manifest: toml::Table = toml::from_str(&manifest).expect("a manifest");
    let members = manifest["workspace"]["members"].as_array().expect("a list");
    let mut folders: Vec<String> =
        members.iter().map(|member| member.as_str().expect("text").to_owned()).collect();
    folders.push(BESIDE.to_owned());
    programs(&root, &folders).iter().flat_map(|(program, root)| tests(program, root)).collect()
}

/// Where the tests of a program run.
fn place(program: &str) -> &'static str {
    if program.ends_with("::thorough") { "thorough" } else { "ci" }
}

fn written() -> Inventory {
    match std::fs::read_to_string(file()) {
        Ok(text) => toml::from_str(&text).unwrap_or_else(|error| panic!("{}: {error}", file().display())),
        Err(_) => Inventory::new(),
    }
}

/// Durations printed by the test programs, by program and name \[s\].
fn told(log: &str) -> BTreeMap<(String, String), f64> {
    let mut program = String::new();
    let mut found = BTreeMap::new();
    for line in log.lines() {
        if let Some(name) = line.strip_prefix("== ") {
            program = name.trim().to_owned();
        }
        // test a::b - should panic ... ok <0.123s>
        let Some((name, rest)) = line.strip_prefix("test ").and_then(|line| line.split_once(" ... ")) else {
            continue;
        };
        let seconds = rest.split_once('<').and_then(|(_, time)| time.strip_suffix("s>")?.parse().ok());
        if let Some(seconds) = seconds {
            let name = name.split(" - ").next().unwrap_or(name).to_owned();
            found.insert((program.clone(), name), seconds);
        }
    }
    found
}

/// The inventory as the text of its file: durations rounded to 0.1 s.
fn rendered(inventory: &Inventory) -> String {
    let mut text = HEAD.to_owned();
    for (program, places) in inventory {
        for (place, tests) in places {
            writeln!(text, "\n[\"{program}\".{place}]").expect("into a string");
            for (name, seconds) in tests {
                writeln!(text, "\"{name}\" = {seconds:.1}").expect("into a string");
            }
        }
    }
    text
}

fn write_anew(found: &[Test]) {
    let before = written();
    let told = std::env::var_os(LOG).map_or_else(BTreeMap::new, |log| {
        told(&std::fs::read_to_string(&log).unwrap_or_else(|error| panic!("{}: {error}", log.display())))
    });
    let mut inventory = Inventory::new();
    for test in found {
        let place = place(&test.program);
        let known = || before.get(&test.program)?.values().find_map(|tests| tests.get(&test.name)).copied();
        let measured = told.get(&(test.program.clone(), test.name.clone())).copied();
        let seconds = measured.or_else(known).unwrap_or(0.0);
        let places = inventory.entry(test.program.clone()).or_default();
        places.entry(place.to_owned()).or_default().insert(test.name.clone(), seconds);
    }
    std::fs::write(file(), rendered(&inventory)).expect("the inventory can be written");
}

#[test]
fn every_test_of_the_sources_stands_in_the_inventory_and_no_other() {
    let found = in_the_sources();
    if std::env::var(ACCEPT).is_ok_and(|value| value == "accept") {
        write_anew(&found);
    }
    let of_sources: BTreeSet<(String, String, String)> = found
        .iter()
        .map(|test| (test.program.clone(), place(&test.program).to_owned(), test.name.clone()))
        .collect();
    assert_eq!(of_sources.len(), found.len(), "two tests of one program have one name");
    let inventory = written();
    let of_inventory: BTreeSet<(String, String, String)> = inventory
        .iter()
        .flat_map(|(program, places)| places.iter().map(move |(place, tests)| (program, place, tests)))
        .flat_map(|(program, place, tests)| {
            tests.keys().map(move |name| (program.clone(), place.clone(), name.clone()))
        })
        .collect();
    let shown = |set: BTreeSet<&(String, String, String)>| {
        set.into_iter().map(|(program, place, name)| format!("{program} {place}: {name}")).collect::<Vec<_>>()
    };
    let missing = shown(of_sources.difference(&of_inventory).collect());
    let gone = shown(of_inventory.difference(&of_sources).collect());
    assert!(
        missing.is_empty() && gone.is_empty(),
        "tests/inventory.toml differs from the sources; tests/inventory writes it anew.\n\
         Not in the inventory:\n  {}\nIn the inventory only:\n  {}",
        missing.join("\n  "),
        gone.join("\n  ")
    );
    assert!(found.len() > 1_700, "{} tests are found", found.len());
}

#[test]
fn whoever_runs_alone_says_so_first() {
    let tests = in_the_sources();
    let alone: Vec<&Test> = tests.iter().filter(|test| test.program.ends_with("::alone")).collect();
    assert!(alone.len() > 30, "{} tests", alone.len());
    let forgetful: Vec<&Test> = alone.into_iter().filter(|test| !test.takes_the_lock).collect();
    assert!(forgetful.is_empty(), "their first line is not 'let _alone = alone();': {forgetful:#?}");
}

#[test]
fn durations_are_read_from_what_programs_print() {
    let log = "== a::lib\ntest x::y ... ok <0.123s>\ntest z - should panic ... ok <2.000s>\n\
               test untimed ... ok\n== b::main\ntest x::y ... ok <61.250s>\n";
    let at = |program: &str, name: &str| (program.to_owned(), name.to_owned());
    let expected = BTreeMap::from([
        (at("a::lib", "x::y"), 0.123),
        (at("a::lib", "z"), 2.0),
        (at("b::main", "x::y"), 61.25),
    ]);
    assert_eq!(told(log), expected);
    let inventory = Inventory::from([(
        "a::lib".to_owned(),
        BTreeMap::from([("ci".to_owned(), BTreeMap::from([("x::y".to_owned(), 0.123)]))]),
    )]);
    let text = rendered(&inventory);
    assert!(text.ends_with("\n[\"a::lib\".ci]\n\"x::y\" = 0.1\n"), "{text}");
    let read: Inventory = toml::from_str(&text).expect("it is TOML");
    assert_eq!(read["a::lib"]["ci"]["x::y"], 0.1);
}

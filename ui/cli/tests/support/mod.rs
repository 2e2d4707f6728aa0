//! The program from outside, for several of the tests.
#![allow(dead_code, reason = "each program of tests uses a part of it")]

pub mod hosting;
pub mod live;
pub mod pair;
pub mod party;
pub mod projects;
pub mod screen;
pub mod shared_liver;
pub mod soak;

use std::path::Path;
use std::process::{Command, Output};

use serde_json::Value;

/// Runs the program in a folder.
pub fn trocar(folder: &Path, arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_trocar"))
        .args(arguments)
        .current_dir(folder)
        .env("NO_COLOR", "1")
        .output()
        .expect("the program starts")
}

/// A run of 0.1 s in virtual time.
pub const BRIEF: [&str; 5] = ["run", "wall", "--lockstep", "--seconds", "0.1"];

/// The names in a folder, in order.
pub fn names(folder: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(folder).expect("a folder");
    let mut names: Vec<String> =
        entries.map(|entry| entry.expect("an entry").file_name().to_string_lossy().into_owned()).collect();
    names.sort();
    names
}

/// A folder that goes when the test is over.
pub fn here() -> tempfile::TempDir {
    tempfile::tempdir().expect("a folder")
}

/// What it printed.
pub fn stdout(output: &Output) -> String {
    String::from_utf8(output.stdout.clone()).expect("text")
}

/// What it said beside that.
pub fn stderr(output: &Output) -> String {
    String::from_utf8(output.stderr.clone()).expect("text")
}

/// The one object on stdout.
pub fn object(output: &Output) -> Value {
    serde_json::from_slice(&output.stdout)
        .unwrap_or_else(|error| panic!("{error}: stdout is {:?}, stderr {}", stdout(output), stderr(output)))
}

/// Holds an object against the schema that the program prints for it.
pub fn assert_valid(of: &str, object: &Value) {
    let folder = here();
    let printed = trocar(folder.path(), &["schema", of]);
    let schema: Value = serde_json::from_slice(&printed.stdout).expect("a schema");
    let validator = jsonschema::validator_for(&schema).expect("a sound schema");
    let errors: Vec<String> =
        validator.iter_errors(object).map(|error| format!("{}: {error}", error.instance_path())).collect();
    assert!(errors.is_empty(), "{errors:?}");
}

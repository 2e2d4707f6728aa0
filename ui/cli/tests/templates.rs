//! Templates: each runs as a member of this workspace, and is complete where `trocar new` writes it, outside of this
//! repository. The test program `thorough` builds them there.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use serde_json::Value;

use crate::support::projects::{
    PROJECTS, assert_it_runs, assert_ok, cargo, repository, target, text, write_project,
};
use crate::support::{here, stderr, stdout, trocar};

/// The kind and the name of each target of a package.
fn targets(package: &Value) -> BTreeSet<(String, String)> {
    let targets = package["targets"].as_array().expect("a list").iter();
    let word = |value: &Value| value.as_str().expect("text").to_owned();
    targets.map(|target| (word(&target["kind"][0]), word(&target["name"]))).collect()
}

/// What `cargo metadata` tells of the packages at this folder. Their dependencies are not looked up: only those that
/// this platform needs are on every machine.
fn metadata(folder: &Path) -> Value {
    let mut command = cargo(folder);
    let output = command.args(["metadata", "--no-deps", "--offline", "--format-version", "1"]).output();
    let output = output.expect("cargo runs");
    assert_ok(&folder.display().to_string(), &output);
    assert!(!text(&output.stderr).contains("warning"), "{}", text(&output.stderr));
    serde_json::from_slice(&output.stdout).expect("one object")
}

/// The name and the requirement of each dependency of a package; of one that has a path its path.
fn dependencies(package: &Value) -> BTreeSet<(String, PathBuf)> {
    let dependencies = package["dependencies"].as_array().expect("a list").iter();
    let word = |value: &Value| value.as_str().map(str::to_owned);
    let place = |of: &Value| PathBuf::from(word(&of["path"]).or_else(|| word(&of["req"])).expect("either"));
    dependencies.map(|of| (word(&of["name"]).expect("text"), place(of))).collect()
}

fn package<'a>(metadata: &'a Value, name: &str) -> &'a Value {
    let packages = metadata["packages"].as_array().expect("a list");
    packages.iter().find(|package| package["name"] == name).unwrap_or_else(|| panic!("no package is {name}"))
}

#[test]
fn every_template_runs() {
    for project in PROJECTS {
        let folder = repository().join("ui/sdk/templates").join(project.1);
        assert_it_runs(&target().join("release").join(format!("template-{}", project.1)), &folder, &project);
    }
}

#[test]
fn every_project_is_complete_outside_of_the_repository() {
    let folder = here();
    assert!(!folder.path().starts_with(repository()), "the projects must lie outside of the repository");
    let members = metadata(&repository());
    for (name, template, ..) in PROJECTS {
        write_project(folder.path(), name, template);
        let project = metadata(&folder.path().join(name));
        let old = format!("template-{template}");
        // As a member of this workspace the template is built with the libraries that it asks for.
        let (project, member) = (package(&project, name), package(&members, &old));
        let wanted = dependencies(member);
        assert_eq!(dependencies(project), wanted, "{name}");
        for (ours, room) in [("trocar", "ui/sdk"), ("trocar-cli", "ui/cli")] {
            assert!(wanted.contains(&(ours.to_owned(), repository().join(room))), "{name}: {wanted:?}");
        }
        let renamed = targets(member).into_iter().map(|(kind, target)| {
            let snake = old.replace('-', "_");
            (kind, target.replace(&old, name).replace(&snake, &name.replace('-', "_")))
        });
        assert_eq!(targets(project), renamed.collect(), "{name}");
    }
}

#[test]
fn templates_are_listed_and_what_cannot_be_written_is_refused() {
    let folder = here();
    let listed = stdout(&trocar(folder.path(), &["list", "templates"]));
    for (_, template, ..) in PROJECTS {
        assert!(listed.contains(template), "{template} is not in: {listed}");
    }
    let refused = |arguments: &[&str], code: i32, named: &str| {
        let output = trocar(folder.path(), arguments);
        let message = stderr(&output);
        assert_eq!(output.status.code(), Some(code), "{arguments:?}: {message}");
        assert!(message.contains(named), "{arguments:?}: '{named}' is not in: {message}");
    };
    refused(&["new", "sim", "--template", "contoller"], 2, "did you mean 'controller'");
    refused(&["new", "My Sim"], 2, "lower-case letters");
    for name in ["fn", "2d-sim", "core", "test", "serde", "öl"] {
        refused(&["new", name], 2, "would do");
    }
    refused(&["new", "sim", "--trocar", "/"], 4, "no checkout of Trocar");
    assert_eq!(std::fs::read_dir(folder.path()).expect("a folder").count(), 0, "something was written");
    assert!(trocar(folder.path(), &["new", "sim"]).status.success());
    refused(&["new", "sim"], 4, "nothing is overwritten");
}

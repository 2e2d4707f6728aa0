//! Templates: each runs as a member of this workspace, and is complete where `trocar new` writes it, outside of this
//! repository. The test program `thorough` builds them there.

use std::collections::BTreeSet;
use std::path::Path;

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

/// What `cargo metadata` tells of the package at this folder.
fn metadata(folder: &Path, arguments: &[&str]) -> Value {
    let mut command = cargo(folder);
    let output = command.args(["metadata", "--offline", "--format-version", "1"]).args(arguments).output();
    let output = output.expect("cargo runs");
    assert_ok(&folder.display().to_string(), &output);
    assert!(!text(&output.stderr).contains("warning"), "{}", text(&output.stderr));
    serde_json::from_slice(&output.stdout).expect("one object")
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
    let members = metadata(&repository(), &["--no-deps"]);
    for (name, template, ..) in PROJECTS {
        write_project(folder.path(), name, template);
        let project = folder.path().join(name);
        // The versions that this workspace has locked are on this machine already.
        std::fs::copy(repository().join("Cargo.lock"), project.join("Cargo.lock")).expect("a lock file");
        let found = metadata(&project, &[]);
        for (ours, manifest) in [("trocar", "ui/sdk/Cargo.toml"), ("trocar-cli", "ui/cli/Cargo.toml")] {
            let wanted = repository().join(manifest);
            assert_eq!(
                package(&found, ours)["manifest_path"].as_str().map(Path::new),
                Some(&*wanted),
                "{name}"
            );
        }
        let old = format!("template-{template}");
        let renamed = targets(package(&members, &old)).into_iter().map(|(kind, target)| {
            let snake = old.replace('-', "_");
            (kind, target.replace(&old, name).replace(&snake, &name.replace('-', "_")))
        });
        assert_eq!(targets(package(&found, name)), renamed.collect(), "{name}");
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
    refused(&["new", "sim", "--trocar", "/"], 4, "no checkout of Trocar");
    assert_eq!(std::fs::read_dir(folder.path()).expect("a folder").count(), 0, "something was written");
    assert!(trocar(folder.path(), &["new", "sim"]).status.success());
    refused(&["new", "sim"], 4, "nothing is overwritten");
}

//! The scenarios of the repository are valid, everything that they name exists, and each is part of the program.

use std::path::{Path, PathBuf};

use serde_json::Value;
use trocar::app::SCENARIOS;
use trocar_scene::scenario::{self, Scenario};
use trocar_scene::tissue::tissue;
use trocar_scene::{Hand, Instrument, OutOfValidity, Snapshot, Sources, Tissue};
use trocar_tests::app;

fn shipped() -> Vec<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../scenarios");
    let mut files: Vec<PathBuf> = std::fs::read_dir(folder)
        .expect("the scenarios folder")
        .map(|entry| entry.expect("an entry").path())
        .filter(|path| path.extension().is_some_and(|extension| extension == "toml"))
        .collect();
    files.sort();
    files
}

#[test]
fn every_scenario_is_part_of_the_program() {
    let name = |file: &PathBuf| file.file_stem().and_then(|stem| stem.to_str()).map(str::to_owned);
    let files: Vec<String> = shipped().iter().filter_map(name).collect();
    let mut known: Vec<String> = SCENARIOS.iter().map(|(name, _)| (*name).to_owned()).collect();
    known.sort();
    assert_eq!(files, known);
}

#[test]
fn every_shipped_scenario_loads_and_its_named_things_exist() {
    let app = app();
    let registry = app.registry();
    for file in shipped() {
        let scenario = Scenario::load(&file, registry).unwrap_or_else(|error| panic!("{error}"));
        assert_eq!(Some(scenario.name.as_str()), file.file_stem().and_then(|stem| stem.to_str()));
        assert!(!scenario.title.is_empty() && !scenario.description.is_empty());
        let store = scenario.spawn(registry).unwrap_or_else(|error| panic!("{error}"));
        let view = store.view();
        assert_eq!(view.entities().count(), scenario.entities().len());
        for (name, entity) in scenario.entities() {
            assert_eq!(view.find(name), Some(*entity));
        }
        for hand in &scenario.hands {
            let component = view.get::<Hand>(hand.entity).expect("a hand");
            assert!(view.get::<Instrument>(component.instrument).is_some());
            assert!(scenario.controllers.iter().any(|c| c.name == format!("haptics.{}", hand.name)));
        }
    }
}

/// Components with the material of soft bodies.
const MATTER: [&str; 7] = ["mass_spring", "xpbd", "linear_fem", "dynamic_fem", "sewn", "tied", "cauterised"];
/// Numbers of those components that are no material parameters: numerical settings and loads.
const METHOD: [&str; 15] = [
    "lag",
    "damping",
    "thickness",
    "contact_stiffness",
    "parts",
    "iterations",
    "contact_radius",
    "mass_damping",
    "stiffness_damping",
    "spacing",
    "mark",
    "tears_at",
    "strength",
    "cut",
    "latent_heat",
];

/// Every number of a component, with the name of its table.
fn numbers<'a>(value: &'a Value, within: &'a str, found: &mut Vec<(&'a str, &'a str, f64)>) {
    for (name, value) in value.as_object().into_iter().flatten() {
        found.extend(value.as_f64().map(|value| (within, name.as_str(), value)));
        if name != "mark" {
            numbers(value, name, found);
        }
    }
}

/// Material numbers of a scene's soft bodies that have neither a source nor a tissue's range.
fn without_source(scene: &Snapshot) -> Vec<String> {
    let mut bare = Vec::new();
    for entity in scene.entities() {
        let all = scene.entity_json(entity);
        let tissue = scene.get::<Tissue>(entity).and_then(|of| tissue(&of.0));
        let sources = scene.get::<Sources>(entity).cloned().unwrap_or_default();
        for component in MATTER.iter().filter(|component| !all[**component].is_null()) {
            let mut found = Vec::new();
            numbers(&all[*component], component, &mut found);
            for (within, name, value) in found {
                // Friction depends on the other body as much; that of `tied` and `sewn` is a material parameter.
                let is_method = METHOD.contains(&name) || (name == "friction" && *component != "tied");
                // Sheets and lines have a mass by area or length, which is no tissue parameter.
                let of_tissue = || {
                    let of = tissue.and_then(|of| of.parameter(name))?;
                    (within == *component || within == "volume").then_some(of)
                };
                let known = sources.0.get(*component).and_then(|known| known.get(name));
                if !is_method && known.is_none() && of_tissue().is_none() {
                    let name_of = scene.get::<trocar_scene::Name>(entity).map(|name| name.0.clone());
                    bare.push(format!("{name_of:?} {component} {name} = {value}"));
                }
            }
        }
    }
    bare
}

#[test]
fn what_soft_bodies_of_shipped_scenarios_are_made_of_has_a_source_and_is_within_its_range() {
    let app = app();
    let registry = app.registry();
    // Any other component with a material stiffness must be in the list.
    let elsewhere = ["engine_soft", "thread", "needle", "soft_regions"];
    for (_, entry) in registry.iter() {
        let schema = (entry.schema)().map(|schema| schema.to_string()).unwrap_or_default();
        let is_matter = ["young_modulus", "bending_stiffness"].iter().any(|of| schema.contains(*of));
        assert!(
            !is_matter || MATTER.contains(&entry.name) || elsewhere.contains(&entry.name),
            "'{}' is made of something: does it have a source?",
            entry.name
        );
    }
    let mut bodies = 0;
    for file in shipped() {
        let scenario = Scenario::load(&file, registry).unwrap_or_else(|error| panic!("{error}"));
        let scene = scenario.spawn(registry).unwrap_or_else(|error| panic!("{error}")).snapshot();
        let bare = without_source(&scene);
        assert!(bare.is_empty(), "{}: {bare:#?}", file.display());
        let doubtful: Vec<String> =
            scene.iter::<OutOfValidity>().map(|(_, doubt)| doubt.reason.clone()).collect();
        assert!(doubtful.is_empty(), "{}: {doubtful:#?}", file.display());
        bodies += scene
            .entities()
            .filter(|entity| MATTER.iter().any(|of| !scene.entity_json(*entity)[*of].is_null()))
            .count();
    }
    assert!(bodies >= 16, "only {bodies} bodies were looked at");

    // A number without a source is found, and so is a number out of its range.
    let text = std::fs::read_to_string(shipped()[0].with_file_name("band.toml")).expect("readable");
    let load = |text: &str| Scenario::parse(Path::new("band.toml"), text, registry);
    let spawned = |text: &str| {
        let scenario = load(text).unwrap_or_else(|error| panic!("{error}"));
        scenario.spawn(registry).unwrap_or_else(|error| panic!("{error}")).snapshot()
    };
    let line = text.lines().find(|line| line.starts_with("poisson_ratio = {")).expect("a source");
    let bare = without_source(&spawned(&text.replace(line, "")));
    assert!(bare.len() == 1 && bare[0].contains("cushion") && bare[0].contains("poisson_ratio"), "{bare:?}");
    let far = spawned(&text.replace("density = 1100.0", "density = 2000.0"));
    let doubt = far.iter::<OutOfValidity>().next().expect("no such silicone").1.reason.clone();
    assert!(doubt.contains("density of 2000") && doubt.contains("970 to 1250"), "{doubt}");
    // A source for a missing parameter is refused by name.
    for (from, to, says) in [
        ("poisson_ratio = {", "possion_ratio = {", "'xpbd' gives no number 'possion_ratio'"),
        (
            "[entity.sources.xpbd]\nyoung",
            "[entity.sources.linear_fem]\nyoung",
            "the entity has no 'linear_fem'",
        ),
    ] {
        let refused = load(&text.replace(from, to)).err().map(|error| error.to_string()).unwrap_or_default();
        assert!(refused.contains(says) && refused.contains("sources"), "{refused}");
    }
}

#[test]
fn every_shipped_scenario_is_valid_under_the_published_schema() {
    let schema = scenario::json_schema(app().registry());
    jsonschema::draft202012::meta::validate(&schema).unwrap_or_else(|error| panic!("{error}"));
    let validator = jsonschema::draft202012::new(&schema).expect("a schema");
    for file in shipped() {
        let text = std::fs::read_to_string(&file).expect("readable");
        let value: toml::Value = toml::from_str(&text).expect("TOML");
        let value = serde_json::to_value(value).expect("JSON");
        let errors: Vec<String> = validator
            .iter_errors(&value)
            .map(|error| format!("{}: {error}", error.instance_path()))
            .collect();
        assert!(errors.is_empty(), "{}: {errors:#?}", file.display());
    }
}

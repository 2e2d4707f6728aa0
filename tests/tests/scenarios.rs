//! The scenarios of the repository: valid, with everything that they name, each part of the program.

use std::path::{Path, PathBuf};

use trocar::app::SCENARIOS;
use trocar_scene::scenario::{self, Scenario};
use trocar_scene::{Hand, Instrument};
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

//! Tuning: any value of any component, before a session and while it runs.
//!
//! A field is named `ENTITY.COMPONENT.FIELD`, such as `grasper.left.instrument.jaw_friction`; a `*` in the entity's
//! part selects several entities. Three operations take fields:
//!
//! - [`tuned_scenario`] sets them before a session begins, and also values outside components: `gravity.2`,
//!   `controller.engine.rate_hz`, `task.weights.cutoff_secs`, `network.reflector.loss`.
//! - A [`Tuner`] changes them in a running scene and switches between sets of values ([`TuningSets`]), so that a person
//!   can compare two of them by feel.
//! - [`save`] writes the chosen values back into the scenario's text, in place: comments and order stay.
//!
//! ```
//! use trocar::prelude::*;
//! use trocar::tuning;
//!
//! let app = App::new();
//! let scenario = app.scenario("peg-transfer")?;
//! let heavy = tuning::tuned_scenario(&app, &scenario, &[("ring.*.rigid_body.mass".into(), 0.02.into())])?;
//! let scene = heavy.spawn(app.registry())?.snapshot();
//! let ring = scene.find("ring.6").unwrap();
//! assert_eq!(scene.get::<RigidBody>(ring).unwrap().mass, 0.02);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod document;
mod field;
mod sets;
mod tuner;

use std::path::Path;

use serde_json::Value;
use thiserror::Error;
use trocar_scene::Snapshot;
use trocar_scene::scenario::{Scenario, ScenarioError};

pub use document::{DocumentError, ScenarioText};
pub use field::{Field, FieldError, find, list, parse_assignment, parse_value, read};
pub use sets::{BASE, SETS_MAX, SetsError, TuningSet, TuningSets, VALUES_MAX};
pub use tuner::{Change, TuneError, Tuned, Tuner};

use crate::app::{App, AppError};

/// Why a scenario cannot be tuned, or tuned values cannot be saved.
#[derive(Debug, Error)]
pub enum ScenarioTuneError {
    /// The field or its value is invalid.
    #[error(transparent)]
    Tune(#[from] TuneError),
    /// The scenario's text cannot be edited.
    #[error(transparent)]
    Document(#[from] DocumentError),
    /// The scenario would be invalid with these values.
    #[error("with the values that were set, {}", in_short(.0))]
    Invalid(AppError),
}

/// Drops the position, which refers to a text that the user never sees, and keeps the reason.
fn in_short(error: &AppError) -> String {
    match error {
        AppError::Scenario(ScenarioError::Invalid { key, reason, .. }) => format!("{key}: {reason}"),
        other => other.to_string(),
    }
}

/// The scenario with other values; only its text is parsed again. A recording stores the text with these values as its
/// scenario.
///
/// # Errors
/// [`ScenarioTuneError`] names the field and the valid values.
pub fn tuned_scenario(
    app: &App,
    scenario: &Scenario,
    values: &[(String, Value)],
) -> Result<Scenario, ScenarioTuneError> {
    let scene = scenario.spawn(app.registry()).map_err(|error| ScenarioTuneError::Invalid(error.into()))?;
    let text = tuned_text(&scene.snapshot(), scenario.text(), values)?;
    app.scenario_from(&scenario.file, &text).map_err(ScenarioTuneError::Invalid)
}

/// The result of [`save`].
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Saved {
    /// The text of the scenario.
    pub text: String,
    /// Values that no scenario can hold, in words: those of entities and components created at run time.
    pub left_out: Vec<String>,
}

/// The text of a scenario with these values ([`Tuner::values`]) written into it. The text may have been edited since
/// the session began: only the tuned values change.
///
/// # Errors
/// When the text is not a valid scenario, or would not be with these values.
pub fn save(
    app: &App,
    file: &Path,
    text: &str,
    values: &[(String, Value)],
) -> Result<Saved, ScenarioTuneError> {
    let scenario = app.scenario_from(file, text).map_err(ScenarioTuneError::Invalid)?;
    // Entities are matched by name: others may have been inserted before them in the file.
    let scene = scenario.spawn(app.registry()).map_err(|error| ScenarioTuneError::Invalid(error.into()))?;
    let scene = scene.snapshot();
    let mut saved = Saved { text: text.to_owned(), left_out: Vec::new() };
    for value in values {
        match tuned_text(&scene, &saved.text, std::slice::from_ref(value)) {
            Ok(text) => saved.text = text,
            Err(ScenarioTuneError::Invalid(error)) => return Err(ScenarioTuneError::Invalid(error)),
            Err(error) => saved.left_out.push(error.to_string()),
        }
    }
    app.scenario_from(file, &saved.text).map_err(ScenarioTuneError::Invalid)?;
    Ok(saved)
}

fn tuned_text(scene: &Snapshot, text: &str, values: &[(String, Value)]) -> Result<String, ScenarioTuneError> {
    let mut document = ScenarioText::parse(text)?;
    let mut fields = Vec::new();
    for (name, value) in values {
        match field::find(scene, name) {
            Ok(_) => fields.push((name.as_str(), value)),
            // No such entity: the key may be outside components.
            Err(error @ FieldError::NoEntity { .. }) => {
                if let Err(other) = document.set_key(name, value) {
                    let root = name.split('.').next().unwrap_or_default();
                    let meant = document::BESIDE_ENTITIES.contains(&root);
                    return Err(if meant { other.into() } else { TuneError::from(error).into() });
                }
            }
            Err(error) => return Err(TuneError::from(error).into()),
        }
    }
    for (field, value) in tuner::resolve(scene, fields)? {
        let mut row = field::row(scene, &field).map_err(TuneError::from)?;
        field::write(&field, &mut row, &value).map_err(TuneError::from)?;
        document.set_field(&field, &row)?;
    }
    Ok(document.text())
}

#[cfg(test)]
mod tests {
    use super::*;
    use trocar_scene::{Pose, RigidBody};

    fn peg_transfer(values: &[&str]) -> Result<Scenario, ScenarioTuneError> {
        let app = App::new();
        let scenario = app.scenario("peg-transfer").unwrap();
        let values: Vec<(String, Value)> =
            values.iter().map(|text| parse_assignment(text).unwrap()).collect();
        tuned_scenario(&app, &scenario, &values)
    }

    #[test]
    fn a_tuned_scenario_differs_in_nothing_else() {
        let app = App::new();
        let scenario = peg_transfer(&[
            "ring.*.rigid_body.mass=0.02",
            "ring.3.rigid_body.restitution=0.5",
            "ring.1.pose.translation.2=0.01",
            "gravity.2=-1.62",
            "controller.engine.rate_hz=250",
            "task.weights.cutoff_secs=120",
        ])
        .unwrap();
        assert_eq!(scenario.gravity_in_world.z, -1.62);
        assert_eq!(scenario.controllers[2].rate_hz, 250.0);
        let scene = scenario.spawn(app.registry()).unwrap().snapshot();
        let before = app.scenario("peg-transfer").unwrap().spawn(app.registry()).unwrap().snapshot();
        for entity in before.entities() {
            let (mut old, mut new) = (before.entity_json(entity), scene.entity_json(entity));
            let name = before.name(entity);
            if name.starts_with("ring.") {
                assert_eq!(scene.get::<RigidBody>(entity).unwrap().mass, 0.02);
                (old["rigid_body"], new["rigid_body"]) = (Value::Null, Value::Null);
            }
            if name == "ring.1" {
                assert_eq!(scene.get::<Pose>(entity).unwrap().translation.z, 0.01);
                (old["pose"], new["pose"]) = (Value::Null, Value::Null);
            }
            assert_eq!(old, new, "{name}");
        }
        let lines = |text: &str| text.lines().map(str::to_owned).collect::<Vec<_>>();
        let (old, new) = (lines(app.scenario("peg-transfer").unwrap().text()), lines(scenario.text()));
        let kept = old.iter().filter(|line| new.contains(line)).count();
        // Six rings, two poses on one line each, gravity, the rate and the cutoff.
        assert!(old.len() - kept <= 10 && new.len() <= old.len() + 1, "{} of {} lines", kept, old.len());
    }

    #[test]
    fn what_cannot_be_set_is_said_by_its_name() {
        for (text, says) in [
            ("ring.1.rigid_body.mass=-1", "mass: -1 is out of range"),
            ("ring.1.rigid_body.mas=1", "there is no 'mas'"),
            ("rong.1.rigid_body.mass=1", "no entity is called like that"),
            ("controller.engin.rate_hz=1", "haptics.left, haptics.right, engine"),
            ("controller.engine.rate_hz=1e9", "out of range (1 to 10000 Hz)"),
            ("controller.engine.rat=1", "unknown key 'rat'"),
            ("gravity.2=-1e9", "-100 to 100"),
        ] {
            let error = peg_transfer(&[text]).unwrap_err().to_string();
            assert!(error.contains(says), "{text}: {error}");
        }
    }

    #[test]
    fn what_was_tuned_is_saved_into_a_file_that_others_have_edited() {
        let app = App::new();
        let scenario = app.scenario("peg-transfer").unwrap();
        let scene = scenario.spawn(app.registry()).unwrap().snapshot();
        assert!(scene.find("ring.6").is_some());
        let tuned = [("ring.6.rigid_body.mass".to_owned(), 0.05.into())];
        // Another entity before all others shifts their numbers.
        let edited = scenario.text().replacen(
            "[[entity]]\nname = \"board.left\"",
            "[[entity]]\nname = \"lamp\"\npose = {}\n\n[[entity]]\nname = \"board.left\"",
            1,
        );
        assert_ne!(edited, scenario.text());
        let saved = save(&app, Path::new("p.toml"), &edited, &tuned).unwrap();
        assert!(saved.left_out.is_empty());
        let scene = app.scenario_from(Path::new("p.toml"), &saved.text).unwrap();
        let scene = scene.spawn(app.registry()).unwrap().snapshot();
        assert_eq!(scene.get::<RigidBody>(scene.find("ring.6").unwrap()).unwrap().mass, 0.05);
        assert_eq!(scene.get::<RigidBody>(scene.find("ring.5").unwrap()).unwrap().mass, 0.005);
        assert!(scene.find("lamp").is_some());

        let gone = edited.replace("name = \"ring.6\"", "name = \"ring.7\"");
        let saved = save(&app, Path::new("p.toml"), &gone, &tuned).unwrap();
        assert!(saved.text == gone && saved.left_out[0].contains("ring.6"), "{:?}", saved.left_out);
        let wrong = [("ring.6.rigid_body.mass".to_owned(), (-1.0).into())];
        assert!(save(&app, Path::new("p.toml"), &edited, &wrong).is_err());
    }
}

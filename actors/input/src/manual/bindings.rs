//! Bindings of keys, buttons and sticks to actions, with their rates: replaceable data.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use serde::{Deserialize, Serialize};
use thiserror::Error;
use trocar_scene::PersonAction;

use super::control::Control;

/// Most controls of one action.
const CONTROLS_MAX: usize = 16;

/// Why bindings are invalid.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum BindingsError {
    /// No TOML, an unknown key, action or control, or a value of another type.
    #[error("{0}")]
    Text(String),
    /// One control for two actions.
    #[error("{control} cannot mean both {first} and {second}")]
    Twice {
        /// The control.
        control: &'static str,
        /// One action.
        first: &'static str,
        /// The other one.
        second: &'static str,
    },
    /// Too many controls.
    #[error("{0} has more than {CONTROLS_MAX} controls")]
    TooMany(&'static str),
    /// A parameter is out of range.
    #[error("{field} = {value} is out of range ({min} to {max})")]
    Range {
        /// Which one.
        field: &'static str,
        /// Its value.
        value: f64,
        /// Least valid value.
        min: f64,
        /// Greatest valid value.
        max: f64,
    },
}

/// Bindings of controls to actions, and rates of motions.
///
/// ```
/// use trocar_input::manual::Bindings;
///
/// // What is not mentioned stays as it is.
/// let bindings = Bindings::parse("fine = 0.1\n[controls]\nmove_up = ['KeyI']\nmove_left = ['KeyJ']")?;
/// assert_eq!(bindings.fine, 0.1);
/// let error = Bindings::parse("[controls]\njump = ['KeyJ']").unwrap_err().to_string();
/// assert!(error.contains("jump") && error.contains("move_left"), "{error}");
/// # Ok::<(), trocar_input::manual::BindingsError>(())
/// ```
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Bindings {
    /// Speed of the tip in the picture while a key or a stick moves it \[heights of the picture per second\].
    pub speed: f64,
    /// Speed with which a key or a stick rolls the instrument \[rad/s\].
    pub roll_speed: f64,
    /// Speed with which a key changes the opening of the released jaws \[shares of the largest one per second\].
    pub jaw_speed: f64,
    /// Roll per pointer motion of one image height to the right \[rad\].
    pub roll_per_height: f64,
    /// Change of the logarithm of the distance from the eye per wheel notch.
    pub depth_per_notch: f64,
    /// Scale of motions in fine mode.
    pub fine: f64,
    /// Initial opening of the released jaws, as a share of the largest one.
    pub opening: f64,
    /// The controls of each action. Actions omitted in a file keep their defaults.
    #[serde(deserialize_with = "over_the_defaults")]
    pub controls: BTreeMap<PersonAction, Vec<Control>>,
}

impl Default for Bindings {
    fn default() -> Self {
        Self {
            speed: 0.25,
            roll_speed: 1.5,
            jaw_speed: 0.8,
            roll_per_height: 3.0,
            depth_per_notch: 0.02,
            fine: 0.2,
            opening: 0.5,
            controls: default_controls(),
        }
    }
}

/// Default controls of each action.
const DEFAULTS: [(PersonAction, &[&str]); 17] = [
    (PersonAction::MoveLeft, &["KeyA", "ArrowLeft", "PadLeftStickLeft"]),
    (PersonAction::MoveRight, &["KeyD", "ArrowRight", "PadLeftStickRight"]),
    (PersonAction::MoveUp, &["KeyW", "ArrowUp", "PadLeftStickUp"]),
    (PersonAction::MoveDown, &["KeyS", "ArrowDown", "PadLeftStickDown"]),
    (PersonAction::MoveAway, &["KeyE", "PageUp", "PadRightStickUp"]),
    (PersonAction::MoveCloser, &["KeyQ", "PageDown", "PadRightStickDown"]),
    (PersonAction::RollLeft, &["KeyC", "PadRightStickLeft"]),
    (PersonAction::RollRight, &["KeyV", "PadRightStickRight"]),
    (PersonAction::Grip, &["MouseLeft", "KeyF", "PadRightTrigger"]),
    (PersonAction::JawClose, &["KeyZ", "PadDown"]),
    (PersonAction::JawOpen, &["KeyX", "PadUp"]),
    (PersonAction::Activate, &["KeyB", "PadSouth"]),
    (PersonAction::Coagulate, &["KeyN", "PadEast"]),
    (PersonAction::Turn, &["MouseRight"]),
    (PersonAction::Clutch, &["Space", "PadLeftTrigger"]),
    (PersonAction::Fine, &["ShiftLeft", "ShiftRight", "PadLeftShoulder"]),
    (PersonAction::SwitchHand, &["Tab", "MouseMiddle", "PadNorth"]),
];

fn default_controls() -> BTreeMap<PersonAction, Vec<Control>> {
    let named = |names: &[&str]| names.iter().filter_map(|name| Control::named(name)).collect();
    DEFAULTS.into_iter().map(|(action, names)| (action, named(names))).collect()
}

fn over_the_defaults<'de, D>(deserializer: D) -> Result<BTreeMap<PersonAction, Vec<Control>>, D::Error>
where
    D: serde::Deserializer<'de>,
{
    let mut controls = default_controls();
    controls.extend(BTreeMap::<PersonAction, Vec<Control>>::deserialize(deserializer)?);
    Ok(controls)
}

impl Bindings {
    /// Reads bindings from TOML; omitted values keep their defaults. A rebound control is removed from its default
    /// action.
    ///
    /// # Errors
    /// [`BindingsError`] names what is wrong, where, and the valid choices.
    pub fn parse(text: &str) -> Result<Self, BindingsError> {
        let table: toml::Table =
            toml::from_str(text).map_err(|error| BindingsError::Text(error.to_string()))?;
        let mentioned: Vec<String> = match table.get("controls") {
            Some(toml::Value::Table(controls)) => controls.keys().cloned().collect(),
            _ => Vec::new(),
        };
        let mut bindings: Self =
            toml::from_str(text).map_err(|error| BindingsError::Text(error.to_string()))?;
        let is_mentioned = |action: &PersonAction| mentioned.iter().any(|name| name == action.name());
        let taken: Vec<Control> = bindings
            .controls
            .iter()
            .filter(|(action, _)| is_mentioned(action))
            .flat_map(|(_, controls)| controls.clone())
            .collect();
        for (action, controls) in &mut bindings.controls {
            if !is_mentioned(action) {
                controls.retain(|control| !taken.contains(control));
            }
        }
        bindings.check()?;
        Ok(bindings)
    }

    /// Checks that each control has one action, and every parameter is in range.
    ///
    /// # Errors
    /// [`BindingsError`] names the problem and the valid range.
    pub fn check(&self) -> Result<(), BindingsError> {
        let figures = [
            ("speed", self.speed, 0.001, 10.0),
            ("roll_speed", self.roll_speed, 0.01, 20.0),
            ("jaw_speed", self.jaw_speed, 0.01, 20.0),
            ("roll_per_height", self.roll_per_height, 0.01, 20.0),
            ("depth_per_notch", self.depth_per_notch, 0.0001, 1.0),
            ("fine", self.fine, 0.001, 1.0),
            ("opening", self.opening, 0.0, 1.0),
        ];
        for (field, value, min, max) in figures {
            // Written so that a NaN fails.
            if !(min..=max).contains(&value) {
                return Err(BindingsError::Range { field, value, min, max });
            }
        }
        let mut owners: [Option<PersonAction>; Control::COUNT] = [None; Control::COUNT];
        for (action, controls) in &self.controls {
            if controls.len() > CONTROLS_MAX {
                return Err(BindingsError::TooMany(action.name()));
            }
            for control in controls {
                if let Some(first) = owners[control.index()].replace(*action)
                    && first != *action
                {
                    let (control, second) = (control.name(), action.name());
                    return Err(BindingsError::Twice { control, first: first.name(), second });
                }
            }
        }
        Ok(())
    }

    /// The action of a control.
    pub fn action_of(&self, control: Control) -> Option<PersonAction> {
        self.controls.iter().find(|(_, controls)| controls.contains(&control)).map(|(action, _)| *action)
    }

    /// The bindings as a Markdown table.
    pub fn table(&self) -> String {
        let mut table = String::from("| what | with |\n|---|---|\n");
        // Writing into a string cannot fail.
        let _ = writeln!(table, "| moves the tip in the picture | the pointer |");
        let _ = writeln!(table, "| moves it away and closer | the wheel |");
        for action in PersonAction::ALL {
            let controls = self.controls.get(action).map_or(&[][..], Vec::as_slice);
            let names: Vec<String> = controls.iter().map(|control| format!("`{}`", control.name())).collect();
            let _ = writeln!(table, "| {} (`{}`) | {} |", action.about(), action.name(), names.join(", "));
        }
        table
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn by_default_every_action_has_a_control_and_every_control_one_action() {
        let bindings = Bindings::default();
        bindings.check().expect("sound");
        for action in PersonAction::ALL {
            assert!(!bindings.controls[action].is_empty(), "{}", action.name());
        }
        // An unknown name would be skipped silently.
        for (action, names) in DEFAULTS {
            let bound: Vec<&str> = bindings.controls[&action].iter().map(|control| control.name()).collect();
            assert_eq!(bound, names, "{}", action.name());
        }
        let text = toml::to_string(&bindings).expect("TOML");
        assert_eq!(Bindings::parse(&text), Ok(bindings));
    }

    #[test]
    fn a_control_that_is_bound_anew_leaves_its_action() {
        let bindings = Bindings::parse("[controls]\nclutch = ['Tab']").expect("valid");
        let tab = Control::named("Tab").expect("a key");
        assert_eq!(bindings.action_of(tab), Some(PersonAction::Clutch));
        let left: Vec<&str> =
            bindings.controls[&PersonAction::SwitchHand].iter().map(|control| control.name()).collect();
        assert_eq!(left, ["MouseMiddle", "PadNorth"]);
    }

    #[test]
    fn what_cannot_be_bound_is_refused_with_what_can() {
        let refused = |text: &str| Bindings::parse(text).expect_err(text).to_string();
        let unknown = refused("[controls]\nfly = ['KeyA']");
        for action in PersonAction::ALL {
            assert!(unknown.contains(action.name()), "{unknown}");
        }
        assert!(refused("[controls]\ngrip = ['Mause']").contains("'Mause'"));
        assert!(refused("speeed = 1.0").contains("roll_speed"));
        assert!(refused("fine = 0.0").contains("fine = 0 is out of range (0.001 to 1)"));
        assert!(refused("fine = nan").contains("out of range"));
        let twice = refused("[controls]\ngrip = ['KeyG']\nclutch = ['KeyG']");
        assert!(twice.contains("KeyG cannot mean both grip and clutch"), "{twice}");
        assert!(refused(&format!("[controls]\ngrip = {:?}", vec!["KeyG"; 17])).contains("more than 16"));
    }

    proptest! {
        #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(300) })]

        #[test]
        fn any_text_is_read_or_refused(
            text in prop_oneof![
                "\\PC{0,60}",
                "(fine|speed|grip|\\[controls\\]|'KeyA'|=|\\[|\\]|[0-9.]{1,5}|nan|\n){0,12}",
            ],
        ) {
            if let Ok(bindings) = Bindings::parse(&text) {
                prop_assert!(bindings.check().is_ok());
            }
        }
    }
}

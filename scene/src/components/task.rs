//! Exercises: state, errors and motion metrics.

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::entity::Entity;
use crate::{Component, RecordPolicy};

/// An error of the trainee.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct TaskError {
    /// Kind, such as `drop_in_view`.
    pub kind: String,
    /// When \[s\].
    pub at_secs: f64,
    /// The entity concerned.
    #[schemars(with = "Option<String>")]
    pub entity: Option<Entity>,
}

/// State of an exercise.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema, Component)]
#[component(name = "task_state", schema)]
#[serde(default, deny_unknown_fields)]
pub struct TaskState {
    /// Name of the exercise.
    pub task: String,
    /// Name of the current phase.
    pub phase: String,
    /// Steps done.
    pub done: u32,
    /// Steps in all.
    pub steps: u32,
    /// Time on the exercise's own clock \[s\].
    pub seconds: f64,
    /// Whether the exercise has ended, for any reason.
    pub over: bool,
    /// Whether everything was done.
    pub completed: bool,
    /// Whether time ran out first.
    pub cut_off: bool,
    /// Score 0–100, once known; [`TaskState::score_kind`] says what it is made of. Not clinically validated.
    pub score: Option<f64>,
    /// Errors, in order; bounded.
    pub errors: Vec<TaskError>,
    /// Motion metrics: hand → name → value.
    pub metrics: BTreeMap<String, BTreeMap<String, f64>>,
}

/// Name of the peg transfer as an exercise.
pub const PEG_TRANSFER: &str = "peg-transfer";
/// Exercises whose score has the form of the FLS programme.
const FLS_STYLE: [&str; 1] = [PEG_TRANSFER];
/// The metrics with the judged quantities of an exercise that consists of expectations.
pub const OUTCOME: &str = "outcome";

/// What a score is made of.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum ScoreKind {
    /// Time and penalties, in the form of the FLS programme.
    FlsStyle,
    /// The share of the expectations that were met.
    Expectations,
    /// Whatever the exercise makes of it.
    #[default]
    Own,
}

impl ScoreKind {
    /// In words, for people.
    #[must_use]
    pub fn words(self) -> &'static str {
        match self {
            Self::FlsStyle => "FLS-style score, not clinically validated",
            Self::Expectations => "share of the expectations that were met, not clinically validated",
            Self::Own => "score of this exercise, not clinically validated",
        }
    }
}

impl TaskState {
    /// What its score is made of.
    #[must_use]
    pub fn score_kind(&self) -> ScoreKind {
        match () {
            () if FLS_STYLE.contains(&self.task.as_str()) => ScoreKind::FlsStyle,
            () if self.metrics.contains_key(OUTCOME) => ScoreKind::Expectations,
            () => ScoreKind::Own,
        }
    }
}

/// Measurements of a controller about its simulation: areas, volumes, energies, slips; on the controller's own entity.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema, Component)]
#[component(name = "measured", record = RecordPolicy::sampled(30.0, 1e-6), schema)]
#[serde(default, deny_unknown_fields)]
pub struct Measured {
    /// Name → value, SI units, the unit at the end of the name: `cut_area_m2`.
    pub values: BTreeMap<String, f64>,
}

/// Vital signs of the patient.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema, Component)]
#[component(name = "vital_signs", record = RecordPolicy::sampled(5.0, 0.001), schema)]
#[serde(default, deny_unknown_fields)]
pub struct VitalSigns {
    /// Heart rate \[1/min\].
    pub heart_rate: f64,
    /// Mean arterial pressure \[Pa\].
    pub arterial_pressure: f64,
    /// Oxygen saturation in \[0, 1\].
    pub oxygen_saturation: f64,
    /// Blood lost \[m³\].
    pub blood_loss: f64,
}

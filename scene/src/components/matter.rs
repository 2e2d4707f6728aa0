//! Physical properties: rigid bodies, contact, tissue, temperature, burns.

use std::collections::BTreeMap;
use std::sync::Arc;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::{Component, ComponentError, RecordPolicy};

/// How a rigid body moves.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Motion {
    /// Never moves.
    #[default]
    Static,
    /// Moves under forces.
    Dynamic,
    /// Follows its written pose, regardless of forces.
    Kinematic,
}

/// A rigid body; its geometry is the entity's `Shape`, or else its surface, with contacts from the collision detectors.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Component)]
#[component(name = "rigid_body", check = Self::ranges, schema)]
#[serde(default, deny_unknown_fields)]
pub struct RigidBody {
    /// How it moves.
    pub motion: Motion,
    /// Mass \[kg\]; ignored unless dynamic.
    pub mass: f64,
    /// Coulomb coefficient of friction.
    pub friction: f64,
    /// Coefficient of restitution in \[0, 1\].
    pub restitution: f64,
    /// Linear damping \[1/s\].
    pub linear_damping: f64,
    /// Angular damping \[1/s\].
    pub angular_damping: f64,
}
impl Default for RigidBody {
    fn default() -> Self {
        Self {
            motion: Motion::Static,
            mass: 0.01,
            friction: 0.5,
            restitution: 0.0,
            linear_damping: 0.0,
            angular_damping: 0.0,
        }
    }
}

impl RigidBody {
    fn ranges(&self) -> Result<(), ComponentError> {
        ComponentError::range("mass", self.mass, 1e-6..=1e3, "1e-6 to 1e3 kg")?;
        ComponentError::range("friction", self.friction, 0.0..=10.0, "0 to 10")?;
        ComponentError::range("restitution", self.restitution, 0.0..=1.0, "0 to 1")?;
        ComponentError::range("linear_damping", self.linear_damping, 0.0..=1e4, "0 to 1e4 1/s")?;
        ComponentError::range("angular_damping", self.angular_damping, 0.0..=1e4, "0 to 1e4 1/s")
    }
}

/// A material parameter with its source.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Parameter {
    /// The value, in the unit of its field.
    pub value: f64,
    /// Publication or measurement of the value.
    pub source: String,
}

/// Source of a value.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Source {
    /// Publication or measurement of the value; or a statement that it is chosen, and why.
    pub from: String,
    /// Published range, in the unit of the value.
    #[serde(default)]
    pub range: Option<[f64; 2]>,
}

/// Sources of values in an entity's components, by component and parameter name, for values not covered by [`Tissue`].
/// In a scenario each entry must belong to a value that the entity gives there, and a value outside its range is
/// reported.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema, Component)]
#[component(name = "sources", check = Self::validate, schema)]
#[serde(transparent)]
pub struct Sources(pub BTreeMap<String, BTreeMap<String, Source>>);
impl Sources {
    fn validate(&self) -> Result<(), ComponentError> {
        let all =
            self.0.iter().flat_map(|(of, known)| known.iter().map(move |(name, source)| (of, name, source)));
        for (of, name, Source { from, range }) in all {
            if from.trim().is_empty() {
                return Err(ComponentError::Malformed(format!("'{of}', '{name}': 'from' says nothing")));
            }
            if let Some([low, high]) = range.filter(|[low, high]| low > high) {
                return Err(ComponentError::Malformed(format!(
                    "'{of}', '{name}': a range from {low} to {high} holds nothing"
                )));
            }
        }
        Ok(())
    }
}

/// Tissue of an entity, by its name among [`TISSUES`](crate::tissue::TISSUES). In a scenario, parameters that its other
/// components omit take the tissue's measured values.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema, Component)]
#[component(name = "tissue", check = Self::validate, schema)]
pub struct Tissue(pub String);
impl Tissue {
    fn validate(&self) -> Result<(), ComponentError> {
        if crate::tissue::tissue(&self.0).is_some() {
            return Ok(());
        }
        let known: Vec<&str> = crate::tissue::TISSUES.iter().map(|tissue| tissue.name).collect();
        Err(ComponentError::Malformed(format!(
            "unknown tissue '{}'; there are: {}",
            self.0,
            known.join(", ")
        )))
    }
}

/// Temperature per vertex \[°C\].
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema, Component)]
#[component(name = "temperature", record = RecordPolicy::sampled(10.0, 0.05), schema)]
#[serde(deny_unknown_fields)]
pub struct Temperature {
    /// One value per vertex \[°C\].
    pub celsius: Arc<Vec<f64>>,
}

/// Burn damage per vertex: the Arrhenius integral Ω (Henriques, Moritz 1947).
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema, Component)]
#[component(name = "burn", record = RecordPolicy::sampled(10.0, 0.001), schema)]
#[serde(deny_unknown_fields)]
pub struct Burn {
    /// One Ω per vertex; 1 means that 63 % of the protein is denatured.
    pub omega: Arc<Vec<f64>>,
}

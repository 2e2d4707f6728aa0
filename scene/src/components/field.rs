//! Scalar fields per vertex that simulators publish for viewers: stress, strain, pressure.

use std::collections::BTreeSet;
use std::sync::Arc;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::{Component, ComponentError, RecordPolicy};

/// Fields that one entity can have.
const FIELDS_MAX: usize = 16;
/// Bytes of a name or unit.
const NAME_MAX: usize = 64;

/// One number per vertex.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ScalarField {
    /// Name of the quantity, such as `stress`.
    pub name: String,
    /// Its unit, such as `Pa`; empty for pure numbers.
    pub unit: String,
    /// One value per vertex; vertices beyond the end have none.
    pub values: Arc<Vec<f64>>,
    /// Range of the colour scale; if absent, the current range of values.
    #[serde(default)]
    pub range: Option<[f64; 2]>,
}

/// The fields of an entity with [`VertexPositions`](super::VertexPositions), each under a name of its own.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema, Component)]
#[component(name = "scalar_fields", record = RecordPolicy::sampled(5.0, 0.001), check = Self::validate, schema)]
#[serde(deny_unknown_fields)]
pub struct ScalarFields {
    /// All of them; at most 16.
    pub fields: Vec<ScalarField>,
}

impl ScalarFields {
    /// The field of that name.
    pub fn get(&self, name: &str) -> Option<&ScalarField> {
        self.fields.iter().find(|field| field.name == name)
    }

    fn validate(&self) -> Result<(), ComponentError> {
        let count = self.fields.len();
        ComponentError::range("fields (their number)", count as f64, ..=FIELDS_MAX as f64, "at most 16")?;
        let mut names = BTreeSet::new();
        for field in &self.fields {
            let length = |text: &str| text.len() as f64;
            let room = NAME_MAX as f64;
            ComponentError::range("name (its bytes)", length(&field.name), 1.0..=room, "1 to 64")?;
            ComponentError::range("unit (its bytes)", length(&field.unit), ..=room, "at most 64")?;
            if !names.insert(&field.name) {
                return Err(ComponentError::Malformed(format!("two fields are called '{}'", field.name)));
            }
            if let Some([low, high]) = field.range
                && low >= high
            {
                return Err(ComponentError::OutOfRange {
                    field: "range",
                    value: high,
                    valid: "the upper end above the lower one",
                });
            }
        }
        Ok(())
    }
}

//! Points of a soft body that are pinned to an instrument, a needle or a rigid body, as a scenario declares them.

use nalgebra::Point3;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use trocar_scene::{Component, ComponentError};

/// Maximum number of pinned points per organ: each costs three sparse solves when it is first pinned and whenever the
/// inverse changes.
pub const PINS_MAX: usize = 32;
/// Pinned points of an organ, and what they are pinned to.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct PinnedWith {
    /// The name of an entity that has a pose: an instrument, a needle, a rigid body.
    pub entity: String,
    /// Points inside the organ or on it, in its frame at rest \[m\]. They keep their initial positions relative to the
    /// entity.
    #[schemars(with = "Vec<[f64; 3]>")]
    pub points: Vec<Point3<f64>>,
}

/// An organ of `linear_fem` with points pinned to other entities.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema, Component)]
#[component(name = "pinned", check = Self::ranges, schema)]
#[serde(deny_unknown_fields)]
pub struct PinnedBody {
    /// The entities, with their points.
    pub with: Vec<PinnedWith>,
}

impl PinnedBody {
    fn ranges(&self) -> Result<(), ComponentError> {
        let points = self.with.iter().map(|with| with.points.len()).sum::<usize>() as f64;
        ComponentError::range("points", points, 1.0..=PINS_MAX as f64, "1 to 32 points in all")
    }
}

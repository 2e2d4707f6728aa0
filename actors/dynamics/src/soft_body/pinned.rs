//! What has been driven into a soft body, as a scenario says it.

use nalgebra::Point3;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use trocar_scene::{Component, ComponentError};

/// Points of one organ that are pinned at most: each costs three sparse solves when it is first held and whenever the inverse
/// is another one.
pub const PINS_MAX: usize = 32;
/// What holds some points of an organ.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct PinnedWith {
    /// The name of an entity that has a pose: an instrument, a needle, a rigid body.
    pub entity: String,
    /// Points inside of the organ, or on it, in its frame at rest \[m\]. They go with the entity from where it is at first.
    #[schemars(with = "Vec<[f64; 3]>")]
    pub points: Vec<Point3<f64>>,
}

/// An organ of `linear_fem` into which something has been driven that leads points of its inside.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct PinnedBody {
    /// By what.
    pub with: Vec<PinnedWith>,
}

impl Component for PinnedBody {
    const NAME: &'static str = "pinned";
    fn check(&self) -> Result<(), ComponentError> {
        trocar_scene::finite::check(self)?;
        let points = self.with.iter().map(|with| with.points.len()).sum::<usize>() as f64;
        ComponentError::range("points", points, 1.0..=PINS_MAX as f64, "1 to 32 points in all")
    }
    fn schema() -> Option<serde_json::Value> {
        Some(schemars::schema_for!(Self).to_value())
    }
}

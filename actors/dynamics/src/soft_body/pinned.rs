//! Points of a soft body that are pinned to an instrument, a needle or a rigid body, as a scenario declares them.

use nalgebra::Point3;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use trocar_scene::{Component, ComponentError, EntityMesh};

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
#[component(name = "pinned", check = Self::ranges, fits = Self::fits, schema)]
#[serde(deny_unknown_fields)]
pub struct PinnedBody {
    /// The entities, with their points.
    pub with: Vec<PinnedWith>,
}

/// How far outside of an organ a pinned point may be when a scenario is read, as a barycentric coordinate: the solver refuses
/// any that is outside, with its distance.
const OUTSIDE_MAX: f64 = 0.5;

impl PinnedBody {
    /// No point may be far outside of the organ.
    fn fits(&self, mesh: &EntityMesh<'_>) -> Result<(), ComponentError> {
        let is_outside = |point: &&Point3<f64>| mesh.depth(point).is_some_and(|depth| depth < -OUTSIDE_MAX);
        for with in &self.with {
            if let Some(point) = with.points.iter().find(is_outside) {
                let ([x, y, z], span) = ([point.x, point.y, point.z], mesh.span());
                let reason =
                    format!("the point [{x}, {y}, {z}] for '{}' is outside of the mesh; {span}", with.entity);
                return Err(ComponentError::Malformed(reason));
            }
        }
        Ok(())
    }

    fn ranges(&self) -> Result<(), ComponentError> {
        let points = self.with.iter().map(|with| with.points.len()).sum::<usize>() as f64;
        ComponentError::range("points", points, 1.0..=PINS_MAX as f64, "1 to 32 points in all")
    }
}

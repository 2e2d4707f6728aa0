//! What every deforming body has beside its mesh, whichever method moves it.

use std::sync::Arc;

use nalgebra::{Point3, Vector3};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::component::{Component, ComponentError};
use crate::finite;
use crate::time::SimTime;

/// Most regions of [`Anchors`].
const REGIONS_MAX: usize = 64;

/// Velocity of each vertex, in the entity's frame.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct VertexVelocities {
    /// One velocity per vertex \[m/s\].
    #[schemars(with = "Vec<[f64; 3]>")]
    pub velocities: Arc<Vec<Vector3<f64>>>,
}
super::component!(VertexVelocities, "vertex_velocities");

/// Where each vertex would be without any force, in the entity's frame; whoever deforms a body writes it once.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RestPositions {
    /// One point per vertex \[m\].
    #[schemars(with = "Vec<[f64; 3]>")]
    pub positions: Arc<Vec<Point3<f64>>>,
}
super::component!(RestPositions, "rest_positions");

/// Parts of a deforming body that are held where they are at rest, in the entity's frame: bones and ligaments behind an
/// organ, clips on a gauze.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Anchors {
    /// A vertex in any of these is held.
    pub regions: Vec<Region>,
}

/// A body that its simulator had to stop, at its last good state.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Frozen {
    /// What the solver found.
    pub reason: String,
    /// When.
    pub since: SimTime,
}
super::component!(Frozen, "frozen");

/// A body whose simulator goes on, but beyond what its method is right for.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct OutOfValidity {
    /// What of it is not to be believed, and what to do about that.
    pub reason: String,
    /// Since when.
    pub since: SimTime,
}
super::component!(OutOfValidity, "doubtful");

/// A body whose heat stands still since its solver had to stop it, while whoever moves the body goes on.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct HeatFrozen {
    /// What the solver found.
    pub reason: String,
    /// When.
    pub since: SimTime,
}
super::component!(HeatFrozen, "heat_frozen");

/// A body whose mesh was mended when it was read.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct MeshRepaired {
    /// What was done.
    pub what: String,
}
super::component!(MeshRepaired, "mesh_repaired");

/// A part of space, borders included.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Region {
    /// Between two corners.
    Box {
        /// Smallest corner \[m\].
        #[schemars(with = "[f64; 3]")]
        min: Point3<f64>,
        /// Largest corner \[m\].
        #[schemars(with = "[f64; 3]")]
        max: Point3<f64>,
    },
    /// Around a point.
    Ball {
        /// The point \[m\].
        #[schemars(with = "[f64; 3]")]
        center: Point3<f64>,
        /// How far \[m\].
        radius: f64,
    },
}

impl Region {
    /// Whether a point is in it.
    pub fn contains(&self, point: &Point3<f64>) -> bool {
        match self {
            Self::Box { min, max } => (0..3).all(|k| point[k] >= min[k] && point[k] <= max[k]),
            Self::Ball { center, radius } => (point - center).norm_squared() <= radius * radius,
        }
    }
}

impl Anchors {
    /// Whether a point of the body at rest is held.
    pub fn hold(&self, point: &Point3<f64>) -> bool {
        self.regions.iter().any(|region| region.contains(point))
    }
}

impl Component for Anchors {
    const NAME: &'static str = "anchors";
    fn check(&self) -> Result<(), ComponentError> {
        finite::check(self)?;
        let valid = "at most 64";
        ComponentError::range("regions", self.regions.len() as f64, 0.0..=REGIONS_MAX as f64, valid)
    }
    fn schema() -> Option<serde_json::Value> {
        super::schema_of::<Self>()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn regions_hold_what_is_in_them_and_on_their_borders() {
        let anchors = Anchors {
            regions: vec![
                Region::Box { min: Point3::origin(), max: Point3::new(0.1, 0.1, 0.1) },
                Region::Ball { center: Point3::new(1.0, 0.0, 0.0), radius: 0.5 },
            ],
        };
        for (point, held) in [
            ([0.1, 0.0, 0.05], true),
            ([0.11, 0.0, 0.0], false),
            ([0.5, 0.0, 0.0], true),
            ([0.6, 0.4, 0.0], false),
        ] {
            assert_eq!(anchors.hold(&Point3::from(point)), held, "{point:?}");
        }
        assert!(anchors.check().is_ok());
        let many = Anchors { regions: vec![anchors.regions[0].clone(); REGIONS_MAX + 1] };
        assert!(many.check().is_err());
    }
}

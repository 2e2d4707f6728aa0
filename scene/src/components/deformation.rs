//! Components of deformable bodies besides their mesh, common to all methods.

use std::sync::Arc;

use nalgebra::{Point3, Vector3};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::entity_mesh::EntityMesh;
use crate::time::SimTime;
use crate::{Component, ComponentError, RecordPolicy};

/// Most regions of [`Anchors`].
const REGIONS_MAX: usize = 64;

/// Velocity of each vertex, in the entity's frame.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema, Component)]
#[component(name = "vertex_velocities", record = RecordPolicy::sampled(5.0, 0.001), schema)]
#[serde(deny_unknown_fields)]
pub struct VertexVelocities {
    /// One velocity per vertex \[m/s\].
    #[schemars(with = "Vec<[f64; 3]>")]
    pub velocities: Arc<Vec<Vector3<f64>>>,
}

/// Rest position of each vertex, in the entity's frame; written once by the body's solver.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema, Component)]
#[component(name = "rest_positions", schema)]
#[serde(deny_unknown_fields)]
pub struct RestPositions {
    /// One point per vertex \[m\].
    #[schemars(with = "Vec<[f64; 3]>")]
    pub positions: Arc<Vec<Point3<f64>>>,
}

/// Fixed parts of a deformable body (Dirichlet boundary), as regions of the rest shape in the entity's frame: bones and
/// ligaments behind an organ, clips on a gauze.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema, Component)]
#[component(name = "anchors", check = Self::ranges, fits = Self::fits, schema)]
#[serde(deny_unknown_fields)]
pub struct Anchors {
    /// Regions whose vertices are fixed.
    pub regions: Vec<Region>,
}

/// A body stopped by its simulator, at its last valid state.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema, Component)]
#[component(name = "frozen", schema)]
#[serde(default, deny_unknown_fields)]
pub struct Frozen {
    /// Reason given by the solver.
    pub reason: String,
    /// When.
    pub since: SimTime,
}

/// A body simulated outside the range of validity of its method.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema, Component)]
#[component(name = "doubtful", schema)]
#[serde(default, deny_unknown_fields)]
pub struct OutOfValidity {
    /// What is inaccurate, and how to fix it.
    pub reason: String,
    /// Since when.
    pub since: SimTime,
}

/// A body whose heat solver has stopped, while its motion is still simulated.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema, Component)]
#[component(name = "heat_frozen", schema)]
#[serde(default, deny_unknown_fields)]
pub struct HeatFrozen {
    /// Reason given by the solver.
    pub reason: String,
    /// When.
    pub since: SimTime,
}

/// A body whose mesh was repaired when it was read.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema, Component)]
#[component(name = "mesh_repaired", schema)]
#[serde(default, deny_unknown_fields)]
pub struct MeshRepaired {
    /// What was done.
    pub what: String,
}

/// What is worth knowing about a body's mesh as it was read: a likely mistake in its unit, pieces that do not hang together,
/// cells that were split.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema, Component)]
#[component(name = "mesh_remarks", schema)]
#[serde(default, deny_unknown_fields)]
pub struct MeshRemarks {
    /// One sentence each.
    pub remarks: Vec<String>,
}

/// A closed region of space.
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
        /// Its radius \[m\].
        radius: f64,
    },
}

impl Region {
    /// Whether a point is in it.
    pub fn contains(&self, point: &Point3<f64>) -> bool {
        match self {
            Self::Box { min, max } => (0..3).all(|k| point[k] >= min[k] && point[k] <= max[k]),
            Self::Ball { center, radius } => {
                *radius >= 0.0 && (point - center).norm_squared() <= radius * radius
            }
        }
    }
}

impl Region {
    /// Why it holds nothing anywhere, if it does.
    fn inverted(&self) -> Option<String> {
        match self {
            Self::Box { min, max } => {
                let axis = (0..3).find(|&axis| min[axis] > max[axis])?;
                Some(format!(", as its min is above its max along {}", ["x", "y", "z"][axis]))
            }
            Self::Ball { radius, .. } => (*radius < 0.0).then(|| ", as its radius is below 0".to_owned()),
        }
    }
}

impl Anchors {
    /// Whether a point of the rest shape is fixed.
    pub fn hold(&self, point: &Point3<f64>) -> bool {
        self.regions.iter().any(|region| region.contains(point))
    }

    fn ranges(&self) -> Result<(), ComponentError> {
        let valid = "at most 64";
        ComponentError::range("regions", self.regions.len() as f64, 0.0..=REGIONS_MAX as f64, valid)
    }

    /// Every region must hold a vertex: one that holds none is in the wrong place.
    fn fits(&self, mesh: &EntityMesh<'_>) -> Result<(), ComponentError> {
        let count = mesh.vertices.len();
        let is_empty = |region: &Region| !mesh.vertices.iter().any(|vertex| region.contains(vertex));
        let Some(at) = self.regions.iter().position(is_empty) else { return Ok(()) };
        let which = match self.regions.len() {
            1 => "they hold".to_owned(),
            many => format!("region {} of {many} holds", at + 1),
        };
        let inverted = self.regions[at].inverted().unwrap_or_default();
        Err(ComponentError::Malformed(format!("{which} none of {count} vertices{inverted}; {}", mesh.span())))
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

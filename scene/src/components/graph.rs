//! The scene graph: names, parents, poses, velocities.

use nalgebra::{Isometry3, Quaternion, UnitQuaternion, Vector3};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::entity::Entity;
use crate::{Component, ComponentError, RecordPolicy};

/// Name of an entity in files and messages.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema, Component)]
#[component(name = "name", schema)]
#[serde(transparent)]
pub struct Name(pub String);

/// The entity in whose frame this one's [`Pose`] is given.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema, Component)]
#[component(name = "parent", schema)]
#[serde(transparent)]
pub struct Parent(#[schemars(with = "String")] pub Entity);

/// Position \[m\] and rotation: `parent_from_entity`, or `world_from_entity` without a [`Parent`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema, Component)]
#[component(name = "pose", record = RecordPolicy::sampled(60.0, 2.5e-7), check = Self::validate, schema)]
#[serde(default, deny_unknown_fields)]
pub struct Pose {
    /// Origin of the entity's frame in the parent's \[m\].
    #[schemars(with = "[f64; 3]")]
    pub translation: Vector3<f64>,
    /// Rotation quaternion `[x, y, z, w]`, of unit length.
    #[schemars(with = "[f64; 4]")]
    pub rotation: UnitQuaternion<f64>,
}

impl Pose {
    /// From its two parts.
    pub fn new(translation: Vector3<f64>, rotation: UnitQuaternion<f64>) -> Self {
        Self { translation, rotation }
    }
    /// Position only.
    pub fn at(x: f64, y: f64, z: f64) -> Self {
        Self { translation: Vector3::new(x, y, z), rotation: UnitQuaternion::identity() }
    }
    /// As a rigid transform.
    pub fn isometry(&self) -> Isometry3<f64> {
        Isometry3::from_parts(self.translation.into(), self.rotation)
    }

    fn validate(&self) -> Result<(), ComponentError> {
        check_rotation(&self.rotation)
    }
}

impl From<Isometry3<f64>> for Pose {
    fn from(iso: Isometry3<f64>) -> Self {
        Self { translation: iso.translation.vector, rotation: iso.rotation }
    }
}

/// Refuses rotations whose quaternion is off unit length by more than 1e-6.
pub(crate) fn check_rotation(rotation: &UnitQuaternion<f64>) -> Result<(), ComponentError> {
    let quaternion: &Quaternion<f64> = rotation.quaternion();
    let norm = quaternion.norm();
    if (norm - 1.0).abs() <= 1e-6 { Ok(()) } else { Err(ComponentError::NotNormalised { norm }) }
}

/// Linear \[m/s\] and angular \[rad/s\] velocity of the entity's origin, in world axes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema, Component)]
#[component(name = "velocity", record = RecordPolicy::sampled(30.0, 0.0001), schema)]
#[serde(default, deny_unknown_fields)]
pub struct Velocity {
    /// Velocity of the origin \[m/s\].
    #[schemars(with = "[f64; 3]")]
    pub linear: Vector3<f64>,
    /// Angular velocity \[rad/s\].
    #[schemars(with = "[f64; 3]")]
    pub angular: Vector3<f64>,
}

//! Joints of rigid bodies: what the scenario gives, where they sit in the bodies, and what they bear.

use std::borrow::Cow;
use std::fmt;

use nalgebra::{Isometry3, Point3, Translation3, Unit, UnitQuaternion, Vector3};
use schemars::{JsonSchema, Schema, SchemaGenerator};
use serde::de::value::{MapAccessDeserializer, SeqAccessDeserializer};
use serde::de::{MapAccess, SeqAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use super::Pose;
use crate::entity::Entity;
use crate::{Component, ComponentError, RecordPolicy};

/// Most joints that one entity lists.
pub const JOINTS_MAX: usize = 64;
/// Farthest place of a joint along each axis \[m\].
const FARTHEST: f64 = 1e3;

/// What a joint leaves free.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum JointKind {
    /// All rotations about the point: a ball and socket.
    #[default]
    Ball,
    /// The rotation about the axis: a hinge (revolute joint).
    Hinge,
    /// Nothing: a weld.
    Fixed,
}

/// A joint of a rigid body with another one, or with a fixed point of the world. Its two bodies do not collide with each
/// other.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Joint {
    /// What it leaves free.
    pub kind: JointKind,
    /// Its point, in world at the start \[m\].
    #[schemars(with = "[f64; 3]")]
    pub at: Point3<f64>,
    /// Axis of a hinge, in world at the start; of any length above zero.
    #[serde(default)]
    #[schemars(with = "Option<[f64; 3]>")]
    pub axis: Option<Vector3<f64>>,
    /// The other rigid body; absent: a fixed point of the world.
    #[serde(default)]
    #[schemars(with = "Option<String>")]
    pub to: Option<Entity>,
}

impl Joint {
    /// `world_from_joint` at the start: its point, and the axis of a hinge along z.
    #[must_use]
    pub fn frame_in_world(&self) -> Isometry3<f64> {
        let axis = self.axis.and_then(|axis| Unit::try_new(axis, 0.0));
        let turn = axis.map_or_else(UnitQuaternion::identity, |axis| {
            // Opposite directions have no unique rotation.
            UnitQuaternion::rotation_between_axis(&Vector3::z_axis(), &axis)
                .unwrap_or_else(|| UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI))
        });
        Isometry3::from_parts(Translation3::from(self.at.coords), turn)
    }

    fn check(&self) -> Result<(), ComponentError> {
        for place in self.at.iter() {
            ComponentError::range("at", *place, -FARTHEST..=FARTHEST, "-1,000 to 1,000 m")?;
        }
        let told = |reason: &str| Err(ComponentError::Malformed(reason.to_owned()));
        match (self.kind, self.axis) {
            (JointKind::Hinge, None) => told("a hinge needs an 'axis', such as axis = [0.0, 1.0, 0.0]"),
            (JointKind::Hinge, Some(axis)) if !(1e-9..=1e9).contains(&axis.norm()) => {
                told("'axis' has no direction: a length from 1e-9 to 1e9 is valid")
            }
            (JointKind::Ball | JointKind::Fixed, Some(_)) => {
                told("'axis' is of a hinge: a ball joint and a fixed one have none")
            }
            _ => Ok(()),
        }
    }
}

/// The joints of a rigid body: in a scenario one table, or an array of several.
#[derive(Clone, Debug, Default, PartialEq, Component)]
#[component(name = "joint", check = Self::validate, schema)]
pub struct Joints(pub Vec<Joint>);

impl Joints {
    fn validate(&self) -> Result<(), ComponentError> {
        if self.0.len() > JOINTS_MAX {
            let count = self.0.len();
            return Err(ComponentError::Malformed(format!(
                "{count} joints are more than the limit of {JOINTS_MAX} for one body"
            )));
        }
        self.0.iter().try_for_each(Joint::check)
    }
}

/// The joints of a rigid body: one table, or an array of several.
#[derive(JsonSchema)]
#[serde(untagged)]
#[allow(dead_code)] // its schema is what counts
enum InDocument {
    /// One joint.
    One(Joint),
    /// Several.
    Several(Vec<Joint>),
}

impl JsonSchema for Joints {
    fn schema_name() -> Cow<'static, str> {
        "Joints".into()
    }
    fn json_schema(generator: &mut SchemaGenerator) -> Schema {
        InDocument::json_schema(generator)
    }
}

impl Serialize for Joints {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        self.0.serialize(serializer)
    }
}

impl<'de> Deserialize<'de> for Joints {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        if deserializer.is_human_readable() {
            deserializer.deserialize_any(OneOrSeveral)
        } else {
            Vec::deserialize(deserializer).map(Self)
        }
    }
}

struct OneOrSeveral;

impl<'de> Visitor<'de> for OneOrSeveral {
    type Value = Joints;

    fn expecting(&self, to: &mut fmt::Formatter) -> fmt::Result {
        to.write_str("a table such as { kind = \"ball\", at = [0.0, 0.0, 0.1] }, or an array of them")
    }

    fn visit_map<A: MapAccess<'de>>(self, map: A) -> Result<Joints, A::Error> {
        Joint::deserialize(MapAccessDeserializer::new(map)).map(|joint| Joints(vec![joint]))
    }

    fn visit_seq<A: SeqAccess<'de>>(self, list: A) -> Result<Joints, A::Error> {
        Vec::deserialize(SeqAccessDeserializer::new(list)).map(Joints)
    }
}

/// Where a joint sits in its bodies, as placed at the start.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct JointFrame {
    /// The joint that was placed.
    pub joint: Joint,
    /// `body_from_joint`.
    pub in_body: Pose,
    /// `other_from_joint`; without another body `world_from_joint`.
    pub in_other: Pose,
}

/// Where an entity's joints sit in their bodies: written once, so that a later life of the controller has the same joints to
/// the bit.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, Component)]
#[component(name = "joint_frames")]
#[serde(deny_unknown_fields)]
pub struct JointFrames {
    /// One for each joint, in their order.
    pub joints: Vec<JointFrame>,
}

/// What a joint bears.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct JointLoad {
    /// Force on the body, in world \[N\].
    pub force: Vector3<f64>,
    /// Torque on the body about the joint's point, in world axes \[N·m\]; zero for a ball joint.
    pub torque: Vector3<f64>,
    /// Distance between the joint's point on the one body and on the other \[m\].
    pub position_error: f64,
    /// Angle between the frames of both in the directions that the joint locks \[rad\].
    pub angle_error: f64,
}

/// What an entity's joints bear, as the controller of rigid bodies measures it in the last step of each tick.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, Component)]
#[component(name = "joint_state", record = RecordPolicy::sampled(60.0, 1e-6))]
#[serde(deny_unknown_fields)]
pub struct JointState {
    /// One for each joint, in their order.
    pub joints: Vec<JointLoad>,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_frame_of_a_hinge_has_its_axis_along_z() {
        for axis in [Vector3::x(), -Vector3::z(), Vector3::new(1.0, -2.0, 0.5), Vector3::z() * 3.0] {
            let joint = Joint { kind: JointKind::Hinge, axis: Some(axis), ..Joint::default() };
            assert!((joint.frame_in_world() * Vector3::z() - axis.normalize()).norm() < 1e-15);
            assert_eq!(joint.check(), Ok(()));
        }
    }

    #[test]
    fn what_is_no_joint_is_refused() {
        let hinge = Joint { kind: JointKind::Hinge, axis: Some(Vector3::x()), ..Joint::default() };
        for (joint, says) in [
            (Joint { axis: None, ..hinge }, "needs an 'axis'"),
            (Joint { axis: Some(Vector3::zeros()), ..hinge }, "no direction"),
            (Joint { kind: JointKind::Ball, ..hinge }, "of a hinge"),
            (Joint { kind: JointKind::Fixed, ..hinge }, "of a hinge"),
            (Joint { at: Point3::new(0.0, 2e3, 0.0), ..hinge }, "at"),
        ] {
            let error = Joints(vec![hinge, joint]).check().unwrap_err().to_string();
            assert!(error.contains(says), "'{says}' is not in: {error}");
        }
        assert!(Joints(vec![hinge; JOINTS_MAX]).check().is_ok());
        assert!(Joints(vec![hinge; JOINTS_MAX + 1]).check().is_err());
    }
}

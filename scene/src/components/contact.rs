//! The collision list: what touches what, contributed by every detector.

use nalgebra::{Point3, Vector3};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::entity::Entity;

/// The part of an entity that takes part in a collision.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Primitive {
    /// The entity as a whole, or an analytic shape of it by index.
    Shape(u32),
    /// A triangle of its surface.
    Triangle(u32),
    /// A tetrahedron of its volume.
    Tetrahedron(u32),
    /// A segment of its line.
    Segment(u32),
    /// A vertex.
    Vertex(u32),
    /// A jaw of an instrument: 0 is A, 1 is B.
    Jaw(u8),
    /// The shaft of an instrument.
    Shaft,
}

/// One contact between two primitives.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Collision {
    /// First entity.
    #[schemars(with = "String")]
    pub a: Entity,
    /// Which part of it.
    pub primitive_a: Primitive,
    /// Second entity.
    #[schemars(with = "String")]
    pub b: Entity,
    /// Which part of it.
    pub primitive_b: Primitive,
    /// Where, in world \[m\].
    #[schemars(with = "[f64; 3]")]
    pub point_in_world: Point3<f64>,
    /// Unit direction from `a` to `b`.
    #[schemars(with = "[f64; 3]")]
    pub normal_in_world: Vector3<f64>,
    /// Penetration depth \[m\]; negative while apart.
    pub depth: f64,
    /// Penalty force on `b` \[N\].
    #[schemars(with = "[f64; 3]")]
    pub force_in_world: Vector3<f64>,
    /// Relative normal velocity that a response must reach \[m/s\].
    pub velocity_constraint: f64,
}

/// What one detector found in its last tick; contributed, so that lists of several detectors coexist.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct CollisionList {
    /// The contacts.
    pub collisions: Vec<Collision>,
    /// Deepest penetration since the session began \[m\].
    pub penetration_max: f64,
}
super::component!(CollisionList, "collision_list");

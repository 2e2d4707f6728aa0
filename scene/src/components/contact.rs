//! The collision list: contacts between primitives, contributed by every detector.

use nalgebra::{Point3, Vector3};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::entity::Entity;
use crate::time::SimTime;
use crate::{Component, RecordPolicy};

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

/// Detection method of a contact.
#[derive(
    Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, JsonSchema,
)]
#[serde(rename_all = "snake_case")]
pub enum Detection {
    /// A program's own method.
    #[default]
    Custom,
    /// The physics engine, within its step.
    Engine,
    /// Trees of oriented boxes.
    ObbTree,
    /// Distances between surfaces.
    Proximity,
    /// The dynamic point of a line.
    DynamicPoint,
    /// Depth images.
    ZBuffer,
    /// Spheres hashed by direction.
    SphericalHash,
    /// Continuous detection over a step's motion.
    Continuous,
    /// The proxy of a hand.
    Proxy,
    /// A simulator, within its step.
    Simulator,
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
    /// The nearest or deepest point of each, in world \[m\]; equal if only one is known.
    #[schemars(with = "[[f64; 3]; 2]")]
    pub points_in_world: [Point3<f64>; 2],
    /// Unit direction from `a` to `b`.
    #[schemars(with = "[f64; 3]")]
    pub normal_in_world: Vector3<f64>,
    /// Penetration depth \[m\]: distance of the first point beyond the second along the normal; negative while apart.
    pub depth: f64,
    /// Penalty force on `b` \[N\].
    #[schemars(with = "[f64; 3]")]
    pub force_in_world: Vector3<f64>,
    /// Relative normal velocity that a response must reach \[m/s\].
    pub velocity_constraint: f64,
    /// Detection method.
    pub method: Detection,
    /// Time of detection; bodies that moved since are no longer at these points.
    pub detected_at: SimTime,
}

impl Collision {
    /// Midpoint of both points, in world \[m\].
    #[must_use]
    pub fn middle_in_world(&self) -> Point3<f64> {
        nalgebra::center(&self.points_in_world[0], &self.points_in_world[1])
    }
}

/// Contacts of one detector's last tick; a contribution, so that lists of several detectors coexist.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema, Component)]
#[component(name = "collision_list", record = RecordPolicy::sampled(20.0, 1e-5), listed = Self::count, schema)]
#[serde(deny_unknown_fields)]
pub struct CollisionList {
    /// The contacts.
    pub collisions: Vec<Collision>,
    /// Deepest penetration since the session began \[m\].
    pub penetration_max: f64,
}

impl CollisionList {
    fn count(&self) -> u64 {
        self.collisions.len() as u64
    }
}

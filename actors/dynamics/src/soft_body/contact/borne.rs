//! What a soft body keeps from step to step about the rigid bodies that it bears, and about its joints with them.

use nalgebra::{Point3, Vector3};
use serde::{Deserialize, Serialize};
use trocar_scene::Entity;

/// The feature of one of two bodies that touches the other's surface.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum BearingFeature {
    /// A vertex of the soft body.
    Vertex(u32),
    /// The middle of a segment of the soft body.
    Middle(u32),
    /// A point of the rigid body, by its number.
    Point(u32),
    /// A joint, by its number, and the number of its direction.
    Joint(u32, u8),
}

/// A contact of a soft body with a rigid one, from step to step.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BorneContact {
    /// The rigid body.
    pub body: Entity,
    /// What touches.
    pub feature: BearingFeature,
    /// Normal force in the last step \[N\].
    pub force: f64,
    /// Friction on the soft body in the last step, with the force of its hysteresis along the normal, in world \[N\].
    pub friction: Vector3<f64>,
    /// Displacement of the tangential spring \[m\], in world.
    pub drawn: Vector3<f64>,
    /// How deep the two overlapped when the contact was first found, as far as that has not been worked off \[m\]: what
    /// starts inside another body is pushed out slowly, not thrown.
    pub overlap: f64,
}

/// A vertex of a soft body that is joined to a rigid one.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RigidJoint {
    /// The rigid body.
    pub body: Entity,
    /// The vertex.
    pub vertex: u32,
    /// Where it is joined, in the rigid body's frame \[m\].
    pub place: Point3<f64>,
    /// Stiffness \[N/m\] and damping \[N·s/m\].
    pub stiffness: f64,
    /// See above.
    pub damping: f64,
}

//! Interface of a world of rigid bodies and instruments, independent of its solver; the rigid-body controller schedules
//! any.

use nalgebra::{Isometry3, Matrix3, Point3};
use serde::{Deserialize, Serialize};
use trocar_scene::kinematics::spatial::Wrench;
use trocar_scene::{
    Collision, Component, Detection, Entity, Instrument, InstrumentTarget, JointKind, JointLoad, Pose,
    RigidBody, Shape, SimTime, Velocity,
};

use super::WorldError;
use crate::instrument::contact::Contact;
use crate::instrument::coupling::CriticallyDampedCoupling;
use crate::instrument::grasp::Hold;
use crate::instrument::local_model::Obstacle;
use crate::instrument::state::InstrumentState;
use crate::instrument::target_track::TargetTrack;

/// The entity under which the world's own floor reports its contacts.
pub const FLOOR: Entity = Entity::of_writer(u16::MAX, u16::MAX);
/// Half of the floor's width, depth and thickness \[m\].
pub const FLOOR_HALF_EXTENTS: [f64; 3] = [2.0, 2.0, 0.05];

/// Settings that the controller of a world needs.
#[derive(Clone, Debug, PartialEq)]
pub struct Scheduling {
    /// Length of one step \[s\].
    pub substep_secs: f64,
    /// Its contact detection method.
    pub method: Detection,
    /// Whether it claims the poses of all entities rather than of those that are dynamic at its start.
    pub claims_all_poses: bool,
    /// Names of instruments whose contacts another controller models.
    pub contact_models_by_others: Vec<String>,
}

/// Mass properties of a body, as seen by impulses.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Inertia {
    /// Inverse mass \[1/kg\]; 0: immovable.
    pub mass_inverse: f64,
    /// Centre of mass, in the body's frame \[m\].
    pub centre_in_body: Point3<f64>,
    /// Inverse inertia tensor about the centre of mass, in the body's axes \[1/(kg·m²)\].
    pub inertia_inverse_in_body: Matrix3<f64>,
}

/// A joint of a body with another one, or with a fixed point of the world.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BodyJoint {
    /// The body whose joint it is.
    pub body: Entity,
    /// The other one; `None`: the world.
    pub other: Option<Entity>,
    /// What it leaves free; the axis of a hinge is z of its frames.
    pub kind: JointKind,
    /// `body_from_joint`.
    pub body_from_joint: Isometry3<f64>,
    /// `other_from_joint`, or `world_from_joint`.
    pub other_from_joint: Isometry3<f64>,
}

/// An instrument in a world.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ToolView {
    /// Pose, velocity and jaw opening.
    pub state: InstrumentState,
    /// The virtual coupling to its hand.
    pub coupling: CriticallyDampedCoupling,
    /// The body that it holds by opposing contacts of both jaws.
    pub hold: Option<Hold>,
    /// Normal force on the pads of jaw A and jaw B in the last step \[N\].
    pub pad_force: [f64; 2],
    /// The last two target samples of its hand.
    pub track: TargetTrack,
}

/// Rigid bodies and instruments, advanced one step at a time. No scene, no actor, no clock: two worlds of one type that
/// receive the same calls have bit-identical states.
pub trait World: Send + Sized + 'static {
    /// Its settings.
    type Settings;

    /// An empty world at time `now`.
    ///
    /// # Errors
    /// A setting that is out of range.
    fn new(settings: Self::Settings, now: SimTime) -> Result<Self, WorldError>;
    /// The settings that its controller needs.
    fn scheduling(settings: &Self::Settings) -> Scheduling;
    /// The current simulation time.
    fn now(&self) -> SimTime;
    /// Sets the time without simulating the interval.
    fn skip_to(&mut self, time: SimTime);
    /// Advances by one step.
    ///
    /// # Errors
    /// [`WorldError::Diverged`]: the world can continue once the named bodies are made immovable; with none named it
    /// cannot.
    fn step(&mut self) -> Result<(), WorldError>;

    /// Adds a body; replaces the entity's previous one.
    ///
    /// # Errors
    /// A component that is out of range; too many bodies.
    fn insert_body(
        &mut self,
        entity: Entity,
        body: &RigidBody,
        shape: &Shape,
        pose: &Pose,
        velocity: &Velocity,
    ) -> Result<(), WorldError>;
    /// Adds a body with a surface mesh, whose contacts external detectors find ([`World::set_detected_contacts`]).
    ///
    /// # Errors
    /// As [`World::insert_body`]; a dynamic body whose surface encloses nothing.
    fn insert_surface_body(
        &mut self,
        entity: Entity,
        body: &RigidBody,
        surface: (&[Point3<f64>], &[[u32; 3]]),
        pose: &Pose,
        velocity: &Velocity,
    ) -> Result<(), WorldError>;
    /// Adds an instrument; replaces the entity's previous one. `hold` is a grasp to resume.
    ///
    /// # Errors
    /// A component that is out of range; too many instruments.
    fn insert_tool(
        &mut self,
        entity: Entity,
        instrument: &Instrument,
        state: &InstrumentState,
        hold: Option<Hold>,
    ) -> Result<(), WorldError>;
    /// Removes a body or an instrument. Returns whether it existed.
    fn remove(&mut self, entity: Entity) -> bool;
    /// Moves a body to a pose, at the given velocity. A kinematic body moves there within `travel_secs`.
    ///
    /// # Errors
    /// A pose or velocity that is out of range; no such body.
    fn move_body(
        &mut self,
        entity: Entity,
        pose: &Pose,
        velocity: &Velocity,
        travel_secs: f64,
    ) -> Result<(), WorldError>;
    /// Changes a body's friction and restitution in place.
    ///
    /// # Errors
    /// A component that is out of range; no such body.
    fn set_surface(&mut self, entity: Entity, body: &RigidBody) -> Result<(), WorldError>;
    /// Restores an instrument's last two target samples, saved by another world.
    ///
    /// # Errors
    /// A target that is out of range; no such instrument.
    fn set_track(&mut self, entity: Entity, track: TargetTrack) -> Result<(), WorldError>;
    /// Sets the target pose of an instrument.
    ///
    /// # Errors
    /// A target that is out of range; no such instrument.
    fn set_target(&mut self, entity: Entity, target: InstrumentTarget) -> Result<(), WorldError>;
    /// Whether external detectors find contacts of any of its bodies.
    fn has_surfaces(&self) -> bool;
    /// Replaces all detected contacts.
    fn set_detected_contacts<'a>(&mut self, found: impl IntoIterator<Item = &'a Collision>);

    /// Replaces all joints. A joint of a body that is not there, or of two that do not move by forces, joins nothing until
    /// the next call. Joined bodies do not collide with each other.
    ///
    /// # Errors
    /// [`WorldError::TooManyJoints`].
    fn set_joints(&mut self, joints: &[BodyJoint]) -> Result<(), WorldError>;
    /// What each joint bore in the last step, in their order.
    fn joint_loads(&self, loads: &mut Vec<JointLoad>);

    /// Applies a constant wrench to a body from the next step on, until the next call: force \[N\], and torque about
    /// its centre of mass \[N·m\]. A sleeping body wakes.
    ///
    /// # Errors
    /// No such body; a non-finite force.
    fn push(&mut self, entity: Entity, push: &Wrench) -> Result<(), WorldError>;
    /// Mass properties of a body as seen by contacts; `None` for an immovable or unknown body.
    fn inertia(&self, entity: Entity) -> Option<Inertia>;

    /// `world_from_body` of a body or an instrument.
    fn pose(&self, entity: Entity) -> Option<Pose>;
    /// Velocity of the origin of a body or an instrument.
    fn velocity(&self, entity: Entity) -> Option<Velocity>;
    /// Whether a body sleeps (rests, and costs no computation).
    fn is_sleeping(&self, entity: Entity) -> bool;
    /// An instrument.
    fn tool(&self, entity: Entity) -> Option<ToolView>;
    /// The wrench that an instrument exerts on its hand, about the tip, in world axes, averaged over the steps since
    /// the last call.
    fn take_wrench_on_hand(&mut self, entity: Entity) -> Option<Wrench>;
    /// The first fixed surface that an instrument reaches within `horizon_secs`.
    fn obstacle(&self, entity: Entity, horizon_secs: f64) -> Option<Obstacle>;
    /// The contacts of the last step between bodies of which at least one is awake, in canonical order.
    fn contacts(&mut self) -> &[Contact];
    /// Maximum penetration depth of any pair after any step \[m\].
    fn penetration_max(&self) -> f64;
}

/// Rejects a component that is out of range.
///
/// # Errors
/// [`WorldError::InvalidComponent`].
pub fn check<T: Component>(entity: Entity, component: &T) -> Result<(), WorldError> {
    component.check().map_err(|source| WorldError::InvalidComponent { entity, component: T::NAME, source })
}

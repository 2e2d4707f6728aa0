//! What a world of rigid bodies and instruments does, whoever computes it: the controller of rigid bodies schedules any.

use nalgebra::{Matrix3, Point3};
use serde::{Deserialize, Serialize};
use trocar_scene::{
    Collision, Component, Detection, Entity, Instrument, InstrumentTarget, Pose, RigidBody, Shape, SimTime,
    Velocity,
};

use super::WorldError;
use super::wrench::Wrench as Push;
use crate::instrument::contact::Contact;
use crate::instrument::coupling::{VirtualCoupling, Wrench};
use crate::instrument::grasp::Hold;
use crate::instrument::local_model::Obstacle;
use crate::instrument::state::InstrumentState;
use crate::instrument::target_track::TargetTrack;

/// A world's own floor reports its contacts under this entity.
pub const FLOOR: Entity = Entity::of_writer(u16::MAX, u16::MAX);

/// What the controller of a world has to know of its settings.
#[derive(Clone, Debug, PartialEq)]
pub struct Scheduling {
    /// Length of one step \[s\].
    pub substep_secs: f64,
    /// By which method it finds contacts.
    pub method: Detection,
    /// Whether it claims the poses of all entities rather than of those that are dynamic at its start.
    pub claims_all_poses: bool,
    /// Names of instruments whose contacts somebody else models.
    pub contact_models_by_others: Vec<String>,
}

/// How a body gives way to impulses.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Inertia {
    /// One over its mass \[1/kg\]; 0: it does not.
    pub mass_inverse: f64,
    /// Its centre of mass, in its own frame \[m\].
    pub centre_in_body: Point3<f64>,
    /// The inverse of its inertia about that, in its own axes \[1/(kg·m²)\].
    pub inertia_inverse_in_body: Matrix3<f64>,
}

/// An instrument in a world.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ToolView {
    /// Where it is, and how it moves.
    pub state: InstrumentState,
    /// The coupling to its hand, in effect.
    pub coupling: VirtualCoupling,
    /// What it holds by opposing contacts of both jaws.
    pub hold: Option<Hold>,
    /// Normal force on the pads of jaw A and jaw B in the last step \[N\].
    pub pad_force: [f64; 2],
    /// The last two samples of its hand.
    pub track: TargetTrack,
}

/// Rigid bodies and instruments, one step at a time. No scene, no actor, no clock: worlds of one kind that are given the same
/// calls hold the same bits.
pub trait World: Send + Sized + 'static {
    /// What it is made with.
    type Settings;

    /// An empty world that stands at `now`.
    ///
    /// # Errors
    /// A setting that is out of range.
    fn new(settings: Self::Settings, now: SimTime) -> Result<Self, WorldError>;
    /// What its controller has to know of the settings.
    fn scheduling(settings: &Self::Settings) -> Scheduling;
    /// The time at which it stands.
    fn now(&self) -> SimTime;
    /// Sets the time without simulating what lies between.
    fn skip_to(&mut self, time: SimTime);
    /// Advances by one step.
    ///
    /// # Errors
    /// [`WorldError::Diverged`]: with those that it names made immovable the world can go on; with none it cannot.
    fn step(&mut self) -> Result<(), WorldError>;

    /// Adds a body, in place of the one that the entity had.
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
    /// Adds a body that is a surface, whose contacts others find ([`World::set_detected_contacts`]).
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
    /// Adds an instrument, in place of the one that the entity had; `hold` is what it holds already.
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
    /// Takes a body or an instrument away; whether there was one.
    fn remove(&mut self, entity: Entity) -> bool;
    /// Puts a body somewhere else, at the given velocity. A kinematic body travels there within `travel_secs`.
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
    /// Gives an instrument the last two samples that another world had of its hand.
    ///
    /// # Errors
    /// A target that is out of range; no such instrument.
    fn set_track(&mut self, entity: Entity, track: TargetTrack) -> Result<(), WorldError>;
    /// Tells an instrument where its hand wants it.
    ///
    /// # Errors
    /// A target that is out of range; no such instrument.
    fn set_target(&mut self, entity: Entity, target: InstrumentTarget) -> Result<(), WorldError>;
    /// Whether somebody else finds contacts of any of its bodies.
    fn has_surfaces(&self) -> bool;
    /// Contacts that others have found, in the place of those before.
    fn set_detected_contacts<'a>(&mut self, found: impl IntoIterator<Item = &'a Collision>);

    /// Pushes a body in all steps until it is pushed otherwise: a force \[N\], and its torque about the origin of the world
    /// \[N·m\]. One that sleeps wakes.
    ///
    /// # Errors
    /// No such body; a force that is none.
    fn push(&mut self, entity: Entity, push: &Push) -> Result<(), WorldError>;
    /// How a body gives way; `None` where it does not or there is none.
    fn inertia(&self, entity: Entity) -> Option<Inertia>;

    /// `world_from_body` of a body or an instrument.
    fn pose(&self, entity: Entity) -> Option<Pose>;
    /// Velocity of the origin of a body or an instrument.
    fn velocity(&self, entity: Entity) -> Option<Velocity>;
    /// Whether a body rests and costs nothing.
    fn is_sleeping(&self, entity: Entity) -> bool;
    /// An instrument.
    fn tool(&self, entity: Entity) -> Option<ToolView>;
    /// The wrench that an instrument exerts on its hand, about the tip, in world axes, averaged over the steps since this was
    /// last asked.
    fn take_wrench_on_hand(&mut self, entity: Entity) -> Option<Wrench>;
    /// The first fixed surface that an instrument meets within `horizon_secs`.
    fn obstacle(&self, entity: Entity, horizon_secs: f64) -> Option<Obstacle>;
    /// The contacts of the last step between bodies of which at least one is awake, in canonical order.
    fn contacts(&mut self) -> &[Contact];
    /// Deepest penetration of any pair after any step \[m\].
    fn penetration_max(&self) -> f64;
}

/// Refuses a component that is out of range.
///
/// # Errors
/// [`WorldError::InvalidComponent`].
pub fn check<T: Component>(entity: Entity, component: &T) -> Result<(), WorldError> {
    component.check().map_err(|source| WorldError::InvalidComponent { entity, component: T::NAME, source })
}

//! [`World`](trocar_dynamics::rigid_world::World) for Rapier's world, so that the rigid-body controller can schedule
//! it.

use nalgebra::Point3;
use trocar_dynamics::instrument::contact::Contact;
use trocar_dynamics::instrument::grasp::Hold;
use trocar_dynamics::instrument::local_model::Obstacle;
use trocar_dynamics::instrument::state::InstrumentState;
use trocar_dynamics::instrument::target_track::TargetTrack;
use trocar_dynamics::rigid_world::{BodyJoint, Inertia, Scheduling, ToolView, World};
use trocar_scene::components::{
    Collision, Detection, Instrument, InstrumentTarget, JointLoad, Pose, RigidBody, Shape, Velocity,
};
use trocar_scene::entity::Entity;
use trocar_scene::kinematics::spatial::Wrench;
use trocar_scene::time::SimTime;

use super::RigidWorld;
use crate::{EngineError, EngineSettings};

impl World for RigidWorld {
    type Settings = EngineSettings;

    fn new(settings: EngineSettings, now: SimTime) -> Result<Self, EngineError> {
        Self::new(settings, now)
    }
    fn scheduling(settings: &EngineSettings) -> Scheduling {
        settings.shared().scheduling(Detection::Engine)
    }
    fn now(&self) -> SimTime {
        self.now()
    }
    fn skip_to(&mut self, time: SimTime) {
        self.skip_to(time);
    }
    fn step(&mut self) -> Result<(), EngineError> {
        self.step()
    }
    fn insert_body(
        &mut self,
        entity: Entity,
        body: &RigidBody,
        shape: &Shape,
        pose: &Pose,
        velocity: &Velocity,
    ) -> Result<(), EngineError> {
        self.insert_body(entity, body, shape, pose, velocity)
    }
    fn insert_surface_body(
        &mut self,
        entity: Entity,
        body: &RigidBody,
        surface: (&[Point3<f64>], &[[u32; 3]]),
        pose: &Pose,
        velocity: &Velocity,
    ) -> Result<(), EngineError> {
        self.insert_surface_body(entity, body, surface, pose, velocity)
    }
    fn insert_tool(
        &mut self,
        entity: Entity,
        instrument: &Instrument,
        state: &InstrumentState,
        hold: Option<Hold>,
    ) -> Result<(), EngineError> {
        self.insert_grasper(entity, instrument, state, hold)
    }
    fn remove(&mut self, entity: Entity) -> bool {
        self.remove(entity)
    }
    fn move_body(
        &mut self,
        entity: Entity,
        pose: &Pose,
        velocity: &Velocity,
        travel_secs: f64,
    ) -> Result<(), EngineError> {
        self.move_body(entity, pose, velocity, travel_secs)
    }
    fn set_surface(&mut self, entity: Entity, body: &RigidBody) -> Result<(), EngineError> {
        self.set_surface(entity, body)
    }
    fn set_track(&mut self, entity: Entity, track: TargetTrack) -> Result<(), EngineError> {
        self.set_track(entity, track)
    }
    fn set_target(&mut self, entity: Entity, target: InstrumentTarget) -> Result<(), EngineError> {
        self.set_target(entity, target)
    }
    fn has_surfaces(&self) -> bool {
        self.has_surfaces()
    }
    fn set_detected_contacts<'a>(&mut self, found: impl IntoIterator<Item = &'a Collision>) {
        self.set_penalties(found);
    }
    fn push(&mut self, entity: Entity, push: &Wrench) -> Result<(), EngineError> {
        self.push(entity, push)
    }
    fn set_joints(&mut self, joints: &[BodyJoint]) -> Result<(), EngineError> {
        self.set_joints(joints)
    }
    fn joint_loads(&self, loads: &mut Vec<JointLoad>) {
        self.joint_loads(loads);
    }
    fn inertia(&self, entity: Entity) -> Option<Inertia> {
        self.inertia(entity)
    }
    fn pose(&self, entity: Entity) -> Option<Pose> {
        self.pose(entity)
    }
    fn velocity(&self, entity: Entity) -> Option<Velocity> {
        self.velocity(entity)
    }
    fn is_sleeping(&self, entity: Entity) -> bool {
        self.is_sleeping(entity)
    }
    fn tool(&self, entity: Entity) -> Option<ToolView> {
        let (grasper, state) = (self.grasper(entity)?, self.grasper_state(entity)?);
        Some(ToolView {
            state,
            coupling: *grasper.coupling(),
            hold: grasper.hold().copied(),
            pad_force: grasper.pad_force(),
            track: grasper.track,
        })
    }
    fn take_wrench_on_hand(&mut self, entity: Entity) -> Option<Wrench> {
        self.take_wrench_on_hand(entity)
    }
    fn obstacle(&self, entity: Entity, horizon_secs: f64) -> Option<Obstacle> {
        self.obstacle(entity, horizon_secs)
    }
    fn contacts(&mut self) -> &[Contact] {
        self.contacts()
    }
    fn penetration_max(&self) -> f64 {
        self.statistics().penetration_max
    }
}

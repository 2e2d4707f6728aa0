//! Rigid bodies and instruments under gravity, contact and friction: Rapier, tuned for millimetre and gram scales.
//!
//! A plain type: no scene, no actor, no clock. [`RigidWorld::step`] advances by one substep. Two worlds that receive
//! the same calls have bit-identical states.

mod joints;
mod scheduled;
mod surfaces;

use std::collections::BTreeMap;

use nalgebra::Isometry3;
use rapier3d_f64::dynamics::{CoefficientCombineRule, RigidBodyBuilder, RigidBodyHandle, RigidBodyType};
use rapier3d_f64::geometry::{
    ColliderBuilder, ColliderHandle, Group, InteractionGroups, InteractionTestMode,
};
use rapier3d_f64::math::Pose as RapierPose;
use rapier3d_f64::pipeline::PhysicsWorld;
use rapier3d_f64::prelude::MassProperties;
use trocar_scene::components::{
    Instrument, InstrumentTarget, Motion, Pose, Primitive, RigidBody, Shape, Velocity,
};
use trocar_scene::entity::Entity;
use trocar_scene::kinematics::spatial::Wrench;
use trocar_scene::time::SimTime;

use trocar_dynamics::instrument::contact::Contact;
use trocar_dynamics::instrument::grasp::{self, Hold, PadContact};
use trocar_dynamics::instrument::local_model::Obstacle;
use trocar_dynamics::instrument::state::InstrumentState;
use trocar_dynamics::instrument::target_track::TargetTrack;
pub use trocar_dynamics::rigid_world::FLOOR;
use trocar_dynamics::rigid_world::{FLOOR_HALF_EXTENTS, check};

use crate::anticipate::first_obstacle;
use crate::conversion::{pose_from_rapier, pose_to_rapier, vector_from_rapier, vector_to_rapier};
use crate::grasper::Grasper;
use crate::jaws::jaw_count;
use crate::penalty::{Penalties, PoseHistory};
use crate::settings::EngineSettings;
use crate::{EngineError, contacts, shapes};

pub use joints::JOINTS_MAX;

/// Maximum number of bodies, instruments not counted.
pub const BODIES_MAX: usize = 4096;
/// Maximum number of instruments: each takes two of Rapier's 32 collision groups.
pub const INSTRUMENTS_MAX: usize = 15;

const GROUP_FIXED: u32 = 1 << 0;
const GROUP_MOVING: u32 = 1 << 1;
/// A body slower than 0.5 mm/s for this long goes to sleep \[s\].
const SLEEP_AFTER_SECS: f64 = 0.3;

/// A body that is no instrument.
#[derive(Clone, Debug)]
struct Body {
    handle: RigidBodyHandle,
    colliders: Vec<ColliderHandle>,
    motion: Motion,
    /// Remaining motion of a kinematic body towards its target pose.
    travel: Option<KinematicMove>,
    /// Past poses, if an external detector finds the body's contacts.
    trail: Option<PoseHistory>,
    friction: f64,
    /// External wrench on the body; torque about the world origin.
    push: Wrench,
}

/// Motion of a kinematic body towards its target pose.
#[derive(Clone, Copy, Debug)]
struct KinematicMove {
    to: RapierPose,
    /// Steps that remain.
    steps: u32,
}

/// Statistics since the world was built.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct WorldStatistics {
    /// Steps taken.
    pub steps: u64,
    /// Maximum penetration depth of any pair after any step \[m\].
    pub penetration_max: f64,
    /// Steps after which some pair was deeper than 0.1 mm.
    pub steps_over_penetration_limit: u64,
}

/// Penetration depth that counts as too deep \[m\].
pub const PENETRATION_LIMIT: f64 = 1e-4;

/// A world of rigid bodies and instruments.
pub struct RigidWorld {
    settings: EngineSettings,
    physics: PhysicsWorld,
    bodies: BTreeMap<Entity, Body>,
    graspers: BTreeMap<Entity, Grasper>,
    statistics: WorldStatistics,
    now: SimTime,
    contacts: Vec<Contact>,
    pads: Vec<PadContact>,
    /// Contacts from external detectors.
    penalties: Penalties,
    tools: BTreeMap<Entity, PoseHistory>,
    joints: joints::WorldJoints,
}

impl RigidWorld {
    /// A world at time `now`, empty except for its floor.
    ///
    /// # Errors
    /// [`EngineError::InvalidSetting`].
    pub fn new(settings: EngineSettings, now: SimTime) -> Result<Self, EngineError> {
        settings.check()?;
        let mut physics = PhysicsWorld {
            gravity: vector_to_rapier(&settings.gravity_in_world),
            integration_parameters: settings.integration_parameters(0.0),
            ..PhysicsWorld::default()
        };
        if let Some(height) = settings.floor_height {
            let [x, y, z] = FLOOR_HALF_EXTENTS;
            let floor = ColliderBuilder::cuboid(x, y, z)
                .collision_groups(groups(GROUP_FIXED, !GROUP_FIXED))
                .friction_combine_rule(CoefficientCombineRule::GeometricMean)
                .user_data(contacts::tag(FLOOR, Primitive::Shape(0)));
            let place = RapierPose::translation(0.0, 0.0, height - z);
            physics.insert(RigidBodyBuilder::fixed().pose(place), floor);
        }
        Ok(Self {
            settings,
            physics,
            bodies: BTreeMap::new(),
            graspers: BTreeMap::new(),
            statistics: WorldStatistics::default(),
            now,
            contacts: Vec::new(),
            pads: Vec::new(),
            penalties: Penalties::default(),
            tools: BTreeMap::new(),
            joints: joints::WorldJoints::default(),
        })
    }

    /// The settings of this world.
    pub fn settings(&self) -> &EngineSettings {
        &self.settings
    }
    /// The current simulation time.
    pub fn now(&self) -> SimTime {
        self.now
    }
    /// Statistics since the world was built.
    pub fn statistics(&self) -> WorldStatistics {
        self.statistics
    }

    /// Sets the time without simulating the interval, after a pause that is too long to catch up with.
    pub fn skip_to(&mut self, time: SimTime) {
        self.now = time;
    }

    /// Adds a body; replaces the entity's previous one.
    ///
    /// # Errors
    /// A component that is out of range, or [`EngineError::TooManyBodies`].
    pub fn insert_body(
        &mut self,
        entity: Entity,
        body: &RigidBody,
        shape: &Shape,
        pose: &Pose,
        velocity: &Velocity,
    ) -> Result<(), EngineError> {
        check(entity, shape)?;
        let handle =
            self.insert_rigid(entity, body, shapes::mass_properties(shape, body.mass), pose, velocity)?;
        let own_groups = match body.motion {
            Motion::Static | Motion::Kinematic => groups(GROUP_FIXED, !GROUP_FIXED),
            Motion::Dynamic => groups(GROUP_MOVING, u32::MAX),
        };
        let colliders = shapes::parts(shape)
            .into_iter()
            .enumerate()
            .map(|(index, part)| {
                let collider = ColliderBuilder::new(part.shape)
                    .position(part.pose)
                    .density(0.0)
                    .friction(body.friction)
                    .friction_combine_rule(CoefficientCombineRule::GeometricMean)
                    .restitution(body.restitution)
                    .restitution_combine_rule(CoefficientCombineRule::GeometricMean)
                    .collision_groups(own_groups)
                    .user_data(contacts::tag(entity, Primitive::Shape(index as u32)));
                self.physics.insert_collider(collider, Some(handle))
            })
            .collect();
        let (motion, friction) = (body.motion, body.friction);
        let (travel, trail, push) = (None, None, Wrench::default());
        self.bodies.insert(entity, Body { handle, colliders, motion, travel, trail, friction, push });
        Ok(())
    }

    /// Adds a body without colliders; replaces the entity's previous one.
    fn insert_rigid(
        &mut self,
        entity: Entity,
        body: &RigidBody,
        properties: MassProperties,
        pose: &Pose,
        velocity: &Velocity,
    ) -> Result<RigidBodyHandle, EngineError> {
        check(entity, body)?;
        check(entity, pose)?;
        check(entity, velocity)?;
        self.remove(entity);
        if self.bodies.len() >= BODIES_MAX {
            return Err(EngineError::TooManyBodies { entity, max: BODIES_MAX });
        }
        let kind = match body.motion {
            Motion::Static => RigidBodyType::Fixed,
            Motion::Kinematic => RigidBodyType::KinematicPositionBased,
            Motion::Dynamic => RigidBodyType::Dynamic,
        };
        let mut builder = RigidBodyBuilder::new(kind)
            .pose(pose_to_rapier(pose))
            .linear_damping(body.linear_damping)
            .angular_damping(body.angular_damping);
        if body.motion == Motion::Dynamic {
            let lever = pose.rotation * vector_from_rapier(properties.local_com);
            builder = builder
                .linvel(vector_to_rapier(&(velocity.linear + velocity.angular.cross(&lever))))
                .angvel(vector_to_rapier(&velocity.angular))
                .ccd_enabled(true)
                .additional_mass_properties(properties);
        }
        let handle = self.physics.insert_body(builder);
        if let Some(body) = self.physics.bodies.get_mut(handle) {
            body.activation_mut().time_until_sleep = SLEEP_AFTER_SECS;
        }
        Ok(handle)
    }

    /// Adds an instrument; replaces the entity's previous one. `hold` is a grasp to resume.
    ///
    /// # Errors
    /// A component that is out of range, or [`EngineError::TooManyInstruments`].
    pub fn insert_grasper(
        &mut self,
        entity: Entity,
        instrument: &Instrument,
        state: &InstrumentState,
        hold: Option<Hold>,
    ) -> Result<(), EngineError> {
        check(entity, instrument)?;
        check(entity, &Pose::from(state.tip_in_world))?;
        check(entity, &state.velocity)?;
        let track = self.graspers.get(&entity).map(|old| old.track);
        self.remove(entity);
        let slot = (0..INSTRUMENTS_MAX as u32)
            .find(|slot| self.graspers.values().all(|other| other.slot != *slot))
            .ok_or(EngineError::TooManyInstruments { entity, max: INSTRUMENTS_MAX })?;
        let (palm, jaws) = (1 << (2 + 2 * slot), 1 << (3 + 2 * slot));
        // The drive's limit keeps the jaws apart; palm and jaws share the hinge.
        let own = palm | jaws;
        let mut grasper = Grasper::insert(
            &mut self.physics,
            &self.settings,
            entity,
            instrument,
            state,
            slot,
            [groups(palm, !own), groups(jaws, !own)],
            |jaw| contacts::tag(entity, jaw.map_or(Primitive::Shaft, |jaw| Primitive::Jaw(jaw as u8))),
        );
        grasper.track = track.unwrap_or_default();
        grasper.hold = hold.filter(|hold| self.bodies.contains_key(&hold.held));
        self.graspers.insert(entity, grasper);
        self.fit_contacts();
        Ok(())
    }

    /// Fits the contacts to the strongest jaws.
    fn fit_contacts(&mut self) {
        let force = |grasper: &Grasper| {
            let instrument = grasper.instrument();
            if jaw_count(instrument) > 0 { instrument.jaw_force_max } else { 0.0 }
        };
        let strongest = self.graspers.values().map(force).fold(0.0, f64::max);
        self.physics.integration_parameters = self.settings.integration_parameters(strongest);
        self.ease_joints();
    }

    /// Removes a body or an instrument. Returns whether it existed.
    pub fn remove(&mut self, entity: Entity) -> bool {
        if let Some(body) = self.bodies.remove(&entity) {
            let held_by: Vec<Entity> = self
                .graspers
                .iter()
                .filter(|(_, grasper)| grasper.hold.is_some_and(|hold| hold.held == entity))
                .map(|(entity, _)| *entity)
                .collect();
            for holder in held_by {
                if let Some(grasper) = self.graspers.get_mut(&holder) {
                    grasper.hold = None;
                    grasper.update_assist(&mut self.physics, None);
                }
            }
            self.physics.remove_body_with_colliders(body.handle, true);
            self.forget(body.handle);
            return true;
        }
        match self.graspers.remove(&entity) {
            Some(grasper) => {
                self.forget(grasper.palm());
                self.tools.remove(&entity);
                grasper.remove(&mut self.physics);
                self.fit_contacts();
                true
            }
            None => false,
        }
    }

    /// Moves a body to a pose, at the given velocity. A kinematic body moves there within `travel_secs` (at least one
    /// step) and pushes what is in its way.
    ///
    /// # Errors
    /// A pose or velocity that is out of range, or [`EngineError::Unknown`].
    pub fn move_body(
        &mut self,
        entity: Entity,
        pose: &Pose,
        velocity: &Velocity,
        travel_secs: f64,
    ) -> Result<(), EngineError> {
        check(entity, pose)?;
        check(entity, velocity)?;
        let known = self.bodies.get_mut(&entity).ok_or(EngineError::Unknown { entity })?;
        let body = self.physics.bodies.get_mut(known.handle).ok_or(EngineError::Unknown { entity })?;
        if known.motion == Motion::Kinematic {
            let steps = (travel_secs / self.settings.substep_secs).round().clamp(1.0, 1000.0) as u32;
            known.travel = Some(KinematicMove { to: pose_to_rapier(pose), steps });
            return Ok(());
        }
        body.set_position(pose_to_rapier(pose), true);
        if known.motion == Motion::Dynamic {
            let lever = pose.rotation * vector_from_rapier(body.local_center_of_mass());
            body.set_linvel(vector_to_rapier(&(velocity.linear + velocity.angular.cross(&lever))), true);
            body.set_angvel(vector_to_rapier(&velocity.angular), true);
        }
        Ok(())
    }

    /// Changes a body's friction and restitution in place.
    ///
    /// # Errors
    /// A component that is out of range, or [`EngineError::Unknown`].
    pub fn set_surface(&mut self, entity: Entity, body: &RigidBody) -> Result<(), EngineError> {
        check(entity, body)?;
        let known = self.bodies.get(&entity).ok_or(EngineError::Unknown { entity })?;
        for handle in &known.colliders {
            if let Some(collider) = self.physics.colliders.get_mut(*handle) {
                collider.set_friction(body.friction);
                collider.set_restitution(body.restitution);
            }
        }
        self.physics.wake_up(known.handle, true);
        Ok(())
    }

    /// Restores an instrument's last two target samples, saved by another world.
    ///
    /// # Errors
    /// A target that is out of range, or [`EngineError::Unknown`].
    pub fn set_track(&mut self, entity: Entity, track: TargetTrack) -> Result<(), EngineError> {
        for sample in track.previous().into_iter().chain(track.newest()) {
            check(entity, sample)?;
        }
        self.graspers.get_mut(&entity).ok_or(EngineError::Unknown { entity })?.track = track;
        Ok(())
    }

    /// Sets the target pose of an instrument.
    ///
    /// # Errors
    /// A target that is out of range, or [`EngineError::Unknown`].
    pub fn set_target(&mut self, entity: Entity, target: InstrumentTarget) -> Result<(), EngineError> {
        check(entity, &target)?;
        let grasper = self.graspers.get_mut(&entity).ok_or(EngineError::Unknown { entity })?;
        grasper.track.push(target);
        Ok(())
    }

    /// Advances by one substep.
    ///
    /// # Errors
    /// [`EngineError::Diverged`]: the named bodies keep their previous state, all others have advanced.
    pub fn step(&mut self) -> Result<(), EngineError> {
        let step_secs = self.settings.substep_secs;
        for grasper in self.graspers.values_mut() {
            grasper.prepare(&mut self.physics, &self.settings, self.now);
        }
        self.move_kinematic_bodies();
        self.press_surfaces();
        self.press_pushed();
        self.physics.step();
        self.release_pushed();
        self.now += SimTime::from_secs_f64(step_secs);
        self.leave_trails();
        self.statistics.steps += 1;
        let quarantine = self.physics.quarantine();
        if !quarantine.is_empty() {
            return Err(EngineError::Diverged { entities: self.quarantined() });
        }
        self.measure_penetration();
        self.update_holds();
        Ok(())
    }

    /// The entities that Rapier has just quarantined; none if one of the quarantined bodies is unknown to this world.
    fn quarantined(&self) -> Vec<Entity> {
        let quarantine = self.physics.quarantine();
        let body = |handle: &RigidBodyHandle| self.bodies.iter().find(|(_, body)| body.handle == *handle);
        let found: Vec<Option<Entity>> =
            quarantine.bodies().iter().map(|handle| body(handle).map(|(entity, _)| *entity)).collect();
        let all_are_ours = quarantine.colliders().is_empty() && found.iter().all(Option::is_some);
        if all_are_ours { found.into_iter().flatten().collect() } else { Vec::new() }
    }

    fn move_kinematic_bodies(&mut self) {
        for body in self.bodies.values_mut() {
            let Some(travel) = &mut body.travel else { continue };
            if let Some(rigid) = self.physics.bodies.get_mut(body.handle) {
                let share = 1.0 / f64::from(travel.steps);
                rigid.set_next_kinematic_position(rigid.position().lerp(&travel.to, share));
            }
            travel.steps -= 1;
            if travel.steps == 0 {
                body.travel = None;
            }
        }
    }

    fn measure_penetration(&mut self) {
        let deepest = contacts::awake_pairs(&self.physics)
            .filter_map(|pair| contacts::depth_now(pair, &self.physics.colliders))
            .fold(0.0, f64::max);
        self.statistics.penetration_max = self.statistics.penetration_max.max(deepest);
        self.statistics.steps_over_penetration_limit += u64::from(deepest > PENETRATION_LIMIT);
    }

    fn update_holds(&mut self) {
        let step_secs = self.settings.substep_secs;
        for grasper in self.graspers.values_mut() {
            self.pads.clear();
            let palm = *self.physics.bodies[grasper.palm()].position();
            let mut pad_force = [0.0; 2];
            for (jaw, collider) in grasper.colliders() {
                let Some(jaw) = jaw else { continue };
                for pair in self.physics.narrow_phase.contact_pairs_with(collider) {
                    if !pair.has_any_active_contact() {
                        continue;
                    }
                    let jaw_is_first = pair.collider1 == collider;
                    let other = if jaw_is_first { pair.collider2 } else { pair.collider1 };
                    let Some(other) = self.physics.colliders.get(other) else { continue };
                    // Sum over the manifolds of the impulses on the second collider.
                    let impulse = vector_from_rapier(pair.total_impulse());
                    let force = if jaw_is_first { impulse } else { -impulse } / step_secs;
                    pad_force[jaw] += force.norm();
                    self.pads.push(PadContact {
                        jaw,
                        body: contacts::owner(other).0,
                        normal_force_in_instrument: vector_from_rapier(
                            palm.rotation.inverse() * vector_to_rapier(&force),
                        ),
                    });
                }
            }
            grasper.pad_force = pad_force;
            // Only dynamic bodies can be held; pegs and boards may be squeezed without a grasp.
            let liftable = |entity: Entity| {
                self.bodies.get(&entity).filter(|body| body.motion == Motion::Dynamic).map(|body| body.handle)
            };
            self.pads.retain(|pad| liftable(pad.body).is_some());
            grasper.hold =
                grasp::carry_on(grasper.hold, grasp::opposed_body(&self.pads), step_secs, |entity| {
                    let body = self.physics.bodies.get(liftable(entity)?)?;
                    Some(crate::conversion::isometry_from_rapier(&palm.inv_mul(body.position())))
                });
            let held = grasper.hold.and_then(|hold| liftable(hold.held));
            grasper.update_assist(&mut self.physics, held);
        }
    }

    /// `world_from_body` of a body or an instrument.
    pub fn pose(&self, entity: Entity) -> Option<Pose> {
        let body = self.physics.bodies.get(self.handle(entity)?)?;
        Some(pose_from_rapier(body.position()))
    }

    /// Velocity of the origin of a body or an instrument.
    pub fn velocity(&self, entity: Entity) -> Option<Velocity> {
        let body = self.physics.bodies.get(self.handle(entity)?)?;
        Some(Velocity {
            linear: vector_from_rapier(body.velocity_at_point(body.position().translation)),
            angular: vector_from_rapier(body.angvel()),
        })
    }

    /// Whether a body sleeps (rests, and costs no computation).
    pub fn is_sleeping(&self, entity: Entity) -> bool {
        self.handle(entity)
            .and_then(|handle| self.physics.bodies.get(handle))
            .is_some_and(|body| body.is_sleeping())
    }

    fn handle(&self, entity: Entity) -> Option<RigidBodyHandle> {
        self.bodies
            .get(&entity)
            .map(|body| body.handle)
            .or_else(|| self.graspers.get(&entity).map(Grasper::palm))
    }

    /// All bodies except instruments, in entity order, with their motion type.
    pub fn bodies(&self) -> impl Iterator<Item = (Entity, Motion)> + '_ {
        self.bodies.iter().map(|(entity, body)| (*entity, body.motion))
    }
    /// The instruments, in entity order.
    pub fn graspers(&self) -> impl Iterator<Item = &Grasper> {
        self.graspers.values()
    }
    /// An instrument.
    pub fn grasper(&self, entity: Entity) -> Option<&Grasper> {
        self.graspers.get(&entity)
    }
    /// Pose, velocity and jaw opening of an instrument.
    pub fn grasper_state(&self, entity: Entity) -> Option<InstrumentState> {
        self.graspers.get(&entity).map(|grasper| grasper.state(&self.physics))
    }
    /// The wrench that an instrument exerts on its hand, about the tip, in world axes, averaged over the steps since
    /// the last call.
    pub fn take_wrench_on_hand(&mut self, entity: Entity) -> Option<Wrench> {
        self.graspers.get_mut(&entity).map(Grasper::take_wrench_on_hand)
    }
    /// `instrument_from_body`, if both are simulated.
    pub fn relative_pose(&self, instrument: Entity, body: Entity) -> Option<Isometry3<f64>> {
        Some(self.pose(instrument)?.isometry().inverse() * self.pose(body)?.isometry())
    }

    /// The first fixed surface that an instrument reaches within `horizon_secs` at its current velocity.
    pub fn obstacle(&self, entity: Entity, horizon_secs: f64) -> Option<Obstacle> {
        let grasper = self.graspers.get(&entity)?;
        let velocity = grasper.state(&self.physics).velocity.linear;
        first_obstacle(&self.physics, grasper, &velocity, horizon_secs)
    }

    /// The contacts of the last step between bodies of which at least one is awake, in canonical order.
    pub fn contacts(&mut self) -> &[Contact] {
        contacts::collect(&self.physics, self.settings.substep_secs, &mut self.contacts);
        &self.contacts
    }
}

fn groups(member_of: u32, collides_with: u32) -> InteractionGroups {
    InteractionGroups::new(
        Group::from_bits_truncate(member_of),
        Group::from_bits_truncate(collides_with),
        InteractionTestMode::And,
    )
}

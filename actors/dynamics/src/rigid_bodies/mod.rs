//! The controller that schedules a rigid world: reads bodies, instruments and targets from the scene, steps the world,
//! and writes poses, forces, contacts and grasps back.
//!
//! The scene holds everything that a restart needs: poses and velocities of bodies and tips ([`Pose`], [`Velocity`]),
//! jaw openings ([`JawState`]), held bodies with their anchors ([`Grasp`]), where joints sit in their bodies
//! ([`JointFrames`](trocar_scene::JointFrames)), and, where the session registers it, the
//! play of the mechanism ([`MechanismState`]).

pub(crate) mod access;
pub mod external_contact_model;
pub(crate) mod geometry;
mod joints;
pub(crate) mod soft_contact;
mod write_scene;

use std::collections::BTreeMap;

use nalgebra::Vector3;
use trocar_scene::access::Access;
use trocar_scene::commands::Commands;
use trocar_scene::components::{
    Collision, CollisionList, Detection, Frozen, Grasp, Instrument, InstrumentTarget, JawState,
    LocalContactModel, Motion, Pose, RigidBody, Shape, SurfaceMesh, Velocity, VertexPositions,
};
use trocar_scene::controller::{BuildContext, Controller, ControllerError, Tick};
use trocar_scene::entity::Entity;
use trocar_scene::kinematics::spatial::Wrench;
use trocar_scene::snapshot::Snapshot;
use trocar_scene::time::{Revision, SimTime};

use crate::instrument::grasp::Hold;
use crate::instrument::mechanism::MechanismState;
use crate::instrument::state::{InstrumentState, JawOpening};
use crate::instrument::target_track::TargetTrack;
use crate::rigid_world::{World, WorldError};
use crate::soft_body::bearing;
use crate::soft_body::contact::RigidContacts;
use access::{declared_access, declared_rows, meets_soft_bodies, moved_entities};
use external_contact_model::{held_by, modelled_by_others};
use geometry::Geometry;
use joints::JointKeeper;

/// Maximum number of contacts in the collision list; the deepest are kept.
pub const COLLISIONS_MAX: usize = 256;
/// Maximum number of the controller's own pose writes in flight to the Model, per body.
const WRITES_IN_FLIGHT: usize = 8;
/// Longest pause that is caught up with \[s\]; the rest of a longer pause is skipped.
const CATCH_UP_SECS_MAX: f64 = 0.2;
/// Longest time that one tick simulates \[s\], or two of its periods if they are longer. The following ticks catch up
/// with the rest of a pause: computing it all in one tick would look like a stall, on a machine that was busy anyway.
const TICK_SECS_MAX: f64 = 0.02;

/// Rigid bodies and instruments as a controller of the scene, generic over the world that simulates them.
pub struct RigidBodiesController<W: World> {
    me: Entity,
    pub(crate) world: W,
    access: Access,
    /// Length of one step \[s\].
    step_secs: f64,
    method: Detection,
    /// Bodies and instruments whose rows it may write, sorted; `None`: all.
    pub(crate) declared: Option<Vec<Entity>>,
    /// Instruments whose contacts another controller models, sorted.
    modelled_by_others: Vec<Entity>,
    /// Scene revision up to which changes have been read.
    seen: Revision,
    /// The components that each body was built from, and the poses recently written for it.
    pub(crate) bodies: BTreeMap<Entity, KnownBody>,
    instruments: BTreeMap<Entity, KnownInstrument>,
    /// Collision lists of other controllers, and when each changed.
    pub(crate) lists: Vec<(Entity, Option<Revision>)>,
    collisions_were_empty: bool,
    /// Bodies that cannot be simulated, with the reason, not yet reported to the scene.
    newly_frozen: Vec<(Entity, String)>,
    /// Bodies for which it may write [`Frozen`](trocar_scene::Frozen): those present at the start; sorted.
    may_be_told_frozen: Vec<Entity>,
    /// Whether the session has soft bodies that answer contacts.
    pub(crate) meets_soft_bodies: bool,
    /// Bodies that receive impulses from soft bodies in this tick.
    pub(crate) pushed: Vec<Entity>,
    joints: JointKeeper,
}

pub(crate) struct KnownBody {
    pub(crate) body: RigidBody,
    geometry: Geometry,
    written: [Option<Pose>; WRITES_IN_FLIGHT],
    next_slot: usize,
    slept: bool,
    /// Made immovable, because it could not be simulated.
    pub(crate) frozen: bool,
    /// The state published to soft bodies, and whether it is up to date in the scene.
    pub(crate) contacts: Option<RigidContacts>,
    pub(crate) is_told: bool,
    /// Before the steps of a tick: its motion, the wrench from soft bodies during them, and its pose.
    pub(crate) before: Option<([Vector3<f64>; 2], Wrench, Pose)>,
}

struct KnownInstrument {
    instrument: Instrument,
    /// Revisions of the last change of the target, and of the contact model that constrains it.
    target_seen: [Option<Revision>; 2],
    grasp: Option<Grasp>,
}

impl<W: World> RigidBodiesController<W> {
    /// Builds the world from the scene.
    ///
    /// # Errors
    /// A component or setting that cannot be simulated.
    pub fn new(context: &BuildContext<'_>, settings: W::Settings) -> Result<Self, WorldError> {
        let scheduling = W::scheduling(&settings);
        let modelled_by_others = modelled_by_others(context.scene, &scheduling.contact_models_by_others)?;
        let mut this = Self {
            me: context.me,
            access: declared_access(context.scene, &scheduling, &modelled_by_others),
            declared: declared_rows(context.scene, &scheduling),
            modelled_by_others,
            step_secs: scheduling.substep_secs,
            method: scheduling.method,
            world: W::new(settings, context.time)?,
            seen: Revision::ZERO,
            bodies: BTreeMap::new(),
            instruments: BTreeMap::new(),
            lists: Vec::new(),
            collisions_were_empty: false,
            newly_frozen: Vec::new(),
            may_be_told_frozen: moved_entities(context.scene),
            meets_soft_bodies: meets_soft_bodies(context.scene),
            pushed: Vec::new(),
            joints: JointKeeper::new(context.scene, scheduling.claims_all_poses),
        };
        this.read_changes(context.scene, 0.0)?;
        Ok(this)
    }

    /// The world.
    pub fn world(&self) -> &W {
        &self.world
    }

    /// Reads the changes of the scene since the last call.
    fn read_changes(&mut self, scene: &Snapshot, period_secs: f64) -> Result<(), WorldError> {
        self.drop_vanished(scene);
        let changed = scene.iter_changed::<RigidBody>(self.seen).map(|(entity, _)| entity);
        let changed = changed
            .chain(scene.iter_changed::<Shape>(self.seen).map(|(entity, _)| entity))
            .chain(scene.iter_changed::<SurfaceMesh>(self.seen).map(|(entity, _)| entity))
            .chain(scene.iter_changed::<VertexPositions>(self.seen).map(|(entity, _)| entity));
        for entity in changed {
            if let Some(body) = scene.get::<RigidBody>(entity)
                && let Some(geometry) = Geometry::of(scene, entity)
            {
                self.take_body(scene, entity, body, geometry)?;
            }
        }
        for (entity, pose) in scene.iter_changed::<Pose>(self.seen) {
            self.take_pose(scene, entity, pose, period_secs)?;
        }
        for (entity, instrument) in scene.iter::<Instrument>() {
            self.take_instrument(scene, entity, instrument)?;
        }
        self.take_joints(scene)?;
        self.publish_inertia(scene, period_secs);
        self.take_contacts(scene);
        self.seen = scene.revision();
        Ok(())
    }

    fn drop_vanished(&mut self, scene: &Snapshot) {
        let (world, joints) = (&mut self.world, &mut self.joints);
        self.bodies.retain(|entity, _| {
            let stays = scene.get::<RigidBody>(*entity).is_some() && Geometry::is_there(scene, *entity);
            if !stays {
                joints.bodies_changed();
                world.remove(*entity);
            }
            stays
        });
        self.instruments.retain(|entity, _| {
            let stays = scene.get::<Instrument>(*entity).is_some();
            if !stays {
                world.remove(*entity);
            }
            stays
        });
    }

    fn take_body(
        &mut self,
        scene: &Snapshot,
        entity: Entity,
        body: &RigidBody,
        geometry: Geometry,
    ) -> Result<(), WorldError> {
        if self.bodies.get(&entity).is_some_and(|known| known.frozen) {
            return Ok(());
        }
        if let Some(known) = self.bodies.get_mut(&entity) {
            let same = known.geometry.is_same(&geometry);
            if known.body == *body && same {
                return Ok(());
            }
            let is_shape = matches!(geometry, Geometry::Shape(_));
            let surface_only = same
                && is_shape
                && RigidBody { friction: body.friction, restitution: body.restitution, ..known.body.clone() }
                    == *body;
            known.body = body.clone();
            known.geometry = geometry.clone();
            if surface_only {
                return self.world.set_surface(entity, body);
            }
            // Rebuilt at its pose in the world, which may be ahead of the snapshot.
            let pose = self.world.pose(entity).unwrap_or_else(|| scene.world_pose(entity).into());
            let velocity = self.world.velocity(entity).unwrap_or_default();
            return self.insert(entity, body, &geometry, &pose, &velocity);
        }
        let pose = Pose::from(scene.world_pose(entity));
        let velocity = scene.get::<Velocity>(entity).copied().unwrap_or_default();
        let frozen = scene.get::<Frozen>(entity).is_some();
        let known = KnownBody {
            body: body.clone(),
            geometry: geometry.clone(),
            written: first_write(scene.get::<Pose>(entity)),
            next_slot: 1,
            slept: false,
            frozen,
            contacts: scene.get::<RigidContacts>(entity).cloned(),
            is_told: true,
            before: None,
        };
        if frozen {
            self.bodies.insert(entity, known);
            return self.insert(entity, &immovable(body), &geometry, &pose, &Velocity::default());
        }
        let taken = self.insert(entity, body, &geometry, &pose, &velocity);
        if let Err(WorldError::NoVolume { .. }) = taken {
            // One body that cannot be simulated does not stop the others.
            self.bodies.insert(entity, known);
            return self.freeze(entity, &pose, WorldError::NoVolume { entity }.to_string());
        }
        self.bodies.insert(entity, known);
        taken
    }

    /// Makes a body that cannot be simulated immovable at its pose, and queues the report.
    fn freeze(&mut self, entity: Entity, pose: &Pose, reason: String) -> Result<(), WorldError> {
        let known = self.bodies.get_mut(&entity).ok_or(WorldError::Unknown { entity })?;
        known.frozen = true;
        let (body, geometry) = (immovable(&known.body), known.geometry.clone());
        self.newly_frozen.push((entity, reason));
        self.insert(entity, &body, &geometry, pose, &Velocity::default())
    }

    /// Advances the world to a time; bodies whose state would become non-finite are frozen.
    fn step_to(&mut self, time: SimTime) -> Result<(), WorldError> {
        while self.world.now() < time {
            let Err(error) = self.world.step() else { continue };
            let WorldError::Diverged { entities } = &error else { return Err(error) };
            let is_body = |entity| self.bodies.get(entity).is_some_and(|known| !known.frozen);
            if entities.is_empty() || !entities.iter().all(is_body) {
                return Err(error);
            }
            for entity in entities.clone() {
                let pose = self.world.pose(entity).ok_or(WorldError::Unknown { entity })?;
                self.freeze(entity, &pose, error.to_string())?;
            }
            // The world has forgotten the joints of what was built anew.
            self.joints.hand_over(&mut self.world)?;
        }
        Ok(())
    }

    fn insert(
        &mut self,
        entity: Entity,
        body: &RigidBody,
        geometry: &Geometry,
        pose: &Pose,
        velocity: &Velocity,
    ) -> Result<(), WorldError> {
        self.joints.bodies_changed();
        match geometry {
            Geometry::Shape(shape) => self.world.insert_body(entity, body, shape, pose, velocity),
            Geometry::Surface(vertices, triangles) => {
                self.world.insert_surface_body(entity, body, (vertices, triangles), pose, velocity)
            }
        }
    }

    /// Reads detected contacts, if any collision list has changed; without those that soft bodies answer.
    fn take_contacts(&mut self, scene: &Snapshot) {
        if !self.world.has_surfaces() {
            return;
        }
        let lists = || scene.iter::<CollisionList>().filter(|(writer, _)| *writer != self.me);
        let known: Vec<_> =
            lists().map(|(writer, _)| (writer, scene.changed::<CollisionList>(writer))).collect();
        if known != self.lists {
            let all = lists().flat_map(|(_, list)| &list.collisions);
            let own: Vec<&Collision> = all
                .filter(|row| {
                    let left = [(row.a, row.b), (row.b, row.a)];
                    !left.into_iter().any(|(one, other)| self.is_answered_for(scene, one, other))
                })
                .collect();
            self.world.set_detected_contacts(own);
            self.lists = known;
        }
    }

    /// A pose that the controller has not written itself is a teleport.
    fn take_pose(
        &mut self,
        scene: &Snapshot,
        entity: Entity,
        pose: &Pose,
        period_secs: f64,
    ) -> Result<(), WorldError> {
        let Some(known) = self.bodies.get_mut(&entity) else { return Ok(()) };
        if known.written.contains(&Some(*pose)) {
            return Ok(());
        }
        known.written = [None; WRITES_IN_FLIGHT];
        known.written[0] = Some(*pose);
        known.next_slot = 1;
        known.slept = false;
        let pose = Pose::from(scene.world_pose(entity));
        let velocity = scene.get::<Velocity>(entity).copied().unwrap_or_default();
        self.world.move_body(entity, &pose, &velocity, period_secs)
    }

    fn take_instrument(
        &mut self,
        scene: &Snapshot,
        entity: Entity,
        instrument: &Instrument,
    ) -> Result<(), WorldError> {
        let by_others = self.modelled_by_others.binary_search(&entity).is_ok();
        let model = scene.get::<LocalContactModel>(entity).filter(|_| by_others);
        let model_changed = model.and_then(|_| scene.changed::<LocalContactModel>(entity));
        let target_changed = [scene.changed::<InstrumentTarget>(entity), model_changed];
        let target = scene.get::<InstrumentTarget>(entity);
        let target = target.map(|target| model.map_or(*target, |model| held_by(model, target)));
        let known = self.instruments.get(&entity);
        let rebuild = known.is_none_or(|known| known.instrument != *instrument);
        if rebuild {
            let resumed = scene.get::<JawState>(entity);
            let grasp = scene.get::<Grasp>(entity).copied();
            let (state, hold) = match (self.world.tool(entity), resumed, target) {
                (Some(tool), _, _) => (tool.state, tool.hold),
                (None, Some(jaws), _) => (resumed_state(scene, entity, jaws), grasp.map(hold_of)),
                // A new instrument starts at its hand's target, or else at the scenario's pose: with a slow world
                // haptics would otherwise receive its surroundings a whole tick late.
                (None, None, Some(target)) => {
                    let opening = JawOpening { angle: target.jaw_angle, ..JawOpening::default() };
                    let state = InstrumentState {
                        tip_in_world: target.tip_in_world.isometry(),
                        velocity: target.velocity_in_world,
                        opening,
                        drive_reference: target.jaw_angle,
                    };
                    (state, None)
                }
                (None, None, None) if scene.get::<Pose>(entity).is_some() => {
                    let state = InstrumentState {
                        tip_in_world: scene.world_pose(entity),
                        velocity: Velocity::default(),
                        opening: JawOpening::default(),
                        drive_reference: 0.0,
                    };
                    (state, None)
                }
                (None, None, None) => return Ok(()),
            };
            let is_new = self.world.tool(entity).is_none();
            self.world.insert_tool(entity, instrument, &state, hold)?;
            if let Some(mechanism) = scene.get::<MechanismState>(entity).filter(|_| is_new) {
                let track = TargetTrack::of(mechanism.previous_target, mechanism.newest_target);
                self.world.set_track(entity, track)?;
            }
            let target_seen = known.map_or([None; 2], |known| known.target_seen);
            self.instruments
                .insert(entity, KnownInstrument { instrument: instrument.clone(), target_seen, grasp });
        }
        if let (Some(known), Some(target)) = (self.instruments.get_mut(&entity), target)
            && known.target_seen != target_changed
        {
            known.target_seen = target_changed;
            self.world.set_target(entity, target)?;
        }
        Ok(())
    }
}

impl<W: World> Controller for RigidBodiesController<W> {
    fn access(&self) -> Access {
        self.access.clone()
    }

    fn tick(&mut self, tick: &Tick<'_>, scene: &Snapshot, out: &mut Commands) -> Result<(), ControllerError> {
        self.read_changes(scene, tick.period.as_secs_f64())
            .map_err(|error| ControllerError::Scene(error.to_string()))?;
        let step_secs = self.step_secs;
        // Catch up to the tick's time; the lag determines the number of steps.
        let behind = tick.time.since(self.world.now()).as_secs_f64();
        if behind > CATCH_UP_SECS_MAX {
            let skipped = SimTime::from_secs_f64(behind - CATCH_UP_SECS_MAX);
            self.world.skip_to(self.world.now() + skipped);
        }
        let at_once = (2.0 * tick.period.as_secs_f64()).clamp(TICK_SECS_MAX, CATCH_UP_SECS_MAX);
        let steps = (behind.min(at_once) / step_secs + 1e-6).floor();
        if steps > 0.0 {
            // In a long tick the soft bodies' impulses are taken as they were given in its course.
            let parts = match self.meets_soft_bodies {
                true => (steps * step_secs / bearing::STEP_MAX - 1e-6).ceil().clamp(1.0, steps),
                false => 1.0,
            };
            let failed = |error: WorldError| ControllerError::Failed(error.to_string());
            let (begin, mut done) = (self.world.now(), 0.0);
            for part in 1..=parts as u32 {
                let all = (steps * f64::from(part) / parts).round();
                // Half a step before the end of the last one: step lengths are rounded to whole nanoseconds.
                let until = begin + SimTime::from_secs_f64((all - 0.5) * step_secs);
                let secs = (all - done) * step_secs;
                self.apply_soft_impulses(scene, secs).map_err(failed)?;
                self.step_to(until).map_err(failed)?;
                self.clear_soft_impulses(secs).map_err(failed)?;
                done = all;
            }
        }
        self.write_frozen(scene, tick, out);
        self.write_bodies(scene, out);
        self.write_joints(out);
        self.write_given(tick.time, out);
        self.write_instruments(scene, tick, out);
        Ok(())
    }
}

/// A static copy of a body.
fn immovable(body: &RigidBody) -> RigidBody {
    RigidBody { motion: Motion::Static, ..body.clone() }
}

/// The write history of a body whose pose only others have written.
fn first_write(pose: Option<&Pose>) -> [Option<Pose>; WRITES_IN_FLIGHT] {
    let mut written = [None; WRITES_IN_FLIGHT];
    written[0] = pose.copied();
    written
}

/// The state of an instrument that the world saved in the scene before a restart.
fn resumed_state(scene: &Snapshot, entity: Entity, jaws: &JawState) -> InstrumentState {
    let mechanism = scene.get::<MechanismState>(entity);
    InstrumentState {
        tip_in_world: scene.world_pose(entity),
        velocity: scene.get::<Velocity>(entity).copied().unwrap_or_default(),
        opening: JawOpening {
            angle: jaws.angle,
            rate: jaws.rate,
            tilt: mechanism.map_or(0.0, |state| state.tilt),
            tilt_rate: mechanism.map_or(0.0, |state| state.tilt_rate),
        },
        drive_reference: mechanism.map_or(jaws.angle, |state| state.drive_reference),
    }
}

fn hold_of(grasp: Grasp) -> Hold {
    Hold {
        held: grasp.held,
        anchor: grasp.anchor.isometry(),
        assisted: grasp.assisted,
        torn: !grasp.assisted,
        slack_secs: 0.0,
    }
}

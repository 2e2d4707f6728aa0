//! The impulse world behind the interface of the rigid-body controller.

use nalgebra::{Matrix3, Point3};
use trocar_dynamics::instrument::contact::Contact;
use trocar_dynamics::instrument::grasp::Hold;
use trocar_dynamics::instrument::local_model::Obstacle;
use trocar_dynamics::instrument::state::InstrumentState;
use trocar_dynamics::instrument::target_track::TargetTrack;
use trocar_dynamics::rigid_world::{
    BodyJoint, FLOOR, FLOOR_HALF_EXTENTS, Inertia, Scheduling, ToolView, World, WorldError, check,
    mass_properties,
};
use trocar_scene::kinematics::spatial::Wrench;
use trocar_scene::{
    Collision, Detection, Entity, Instrument, InstrumentTarget, JointLoad, Motion, Pose, Primitive,
    RigidBody, Shape, SimTime, Velocity,
};

use super::RigidSettings;
use super::bodies::{KinematicMove, Solid, state_of};
use super::contact_report::report_contacts;
use super::convex_parts::{mass_of, mass_of_solid, parts_of};
use super::detected_contact::{DetectedContact, FOUND_MAX};
use super::instrument::Tool;
use super::obstacle_prediction::first_obstacle;
use super::world::{ImpulseWorld, TOOLS_MAX};
use crate::rigid::RigidBodies;

impl World for ImpulseWorld {
    type Settings = RigidSettings;

    fn new(settings: RigidSettings, now: SimTime) -> Result<Self, WorldError> {
        settings.check()?;
        let (gravity, integrator) = (settings.gravity_in_world, settings.integrator);
        let solver = RigidBodies::new(&[], &[], gravity, integrator, settings.contacts()).map_err(|_| {
            WorldError::InvalidSetting {
                field: "gravity_in_world",
                value: gravity.amax(),
                valid: "-100 to 100 m/s²",
            }
        })?;
        let mut world = Self::empty(settings, solver, now);
        if let Some(height) = world.settings.floor_height {
            let floor = Shape::Box { half_extents: FLOOR_HALF_EXTENTS };
            let pose = Pose::at(0.0, 0.0, height - FLOOR_HALF_EXTENTS[2]);
            let body = RigidBody { motion: Motion::Static, ..RigidBody::default() };
            world.insert_body(FLOOR, &body, &floor, &pose, &Velocity::default())?;
        }
        Ok(world)
    }

    fn scheduling(settings: &RigidSettings) -> Scheduling {
        settings.shared().scheduling(Detection::Simulator)
    }

    fn now(&self) -> SimTime {
        self.now
    }

    fn skip_to(&mut self, time: SimTime) {
        self.now = time;
    }

    fn step(&mut self) -> Result<(), WorldError> {
        self.step()
    }

    fn insert_body(
        &mut self,
        entity: Entity,
        body: &RigidBody,
        shape: &Shape,
        pose: &Pose,
        velocity: &Velocity,
    ) -> Result<(), WorldError> {
        check(entity, shape)?;
        check(entity, body)?;
        let parts = parts_of(shape);
        // Each part of a board has its own name; a ring and a cylinder have one.
        let is_whole = !matches!(shape, Shape::PegBoard { .. });
        let name = |index: usize| Primitive::Shape(if is_whole { 0 } else { index as u32 });
        let names = (0..parts.len()).map(name).collect();
        let mass = mass_of(shape, body.mass);
        self.insert(entity, body, Solid::new(parts, names), Some(mass), pose, velocity, false)
    }

    fn insert_surface_body(
        &mut self,
        entity: Entity,
        body: &RigidBody,
        (vertices, triangles): (&[Point3<f64>], &[[u32; 3]]),
        pose: &Pose,
        velocity: &Velocity,
    ) -> Result<(), WorldError> {
        check(entity, body)?;
        let mass = match (mass_properties::enclosed(vertices, triangles), body.motion) {
            (Some(solid), _) => Some(mass_of_solid(&solid, body.mass)),
            (None, Motion::Dynamic) => return Err(WorldError::NoVolume { entity }),
            (None, _) => None,
        };
        self.insert(entity, body, Solid::default(), mass, pose, velocity, true)
    }

    fn insert_tool(
        &mut self,
        entity: Entity,
        instrument: &Instrument,
        state: &InstrumentState,
        hold: Option<Hold>,
    ) -> Result<(), WorldError> {
        check(entity, instrument)?;
        check(entity, &Pose::from(state.tip_in_world))?;
        check(entity, &state.velocity)?;
        let track = self.tools.get(&entity).map(|old| old.track);
        self.remove(entity);
        if self.tools.len() >= TOOLS_MAX {
            return Err(WorldError::TooManyInstruments { entity, max: TOOLS_MAX });
        }
        let hold = hold.filter(|hold| self.bodies.contains_key(&hold.held));
        let mut tool = Tool::new(instrument, &self.settings, 0, state, hold);
        tool.slot = self.rebuild(Some((tool.mass, tool.motion())), None);
        tool.track = track.unwrap_or_default();
        self.tools.insert(entity, tool);
        Ok(())
    }

    fn remove(&mut self, entity: Entity) -> bool {
        self.found.retain(|found| !found.entities.contains(&entity));
        self.joints.is_stale = true;
        if let Some(body) = self.bodies.remove(&entity) {
            for tool in self.tools.values_mut() {
                tool.hold = tool.hold.filter(|hold| hold.held != entity);
            }
            if let Some(slot) = body.slot {
                self.rebuild(None, Some(slot));
            }
            self.wake_all();
            return true;
        }
        match self.tools.remove(&entity) {
            Some(tool) => {
                self.rebuild(None, Some(tool.slot));
                true
            }
            None => false,
        }
    }

    fn move_body(
        &mut self,
        entity: Entity,
        pose: &Pose,
        velocity: &Velocity,
        travel_secs: f64,
    ) -> Result<(), WorldError> {
        check(entity, pose)?;
        check(entity, velocity)?;
        let body = self.bodies.get_mut(&entity).ok_or(WorldError::Unknown { entity })?;
        let pose = pose.isometry();
        if body.component.motion == Motion::Kinematic {
            let steps = (travel_secs / self.settings.substep_secs).round().clamp(1.0, 1000.0) as u32;
            body.travel = Some(KinematicMove { to: pose, steps });
            return Ok(());
        }
        body.pose = pose;
        body.solid.place(&pose);
        if let Some(slot) = body.slot {
            body.velocity = *velocity;
            let state = state_of(&self.solver.masses()[slot], &body.principal, &pose, velocity);
            self.solver.place(slot, state).map_err(|_| WorldError::Unknown { entity })?;
        }
        self.wake_all();
        Ok(())
    }

    fn set_surface(&mut self, entity: Entity, body: &RigidBody) -> Result<(), WorldError> {
        check(entity, body)?;
        let known = self.bodies.get_mut(&entity).ok_or(WorldError::Unknown { entity })?;
        known.component.friction = body.friction;
        known.component.restitution = body.restitution;
        known.sleeps = false;
        known.still_secs = 0.0;
        Ok(())
    }

    fn set_track(&mut self, entity: Entity, track: TargetTrack) -> Result<(), WorldError> {
        for sample in track.previous().into_iter().chain(track.newest()) {
            check(entity, sample)?;
        }
        self.tools.get_mut(&entity).ok_or(WorldError::Unknown { entity })?.track = track;
        Ok(())
    }

    fn set_target(&mut self, entity: Entity, target: InstrumentTarget) -> Result<(), WorldError> {
        check(entity, &target)?;
        self.tools.get_mut(&entity).ok_or(WorldError::Unknown { entity })?.track.push(target);
        Ok(())
    }

    fn has_surfaces(&self) -> bool {
        self.bodies.values().any(|body| body.trail.is_some())
    }

    fn set_detected_contacts<'a>(&mut self, found: impl IntoIterator<Item = &'a Collision>) {
        let is_surface = |entity: &Entity| self.bodies.get(entity).is_some_and(|body| body.trail.is_some());
        let mut found: Vec<&Collision> =
            found.into_iter().filter(|found| is_surface(&found.a) || is_surface(&found.b)).collect();
        if found.len() > FOUND_MAX {
            found.sort_by(|a, b| b.depth.total_cmp(&a.depth));
            found.truncate(FOUND_MAX);
        }
        self.found.clear();
        for collision in found {
            let then = |entity: Entity| match (self.bodies.get(&entity), self.tools.get(&entity)) {
                (Some(body), _) => match &body.trail {
                    Some(trail) => trail.at(collision.detected_at).map(Some),
                    None => Some(Some(body.pose)),
                },
                (None, Some(tool)) => tool.trail.at(collision.detected_at).map(Some),
                (None, None) => Some(None),
            };
            self.found.extend(DetectedContact::new(collision, [then(collision.a), then(collision.b)]));
        }
    }

    fn push(&mut self, entity: Entity, push: &Wrench) -> Result<(), WorldError> {
        let body = self.bodies.get_mut(&entity).ok_or(WorldError::Unknown { entity })?;
        if !push.force.iter().chain(push.torque.iter()).all(|x| x.is_finite()) {
            return Err(WorldError::Diverged { entities: vec![entity] });
        }
        body.push = *push;
        if *push != Wrench::default() {
            body.sleeps = false;
            body.still_secs = 0.0;
        }
        Ok(())
    }

    fn set_joints(&mut self, joints: &[BodyJoint]) -> Result<(), WorldError> {
        self.replace_joints(joints)
    }

    fn joint_loads(&self, loads: &mut Vec<JointLoad>) {
        self.loads_of_joints(loads);
    }

    fn inertia(&self, entity: Entity) -> Option<Inertia> {
        let body = self.bodies.get(&entity)?;
        let mass = self.solver.masses()[body.slot?];
        let turn = body.principal.rotation.to_rotation_matrix();
        let inverse = Matrix3::from_diagonal(&mass.inertia.map(f64::recip));
        Some(Inertia {
            mass_inverse: mass.mass.recip(),
            centre_in_body: body.principal.translation.vector.into(),
            inertia_inverse_in_body: turn.matrix() * inverse * turn.matrix().transpose(),
        })
    }

    fn pose(&self, entity: Entity) -> Option<Pose> {
        let body = self.bodies.get(&entity).map(|body| body.pose);
        body.or_else(|| self.tools.get(&entity).map(|tool| tool.state.tip_in_world)).map(Pose::from)
    }

    fn velocity(&self, entity: Entity) -> Option<Velocity> {
        let body = self.bodies.get(&entity).map(|body| body.velocity);
        body.or_else(|| self.tools.get(&entity).map(|tool| tool.state.velocity))
    }

    fn is_sleeping(&self, entity: Entity) -> bool {
        self.bodies.get(&entity).is_some_and(|body| body.sleeps)
    }

    fn tool(&self, entity: Entity) -> Option<ToolView> {
        self.tools.get(&entity).map(|tool| ToolView {
            state: tool.state,
            coupling: tool.coupling,
            hold: tool.hold,
            pad_force: tool.pad_force,
            track: tool.track,
        })
    }

    fn take_wrench_on_hand(&mut self, entity: Entity) -> Option<Wrench> {
        self.tools.get_mut(&entity).map(Tool::take_wrench_on_hand)
    }

    fn obstacle(&self, entity: Entity, horizon_secs: f64) -> Option<Obstacle> {
        let fixed = self.bodies.values().filter(|body| body.component.motion == Motion::Static);
        first_obstacle(self.tools.get(&entity)?, fixed, horizon_secs)
    }

    fn contacts(&mut self) -> &[Contact] {
        report_contacts(&self.narrow_phase.all, self.settings.substep_secs, &mut self.contacts);
        &self.contacts
    }

    fn penetration_max(&self) -> f64 {
        self.penetration_max
    }
}

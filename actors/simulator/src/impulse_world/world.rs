//! World of rigid bodies and instruments: contacts, detected within the step or externally, are solved by impulses.
//!
//! A body at rest for a while sleeps until something that moves touches it.

use std::collections::BTreeMap;

use nalgebra::{Isometry3, Vector3};
use trocar_dynamics::instrument::contact::Contact;
use trocar_dynamics::instrument::grasp::PadContact;
use trocar_dynamics::rigid_world::{World, WorldError, check};
use trocar_scene::kinematics::spatial::Wrench;
use trocar_scene::{Entity, Motion, Pose, RigidBody, SimTime, Velocity};

use super::bodies::{Body, PoseHistory, Solid, state_of};
use super::detected_contact::DetectedContact;
use super::instrument::Tool;
use super::joints::WorldJoints;
use super::narrow_phase::{Key, NarrowPhase, WorldView};
use super::{RigidSettings, grasp_detection};
use crate::rigid::{
    Arm, ContactImpulse, Joint, RigidBodies, RigidContact, RigidMass, RigidState, RigidStepError,
};

/// Maximum number of bodies besides instruments.
pub const BODIES_MAX: usize = 4096;
/// Maximum number of instruments.
pub const TOOLS_MAX: usize = 64;
/// The entity that stands for none in messages.
pub(super) const NOBODY: Entity = Entity::of_writer(0, 0);
/// A body slower than this for this long falls asleep \[m/s, s\].
const SLEEP_SPEED: f64 = 5e-4;
const SLEEP_AFTER_SECS: f64 = 0.3;

/// A world of rigid bodies and instruments.
pub struct ImpulseWorld {
    pub(super) settings: RigidSettings,
    pub(super) solver: RigidBodies,
    pub(super) bodies: BTreeMap<Entity, Body>,
    pub(super) tools: BTreeMap<Entity, Tool>,
    pub(super) now: SimTime,
    pub(super) found: Vec<DetectedContact>,
    pub(super) narrow_phase: NarrowPhase,
    /// Contact impulses of the last step, by key.
    pub(super) former: Vec<(Key, Vector3<f64>)>,
    pub(super) penetration_max: f64,
    pub(super) contacts: Vec<Contact>,
    pub(super) joints: WorldJoints,
    scratch: Scratch,
}

#[derive(Default)]
struct Scratch {
    rows: Vec<RigidContact>,
    /// Contact of each row, and the sign of its impulse on the second body.
    of: Vec<(usize, f64)>,
    arms: Vec<[Option<Arm>; 2]>,
    joints: Vec<Joint>,
    begin: Vec<ContactImpulse>,
    wrenches: Vec<Wrench>,
    pads: Vec<PadContact>,
}

impl ImpulseWorld {
    /// Its settings.
    #[must_use]
    pub fn settings(&self) -> &RigidSettings {
        &self.settings
    }

    /// Number of contact solves in the last step.
    #[must_use]
    pub fn effort(&self) -> u64 {
        self.solver.visits()
    }

    /// An empty world.
    pub(super) fn empty(settings: RigidSettings, solver: RigidBodies, now: SimTime) -> Self {
        Self {
            solver,
            bodies: BTreeMap::new(),
            tools: BTreeMap::new(),
            now,
            found: Vec::new(),
            narrow_phase: NarrowPhase::default(),
            former: Vec::new(),
            penetration_max: 0.0,
            contacts: Vec::new(),
            joints: WorldJoints::default(),
            scratch: Scratch::default(),
            settings,
        }
    }

    /// Rebuilds the solver's bodies, with one appended or removed.
    pub(super) fn rebuild(&mut self, add: Option<(RigidMass, RigidState)>, remove: Option<usize>) -> usize {
        self.joints.is_stale = true;
        let (mut masses, mut states) = (self.solver.masses().to_vec(), self.solver.states().to_vec());
        if let Some(gone) = remove {
            masses.remove(gone);
            states.remove(gone);
            let slots = self.bodies.values_mut().filter_map(|body| body.slot.as_mut());
            for slot in slots.chain(self.tools.values_mut().map(|tool| &mut tool.slot)) {
                *slot -= usize::from(*slot > gone);
            }
        }
        if let Some((mass, state)) = add {
            masses.push(mass);
            states.push(state);
        }
        let settings = &self.settings;
        // Masses and states have been validated one by one.
        if let Ok(solver) = RigidBodies::new(
            &masses,
            &states,
            settings.gravity_in_world,
            settings.integrator,
            settings.contacts(),
        ) {
            self.solver = solver;
        }
        masses.len().saturating_sub(1)
    }

    #[allow(clippy::too_many_arguments)] // a body is all of this
    pub(super) fn insert(
        &mut self,
        entity: Entity,
        component: &RigidBody,
        solid: Solid,
        mass: Option<(RigidMass, Isometry3<f64>)>,
        pose: &Pose,
        velocity: &Velocity,
        by_others: bool,
    ) -> Result<(), WorldError> {
        check(entity, component)?;
        check(entity, pose)?;
        check(entity, velocity)?;
        self.remove(entity);
        if self.bodies.len() >= BODIES_MAX {
            return Err(WorldError::TooManyBodies { entity, max: BODIES_MAX });
        }
        let pose = pose.isometry();
        let principal = mass.map_or_else(Isometry3::identity, |(_, principal)| principal);
        let slot = match mass {
            Some((mass, principal)) if component.motion == Motion::Dynamic => {
                Some(self.rebuild(Some((mass, state_of(&mass, &principal, &pose, velocity))), None))
            }
            _ => None,
        };
        let mut trail = by_others.then(PoseHistory::default);
        if let Some(trail) = &mut trail {
            trail.push(self.now, pose);
        }
        let mut body = Body {
            component: component.clone(),
            solid,
            slot,
            principal,
            pose,
            velocity: if component.motion == Motion::Dynamic { *velocity } else { Velocity::default() },
            travel: None,
            trail,
            still_secs: 0.0,
            sleeps: false,
            push: Wrench::default(),
        };
        body.solid.place(&pose);
        self.bodies.insert(entity, body);
        Ok(())
    }

    fn prepare(&mut self) {
        let step_secs = self.settings.substep_secs;
        for tool in self.tools.values_mut() {
            tool.prepare(&self.settings, self.now);
        }
        for body in self.bodies.values_mut() {
            let Some(travel) = &body.travel else {
                if body.component.motion == Motion::Kinematic {
                    body.velocity = Velocity::default();
                }
                continue;
            };
            let share = 1.0 / f64::from(travel.steps);
            let way = travel.to.translation.vector - body.pose.translation.vector;
            let turn = (travel.to.rotation * body.pose.rotation.inverse()).scaled_axis();
            body.velocity =
                Velocity { linear: way * (share / step_secs), angular: turn * (share / step_secs) };
        }
    }

    /// Something was removed: bodies may have rested on it.
    pub(super) fn wake_all(&mut self) {
        for body in self.bodies.values_mut() {
            body.sleeps = false;
            body.still_secs = 0.0;
        }
    }

    /// Builds the solver's rows from contacts and external forces.
    fn rows(&mut self) {
        let Scratch { rows, of, arms, joints, begin, wrenches, .. } = &mut self.scratch;
        rows.clear();
        of.clear();
        arms.clear();
        begin.clear();
        joints.clear();
        joints.extend(self.tools.values().filter_map(|tool| tool.joint));
        let (bodies, tools) = (&self.bodies, &self.tools);
        for (index, contact_point) in self.narrow_phase.all.iter().enumerate() {
            let [a, b] = &contact_point.sides;
            let (gives, other, sign) = match (a.slot, b.slot) {
                (_, Some(_)) => (b, a, 1.0),
                (Some(_), None) => (a, b, -1.0),
                (None, None) => continue,
            };
            let Some(slot) = gives.slot else { continue };
            let point = nalgebra::center(&contact_point.point.points[0], &contact_point.point.points[1]);
            let surface = if other.slot.is_some() { None } else { bodies.get(&other.entity) };
            rows.push(RigidContact {
                body: slot as u32,
                other: other.slot.map(|slot| slot as u32),
                point_in_world: point,
                normal_in_world: contact_point.point.normal * sign,
                depth: contact_point.point.depth,
                friction: contact_point.friction,
                restitution: contact_point.restitution.min(1.0),
                surface_velocity: surface.map_or_else(Vector3::zeros, |body| body.velocity_at(&point)),
            });
            let arm = |contact_side: &super::narrow_phase::ContactSide| {
                let tool = tools.get(&contact_side.entity).filter(|_| !contact_point.by_others)?;
                // Joints are in the order of their tools.
                let before =
                    tools.range(..contact_side.entity).filter(|(_, tool)| tool.joint.is_some()).count();
                tool.arm(contact_side.part, &point, before as u32)
            };
            arms.push([arm(gives), arm(other)]);
            let key = contact_point.key();
            let known = self.former.binary_search_by(|(former, _)| former.cmp(&key));
            let impulse = known.map_or_else(|_| Vector3::zeros(), |at| self.former[at].1 * sign);
            begin.push(ContactImpulse { impulse });
            of.push((index, sign));
        }
        let step_secs = self.settings.substep_secs;
        let gravity = self.settings.gravity_in_world;
        wrenches.clear();
        wrenches.resize(self.solver.states().len(), Wrench::default());
        for body in bodies.values() {
            let Some(slot) = body.slot else { continue };
            let (mass, state) = (self.solver.masses()[slot], self.solver.states()[slot]);
            if body.sleeps {
                wrenches[slot].force = -gravity * mass.mass;
                continue;
            }
            let slowed = |damping: f64| (1.0 / (1.0 + damping * step_secs) - 1.0) / step_secs;
            wrenches[slot].force += state.momentum * slowed(body.component.linear_damping);
            wrenches[slot].torque += state.angular_momentum * slowed(body.component.angular_damping);
            let Wrench { force, torque } = body.push;
            wrenches[slot].force += force;
            wrenches[slot].torque += torque;
        }
        for tool in tools.values() {
            // The hand carries its weight.
            let lever = tool.state.tip_in_world.translation.vector - tool.centre().coords;
            let wrench = &mut wrenches[tool.slot];
            wrench.force += tool.wrench.force - gravity * tool.mass.mass;
            wrench.torque += tool.wrench.torque + lever.cross(&tool.wrench.force);
            let Some(hold) = tool.hold else { continue };
            let Some(body) = bodies.get(&hold.held) else { continue };
            let Some(slot) = body.slot else { continue };
            let velocities = [
                [body.velocity.linear, body.velocity.angular],
                [tool.state.velocity.linear, tool.state.velocity.angular],
            ];
            let (mass, centre) = (&self.solver.masses()[slot], self.solver.states()[slot].position);
            if let Some([on_body, on_tool]) =
                grasp_detection::pull(tool, mass, &body.pose, &centre, velocities, step_secs)
            {
                for (slot, pull) in [(slot, on_body), (tool.slot, on_tool)] {
                    wrenches[slot].force += pull.force;
                    wrenches[slot].torque += pull.torque;
                }
            }
        }
    }

    /// Copies poses, contact impulses, grasps and sleep states from the solver after the step.
    fn take_over(&mut self) {
        let step_secs = self.settings.substep_secs;
        let Scratch { of, joints, .. } = &mut self.scratch;
        for contact_point in &mut self.narrow_phase.all {
            contact_point.impulse = Vector3::zeros();
        }
        for ((index, sign), impulse) in of.iter().zip(self.solver.impulses()) {
            self.narrow_phase.all[*index].impulse = impulse.impulse * *sign;
        }
        let (masses, states) = (self.solver.masses(), self.solver.states());
        for body in self.bodies.values_mut() {
            let pose = body.pose_after_step();
            if let Some(travel) = &mut body.travel {
                travel.steps -= 1;
                if travel.steps == 0 {
                    body.travel = None;
                }
                body.pose = pose;
                body.solid.place(&body.pose);
            }
            let Some(slot) = body.slot.filter(|_| !body.sleeps) else { continue };
            body.follow(&masses[slot], &states[slot]);
        }
        let mut moved = joints.iter();
        for tool in self.tools.values_mut() {
            let joint = tool.joint.and_then(|_| moved.next().copied());
            tool.follow(&states[tool.slot], joint);
        }
        self.measure();
        let (bodies, pads) = (&self.bodies, &mut self.scratch.pads);
        for (entity, tool) in &mut self.tools {
            let lifted =
                |held: Entity| bodies.get(&held).filter(|body| body.is_dynamic()).map(|body| body.pose);
            grasp_detection::update(tool, *entity, &self.narrow_phase.all, step_secs, pads, lifted);
        }
        self.former.clear();
        self.former.extend(
            self.narrow_phase.all.iter().map(|contact_point| (contact_point.key(), contact_point.impulse)),
        );
        self.former.sort_by_key(|(key, _)| *key);
        self.rest(step_secs);
        if self.has_surfaces() {
            let now = self.now;
            for body in self.bodies.values_mut() {
                if let Some(trail) = &mut body.trail {
                    trail.push(now, body.pose);
                }
            }
            for tool in self.tools.values_mut() {
                tool.trail.push(now, tool.state.tip_in_world);
            }
        }
    }

    /// Depths after the step.
    fn measure(&mut self) {
        for contact_point in self.narrow_phase.all.iter_mut().filter(|contact_point| !contact_point.by_others)
        {
            let place = |side: usize| {
                let contact_side = &contact_point.sides[side];
                let body = self.bodies.get(&contact_side.entity).map(|body| &body.solid);
                let solid = body.or_else(|| self.tools.get(&contact_side.entity).map(|tool| &tool.solid));
                solid.map_or(contact_point.point.points[side], |solid| {
                    solid.placed[contact_side.part] * contact_side.local
                })
            };
            let points = [place(0), place(1)];
            contact_point.point.points = points;
            contact_point.point.depth = (points[0] - points[1]).dot(&contact_point.point.normal);
            self.penetration_max = self.penetration_max.max(contact_point.point.depth);
        }
    }

    fn rest(&mut self, step_secs: f64) {
        let (narrow_phase, tools) = (&self.narrow_phase.all, &self.tools);
        let is_touched = |entity: Entity| {
            narrow_phase
                .iter()
                .filter(|contact_point| contact_point.sides.iter().any(|side| side.entity == entity))
                .any(|contact_point| {
                    contact_point.by_others
                        || contact_point.sides.iter().any(|side| tools.contains_key(&side.entity))
                })
        };
        for (entity, body) in &mut self.bodies {
            let Some(slot) = body.slot.filter(|_| !body.sleeps) else { continue };
            let state = self.solver.states()[slot];
            let mass = self.solver.masses()[slot];
            // The velocity if all of its kinetic energy were translation.
            let speed = (2.0 * mass.kinetic_energy(&state) / mass.mass).sqrt();
            // External detections vanish without notice when their detector stops.
            let is_pushed = body.push != Wrench::default();
            let may_sleep = speed < SLEEP_SPEED && body.trail.is_none() && !is_pushed && !is_touched(*entity);
            let may_sleep = may_sleep && !self.joints.holds(*entity);
            body.still_secs = if may_sleep { body.still_secs + step_secs } else { 0.0 };
            if body.still_secs >= SLEEP_AFTER_SECS {
                body.sleeps = true;
                body.velocity = Velocity::default();
                let still =
                    RigidState { momentum: Vector3::zeros(), angular_momentum: Vector3::zeros(), ..state };
                // Placed at its present pose.
                let _ = self.solver.place(slot, still);
            }
        }
    }

    /// The entity of a solver body.
    fn entity_of(&self, slot: usize) -> Option<Entity> {
        let body = self.bodies.iter().find(|(_, body)| body.slot == Some(slot));
        let tool = || self.tools.iter().find(|(_, tool)| tool.slot == slot).map(|(entity, _)| *entity);
        body.map(|(entity, _)| *entity).or_else(tool)
    }

    /// Advances by one step.
    pub(super) fn step(&mut self) -> Result<(), WorldError> {
        let step_secs = self.settings.substep_secs;
        if self.joints.is_stale {
            self.resolve_joints()?;
        }
        self.prepare();
        self.lead_joints();
        self.narrow_phase.detect(WorldView {
            bodies: &mut self.bodies,
            tools: &self.tools,
            found: &self.found,
            joined: &self.joints.joined,
            step_secs,
        });
        self.rows();
        let Scratch { rows, arms, joints, begin, wrenches, .. } = &mut self.scratch;
        self.solver.begin_with(begin);
        if let Err(error) = self.solver.step_with_jaws(step_secs, wrenches, rows, arms, joints) {
            let slot = match error {
                RigidStepError::Body { body } => Some(body),
                RigidStepError::Contact(contact) => rows.get(contact).map(|row| row.body as usize),
                _ => None,
            };
            let entities = slot.and_then(|slot| self.entity_of(slot)).into_iter().collect();
            return Err(WorldError::Diverged { entities });
        }
        self.now += SimTime::from_secs_f64(step_secs);
        self.take_over();
        Ok(())
    }
}

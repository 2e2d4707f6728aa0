//! A soft body of a controller from tick to tick: its method with what instruments, jaws and detected contacts do to it.

use nalgebra::{Isometry3, Point3, Vector3};
use trocar_scene::{
    Collision, Commands, Component, ControllerError, Detection, Entity, Frozen, OutOfValidity, Primitive,
    Snapshot, Tick,
};

use super::bearing::Bearer;
use super::bearing::joint::joints;
use super::bearing::rigid_response::{PlaneContact, RigidInStep, RigidPresses};
use super::contact::SoftContacts;
use super::coupling::CoupledBody;
use super::coupling::slow_side::SlowSide;
use super::grasp::{Grips, Holder};
use super::held_back::HeldBack;
use super::instrument_rods::{Rod, rods_of_all};
use super::jaw_friction::{StrainedGrips, TickGrips, crush};
use super::jaws::is_blade;
use super::method::{Step, StepContext, finite_vertices};
use super::rod_contact::{RodContact, collision, touches};
use super::rod_paths::RodPaths;
use super::{Deformable, SoftMethod};
use crate::picking::{DrivenVertex, Jaws, Pick};

/// A body, and what its controller knows of it.
pub(super) struct Body<M> {
    pub(super) body: Deformable,
    pub(super) method: M,
    pub(super) is_pinned: Vec<bool>,
    pub(super) grips: Grips,
    pub(super) strained: StrainedGrips,
    pub(super) held_back: HeldBack,
    pub(super) rod_paths: RodPaths,
    /// The bodies with which it has grown together.
    pub(super) joined_with: Vec<Entity>,
    /// State of the slower side of a coupling, if others are coupled with it.
    pub(super) slow_side: Option<SlowSide>,
    pub(super) frozen: bool,
    pub(super) inputs: StepInputs,
    /// Detected contacts: their persistent state, the sum of the force magnitudes \[N\], and the number of active ones.
    pub(super) contacts: SoftContacts,
    pub(super) contacts_changed: bool,
    pub(super) pressed: (f64, usize),
    /// Why an instrument may pass through it, once that was found.
    pub(super) may_pass: Option<String>,
}

/// Input of a body's step in the current tick.
#[derive(Default)]
pub(super) struct StepInputs {
    pub(super) world_from_body: Isometry3<f64>,
    pub(super) gravity: Vector3<f64>,
    pub(super) rods: Vec<Rod>,
    pub(super) touches: Vec<RodContact>,
    pub(super) presses: Vec<PlaneContact>,
    pub(super) rigid: Vec<RigidInStep>,
    pub(super) driven: Vec<DrivenVertex>,
    /// Where driven vertices are at the beginning of the tick, and where at its end.
    pub(super) driven_ways: Vec<[Point3<f64>; 2]>,
    pub(super) jaws: TickGrips,
    pub(super) given: Vec<(u32, Vector3<f64>)>,
    /// Length of that list without the friction of rigid bodies, which changes from part to part of a tick.
    pub(super) given_before: usize,
    pub(super) forces: Vec<Vector3<f64>>,
    pub(super) meets_instruments: bool,
    pub(super) step_secs: f64,
}

impl StepInputs {
    fn site<'a>(&'a self, scene: &'a Snapshot, tick: &'a Tick<'a>) -> StepContext<'a> {
        StepContext {
            scene,
            tick,
            step_secs: self.step_secs,
            world_from_body: &self.world_from_body,
            gravity: self.gravity,
            rods: &self.rods,
            touches: &self.touches,
            rigid: RigidPresses { bodies: &self.rigid, contacts: &self.presses },
            meets_instruments: self.meets_instruments,
            forces: &self.given,
            driven: &self.driven,
            grip_limits: &self.jaws.limits,
        }
    }
}

/// Contact results of a tick.
#[derive(Default)]
pub(super) struct TickContacts {
    pub(super) collisions: Vec<Collision>,
    /// Maximum penetration depth \[m\].
    pub(super) depth_max: f64,
    /// Sums of the force magnitudes on the current body, by rod contacts and by grasps \[N\].
    pub(super) pushed: f64,
    pub(super) pulled: f64,
}

impl<M: SoftMethod> Body<M> {
    /// The body as one that bears rigid ones.
    pub(super) fn bearer(&self) -> Option<Bearer<'_>> {
        let Self { body, method, inputs, contacts, .. } = self;
        let surface = method.contact_surface(body);
        let (thickness, closed) = (surface.thickness, surface.closed);
        Some(Bearer {
            entity: body.entity,
            world_from_body: inputs.world_from_body,
            positions: method.positions(),
            velocities: method.velocities(),
            triangles: &body.triangles,
            segments: &body.segments,
            thickness,
            closed,
            terms: method.terms()?,
            known: &contacts.borne,
            last: &contacts.last_given,
            joints: &contacts.joints,
        })
    }

    pub(super) fn read(
        kind: &M::Kind,
        entity: Entity,
        scene: &Snapshot,
        step_secs: f64,
    ) -> Result<Self, ControllerError> {
        let mut body = Deformable::read(scene, entity)?;
        let method = M::build(kind, &mut body, scene)
            .map_err(|why| ControllerError::Scene(format!("'{}': {why}", body.name)))?;
        let is_pinned = body.stays();
        let grips = scene.get::<Grips>(entity).cloned().unwrap_or_default();
        grips
            .fit(body.rest.len(), body.holdable().len())
            .map_err(|why| ControllerError::Scene(format!("'{}': {why}", body.name)))?;
        let strained = scene.get::<StrainedGrips>(entity).cloned().unwrap_or_default();
        let frozen = scene.get::<Frozen>(entity).is_some();
        if !frozen {
            // A frozen body is not stepped.
            method
                .check_step(step_secs)
                .map_err(|why| ControllerError::Scene(format!("'{}': {why}", body.name)))?;
        }
        let answers = M::Kind::SOFT_BODY.is_some_and(|of| of.answers_couplings);
        let slow_side = if answers { SlowSide::new(&body, scene) } else { None };
        let contacts = match scene.get::<SoftContacts>(entity) {
            Some(known) => known.clone(),
            None => {
                let wrong = |why| ControllerError::Scene(format!("'{}': {why}", body.name));
                SoftContacts { joints: joints(&body, scene).map_err(wrong)?, ..SoftContacts::default() }
            }
        };
        let (inputs, pressed) = (StepInputs::default(), (0.0, 0));
        let contacts_changed = false;
        Ok(Self {
            body,
            method,
            is_pinned,
            grips,
            strained,
            held_back: HeldBack::resume(scene, entity),
            rod_paths: RodPaths::resume(scene, entity),
            joined_with: CoupledBody::joined_with(scene, entity),
            slow_side,
            frozen,
            inputs,
            contacts,
            contacts_changed,
            pressed,
            may_pass: None,
        })
    }

    /// Checks that all values which others will read of the body are finite: the Model rejects the controller's whole
    /// batch for one non-finite value.
    pub(super) fn is_finite(&self) -> Result<(), String> {
        finite_vertices(self.method.positions(), self.method.velocities())?;
        let touches = self.inputs.touches.iter().zip(&self.inputs.forces);
        let bad = touches.into_iter().find(|(_, force)| !force.iter().all(|x| x.is_finite()));
        bad.map_or(Ok(()), |(touch, _)| {
            Err(format!("the force of the contact at vertex {} is no finite number", touch.nodes[0]))
        })
    }

    /// Applies topology changes, and collects the input of the step.
    pub(super) fn begin(
        &mut self,
        gravity_in_world: &Vector3<f64>,
        scene: &Snapshot,
        tick: &Tick<'_>,
        out: &mut Commands,
    ) -> Result<(), String> {
        let entity = self.body.entity;
        let mut inputs = std::mem::take(&mut self.inputs);
        inputs.world_from_body = scene.world_pose(entity);
        inputs.gravity = Deformable::gravity(gravity_in_world, &inputs.world_from_body);
        inputs.touches.clear();
        inputs.driven.clear();
        inputs.given.clear();
        rods_of_all(scene, &inputs.world_from_body, &mut inputs.rods);
        self.held_back.begin(scene, entity, &inputs.world_from_body, &mut inputs.rods);
        self.rod_paths.lead(tick, &mut inputs.rods, &mut self.held_back);
        let reshaped = self.method.reshape(&mut self.body, &inputs.site(scene, tick), out)?;
        if let Some(reshaped) = reshaped {
            self.is_pinned = self.body.stays();
            let (site, positions) = (inputs.site(scene, tick), self.method.positions());
            self.grips.follow(&reshaped, &site, &self.body.holdable(), positions);
            out.put(entity, self.grips.clone());
        }
        let period = tick.period.as_secs_f64();
        touches(&inputs.rods, &self.method.contact_surface(&self.body), period, &mut inputs.touches);
        let mut jaws = std::mem::take(&mut inputs.jaws);
        let driven = self.hold(&inputs.site(scene, tick), &inputs.touches, &mut jaws, out)?;
        let positions = self.method.positions();
        let ways = driven.iter().map(|of| [positions[of.vertex as usize], of.position_in_body]);
        inputs.driven_ways.clear();
        inputs.driven_ways.extend(ways);
        (inputs.driven, inputs.jaws) = (driven, jaws);
        self.leave_out(scene, &mut inputs);
        if let Some(slow_side) = &mut self.slow_side {
            let mut given = std::mem::take(&mut inputs.given);
            slow_side.take(&inputs.site(scene, tick), self.method.velocities(), &mut given);
            inputs.given = given;
        }
        self.inputs = inputs;
        Ok(())
    }

    /// Leaves out contacts of rods that do not press: held and anchored vertices have prescribed positions, whatever touches
    /// them.
    fn leave_out(&self, scene: &Snapshot, inputs: &mut StepInputs) {
        let (is_pinned, cut) = (&self.is_pinned, self.method.is_cut_by_blades());
        let Self { grips, strained, .. } = self;
        let StepInputs { rods, touches, driven, .. } = inputs;
        touches.retain(|touch| {
            let is_led = |node: &u32| driven.binary_search_by_key(node, |driven| driven.vertex).is_ok();
            let stays = touch.nodes.iter().all(|&node| is_pinned[node as usize]);
            let is_cut = cut && is_blade(scene, rods[touch.rod].instrument);
            // Jaws in which it slips would squeeze it out.
            let by = rods[touch.rod].instrument;
            let slips = strained.has_slipped(by.to_bits())
                && grips.picks.of(by.to_bits()).is_some()
                // The first rod of an instrument is its shaft.
                && rods.iter().position(|rod| rod.instrument == by) != Some(touch.rod);
            !(stays || is_cut || slips || touch.nodes.iter().any(is_led))
        });
    }

    /// Whether an instrument grasps it: jaws close on what has grown together as on one body.
    fn is_held_by(&self, scene: &Snapshot, by: Entity) -> bool {
        let grasps = |grips: &Grips| grips.picks.of(by.to_bits()).is_some();
        let mut others = self.joined_with.iter().filter_map(|other| scene.get::<Grips>(*other));
        grasps(&self.grips) || others.any(grasps)
    }

    /// The longest step that can follow the instruments, up to `within` \[s\].
    pub(super) fn step_max(&self, scene: &Snapshot, within: f64) -> f64 {
        let StepInputs { touches, rods, .. } = &self.inputs;
        let skin = self.method.contact_surface(&self.body);
        let holds = |by: Entity| self.is_held_by(scene, by);
        self.held_back.step_max((touches, rods), &skin, self.method.velocities(), within, holds)
    }

    /// Finds the contacts that stop instruments in the next step, and sets where held vertices are to be at its end,
    /// `until` \[s\] after the beginning of a tick of `period` \[s\].
    pub(super) fn begin_step(&mut self, scene: &Snapshot, until: f64, period: f64) {
        let mut held_back = std::mem::take(&mut self.held_back);
        let StepInputs { touches, rods, step_secs, .. } = &self.inputs;
        let skin = self.method.contact_surface(&self.body);
        let holds = |by: Entity| self.is_held_by(scene, by);
        held_back.find((touches, rods), &skin, self.method.velocities(), *step_secs, holds);
        self.held_back = held_back;
        self.inputs.meets_instruments = self.held_back.is_touched();
        if self.inputs.step_secs < period {
            let StepInputs { driven, driven_ways, .. } = &mut self.inputs;
            for (driven, [from, to]) in driven.iter_mut().zip(driven_ways) {
                driven.position_in_body = from.lerp(to, (until / period).min(1.0));
            }
        }
    }

    /// After a step: the instruments go on, and if some of the part of the tick is `left` \[s\], their contacts are found anew.
    pub(super) fn move_on(&mut self, scene: &Snapshot, left: Option<f64>, period: f64) {
        let mut inputs = std::mem::take(&mut self.inputs);
        self.held_back.lead(&mut inputs.rods, inputs.step_secs);
        let skin = self.method.contact_surface(&self.body);
        self.held_back.judge((&inputs.touches, &inputs.rods), &skin, inputs.step_secs);
        if let Some(left) = left {
            touches(&inputs.rods, &skin, left, &mut inputs.touches);
            self.leave_out(scene, &mut inputs);
        } else {
            self.held_back.forget_limit(period);
        }
        self.inputs = inputs;
    }

    /// Makes the contacts that stop instruments part of the next step.
    pub(super) fn press_instruments(&mut self) {
        let StepInputs { presses, rigid, step_secs, .. } = &mut self.inputs;
        self.held_back.press(*step_secs, presses, rigid);
    }

    pub(super) fn ready<'a>(&'a mut self, scene: &'a Snapshot, tick: &'a Tick<'a>) -> Step<'a, M> {
        let mut forces = std::mem::take(&mut self.inputs.forces);
        forces.clear();
        let Self { body, method, inputs, .. } = self;
        Step { method, body, site: inputs.site(scene, tick), forces, done: Ok(()) }
    }

    /// After a step: looks whether it stops the instruments that it meets.
    pub(super) fn look_for_passing(&mut self, scene: &Snapshot, period: f64) {
        if self.inputs.touches.is_empty() || self.may_pass.is_some() {
            return;
        }
        let StepInputs { touches, rods, forces, .. } = &self.inputs;
        let limit = self.method.instrument_limit(period);
        self.may_pass = limit.passed(&self.held_back, (touches, rods), forces, period, scene);
    }

    pub(super) fn freeze(&mut self, reason: &str, tick: &Tick<'_>, out: &mut Commands) {
        self.frozen = true;
        self.body.freeze(&reason, tick, out);
    }

    /// Writes the body's state and contact forces after a step.
    pub(super) fn end(
        &mut self,
        scene: &Snapshot,
        tick: &Tick<'_>,
        found: &mut TickContacts,
        out: &mut Commands,
    ) {
        let entity = self.body.entity;
        self.body.write(self.method.positions(), self.method.velocities(), out);
        self.held_back.end(entity, &self.inputs.world_from_body, tick.time, out);
        self.rod_paths.end(scene, entity, !self.inputs.touches.is_empty(), out);
        if let Some(reason) = self.may_pass.as_ref().filter(|_| scene.get::<OutOfValidity>(entity).is_none())
        {
            out.put(entity, OutOfValidity { reason: reason.clone(), since: tick.time });
        }
        let site = self.inputs.site(scene, tick);
        self.method.publish(&self.body, &site, out);
        for (touch, force) in site.touches.iter().zip(&self.inputs.forces) {
            // A near rod that did not touch.
            if touch.depth <= 0.0 && *force == Vector3::zeros() {
                continue;
            }
            found.depth_max = found.depth_max.max(touch.depth);
            found.pushed += force.norm();
            let rod = &site.rods[touch.rod];
            let told = collision(touch, rod, entity, force, site.world_from_body, tick.time);
            found.collisions.push(told);
        }
        let mut pulls = Vec::with_capacity(self.grips.picks.picks.len());
        for (index, pick) in self.grips.picks.picks.iter().enumerate() {
            let held: Vec<u32> = pick.vertices.iter().map(|held| held.vertex).collect();
            let pull = self.inputs.jaws.pull(index, || self.method.pull_by(&held));
            found.pulled += pull.norm();
            found.collisions.extend(grip(&self.body, self.method.positions(), pick, &pull, &site));
            pulls.push((pull, self.weight(pick)));
        }
        let picks = (&mut self.grips.picks, &self.inputs.jaws, &pulls[..]);
        if self.strained.take(picks, &self.body, self.method.positions(), (scene, tick), out) {
            out.put(entity, self.grips.clone());
        }
        if let Some(slow_side) = &mut self.slow_side {
            let (body, method) = (&self.body, &mut self.method);
            slow_side.look(|active, outlook| method.look_ahead(body, &site, active, outlook));
            slow_side.publish(&site, &self.is_pinned, method.velocities(), out);
        }
    }

    /// After a part of a tick: what has slipped in its jaws stays where it is now, relative to them.
    pub(super) fn slip(&mut self) {
        let StepInputs { driven, driven_ways, jaws, .. } = &mut self.inputs;
        let (forces, positions) = (self.method.grip_forces(), self.method.positions());
        jaws.take(forces);
        for (driven, way) in driven.iter_mut().zip(driven_ways) {
            if forces.get(driven.grip as usize).is_some_and(|by| by.slipped)
                && let Some(position) = positions.get(driven.vertex as usize)
            {
                driven.position_in_body = *position;
                *way = [*position; 2];
            }
        }
    }

    /// Weight of what a grip holds \[N\]; without that of fixed vertices.
    fn weight(&self, pick: &Pick) -> f64 {
        let inverse = self.method.terms().map_or(&[][..], |terms| terms.masses_inverse);
        let all = pick.vertices.iter().filter_map(|held| inverse.get(held.vertex as usize));
        let mass: f64 = all.filter(|inverse| **inverse > 0.0).map(|inverse| inverse.recip()).sum();
        mass * self.inputs.gravity.norm()
    }

    /// Takes and releases vertices, and returns the prescribed positions of the held ones.
    fn hold(
        &mut self,
        site: &StepContext<'_>,
        touched: &[RodContact],
        grips: &mut TickGrips,
        out: &mut Commands,
    ) -> Result<Vec<DrivenVertex>, String> {
        let parts = self.body.holdable();
        if parts.is_empty() {
            return Ok(Vec::new());
        }
        let holders = Holder::all(site, touched, &parts);
        let jaws: Vec<Jaws<'_>> = holders.iter().map(Holder::jaws).collect();
        let before = self.grips.picks.picks.len();
        let held_by =
            |grips: &Grips| -> Vec<u64> { grips.picks.picks.iter().map(|p| p.instrument).collect() };
        let before_by = held_by(&self.grips);
        self.grips.picks.update(&parts, self.method.positions(), &jaws).map_err(|error| error.to_string())?;
        for jaw in jaws.iter().filter(|jaw| self.strained.has_slipped(jaw.instrument)) {
            self.grips.picks.take_more(&parts, self.method.positions(), jaw);
        }
        let new = self.grips.picks.picks.iter().filter(|pick| !before_by.contains(&pick.instrument));
        new.for_each(|pick| crush(pick, &self.body, site.scene, out));
        if before != self.grips.picks.picks.len() || before_by != held_by(&self.grips) {
            out.put(self.body.entity, self.grips.clone());
        }
        let pose = |of: u64| jaws.iter().find(|jaw| jaw.instrument == of).map(|jaw| jaw.body_from_instrument);
        grips.begin(&self.grips.picks, &self.strained, site.scene, pose);
        let mut driven = self.grips.picks.driven(&jaws);
        driven.retain(|driven| !self.is_pinned[driven.vertex as usize]);
        Ok(driven)
    }
}

/// A grasp as a row of the collision list. Its depth is the displacement of the held vertices from their rest
/// positions, so that force over depth is the stiffness felt.
fn grip(
    body: &Deformable,
    positions: &[Point3<f64>],
    pick: &Pick,
    pull_in_body: &Vector3<f64>,
    site: &StepContext<'_>,
) -> Option<Collision> {
    let instrument = Entity::from_bits(pick.instrument);
    let count = pick.vertices.len();
    let first = *pick.triangles.first()?;
    if count == 0 {
        return None;
    }
    let mean = |points: &[Point3<f64>]| {
        let sum: Vector3<f64> = pick.vertices.iter().map(|held| points[held.vertex as usize].coords).sum();
        sum / count as f64
    };
    let (now, rest) = (mean(positions), mean(&body.rest));
    let place = site.world_from_body * Point3::from(now);
    let force_on_body = site.world_from_body.rotation * -pull_in_body;
    Some(Collision {
        a: instrument,
        primitive_a: Primitive::Shaft,
        b: body.entity,
        primitive_b: if body.triangles.is_empty() {
            Primitive::Segment(first)
        } else {
            Primitive::Triangle(first)
        },
        points_in_world: [place; 2],
        normal_in_world: force_on_body.try_normalize(1e-12).unwrap_or_else(Vector3::z),
        depth: (now - rest).norm(),
        force_in_world: force_on_body,
        velocity_constraint: 0.0,
        method: Detection::Simulator,
        detected_at: site.tick.time,
    })
}

//! Common controller of all soft-body methods: whichever method moves a body, instruments touch, grasp and cut it in
//! the same way, contact forces go to the same list, and a solver failure stops only that body.
//!
//! A method implements [`SoftMethod`]: its construction from the scene, its step, its measures. [`SoftController`] does
//! the rest. In each tick, for each body: blade cuts, rod contacts, grasps, detected contacts, the step, and the writes
//! to the scene.

use std::sync::Arc;

use nalgebra::{Isometry3, Point3, Vector3};
use trocar_scene::{
    Access, BuildContext, Collision, CollisionList, Commands, Component, Controller, ControllerError,
    Detection, Entity, EntitySet, Frozen, Instrument, JawState, Measured, Pose, Primitive, Registry,
    Snapshot, Tick, Velocity,
};

use super::bearing::joint::joints;
use super::bearing::rigid_response::{PlaneContact, RigidInStep, RigidPresses};
use super::bearing::{self, Bearer, Bearing, Bearings, BorneBody};
use super::contact::penalty::{self, RespondingBody};
use super::contact::tracking::{self, AdjacencyCache, Shape};
use super::contact::{BorneContact, SoftContacts};
use super::coupling::CoupledBody;
use super::coupling::slow_side::SlowSide;
use super::frozen::{FrozenPart, RejectedBody};
use super::grasp::{Grips, Holder};
use super::held_back::HeldBack;
use super::instrument_rods::{Rod, rods_of_all};
use super::jaw_friction::{Crushable, StrainedGrips, TickGrips, crush};
use super::jaws::is_blade;
use super::method::{Measures, Step, StepContext, finite_vertices};
use super::rod_contact::{COLLISIONS_MAX, RodContact, collision, touches};
use super::rod_paths::RodPaths;
use super::tick_course::{TickCourse, foresees};
use super::{Deformable, SoftMethod};
use crate::picking::{DrivenVertex, Jaws, Pick};

struct Body<M> {
    body: Deformable,
    method: M,
    is_pinned: Vec<bool>,
    grips: Grips,
    strained: StrainedGrips,
    held_back: HeldBack,
    rod_paths: RodPaths,
    /// The bodies with which it has grown together.
    joined_with: Vec<Entity>,
    /// State of the slower side of a coupling, if others are coupled with it.
    slow_side: Option<SlowSide>,
    frozen: bool,
    inputs: StepInputs,
    /// Detected contacts: their persistent state, the sum of the force magnitudes \[N\], and the number of active ones.
    contacts: SoftContacts,
    contacts_changed: bool,
    pressed: (f64, usize),
}

/// Input of a body's step in the current tick.
#[derive(Default)]
struct StepInputs {
    world_from_body: Isometry3<f64>,
    gravity: Vector3<f64>,
    rods: Vec<Rod>,
    touches: Vec<RodContact>,
    presses: Vec<PlaneContact>,
    rigid: Vec<RigidInStep>,
    driven: Vec<DrivenVertex>,
    /// Where driven vertices are at the beginning of the tick, and where at its end.
    driven_ways: Vec<[Point3<f64>; 2]>,
    jaws: TickGrips,
    given: Vec<(u32, Vector3<f64>)>,
    /// Length of that list without the friction of rigid bodies, which changes from part to part of a tick.
    given_before: usize,
    forces: Vec<Vector3<f64>>,
    meets_instruments: bool,
    step_secs: f64,
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

/// Steps all bodies that carry the component of a method.
pub struct SoftController<M> {
    gravity_in_world: Vector3<f64>,
    bodies: Vec<Body<M>>,
    refused: Vec<RejectedBody>,
    surroundings: AdjacencyCache,
    bearings: Bearings,
    registry: Arc<Registry>,
}

impl<M: SoftMethod> SoftController<M> {
    /// Reads the bodies, and resumes their state from the scene.
    ///
    /// # Errors
    /// The name of the body, and what is wrong with it.
    pub fn new(gravity_in_world: Vector3<f64>, context: &BuildContext<'_>) -> Result<Self, ControllerError> {
        let (mut bodies, mut refused) = (Vec::new(), Vec::new());
        for entity in Deformable::carriers::<M::Kind>(context.scene) {
            let Some(kind) = context.scene.get::<M::Kind>(entity) else { continue };
            match Body::read(kind, entity, context.scene, context.period.as_secs_f64()) {
                Ok(body) => bodies.push(body),
                Err(error) => refused.push(RejectedBody::of(context, entity, FrozenPart::Body, error)?),
            }
        }
        if bodies.is_empty() && refused.is_empty() {
            let (controller, kind) = (M::CONTROLLER, M::Kind::NAME);
            return Err(ControllerError::Scene(format!("{controller}: no entity has a '{kind}'")));
        }
        let (surroundings, registry) = (AdjacencyCache::default(), context.scene.registry().clone());
        Ok(Self { gravity_in_world, bodies, refused, surroundings, bearings: Bearings::default(), registry })
    }

    /// Answers the detected contacts of its bodies.
    fn answer_found(&mut self, scene: &Snapshot, tick: &Tick<'_>) {
        let mut own = Vec::new();
        for of in self.bodies.iter_mut().filter(|of| !of.frozen) {
            let Body { body, method, inputs, contacts, .. } = of;
            let Some(terms) = method.terms() else { continue };
            let StepInputs { given, driven, world_from_body, gravity, .. } = inputs;
            own.push(RespondingBody {
                entity: body.entity,
                shape: Shape {
                    world_from_body: *world_from_body,
                    positions: method.positions(),
                    velocities: method.velocities(),
                    triangles: body.triangles.clone(),
                    segments: body.segments.clone(),
                    motion: Velocity::default(),
                },
                terms,
                driven,
                gravity_in_body: *gravity,
                forces: std::mem::take(given),
                memory: std::mem::take(contacts),
                pressed: (0.0, 0),
                taken: Vector3::zeros(),
                changed: false,
            });
        }
        let when = (tick.time, tick.period.as_secs_f64(), tick.me);
        penalty::answer(&mut own, &mut self.surroundings, scene, when);
        let answered: Vec<_> =
            own.into_iter().map(|own| (own.forces, own.memory, own.pressed, own.changed)).collect();
        let bodies = self.bodies.iter_mut().filter(|of| !of.frozen && of.method.terms().is_some());
        for (of, (forces, memory, pressed, changed)) in bodies.zip(answered) {
            of.contacts_changed = changed;
            (of.inputs.given, of.contacts, of.pressed) = (forces, memory, pressed);
        }
    }

    /// Finds the contacts of its bodies with rigid ones that move, and makes them part of the bodies' next step, with those of
    /// instruments if they are `held_back`.
    fn press(&mut self, borne: &[BorneBody], held_back: bool) -> Vec<Bearing> {
        let Self { bodies, bearings, .. } = self;
        let answering: Vec<usize> = (0..bodies.len())
            .filter(|&at| !bodies[at].frozen && bodies[at].method.terms().is_some())
            .collect();
        let Some(step) = answering.first().map(|&at| bodies[at].inputs.step_secs) else { return Vec::new() };
        for &at in &answering {
            let inputs = &mut bodies[at].inputs;
            inputs.presses.clear();
            inputs.rigid.clear();
            inputs.given.truncate(inputs.given_before);
        }
        if borne.is_empty() {
            if held_back {
                answering.iter().for_each(|&at| bodies[at].press_instruments());
            }
            return Vec::new();
        }
        let bearers: Vec<Bearer<'_>> = answering.iter().filter_map(|&at| bodies[at].bearer()).collect();
        let mut found = bearings.find(&bearers, borne, step);
        let mut inputs = Vec::with_capacity(bearers.len());
        for (index, of) in bearers.iter().enumerate() {
            let own = || found.iter().filter(|bearing| bearing.bearer == index);
            let mut presses: Vec<PlaneContact> = own().map(|bearing| bearing.plane).collect();
            let rubbed: Vec<(u32, Vector3<f64>)> =
                own().flat_map(|bearing| bearing.friction_on(of)).collect();
            let others =
                bearers.iter().filter(|other| other.entity != of.entity).flat_map(|other| other.last);
            let others = others.copied().chain(own().filter_map(|bearing| bearing.friction_given(step)));
            let rigid = of.rigid_in_step(&mut presses, borne, others, step);
            inputs.push((presses, rigid, rubbed));
        }
        for bearing in &mut found {
            bearing.bearer = answering[bearing.bearer];
        }
        for (at, (presses, rigid, rubbed)) in answering.into_iter().zip(inputs) {
            let inputs = &mut bodies[at].inputs;
            (inputs.presses, inputs.rigid) = (presses, rigid);
            inputs.given.extend(rubbed);
            if held_back {
                bodies[at].press_instruments();
            }
        }
        found
    }

    /// After a part of a tick: gives the rigid bodies their impulses, and moves them on.
    fn bear(&mut self, mut found: Vec<Bearing>, borne: &mut [BorneBody], tick: &Tick<'_>, is_last: bool) {
        let bodies = &mut self.bodies;
        let mut next: Vec<usize> = bodies.iter().map(|of| of.inputs.touches.len()).collect();
        let mut kept: Vec<Vec<BorneContact>> = vec![Vec::new(); bodies.len()];
        let mut impulses = vec![[Vector3::zeros(); 2]; borne.len()];
        bodies.iter_mut().for_each(|of| of.contacts.last_given.clear());
        for bearing in &mut found {
            let at = bearing.bearer;
            let Body { inputs, contacts, pressed, frozen, .. } = &mut bodies[at];
            if *frozen {
                continue;
            }
            let force = inputs.forces.get(next[at]);
            let normal = force.map_or(0.0, |force| force.dot(&bearing.plane.normal).max(0.0));
            next[at] += 1;
            let SoftContacts { given_whole, last_given, .. } = contacts;
            let force =
                bearing.end_step(normal, borne, inputs.step_secs, given_whole, last_given, &mut impulses);
            if force != Vector3::zeros() {
                kept[at].push(bearing.contact);
                if is_last {
                    contacts.force_in_world += force;
                    *pressed = (pressed.0 + force.norm(), pressed.1 + 1);
                }
            }
        }
        for ((of, kept), from) in bodies.iter_mut().zip(kept).zip(next) {
            if !of.frozen {
                let step = of.inputs.step_secs;
                let stopping = of.inputs.forces.get(from..).unwrap_or_default();
                of.held_back.end_step(stopping, step);
                let added: Vec<(usize, Vector3<f64>)> =
                    of.held_back.stopping(stopping).map(|(touch, force)| (touch, *force)).collect();
                added.into_iter().for_each(|(touch, force)| of.inputs.forces[touch] += force);
            }
            of.inputs.forces.truncate(of.inputs.touches.len());
            if !(kept.is_empty() && of.contacts.borne.is_empty()) {
                if let Some(terms) = of.method.terms()
                    && *of.contacts.masses_inverse != terms.masses_inverse
                {
                    of.contacts.masses_inverse = terms.masses_inverse.to_vec().into();
                }
                of.contacts.borne = kept;
                of.contacts.step = tick.period.as_secs_f64();
                of.contacts_changed = true;
            }
        }
        if let Some(step) = bodies.first().map(|of| of.inputs.step_secs) {
            bearing::advance(borne, step, &impulses);
        }
    }
}

impl<M: SoftMethod> Controller for SoftController<M> {
    fn access(&self) -> Access {
        let refused = self.refused.iter().map(|body| body.entity);
        let bodies: Vec<Entity> = self.bodies.iter().map(|body| body.body.entity).chain(refused).collect();
        let access = Deformable::access(&bodies)
            .reads::<M::Kind>()
            .reads::<Pose>()
            .reads::<Velocity>()
            .reads::<Instrument>()
            .reads::<JawState>()
            .reads::<Crushable>()
            .reads::<Grips>()
            .writes::<StrainedGrips>(EntitySet::Of(bodies.clone()))
            .writes::<Grips>(EntitySet::Of(bodies.clone()))
            .writes::<Measured>(EntitySet::Own)
            .contributes::<CollisionList>();
        let access = RodPaths::access(HeldBack::access(access, &bodies), &bodies);
        let access = SlowSide::access(access, &self.registry, &bodies);
        let access = tracking::access(access, &self.registry);
        M::access(bearing::access(access, &bodies), &bodies)
    }

    fn tick(&mut self, tick: &Tick<'_>, scene: &Snapshot, out: &mut Commands) -> Result<(), ControllerError> {
        let period = tick.period.as_secs_f64();
        self.bodies.iter_mut().for_each(|of| of.inputs.step_secs = period);
        for body in self.bodies.iter_mut().filter(|body| !body.frozen) {
            if let Err(reason) = body.begin(&self.gravity_in_world, scene, tick, out) {
                body.freeze(&reason, tick, out);
            }
        }
        self.answer_found(scene, tick);
        self.bodies.iter_mut().for_each(|of| of.inputs.given_before = of.inputs.given.len());
        let given = self.bodies.iter().map(|of| (of.body.entity, &of.contacts.given_whole[..]));
        let when = (tick.time, period);
        let mut borne = self.bearings.borne_bodies(scene, when, &self.gravity_in_world, given, false);
        let bearers: Vec<Bearer<'_>> =
            self.bodies.iter().filter(|of| !of.frozen).filter_map(Body::bearer).collect();
        let parts = self.bearings.parts(&bearers, &borne, period);
        self.bodies.iter_mut().for_each(|of| of.contacts.course.clear());
        let mut course = TickCourse::new(period, parts);
        while !course.is_over() {
            if parts > 1 && course.begins_part() {
                let all = self.bodies.iter_mut().map(|of| &mut of.contacts);
                all.for_each(|contacts| contacts.course.push(contacts.given_whole.clone()));
            }
            let going = self.bodies.iter().filter(|of| !of.frozen && course.is_divisible());
            let longest = going.map(|of| of.step_max(scene, course.left())).fold(f64::INFINITY, f64::min);
            let step = course.next(longest);
            for of in &mut self.bodies {
                of.inputs.step_secs = step;
                if !of.frozen {
                    of.begin_step(scene, course.done(), period);
                }
            }
            let pressed = self.press(&borne, parts == 1 || foresees(period));
            let ready = self.bodies.iter_mut().filter(|body| !body.frozen);
            let mut steps: Vec<Step<'_, M>> = ready.map(|body| body.ready(scene, tick)).collect();
            M::step_all(&mut steps);
            let done: Vec<_> = steps.into_iter().map(|step| (step.done, step.forces)).collect();
            for (body, (done, forces)) in self.bodies.iter_mut().filter(|body| !body.frozen).zip(done) {
                body.inputs.forces = forces;
                if let Err(reason) = done.and_then(|()| body.is_finite()) {
                    body.freeze(&reason, tick, out);
                } else {
                    body.slip();
                }
            }
            self.bear(pressed, &mut borne, tick, course.is_over());
            if foresees(period) {
                let going = self.bodies.iter_mut().filter(|of| !of.frozen);
                going.for_each(|of| of.move_on(scene, (!course.is_over()).then(|| course.left()), period));
            }
        }
        for of in &mut self.bodies {
            if std::mem::take(&mut of.contacts_changed) {
                out.put(of.body.entity, of.contacts.clone());
            }
        }
        let mut found = TickContacts::default();
        let mut measured = Measured::default();
        for body in &mut self.bodies {
            found.pushed = 0.0;
            found.pulled = 0.0;
            if !body.frozen {
                body.end(scene, tick, &mut found, out);
            }
            let mut measures = Measures::new(&body.body.name, &mut measured.values);
            measures.put("contact_force_n", found.pushed);
            if body.method.terms().is_some() {
                measures.put("found_force_n", if body.frozen { 0.0 } else { body.pressed.0 });
                measures.put("found_contacts", if body.frozen { 0.0 } else { body.pressed.1 as f64 });
            }
            measures.put("held_force_n", found.pulled);
            measures.put("held_vertices", body.grips.vertices() as f64);
            if let Some(slip) = body.strained.slip_max() {
                measures.put("jaw_slip_m", slip);
            }
            measures.put("frozen", f64::from(u8::from(body.frozen)));
            body.method.measure(&body.body, &mut measures);
        }
        self.refused.iter_mut().for_each(|body| body.report(tick, &mut measured, out));
        found.collisions.sort_by(|a, b| b.depth.total_cmp(&a.depth));
        found.collisions.truncate(COLLISIONS_MAX);
        out.contribute(CollisionList { collisions: found.collisions, penetration_max: found.depth_max });
        out.put(tick.me, measured);
        Ok(())
    }
}

/// Contact results of a tick.
#[derive(Default)]
struct TickContacts {
    collisions: Vec<Collision>,
    /// Maximum penetration depth \[m\].
    depth_max: f64,
    /// Sums of the force magnitudes on the current body, by rod contacts and by grasps \[N\].
    pushed: f64,
    pulled: f64,
}

impl<M: SoftMethod> Body<M> {
    /// The body as one that bears rigid ones.
    fn bearer(&self) -> Option<Bearer<'_>> {
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

    fn read(
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
        })
    }

    /// Checks that all values which others will read of the body are finite: the Model rejects the controller's whole
    /// batch for one non-finite value.
    fn is_finite(&self) -> Result<(), String> {
        finite_vertices(self.method.positions(), self.method.velocities())?;
        let touches = self.inputs.touches.iter().zip(&self.inputs.forces);
        let bad = touches.into_iter().find(|(_, force)| !force.iter().all(|x| x.is_finite()));
        bad.map_or(Ok(()), |(touch, _)| {
            Err(format!("the force of the contact at vertex {} is no finite number", touch.nodes[0]))
        })
    }

    /// Applies topology changes, and collects the input of the step.
    fn begin(
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
    fn step_max(&self, scene: &Snapshot, within: f64) -> f64 {
        let StepInputs { touches, rods, .. } = &self.inputs;
        let skin = self.method.contact_surface(&self.body);
        let holds = |by: Entity| self.is_held_by(scene, by);
        self.held_back.step_max((touches, rods), &skin, self.method.velocities(), within, holds)
    }

    /// Finds the contacts that stop instruments in the next step, and sets where held vertices are to be at its end,
    /// `until` \[s\] after the beginning of a tick of `period` \[s\].
    fn begin_step(&mut self, scene: &Snapshot, until: f64, period: f64) {
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
    fn move_on(&mut self, scene: &Snapshot, left: Option<f64>, period: f64) {
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
    fn press_instruments(&mut self) {
        let StepInputs { presses, rigid, step_secs, .. } = &mut self.inputs;
        self.held_back.press(*step_secs, presses, rigid);
    }

    fn ready<'a>(&'a mut self, scene: &'a Snapshot, tick: &'a Tick<'a>) -> Step<'a, M> {
        let mut forces = std::mem::take(&mut self.inputs.forces);
        forces.clear();
        let Self { body, method, inputs, .. } = self;
        Step { method, body, site: inputs.site(scene, tick), forces, done: Ok(()) }
    }

    fn freeze(&mut self, reason: &str, tick: &Tick<'_>, out: &mut Commands) {
        self.frozen = true;
        self.body.freeze(&reason, tick, out);
    }

    /// Writes the body's state and contact forces after a step.
    fn end(&mut self, scene: &Snapshot, tick: &Tick<'_>, found: &mut TickContacts, out: &mut Commands) {
        let entity = self.body.entity;
        self.body.write(self.method.positions(), self.method.velocities(), out);
        self.held_back.end(entity, &self.inputs.world_from_body, tick.time, out);
        self.rod_paths.end(scene, entity, !self.inputs.touches.is_empty(), out);
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
    fn slip(&mut self) {
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

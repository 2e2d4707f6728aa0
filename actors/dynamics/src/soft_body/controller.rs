//! Common controller of all soft-body methods: whichever method moves a body, instruments touch, grasp and cut it in
//! the same way, contact forces go to the same list, and a solver failure stops only that body.
//!
//! A method implements [`SoftMethod`]: its construction from the scene, its step, its measures. [`SoftController`] does
//! the rest. In each tick, for each body: blade cuts, rod contacts, grasps, detected contacts, the step, and the writes
//! to the scene.

use std::sync::Arc;

use nalgebra::Vector3;
use trocar_scene::{
    Access, BuildContext, CollisionList, Commands, Component, Controller, ControllerError, Entity, EntitySet,
    Instrument, JawState, Measured, OutOfValidity, Pose, Registry, Snapshot, Tick, Velocity,
};

use super::bearing::rigid_response::PlaneContact;
use super::bearing::{self, Bearer, Bearing, Bearings, BorneBody};
use super::contact::penalty::{self, RespondingBody};
use super::contact::tracking::{self, AdjacencyCache, Shape};
use super::contact::{BorneContact, SoftContacts};
use super::coupling::slow_side::SlowSide;
use super::frozen::{FrozenPart, RejectedBody};
use super::grasp::Grips;
use super::held_back::HeldBack;
use super::jaw_friction::{Crushable, StrainedGrips};
use super::method::{Measures, Step};
use super::rod_contact::COLLISIONS_MAX;
use super::rod_paths::RodPaths;
use super::stepped_body::{Body, StepInputs, TickContacts};
use super::tick_course::{TickCourse, foresees};
use super::{Deformable, SoftMethod};

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
            .writes::<OutOfValidity>(EntitySet::Of(bodies.clone()))
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
            let going = self.bodies.iter_mut().filter(|of| !of.frozen);
            going.for_each(|of| of.look_for_passing(scene, period));
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

//! The controller of linear organs: quasi-static finite elements with a precomputed inverse. Contacts and grasps
//! prescribe surface displacements; the solver returns the reaction forces.
//!
//! The inverse is read from a cache or computed by a background job; until then the organ does not move. The rest shape
//! is the shape under gravity. Only the surface positions and the held vertices persist from tick to tick, both in the
//! scene: contacts are detected anew at the current surface, and solved from zero, so that a restart gives identical
//! results. Bilateral constraints keep their rows, without any effect on the bits.

mod bearing;
pub(crate) mod blend;
pub mod component;
pub(crate) mod contacts;
pub(crate) mod embedded_points;
mod held_back;
pub(crate) mod inverse_job;
mod jaws;
pub(crate) mod topology_change;
pub(crate) mod warm_start;

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use nalgebra::{Isometry3, Point3, Vector3};
use trocar_dynamics::soft_body::bearing::rigid_response::RigidPresses;
use trocar_dynamics::soft_body::bearing::{Bearings, access as bearing_access};
use trocar_dynamics::soft_body::contact::SoftContacts;
use trocar_dynamics::soft_body::frozen::{FrozenPart, RejectedBody};
use trocar_dynamics::soft_body::grasp::Grips;
use trocar_dynamics::soft_body::held_back::HeldBack;
use trocar_dynamics::soft_body::instrument_rods::{Rod, rods_of_all};
use trocar_dynamics::soft_body::jaw_friction::{Crushable, StrainedGrips, TickGrips};
use trocar_dynamics::soft_body::jaws::is_blade;
use trocar_dynamics::soft_body::method::{Measures, StepContext, bearing_stiffness, finite_vertices};
use trocar_dynamics::soft_body::rod_contact::{COLLISIONS_MAX, RodContact, collision};
use trocar_dynamics::soft_body::{Deformable, PinnedBody};
use trocar_dynamics::tet_mesh::{MeshRules, TetMesh};
use trocar_scene::{
    Access, BuildContext, Collision, CollisionList, Commands, Controller, ControllerError, Detection, Entity,
    EntitySet, Frozen, Instrument, JawState, Measured, OutOfValidity, Pose, Primitive, SimTime, Snapshot,
    Tick, Velocity,
};

use super::cutting::divisible_volume::DivisibleVolume;
use crate::linear_fem::{Attachment, Cache, Deformation, LinearFem, LinearFemError};
use blend::InverseBlend;
use component::LinearFemBody;
use contacts::{ConstraintReaction, ConstraintSource, Contacts};
use embedded_points::{PinPlaces, Pins};
use topology_change::MeshChanges;
use warm_start::HeldConstraints;

/// Stands for the mobility of a free vertex \[1/kg\]: an organ without mass does not move by itself.
const MOBILITY: f64 = 1e-9;
/// Maximum number of contact detection rounds per tick.
const ROUNDS_MAX: usize = 8;
/// Ticks between two evaluations of the interior: rotations and strains of all elements.
const INSIDE_EVERY: u64 = 10;

pub(super) struct Body {
    pub(super) body: Deformable,
    pub(super) kind: LinearFemBody,
    pub(super) mesh: TetMesh,
    pub(super) solver: Option<Box<LinearFem>>,
    /// Its constraints, and their forces [N].
    pub(super) holding: HeldConstraints,
    forces: Vec<Vector3<f64>>,
    /// The previous inverse, while it is blended out.
    pub(super) blend: Option<InverseBlend>,
    submitted: bool,
    /// For a body that can burn, be cut or tear.
    pub(super) divisible: Option<(DivisibleVolume, MeshChanges)>,
    /// Progress of the inverse's computation, as the bits of an f64.
    progress: Arc<AtomicU64>,
    pub(super) positions: Vec<Point3<f64>>,
    pub(super) grips: Grips,
    strained: StrainedGrips,
    pub(super) jaws: TickGrips,
    pub(super) held_back: HeldBack,
    pub(super) pins: Pins,
    /// Points that rods pressed on in the last tick.
    pub(super) contacts: Contacts,
    /// Contacts with rigid bodies that move, the parameters of these, and the sum of their forces \[N\].
    borne: SoftContacts,
    mobility: Vec<f64>,
    bearing_stiffness: f64,
    borne_force: f64,
    /// Whether they have changed in this tick.
    borne_changed: bool,
    pub(super) is_pinned: Vec<bool>,
    deformation: Deformation,
    /// Whether the strain was outside the validity of linear elasticity.
    beyond: bool,
    frozen: bool,
    /// Its pose in this tick, instruments in its frame, and its reactions in the last step.
    world_from_body: Isometry3<f64>,
    pub(super) rods: Vec<Rod>,
    answers: Vec<ConstraintReaction>,
}

/// Steps every body that carries [`LinearFemBody`].
pub struct LinearFemController {
    cache: Option<Cache>,
    bodies: Vec<Body>,
    refused: Vec<RejectedBody>,
    bearings: Bearings,
    gravity_in_world: Vector3<f64>,
}

impl LinearFemController {
    /// Reads the bodies, and resumes their state from the scene. `cache` is the folder of computed inverses; gravity is
    /// that of the rigid bodies on them.
    ///
    /// # Errors
    /// The name of the body, and what is wrong with it.
    pub fn new(
        gravity_in_world: Vector3<f64>,
        cache: Option<PathBuf>,
        context: &BuildContext<'_>,
    ) -> Result<Self, ControllerError> {
        let (mut bodies, mut refused) = (Vec::new(), Vec::new());
        for entity in Deformable::carriers::<LinearFemBody>(context.scene) {
            let Some(kind) = context.scene.get::<LinearFemBody>(entity).copied() else { continue };
            match Body::read(kind, entity, context.scene) {
                Ok(body) => bodies.push(body),
                Err(error) => refused.push(RejectedBody::of(context, entity, FrozenPart::Body, error)?),
            }
        }
        if bodies.is_empty() && refused.is_empty() {
            return Err(ControllerError::Scene("linear-fem: no entity has a 'linear_fem'".into()));
        }
        let cache = cache.map(|folder| Cache::new(&folder));
        Ok(Self { cache, bodies, refused, bearings: Bearings::default(), gravity_in_world })
    }
}

impl Controller for LinearFemController {
    fn access(&self) -> Access {
        let refused = self.refused.iter().map(|body| body.entity);
        let bodies: Vec<Entity> = self.bodies.iter().map(|body| body.body.entity).chain(refused).collect();
        let access = HeldBack::access(bearing_access(Deformable::access(&bodies), &bodies), &bodies);
        DivisibleVolume::access(access, &bodies)
            .reads::<LinearFemBody>()
            .reads::<Pose>()
            .reads::<Velocity>()
            .reads::<Instrument>()
            .reads::<JawState>()
            .reads::<Crushable>()
            .writes::<StrainedGrips>(EntitySet::Of(bodies.clone()))
            .writes::<OutOfValidity>(EntitySet::Of(bodies.clone()))
            .reads::<PinnedBody>()
            .writes::<Grips>(EntitySet::Of(bodies.clone()))
            .writes::<PinPlaces>(EntitySet::Of(bodies.clone()))
            .writes::<Contacts>(EntitySet::Of(bodies))
            .writes::<Measured>(EntitySet::Own)
            .contributes::<CollisionList>()
    }

    fn tick(&mut self, tick: &Tick<'_>, scene: &Snapshot, out: &mut Commands) -> Result<(), ControllerError> {
        for (index, body) in self.bodies.iter_mut().enumerate().filter(|(_, body)| !body.frozen) {
            body.world_from_body = scene.world_pose(body.body.entity);
            rods_of_all(scene, &body.world_from_body, &mut body.rods);
            body.held_back.begin(scene, body.body.entity, &body.world_from_body, &mut body.rods);
            if body.kind.cut {
                body.rods.retain(|rod| !is_blade(scene, rod.instrument));
            }
            if let Err(why) = body.begin(index, self.cache.as_ref(), scene, tick, out) {
                body.freeze(&why, tick, out);
            }
        }
        self.solve(scene, tick, out);
        let mut collisions: Vec<Collision> = Vec::new();
        let mut measured = Measured::default();
        for body in &mut self.bodies {
            let forces = if body.frozen { [0.0; 2] } else { body.end(scene, tick, &mut collisions, out) };
            body.measure(forces, &mut measured.values);
        }
        self.refused.iter_mut().for_each(|body| body.report(tick, &mut measured, out));
        collisions.sort_by(|a, b| b.depth.total_cmp(&a.depth));
        collisions.truncate(COLLISIONS_MAX);
        out.contribute(CollisionList { collisions, penetration_max: 0.0 });
        out.put(tick.me, measured);
        Ok(())
    }
}

/// What a step of an organ is given.
fn site<'a>(
    scene: &'a Snapshot,
    tick: &'a Tick<'a>,
    world_from_body: &'a Isometry3<f64>,
    rods: &'a [Rod],
    rigid: RigidPresses<'a>,
) -> StepContext<'a> {
    StepContext {
        scene,
        tick,
        step_secs: tick.period.as_secs_f64(),
        world_from_body,
        gravity: Vector3::zeros(),
        rods,
        touches: &[],
        rigid,
        meets_instruments: false,
        forces: &[],
        driven: &[],
        grip_limits: &[],
    }
}

impl Body {
    fn read(kind: LinearFemBody, entity: Entity, scene: &Snapshot) -> Result<Self, ControllerError> {
        let mut body = Deformable::read(scene, entity)?;
        let wrong = |name: &str, why: String| ControllerError::Scene(format!("'{name}': {why}"));
        let mesh = |body: &Deformable| {
            let coincident_within = if body.is_parted { None } else { Some(0.0) };
            let rules = MeshRules { coincident_within, ..MeshRules::default() };
            TetMesh::new(&body.rest, &body.tets, &rules).map_err(|why| wrong(&body.name, why.to_string()))
        };
        let failure_criteria = kind.failure_criteria().map_err(|why| wrong(&body.name, why))?;
        let divisible =
            DivisibleVolume::new(&mut body, failure_criteria, scene).map_err(|why| wrong(&body.name, why))?;
        let mesh = mesh(&body)?;
        let divisible = divisible.map(|divisible| {
            let altered = MeshChanges::new(mesh.tets().len(), &divisible.heated(), divisible.births());
            (divisible, altered)
        });
        let is_pinned = body.stays();
        let pins = Pins::read(scene, &body, &mesh).map_err(|why| wrong(&body.name, why))?;
        Ok(Self {
            kind,
            mesh,
            pins,
            solver: None,
            holding: HeldConstraints::default(),
            forces: Vec::new(),
            blend: None,
            submitted: false,
            divisible,
            progress: Arc::default(),
            positions: body.positions.to_vec(),
            grips: scene.get::<Grips>(entity).cloned().unwrap_or_default(),
            strained: scene.get::<StrainedGrips>(entity).cloned().unwrap_or_default(),
            jaws: TickGrips::default(),
            held_back: HeldBack::resume(scene, entity),
            contacts: scene.get::<Contacts>(entity).cloned().unwrap_or_default(),
            borne: scene.get::<SoftContacts>(entity).cloned().unwrap_or_default(),
            mobility: is_pinned.iter().map(|pinned| if *pinned { 0.0 } else { MOBILITY }).collect(),
            bearing_stiffness: bearing_stiffness(0.0, kind.young_modulus, &body),
            borne_force: 0.0,
            borne_changed: false,
            is_pinned,
            deformation: Deformation::default(),
            beyond: false,
            frozen: scene.get::<Frozen>(entity).is_some(),
            world_from_body: scene.world_pose(entity),
            rods: Vec::new(),
            answers: Vec::new(),
            body,
        })
    }

    /// Begins a tick: takes its inverse, and applies topology changes.
    fn begin(
        &mut self,
        index: usize,
        cache: Option<&Cache>,
        scene: &Snapshot,
        tick: &Tick<'_>,
        out: &mut Commands,
    ) -> Result<(), String> {
        let keys = [2 * index as u64, 2 * index as u64 + 1];
        self.answers.clear();
        self.wait(keys[0], cache, tick)?;
        let (rods, world_from_body) = (std::mem::take(&mut self.rods), self.world_from_body);
        let site = site(scene, tick, &world_from_body, &rods, RigidPresses::default());
        let done = self.alter(keys[1], &site, out);
        self.rods = rods;
        done
    }

    /// A step, in which it presses on these rigid bodies; its reactions are in `answers`.
    fn step(
        &mut self,
        step_secs: f64,
        rigid: RigidPresses<'_>,
        scene: &Snapshot,
        tick: &Tick<'_>,
        out: &mut Commands,
    ) -> Result<(), String> {
        let (rods, world_from_body) = (std::mem::take(&mut self.rods), self.world_from_body);
        let site = StepContext { step_secs, ..site(scene, tick, &world_from_body, &rods, rigid) };
        let before: Vec<Vector3<f64>> = self.held_back.instruments().map(|(_, _, offset)| offset).collect();
        let done = self.react(&site, out);
        self.rods = rods;
        self.answers = done?;
        for ((instrument, _, offset), before) in self.held_back.instruments().zip(before) {
            let own = self.rods.iter_mut().filter(|rod| rod.instrument == instrument);
            own.for_each(|rod| rod.ends.iter_mut().for_each(|end| *end += offset - before));
        }
        let bad = self.answers.iter().position(|answer| !answer.force.iter().all(|x| x.is_finite()));
        bad.map_or(Ok(()), |at| Err(format!("the force of contact {at} is no finite number")))
    }

    /// The reactions of a step.
    fn react(
        &mut self,
        site: &StepContext<'_>,
        out: &mut Commands,
    ) -> Result<Vec<ConstraintReaction>, String> {
        if self.solver.is_none() {
            return Ok(self.bear_undeformed(site));
        }
        let mut answers = self.collect_constraints(site, out)?;
        self.keep(answers.iter().map(|answer| &answer.attachment)).map_err(|error| error.to_string())?;
        let mut asked = 0;
        self.settle(&mut answers, site.rods, &mut asked).map_err(|error| error.to_string())?;
        self.hold_back(&mut answers, site).map_err(|error| error.to_string())?;
        self.slip(&mut answers).map_err(|error| error.to_string())?;
        self.keep_slipped(&answers, site, out);
        self.contacts.keep(&answers, site.rods, self.kind.contact_radius);
        finite_vertices(&self.positions, &[])?;
        Ok(answers)
    }

    /// Ends a tick: writes the body and its contact forces; returns the sums of the forces of contacts and of pins \[N\].
    fn end(
        &mut self,
        scene: &Snapshot,
        tick: &Tick<'_>,
        collisions: &mut Vec<Collision>,
        out: &mut Commands,
    ) -> [f64; 2] {
        if self.solver.is_some() {
            // Results of the last evaluation are for the next tick.
            self.evaluate_interior(tick);
            if !self.divisible.as_ref().is_some_and(|(_, altered)| altered.is_behind()) {
                self.blend.take_if(InverseBlend::is_over);
            }
            if let Err(why) = finite_vertices(&self.positions, &[]) {
                self.freeze(&why, tick, out);
                return [0.0; 2];
            }
        }
        let mut forces = [0.0; 2];
        for answer in &self.answers {
            match answer.by {
                ConstraintSource::Pin(_) => forces[1] += answer.force.norm(),
                ConstraintSource::Body(_) => {}
                _ => forces[0] += answer.force.norm(),
            }
            collisions.extend(self.collision_of(answer, &self.rods, &self.world_from_body, tick.time));
        }
        if self.solver.is_some() {
            self.write(out);
        }
        self.held_back.end(self.body.entity, &self.world_from_body, tick.time, out);
        if self.leaves_linear_range(tick) {
            out.event("beyond_linear", self.body.entity, None, tick.time.as_secs_f64());
            if scene.get::<OutOfValidity>(self.body.entity).is_none() {
                out.put(self.body.entity, self.validity_warning(tick));
            }
        }
        forces
    }

    fn freeze(&mut self, why: &str, tick: &Tick<'_>, out: &mut Commands) {
        self.frozen = true;
        // As in the scene.
        self.positions = self.body.positions.to_vec();
        self.body.freeze(&why, tick, out);
    }

    /// Releases everything that is not kept from the last tick.
    fn keep<'a>(
        &mut self,
        wanted: impl Iterator<Item = &'a Attachment> + Clone,
    ) -> Result<(), LinearFemError> {
        let Some(solver) = &mut self.solver else { return Ok(()) };
        self.holding.keep(solver, wanted.clone())?;
        self.blend.as_mut().map_or(Ok(()), |blend| blend.keep(wanted))
    }

    /// Holds the new constraints, and solves for all.
    fn answer(
        &mut self,
        answers: &mut [ConstraintReaction],
        asked: &mut usize,
    ) -> Result<(), LinearFemError> {
        let Some(solver) = &mut self.solver else { return Ok(()) };
        for (index, answer) in answers.iter().enumerate().skip(*asked) {
            // If two jaws hold the same vertex, the first one has it.
            self.holding.hold(solver, index, &answer.attachment, answer.target)?;
            if let Some(blend) = &mut self.blend {
                blend.hold(index, &answer.attachment, answer.target)?;
            }
        }
        *asked = answers.len();
        self.holding.forces(solver, &mut self.forces)?;
        for (answer, force) in answers.iter_mut().zip(&self.forces) {
            answer.force = *force;
        }
        if let Some(blend) = &mut self.blend {
            blend.blend_forces(answers)?;
        }
        let mut moved = Vec::new();
        solver.surface_displacements(&mut moved);
        for (&node, displacement) in solver.nodes().iter().zip(&moved) {
            self.positions[node as usize] = self.body.rest[node as usize] + displacement;
        }
        if let Some(blend) = &mut self.blend {
            blend.blend_surface(solver.nodes(), &self.body.rest, &mut self.positions);
        }
        Ok(())
    }

    /// Evaluates the interior periodically. During burning or cutting always, because uncovered surface belongs to the
    /// interior for the inverse; and for tearing, which depends on element stress.
    fn evaluate_interior(&mut self, tick: &Tick<'_>) {
        let Some(solver) = &mut self.solver else { return };
        let look = tick.number.is_multiple_of(INSIDE_EVERY);
        let always = solver.is_corrected() || self.blend.is_some() || self.kind.strength.is_some();
        if !look && !always {
            return;
        }
        let mut moved = Vec::new();
        match &mut self.blend {
            Some(blend) => blend.displacements(solver, &mut moved),
            None => solver.displacements(&mut moved),
        }
        for (node, displacement) in moved.iter().enumerate() {
            self.positions[node] = self.body.rest[node] + displacement;
        }
        if look {
            let heated = self.divisible.as_ref().map(|(divisible, _)| divisible.heated()).unwrap_or_default();
            self.deformation = Deformation::without(&self.mesh, &moved, &heated.removed);
        }
    }

    /// A reaction force as a row of the collision list: `a` is the instrument, `b` the body. Its depth is the surface's
    /// displacement from rest, so that force over depth is the organ's stiffness.
    fn collision_of(
        &self,
        answer: &ConstraintReaction,
        rods: &[Rod],
        world_from_body: &Isometry3<f64>,
        at: SimTime,
    ) -> Option<Collision> {
        let size = answer.force.norm();
        if size == 0.0 {
            return None;
        }
        let way = answer.force / size;
        let depth = answer.target.dot(&way).max(1e-6);
        let held =
            |(a, primitive_a): (Entity, Primitive), primitive_b: Primitive, place: Point3<f64>| Collision {
                a,
                primitive_a,
                b: self.body.entity,
                primitive_b,
                points_in_world: [world_from_body * place; 2],
                normal_in_world: world_from_body.rotation * way,
                depth,
                force_in_world: world_from_body.rotation * answer.force,
                velocity_constraint: 0.0,
                method: Detection::Simulator,
                detected_at: at,
            };
        Some(match &answer.by {
            ConstraintSource::RodContact(touch) => {
                let found = collision(
                    &RodContact { depth: 0.0, ..*touch },
                    &rods[touch.rod],
                    self.body.entity,
                    &answer.force,
                    world_from_body,
                    at,
                );
                Collision { depth, ..found }
            }
            ConstraintSource::Jaws(instrument, vertex) => {
                let place = self.positions[*vertex as usize];
                held((*instrument, Primitive::Jaw(0)), Primitive::Vertex(*vertex), place)
            }
            ConstraintSource::Body(_) => return None,
            ConstraintSource::Pin(number) => {
                let pin = &self.pins.pins[*number];
                let place = pin.rest + answer.target;
                held((pin.entity, Primitive::Shape(0)), Primitive::Tetrahedron(pin.tet), place)
            }
        })
    }

    fn write(&mut self, out: &mut Commands) {
        let still = vec![Vector3::zeros(); self.positions.len()];
        self.body.write(&self.positions, &still, out);
        out.put(self.body.entity, self.grips.clone());
        out.put(self.body.entity, self.contacts.clone());
        if let Some(places) = self.pins.take_changes() {
            out.put(self.body.entity, places);
        }
    }

    /// Whether it has just left the validity of linear elasticity.
    fn leaves_linear_range(&mut self, tick: &Tick<'_>) -> bool {
        let beyond = !self.deformation.is_small();
        let new = beyond && !self.beyond && tick.number > 0;
        self.beyond = beyond;
        new
    }

    fn validity_warning(&self, tick: &Tick<'_>) -> OutOfValidity {
        let reason = format!("{}; 'dynamic_fem' bears more", self.deformation.validity_warning());
        OutOfValidity { reason, since: tick.time }
    }

    fn measure(&self, [touched, driven_in]: [f64; 2], values: &mut BTreeMap<String, f64>) {
        let name = &self.body.name;
        let flag = |is: bool| f64::from(u8::from(is));
        values.insert(format!("{name}.contact_force_n"), touched);
        values.insert(format!("{name}.found_force_n"), self.borne_force);
        values.insert(format!("{name}.found_contacts"), self.borne.borne.len() as f64);
        let moved = self.positions.iter().zip(self.body.rest.iter()).map(|(now, rest)| (now - rest).norm());
        values.insert(format!("{name}.displacement_max_m"), moved.fold(0.0, f64::max));
        values.insert(format!("{name}.rotation_max_rad"), self.deformation.rotation);
        // Infinite for an inverted element.
        values.insert(format!("{name}.strain_max"), self.deformation.strain.min(1e3));
        values.insert(format!("{name}.beyond_linear"), flag(self.beyond));
        let held: usize = self.grips.picks.picks.iter().map(|pick| pick.vertices.len()).sum();
        values.insert(format!("{name}.held_vertices"), held as f64);
        if let Some(slip) = self.strained.slip_max() {
            values.insert(format!("{name}.jaw_slip_m"), slip);
        }
        values.insert(format!("{name}.kept_constraints"), self.holding.kept() as f64);
        if !self.pins.pins.is_empty() {
            values.insert(format!("{name}.pinned_force_n"), driven_in);
        }
        let share = f64::from_bits(self.progress.load(Ordering::Relaxed));
        values.insert(format!("{name}.precomputed_share"), if self.solver.is_some() { 1.0 } else { share });
        values.insert(format!("{name}.frozen"), flag(self.frozen));
        if let Some((divisible, altered)) = &self.divisible {
            let mut measures = Measures::new(name, values);
            divisible.measure(&mut measures);
            let blend = self.blend.as_ref();
            let nodes = self.solver.as_ref().map_or(0, |solver| altered.nodes_waiting(solver, blend));
            measures.put("elements_waiting", altered.waiting(blend) as f64);
            measures.put("nodes_waiting", nodes as f64);
        }
    }
}

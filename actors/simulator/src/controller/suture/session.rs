//! A sewing session: needle, thread and tissue of a scene, their grasps, and the steps of their island.

use nalgebra::{Isometry3, Point3, Vector3};
use trocar_dynamics::elasticity::Elastic;
use trocar_dynamics::soft_body::Deformable;
use trocar_dynamics::soft_body::jaws::{CLOSED, holds};
use trocar_dynamics::soft_body::rod_contact::COLLISIONS_MAX;
use trocar_dynamics::tet_mesh::{MeshRules, TetMesh};
use trocar_scene::components::LineMesh;
use trocar_scene::{
    CollisionList, Commands, ControllerError, Entity, Frozen, Instrument, JawState, Measured, OutOfValidity,
    Primitive, Snapshot, Tick,
};

use super::components::{HeldNeedle, SewnTissue, SutureMemory, SutureNeedle};
use crate::controller::suture_thread::contact_report::{ContactReport, collision};
use crate::controller::suture_thread::cut::{follow as follow_cut, parted_at};
use crate::controller::suture_thread::grasp::{GraspConstraints, GraspForce, SPARED, pulls, update};
use crate::controller::suture_thread::knot::KnotState;
use crate::controller::suture_thread::knot_job::KnotWatch;
use crate::controller::suture_thread::led_instruments::LedInstruments;
use crate::controller::suture_thread::obstacles::ObstacleParts;
use crate::controller::suture_thread::remesh::{EDGES_EVERY, fineness, follow, held};
use crate::controller::suture_thread::saved_state::ObstaclePose;
use crate::linear_fem::Deformation;
use crate::suture::needle::NeedleState;
use crate::suture::{Grip, StepInputs, Suture, SutureReport, SutureState, Tissue};
use crate::suture_thread::{Obstacle, Reaction, ThreadState};

/// Maximum step of the island \[s\].
const STEP: f64 = 1e-3;
/// Jaws that open by more than this beyond closed release \[rad\].
const OPENING: f64 = 0.05;
/// Ticks between two checks of the tissue against the validity of linear elasticity.
const DOUBT_EVERY: u64 = 20;
/// Number of segments of the needle's line.
const PIECES: usize = 24;
/// Stiffness of the grasp of a needle \[N/m\], \[N·m/rad\]: steel jaws.
const STIFFNESS: f64 = 2e4;
const TURNING_STIFFNESS: f64 = 5.0;

/// A needle with its thread, the sewn tissue, and their grasps.
pub(crate) struct Sewing {
    gravity: Vector3<f64>,
    needle: Deformable,
    tissue: Deformable,
    kind: SutureNeedle,
    suture: Suture,
    memory: SutureMemory,
    knot: KnotWatch,
    has_knot: bool,
    report: SutureReport,
    /// Of the tissue.
    deformation: Deformation,
    grips: Vec<Grip>,
    parts: ObstacleParts,
    led: LedInstruments,
    /// Parts that the needle passes.
    passes: Vec<usize>,
    leading: GraspConstraints,
    /// Mean reaction on each part over the last tick.
    reactions: Vec<Reaction>,
    pulls: Vec<(Entity, GraspForce)>,
    forces: Vec<(Entity, Point3<f64>, Vector3<f64>)>,
    has_line: bool,
    frozen: bool,
}

impl Sewing {
    /// Reads needle and tissue, and resumes their state from the scene.
    ///
    /// # Errors
    /// What is wrong with them.
    pub fn new(
        gravity_in_world: Vector3<f64>,
        [needle, tissue]: [Entity; 2],
        scene: &Snapshot,
    ) -> Result<Self, ControllerError> {
        let wrong = |of: Entity, why: String| ControllerError::Scene(format!("'{}': {why}", scene.name(of)));
        let gone = || ControllerError::Scene("suture: needle or tissue is gone".into());
        let kind = scene.get::<SutureNeedle>(needle).cloned().ok_or_else(gone)?;
        let sewn = scene.get::<SewnTissue>(tissue).copied().ok_or_else(gone)?;
        let mut line = Deformable::read(scene, needle)?;
        let body = Deformable::read(scene, tissue)?;
        let world_from_body = scene.world_pose(tissue);
        let rest: Vec<_> = body.rest.iter().map(|point| world_from_body * point).collect();
        let mesh = TetMesh::new(&rest, &body.tets, &MeshRules::default())
            .map_err(|error| wrong(tissue, error.to_string()))?;
        let elastic = Elastic::new(sewn.young_modulus, sewn.poisson_ratio)
            .map_err(|error| wrong(tissue, error.to_string()))?;
        let soft =
            Tissue::new(mesh, &elastic, &body.pinned).map_err(|error| wrong(tissue, error.to_string()))?;
        let memory = scene.get::<SutureMemory>(needle).cloned().unwrap_or_default();
        let (state, is_new) = match &memory.state {
            Some(state) => (state.clone(), false),
            None => (begin(&kind, &scene.world_pose(needle)).map_err(|why| wrong(needle, why))?, true),
        };
        let mut suture = Suture::new(&kind.shape(), Some(kind.material()), sewn.resistance(), soft, state)
            .map_err(|error| wrong(needle, error.to_string()))?;
        if is_new {
            suture.swage();
        }
        update_line(&suture, &scene.world_pose(needle), &mut line);
        line.radius = kind.wire_radius;
        Ok(Self {
            gravity: gravity_in_world,
            frozen: [needle, tissue].iter().any(|of| scene.get::<Frozen>(*of).is_some()),
            needle: line,
            tissue: body,
            kind,
            suture,
            memory,
            knot: KnotWatch::new(scene.get::<KnotState>(needle), 0),
            has_knot: false,
            report: SutureReport::default(),
            deformation: Deformation::default(),
            grips: Vec::new(),
            parts: ObstacleParts::default(),
            led: LedInstruments::resume(scene, needle),
            passes: Vec::new(),
            leading: GraspConstraints::default(),
            reactions: Vec::new(),
            pulls: Vec::new(),
            forces: Vec::new(),
            has_line: false,
        })
    }

    /// Updates the grasps.
    fn update(&mut self, scene: &Snapshot, period: f64) {
        let angle = |entity| scene.get::<JawState>(entity).map(|jaws| jaws.angle);
        let stays = |held: &HeldNeedle| angle(held.instrument).is_some_and(|angle| angle <= CLOSED + OPENING);
        self.memory.held.retain(stays);
        let mut closed = Vec::new();
        for (entity, instrument) in scene.iter::<Instrument>() {
            if !holds(instrument.kind) || angle(entity).is_none_or(|angle| angle > CLOSED) {
                continue;
            }
            closed.push(entity);
            let holds_already = self.memory.held.iter().any(|held| held.instrument == entity)
                || self.memory.grips.iter().any(|grip| grip.instrument == entity && !grip.is_shut());
            if self.memory.closed.contains(&entity) || holds_already {
                continue;
            }
            let at = scene.world_pose(entity);
            if let Some(along) = self.between(instrument, &at) {
                let instrument_from_needle = at.inverse() * self.suture.state().needle.pose();
                self.memory.held.push(HeldNeedle { instrument: entity, at, along, instrument_from_needle });
            }
        }
        self.memory.closed = closed;
        let busy: Vec<Entity> = self.memory.held.iter().map(|held| held.instrument).collect();
        // Jaws that are open, or of which nothing is known yet, are to close around the needle.
        let is_open = |entity| angle(entity).is_none_or(|angle| angle > CLOSED);
        self.passes.clear();
        self.passes.extend(self.parts.list.iter().enumerate().filter_map(|(index, part)| {
            let entity = part.met.entity;
            (busy.contains(&entity) || (part.jaw.is_some() && is_open(entity))).then_some(index)
        }));
        if let Some(thread) = &self.suture.state().thread {
            let radius = self.suture.thread_radius();
            if update(&mut self.memory.grips, &self.parts, scene, thread, radius, period, &busy) {
                self.memory.loop_min = None;
            }
            self.leading.exempt_held(&self.memory.grips, &self.parts, thread);
            for held in &self.memory.held {
                // The thread behind the tail lies within jaws that hold the needle there.
                self.leading.exempt_beginning(held.instrument, SPARED - held.along, &self.parts, thread);
            }
        }
    }

    /// Where the needle lies between the jaws of an instrument at `world_from_instrument`: arc length from its tail.
    fn between(&self, instrument: &Instrument, world_from_instrument: &Isometry3<f64>) -> Option<f64> {
        let reach = instrument.jaw_thickness.max(1e-3) + self.kind.wire_radius;
        let inside = |point: &Point3<f64>| {
            let own = world_from_instrument.inverse_transform_point(point);
            let along = own.z.clamp(-instrument.jaw_length, 0.0);
            let off = (own - Point3::new(0.0, 0.0, along)).norm();
            (off <= reach).then_some(off)
        };
        let (solid, pose) = (self.suture.solid(), self.suture.state().needle.pose());
        let length = solid.shape().length();
        let places = (0..=4 * PIECES).filter_map(|piece| {
            let along = length * piece as f64 / (4 * PIECES) as f64;
            Some((along, inside(&(pose * solid.point(along)))?))
        });
        places.min_by(|a, b| a.1.total_cmp(&b.1)).map(|(along, _)| along)
    }

    /// Refines the thread's edges where it is tied, and coarsens them elsewhere.
    fn adapt(&mut self, world_from_needle: &Isometry3<f64>) -> Result<(), String> {
        let fineness =
            fineness([self.kind.knot_edge, self.kind.thread_edge], 2.0 * self.suture.thread_radius());
        let keep: Vec<usize> = held(&self.memory.grips).collect();
        let Some(now) = self.suture.adapt(&fineness, keep).map_err(|error| error.to_string())? else {
            return Ok(());
        };
        follow(&mut self.memory.grips, &now);
        self.replace_line(world_from_needle);
        Ok(())
    }

    /// Cuts the thread where blades have closed on it, or where it breaks.
    fn cut(&mut self, scene: &Snapshot, tick: &Tick<'_>, out: &mut Commands) -> Result<(), String> {
        let Some(thread) = &self.suture.state().thread else { return Ok(()) };
        let breaks_at = self.kind.breaks_at.as_ref().map(|known| known.value);
        let state = (thread, self.suture.thread_radius());
        let found = parted_at(&mut self.memory.blades, scene, &Isometry3::identity(), state, breaks_at);
        let name = found.event();
        for at in found.cuts {
            let Some(parted) = self.suture.cut_thread(at).map_err(|error| error.to_string())? else {
                continue;
            };
            follow_cut(&mut self.memory.grips, &parted);
            self.replace_line(&scene.world_pose(self.needle.entity));
            self.memory.loop_min = None;
            out.event(name, self.needle.entity, None, tick.time.as_secs_f64());
        }
        Ok(())
    }

    /// Rebuilds its line with the current nodes.
    fn replace_line(&mut self, world_from_needle: &Isometry3<f64>) {
        update_line(&self.suture, world_from_needle, &mut self.needle);
        self.has_line = false;
    }

    /// One tick; the loads on instruments are left in `forces`, `reactions` and `pulls`.
    fn step(&mut self, scene: &Snapshot, tick: &Tick<'_>, out: &mut Commands) -> Result<(), String> {
        let period = tick.period.as_secs_f64();
        let world = Isometry3::identity();
        self.led.begin(scene, self.needle.entity, &world);
        self.parts.read(scene, &world, self.kind.tool_friction, &self.memory.met, &self.led);
        self.led.find(&self.parts);
        if !self.parts.are(&self.memory.met)
            && let Some(contacts) = self.suture.contacts_mut()
        {
            self.parts.renumber(&self.memory.met, contacts);
        }
        if tick.number.is_multiple_of(EDGES_EVERY) {
            self.adapt(&scene.world_pose(self.needle.entity))?;
        }
        self.cut(scene, tick, out)?;
        self.update(scene, period);
        let count = (period / STEP - 1e-9).ceil().max(1.0);
        self.forces.clear();
        self.reactions.clear();
        self.reactions.resize(self.parts.list.len(), Reaction::default());
        for step in 0..count as usize {
            let fractions = [step, step + 1].map(|step| step as f64 / count);
            self.grips.clear();
            for held in &self.memory.held {
                let now = scene.world_pose(held.instrument);
                let [from, to] = fractions
                    .map(|share| held.at.try_lerp_slerp(&now, share, 1e-12).unwrap_or(now))
                    .map(|at| at * held.instrument_from_needle);
                self.grips.push(Grip {
                    point: self.suture.solid().point(held.along),
                    from,
                    to,
                    stiffness: STIFFNESS,
                    turning_stiffness: TURNING_STIFFNESS,
                    force_max: self.kind.jaw_force,
                    torque_max: self.kind.jaw_torque,
                });
            }
            self.leading.holds.clear();
            self.leading.twist_holds.clear();
            self.leading.add(&self.memory.grips, &self.parts, scene, fractions[1]);
            let obstacles: Vec<Obstacle<'_>> =
                self.parts.list.iter().map(|part| part.obstacle(fractions, None, None)).collect();
            let around = StepInputs {
                gravity: self.gravity,
                grips: &self.grips,
                holds: &self.leading.holds,
                twist_holds: &self.leading.twist_holds,
                loads: &[],
                obstacles: &obstacles,
                led: self.led.solved(),
                spared: &self.leading.spared,
                needle_passes: &self.passes,
            };
            self.report = self.suture.step(period / count, &around).map_err(|error| error.to_string())?;
            self.led.end_step(self.suture.led(), &mut self.parts);
            for (sum, reaction) in self.reactions.iter_mut().zip(self.suture.reactions()) {
                sum.force += reaction.force / count;
                sum.torque += reaction.torque / count;
            }
            // A grasp that slipped continues from the new pose.
            for (held, gripped) in self.memory.held.iter_mut().zip(self.suture.gripped()) {
                if let Some(wanted) = gripped.slipped {
                    let now = scene.world_pose(held.instrument);
                    let at = held.at.try_lerp_slerp(&now, fractions[1], 1e-12).unwrap_or(now);
                    held.instrument_from_needle = at.inverse() * wanted;
                }
            }
        }
        self.led.end(&self.reactions, &world, period, tick.time);
        let pose = self.suture.state().needle.pose();
        for (held, gripped) in self.memory.held.iter_mut().zip(self.suture.gripped()) {
            let place = pose * self.suture.solid().point(held.along);
            self.forces.push((held.instrument, place, gripped.force));
            held.at = scene.world_pose(held.instrument);
        }
        if let Some(thread) = &self.suture.state().thread {
            let forces = self.suture.hold_forces();
            self.pulls = pulls(&mut self.memory.grips, &self.parts, scene, thread, forces);
            let looked = self.knot.look(thread, self.suture.thread_radius(), tick)?;
            self.has_knot &= !looked.changed;
            if looked.is_another {
                self.memory.loop_min = None;
            }
            if let Some(strands) = thread.strands() {
                let now = strands.loop_length();
                self.memory.loop_min = Some(self.memory.loop_min.map_or(now, |least| least.min(now)));
            }
        }
        self.memory.met.clear();
        self.memory.met.extend(self.parts.list.iter().map(|part| ObstaclePose { at: part.to, ..part.met }));
        if tick.number.is_multiple_of(DOUBT_EVERY) {
            let tissue = self.suture.tissue();
            let moved = tissue.positions().iter().zip(tissue.mesh().rest()).map(|(now, rest)| now - rest);
            self.deformation = Deformation::of(tissue.mesh(), &moved.collect::<Vec<_>>());
        }
        self.memory.penetration_max = self.memory.penetration_max.max(self.report.penetration_max);
        self.memory.state = Some(self.suture.state().clone());
        Ok(())
    }

    /// Reaction forces on instruments: the force on the held part, and its distance from the instrument.
    fn collision_list(&self, tick: &Tick<'_>) -> CollisionList {
        let mut collisions = Vec::new();
        let needle = self.needle.entity;
        for (instrument, place, force) in &self.forces {
            let depth = force.norm() / STIFFNESS;
            let jaw = Primitive::Jaw(0);
            collisions.push(collision(*instrument, jaw, needle, *place, *force, depth, tick.time));
        }
        let told = ContactReport {
            thread: needle,
            world_from_thread: Isometry3::identity(),
            parts: &self.parts,
            reactions: &self.reactions,
            pulls: &self.pulls,
            displacement_max: 0.0,
        };
        told.report(tick.time, &mut collisions);
        collisions.sort_by(|a, b| b.force_in_world.norm().total_cmp(&a.force_in_world.norm()));
        collisions.truncate(COLLISIONS_MAX);
        CollisionList { collisions, penetration_max: self.memory.penetration_max }
    }

    fn write(&mut self, scene: &Snapshot, tick: &Tick<'_>, out: &mut Commands) {
        let (line, body) = (self.needle.entity, self.tissue.entity);
        if !self.has_line {
            self.has_line = true;
            let segments = self.needle.segments.clone();
            out.put(line, LineMesh { segments, radius: self.needle.radius });
        }
        let mut nodes = Vec::new();
        line_of(&self.suture, &scene.world_pose(line), &mut nodes);
        let still = vec![Vector3::zeros(); nodes.len()];
        self.needle.write(&nodes, &still, out);
        let body_from_world = scene.world_pose(body).inverse();
        let positions: Vec<_> =
            self.suture.tissue().positions().iter().map(|point| body_from_world * point).collect();
        if !self.deformation.is_small() && scene.get::<OutOfValidity>(body).is_none() {
            out.put(body, OutOfValidity { reason: self.deformation.validity_warning(), since: tick.time });
        }
        // Quasi-static: zero velocities.
        let still = vec![Vector3::zeros(); positions.len()];
        self.tissue.write(&positions, &still, out);
        out.put(line, self.memory.clone());
        self.led.publish(line, out);
        if !self.has_knot {
            self.has_knot = true;
            out.put(line, self.knot.state().clone());
        }
    }

    /// Its measures.
    pub fn measure(&self, world_from_needle: &Isometry3<f64>, measured: &mut Measured) {
        let state = self.suture.state();
        let tissue = self.suture.tissue();
        let name = &self.needle.name;
        let mut put = |what: &str, value: f64| {
            // If the state is frozen and invalid, some measures are not finite.
            if value.is_finite() {
                measured.values.insert(format!("{name}.{what}"), value);
            }
        };
        let exits = state.bites.iter().filter(|bite| bite.exit.is_some());
        put("entries", f64::from(state.bites_so_far));
        put("exits", exits.clone().count() as f64);
        put("punctured_at_n", state.bites.iter().map(|bite| bite.entry_force).fold(0.0, f64::max));
        put("inside_m", self.report.length_inside);
        put("tip_force_n", self.report.tip_force);
        put("drag_n", self.report.drag);
        put("tissue_force_n", self.report.force_on_tissue.norm());
        put("tissue_energy_j", tissue.energy());
        put("needle_energy_j", state.needle.kinetic_energy(self.suture.solid()));
        let gripping = self.memory.grips.iter().filter(|grip| !grip.is_shut()).count();
        put("held_by", (self.memory.held.len() + gripping) as f64);
        let tensions = state.thread.iter().flat_map(|thread| thread.tensions.iter().copied());
        put("thread_tension_n", tensions.fold(0.0, f64::max));
        let loop_now =
            state.thread.as_ref().and_then(|thread| thread.strands()).map(|strands| strands.loop_length());
        put("loop_m", loop_now.unwrap_or(0.0));
        put("slip_m", loop_now.zip(self.memory.loop_min).map_or(0.0, |(now, least)| now - least));
        put("thread_held_nodes", held(&self.memory.grips).count() as f64);
        put("contacts", self.report.contacts as f64);
        put("contact_force_n", self.reactions.iter().map(|reaction| reaction.force.norm()).sum());
        put("surface_force_n", state.presses.iter().map(|press| press.force.norm()).sum());
        put("penetration_m", self.memory.penetration_max);
        put("iterations", self.report.iterations as f64);
        // Length of the thread beyond its first point of contact with the tissue.
        put("thread_through_m", state.thread_through());
        put("pieces", state.thread.as_ref().map_or(0.0, |thread| thread.threads().count() as f64));
        if let Some(plan) = self.kind.planned_exit {
            let plan = world_from_needle * Point3::from(plan);
            let off = exits.filter_map(|bite| Some((tissue.at_rest(&bite.exit?.0) - plan).norm()));
            put("exit_off_plan_m", off.fold(f64::INFINITY, f64::min).min(1.0));
        }
        put("tissue_rotation_max_rad", self.deformation.rotation);
        // Infinite for an inverted element.
        put("tissue_strain_max", self.deformation.strain.min(1e3));
        put("frozen", f64::from(u8::from(self.frozen)));
        self.knot.state().measure(name, &mut measured.values);
    }

    /// Advances by a tick, or freezes; returns the reaction forces on instruments.
    pub fn tick(&mut self, scene: &Snapshot, tick: &Tick<'_>, out: &mut Commands) -> CollisionList {
        if !self.frozen {
            match self.step(scene, tick, out) {
                Ok(()) => {
                    self.write(scene, tick, out);
                    return self.collision_list(tick);
                }
                Err(why) => {
                    self.frozen = true;
                    self.led.release(tick.time);
                    self.led.publish(self.needle.entity, out);
                    self.needle.freeze(&why, tick, out);
                    self.tissue.freeze(&why, tick, out);
                }
            }
        }
        CollisionList { collisions: Vec::new(), penetration_max: 0.0 }
    }
}

/// Initial needle and thread, in the world.
fn begin(kind: &SutureNeedle, world_from_entity: &Isometry3<f64>) -> Result<SutureState, String> {
    let solid = kind.shape().solid().map_err(|error| error.to_string())?;
    let pose = world_from_entity * kind.pose()?;
    let (tail, back) = (pose * solid.point(0.0), pose * -solid.tangent(0.0));
    let nodes = kind.thread_nodes(tail, back, world_from_entity)?;
    Ok(SutureState::new(NeedleState::at_rest(&pose), Some(ThreadState::at_rest(&nodes))))
}

/// Updates a line to the needle and thread; where the thread was cut, no segment joins the pieces.
fn update_line(suture: &Suture, world_from_entity: &Isometry3<f64>, line: &mut Deformable) {
    let mut nodes = Vec::new();
    line_of(suture, world_from_entity, &mut nodes);
    line.replace_line(nodes);
    if let Some(thread) = &suture.state().thread {
        let joins =
            |edge: &[u32; 2]| (edge[0] as usize).checked_sub(PIECES).is_none_or(|edge| thread.joins(edge));
        std::sync::Arc::make_mut(&mut line.segments).retain(joins);
    }
}

/// Needle and thread as one line from the tip to the thread's end, in the frame of the entity.
fn line_of(suture: &Suture, world_from_entity: &Isometry3<f64>, nodes: &mut Vec<Point3<f64>>) {
    let own = |point: &Point3<f64>| world_from_entity.inverse_transform_point(point);
    let (solid, pose) = (suture.solid(), suture.state().needle.pose());
    let length = solid.shape().length();
    nodes.clear();
    nodes.extend(
        (0..PIECES).map(|piece| own(&(pose * solid.point(length * (1.0 - piece as f64 / PIECES as f64))))),
    );
    match &suture.state().thread {
        Some(thread) => nodes.extend(thread.positions.iter().map(own)),
        None => nodes.push(own(&(pose * solid.point(0.0)))),
    }
}

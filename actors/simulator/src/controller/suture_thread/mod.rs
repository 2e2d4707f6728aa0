//! The controller of suture threads: reads the thread and its obstacles from the scene, steps their island, and writes
//! the state back.
//!
//! Each tick: grasps are updated; the tick is divided into steps of the thread's maximum length, and in each step the
//! obstacles move by their fraction of the way since the last tick; nodes, saved state, contacts and measures are
//! written. Instruments receive the reaction forces on their rods and the pull on their jaws. An elastic body that a
//! thread is tied around is stepped with it ([`ElasticSupport`]).

pub mod component;
pub mod contact_report;
pub mod cut;
pub mod elastic_body;
pub mod grasp;
pub(crate) mod group;
pub mod knot;
pub(crate) mod knot_job;
pub mod led_instruments;
pub mod obstacles;
pub mod remesh;
pub mod saved_state;
pub(crate) mod soft_support;
pub mod suture;

use std::collections::BTreeMap;
use std::path::PathBuf;

use nalgebra::{Isometry3, Vector3};
use trocar_dynamics::soft_body::Deformable;
use trocar_dynamics::soft_body::bearing::{self, Bearings, BorneBody};
use trocar_dynamics::soft_body::contact::SoftContacts;
use trocar_dynamics::soft_body::frozen::{FrozenPart, RejectedBody};
use trocar_dynamics::soft_body::method::finite_vertices;
use trocar_dynamics::soft_body::rod_contact::COLLISIONS_MAX;
use trocar_scene::components::LineMesh;
use trocar_scene::{
    Access, BuildContext, CollisionList, Commands, Controller, ControllerError, Entity, EntitySet, Frozen,
    Instrument, JawState, Measured, Pose, RigidBody, Shape, Snapshot, SurfaceMesh, Tick,
};

use super::coupling::fast_side::FastSide;
use crate::linear_fem::Cache;
use crate::suture_thread::{ElasticObstacle, Obstacle, Reaction, Surroundings, Thread, ThreadReport};
use component::ThreadBody;
use contact_report::ContactReport;
use cut::{follow, parted_at};
use elastic_body::{ElasticSupport, TiedBody};
use grasp::{GraspConstraints, GraspForce, pulls, update};
use group::ThreadGroup;
use knot::KnotState;
use knot_job::KnotWatch;
use led_instruments::LedInstruments;
use obstacles::{MovingObstacle, ObstacleParts, Part, PartShape};
use remesh::{EDGES_EVERY, adapt};
use saved_state::{ObstaclePose, ThreadMemory};
use soft_support::LyingOn;

struct Body {
    lines: ThreadGroup,
    kind: ThreadBody,
    thread: Thread,
    tied: Option<ElasticSupport>,
    lying: Option<LyingOn>,
    memory: ThreadMemory,
    knot: KnotWatch,
    /// Whether the scene already has this knot.
    has_knot: bool,
    parts: ObstacleParts,
    led: LedInstruments,
    leading: GraspConstraints,
    report: ThreadReport,
    /// Mean reaction on each part over the last tick.
    reactions: Vec<Reaction>,
    pulls: Vec<(Entity, GraspForce)>,
    frozen: bool,
    /// Impulses given to rigid bodies that move.
    borne: SoftContacts,
}

/// Steps every thread that carries [`ThreadBody`].
pub struct ThreadController {
    gravity_in_world: Vector3<f64>,
    cache: Option<Cache>,
    bodies: Vec<Body>,
    refused: Vec<RejectedBody>,
    bearings: Bearings,
}

impl ThreadController {
    /// Reads the threads, and resumes their state from the scene. `cache` is the folder of inverses of the elastic
    /// bodies that they are tied around.
    ///
    /// # Errors
    /// The name of the thread, and what is wrong with it.
    pub fn new(
        gravity_in_world: Vector3<f64>,
        cache: Option<PathBuf>,
        context: &BuildContext<'_>,
    ) -> Result<Self, ControllerError> {
        let (mut bodies, mut refused): (Vec<Body>, Vec<RejectedBody>) = (Vec::new(), Vec::new());
        let carriers = Deformable::carriers::<ThreadBody>(context.scene);
        let kinds = carriers.iter().filter_map(|entity| context.scene.get::<ThreadBody>(*entity));
        let named: BTreeMap<&String, usize> =
            kinds.flat_map(|kind| &kind.together_with).fold(BTreeMap::new(), |mut named, name| {
                *named.entry(name).or_default() += 1;
                named
            });
        for entity in carriers {
            let Some(kind) = context.scene.get::<ThreadBody>(entity) else { continue };
            let name = context.scene.name(entity);
            match named.get(&name) {
                // It is stepped with the thread that names it.
                Some(1) if kind.together_with.is_empty() => continue,
                Some(1) | None => {}
                Some(_) => {
                    let why = format!("together_with: '{name}' is named by several threads");
                    return Err(ControllerError::Scene(why));
                }
            }
            let wrong = |why| ControllerError::Scene(format!("'{name}': {why}"));
            let built = Deformable::read(context.scene, entity).and_then(|body| {
                Body::new(kind.clone(), body, context.scene, bodies.len() as u64).map_err(wrong)
            });
            let built = match built {
                Ok(built) => built,
                Err(error) => {
                    refused.push(RejectedBody::of(context, entity, FrozenPart::Body, error)?);
                    continue;
                }
            };
            let around = |body: &Body| body.tied.as_ref().map(ElasticSupport::entity);
            if around(&built).is_some() && bodies.iter().any(|other| around(other) == around(&built)) {
                return Err(wrong("tied_around: another thread is tied around the same body".into()));
            }
            bodies.push(built);
        }
        if bodies.is_empty() && refused.is_empty() {
            return Err(ControllerError::Scene("thread: no entity has a 'thread'".into()));
        }
        let (cache, bearings) = (cache.map(|folder| Cache::new(&folder)), Bearings::default());
        Ok(Self { gravity_in_world, cache, bodies, refused, bearings })
    }
}

impl Controller for ThreadController {
    fn access(&self) -> Access {
        let refused = self.refused.iter().map(|body| body.entity);
        let bodies: Vec<Entity> =
            self.bodies.iter().flat_map(|body| body.lines.entities()).chain(refused).collect();
        let around = self.bodies.iter().filter_map(|body| body.tied.as_ref()).map(ElasticSupport::entity);
        let moved: Vec<Entity> = bodies.iter().copied().chain(around).collect();
        let access = LedInstruments::access(Deformable::access(&moved), &bodies);
        FastSide::access(bearing::access(access, &bodies), &bodies)
            .reads::<ThreadBody>()
            .reads::<TiedBody>()
            .reads::<Pose>()
            .reads::<Instrument>()
            .reads::<JawState>()
            .reads::<RigidBody>()
            .reads::<Shape>()
            .reads::<SurfaceMesh>()
            .writes::<LineMesh>(EntitySet::Of(bodies.clone()))
            .writes::<ThreadMemory>(EntitySet::Of(bodies.clone()))
            .writes::<KnotState>(EntitySet::Of(bodies))
            .writes::<Measured>(EntitySet::Own)
            .contributes::<CollisionList>()
    }

    fn tick(&mut self, tick: &Tick<'_>, scene: &Snapshot, out: &mut Commands) -> Result<(), ControllerError> {
        let mut collisions = Vec::new();
        let mut measured = Measured::default();
        let mut depth_max = 0.0_f64;
        let when = (tick.time, tick.period.as_secs_f64());
        let given = self.bodies.iter().map(|of| (of.lines.first().entity, &of.borne.given_whole[..]));
        let borne = self.bearings.borne_bodies(scene, when, &self.gravity_in_world, given, true);
        for (index, body) in self.bodies.iter_mut().enumerate() {
            let world_from_thread = scene.world_pose(body.lines.first().entity);
            body.reactions.clear();
            body.pulls.clear();
            if !body.frozen {
                let gravity = Deformable::gravity(&self.gravity_in_world, &world_from_thread);
                let ready = body.wait(index as u64, self.cache.as_ref(), tick);
                let done = ready.and_then(|ready| {
                    let step = || body.step(scene, &world_from_thread, gravity, &borne, tick, out);
                    ready.then(step).transpose()
                });
                let done = done.and_then(|done| {
                    let state = body.thread.state();
                    finite_vertices(&state.positions, &state.velocities).map(|()| done)
                });
                match done {
                    Ok(Some(())) => {
                        body.write(out);
                        let told = ContactReport {
                            thread: body.lines.first().entity,
                            world_from_thread,
                            parts: &body.parts,
                            reactions: &body.reactions,
                            pulls: &body.pulls,
                            displacement_max: body
                                .tied
                                .as_ref()
                                .map_or(0.0, ElasticSupport::displacement_max),
                        };
                        told.report(tick.time, &mut collisions);
                    }
                    // It does not move until the elastic body's inverse is ready.
                    Ok(None) => {}
                    Err(why) => {
                        body.frozen = true;
                        body.lines.freeze(&why, tick, out);
                        body.led.release(tick.time);
                        body.led.publish(body.lines.first().entity, out);
                    }
                }
            }
            depth_max = depth_max.max(body.memory.penetration_max);
            body.measure(&mut measured);
        }
        self.refused.iter_mut().for_each(|body| body.report(tick, &mut measured, out));
        collisions.sort_by(|a, b| b.force_in_world.norm().total_cmp(&a.force_in_world.norm()));
        collisions.truncate(COLLISIONS_MAX);
        out.contribute(CollisionList { collisions, penetration_max: depth_max });
        out.put(tick.me, measured);
        Ok(())
    }
}

impl Body {
    fn new(kind: ThreadBody, body: Deformable, scene: &Snapshot, index: u64) -> Result<Self, String> {
        let entity = body.entity;
        let known = scene.get::<ThreadMemory>(entity);
        let lines = ThreadGroup::read(&kind, body, scene)?;
        let thread = lines.thread(&kind, known);
        let tied = kind.tied_around.as_ref().map(|name| ElasticSupport::new(name, scene)).transpose()?;
        let lying = match &kind.lies_on {
            Some(on) => Some(LyingOn::new(on, lines.first(), scene)?),
            None => None,
        };
        let parts = match &lying {
            Some(lying) => ObstacleParts::on(lying.entity(), lying.friction()),
            None => ObstacleParts::around(tied.as_ref().map(|tied| (tied.entity(), tied.kind.friction))),
        };
        Ok(Self {
            thread: thread.map_err(|error| error.to_string())?,
            tied,
            lying,
            memory: known
                .cloned()
                .unwrap_or_else(|| ThreadMemory { loop_min: -1.0, ..ThreadMemory::default() }),
            knot: KnotWatch::new(scene.get::<KnotState>(entity), index),
            has_knot: known.is_some(),
            frozen: scene.get::<Frozen>(entity).is_some(),
            borne: scene.get::<SoftContacts>(entity).cloned().unwrap_or_default(),
            parts,
            led: LedInstruments::resume(scene, entity),
            leading: GraspConstraints::default(),
            report: ThreadReport::default(),
            reactions: Vec::new(),
            pulls: Vec::new(),
            lines,
            kind,
        })
    }

    /// Whether everything that a step needs is ready.
    fn wait(&mut self, key: u64, cache: Option<&Cache>, tick: &Tick<'_>) -> Result<bool, String> {
        let presses = &self.memory.presses;
        self.tied.as_mut().map_or(Ok(true), |tied| tied.wait(key, cache, presses, tick))
    }

    /// One tick.
    fn step(
        &mut self,
        scene: &Snapshot,
        world_from_thread: &Isometry3<f64>,
        gravity: Vector3<f64>,
        borne: &[BorneBody],
        tick: &Tick<'_>,
        out: &mut Commands,
    ) -> Result<(), String> {
        let period = tick.period.as_secs_f64();
        let thread_from_world = world_from_thread.inverse();
        // Another thread on the same body sees what this one has given it in the next tick.
        let mut borne = borne.to_vec();
        let me = self.lines.first().entity;
        self.led.begin(scene, me, world_from_thread);
        let friction = self.kind.tool_friction;
        self.parts.read(scene, world_from_thread, friction, &self.memory.met, &self.led);
        self.led.find(&self.parts);
        self.follow()?;
        let is_moved = |part: &Part| matches!(part.form, PartShape::Elastic) && part.met.at != part.to;
        if self.parts.list.iter().any(is_moved) {
            return Err("what it is tied around has been moved: it has to stay in its place".into());
        }
        self.cut(scene, world_from_thread, tick, out)?;
        let (state, radius) = (self.thread.state(), self.thread.material().radius);
        if update(&mut self.memory.grips, &self.parts, scene, state, radius, period, &[]) {
            self.memory.loop_min = -1.0;
        }
        if self.kind.adaptive && tick.number.is_multiple_of(EDGES_EVERY) {
            adapt(&self.kind, &mut self.thread, &mut self.lines, &mut self.memory.grips)?;
        }
        self.leading.exempt_held(&self.memory.grips, &self.parts, self.thread.state());
        let count = (period / self.kind.step - 1e-9).ceil().max(1.0);
        let dt = period / count;
        self.reactions.resize(self.parts.list.len(), Reaction::default());
        if let Some(lying) = &mut self.lying {
            lying.begin_step(self.lines.first().entity, world_from_thread, scene, tick)?;
        }
        let mut report = ThreadReport::default();
        let moving: Vec<Option<usize>> = self.parts.list.iter().map(|part| part.borne(&borne)).collect();
        self.borne.course.clear();
        let parts = bearing::course_parts(period, count as usize);
        for step in 0..count as usize {
            if parts > 1 && step.is_multiple_of(count as usize / parts) {
                self.borne.course.push(self.borne.given_whole.clone());
            }
            let fractions = [step, step + 1].map(|step| step as f64 / count);
            let elastic = self.tied.as_ref().and_then(ElasticSupport::elastic);
            if let Some(lying) = &mut self.lying {
                lying.begin(dt, 1.0 / (count - step as f64));
            }
            let of_elastic = elastic.map(|body| (body.positions(), body.triangles()));
            let (of_soft, soft) = self.lying.as_mut().map(LyingOn::parts).unzip();
            let yielding = of_elastic.or(of_soft);
            let ahead: Vec<Option<MovingObstacle>> = moving
                .iter()
                .map(|at| Some(MovingObstacle::of(&borne[(*at)?], &thread_from_world, dt)))
                .collect();
            let parts = self.parts.list.iter().zip(ahead);
            let obstacles: Vec<Obstacle<'_>> =
                parts.map(|(part, moving)| part.obstacle(fractions, yielding, moving)).collect();
            self.leading.holds.clear();
            self.leading.twist_holds.clear();
            self.leading.add(&self.memory.grips, &self.parts, scene, fractions[1]);
            self.lines.hold(self.thread.state(), &mut self.leading);
            let around = Surroundings {
                gravity,
                holds: &self.leading.holds,
                twist_holds: &self.leading.twist_holds,
                loads: &[],
                obstacles: &obstacles,
                led: self.led.solved(),
                spared: &self.leading.spared,
                elastic: elastic.map(|body| ElasticObstacle { obstacle: 0, body }),
            };
            let done = match soft {
                Some(surface) => self.thread.step_on(dt, &around, 0, surface),
                None => self.thread.step(dt, &around),
            };
            let done = done.map_err(|error| error.to_string())?;
            self.led.end_step(self.thread.led(), &mut self.parts);
            if let Some(lying) = &mut self.lying {
                lying.end_step(dt, self.thread.state());
            }
            if let Some(tied) = &mut self.tied {
                tied.deform(self.thread.presses());
            }
            let yielded = moving.iter().zip(self.thread.yielded());
            for (at, yielded) in yielded.filter_map(|(at, yielded)| Some(((*at)?, yielded))) {
                let given = yielded.impulse.map(|of| world_from_thread.rotation * of);
                borne[at].end_step(dt, given, &mut self.borne.given_whole);
            }
            report.parts += done.parts;
            report.iterations += done.iterations;
            report.sweeps += done.sweeps;
            report.contacts = done.contacts;
            report.strain_max = report.strain_max.max(done.strain_max);
            report.penetration_max = report.penetration_max.max(done.penetration_max);
            for (sum, reaction) in self.reactions.iter_mut().zip(self.thread.reactions()) {
                sum.force += reaction.force / count;
                sum.torque += reaction.torque / count;
            }
        }
        self.report = report;
        self.led.end(&self.reactions, world_from_thread, period, tick.time);
        self.pulls =
            pulls(&mut self.memory.grips, &self.parts, scene, self.thread.state(), self.thread.hold_forces());
        self.memory.met.clear();
        self.memory.met.extend(self.parts.list.iter().map(|part| ObstaclePose { at: part.to, ..part.met }));
        self.memory.penetration_max = self.memory.penetration_max.max(report.penetration_max);
        self.look(tick)?;
        if let Some(tied) = &mut self.tied
            && tied.settle(tick.number)?
        {
            out.event("beyond_linear", tied.entity(), None, tick.time.as_secs_f64());
        }
        self.memory.take(&self.thread);
        self.lines.save_anchors(&mut self.memory);
        if !self.borne.given_whole.is_empty() {
            self.borne.step = period;
            out.put(self.lines.first().entity, self.borne.clone());
        }
        Ok(())
    }

    /// Cuts it where blades have closed on it, or where it breaks.
    fn cut(
        &mut self,
        scene: &Snapshot,
        world_from_thread: &Isometry3<f64>,
        tick: &Tick<'_>,
        out: &mut Commands,
    ) -> Result<(), String> {
        let breaks_at = self.kind.breaks_at.as_ref().map(|known| known.value);
        let state = (self.thread.state(), self.thread.material().radius);
        let found = parted_at(&mut self.memory.blades, scene, world_from_thread, state, breaks_at);
        let name = found.event();
        let mut cuts = found.cuts;
        while !cuts.is_empty() {
            let at = cuts.remove(0);
            let was_closed = self.thread.state().is_closed();
            let Some(parted) = self.thread.cut(at).map_err(|error| error.to_string())? else { continue };
            follow(&mut self.memory.grips, &parted);
            self.lines.part(&parted, self.thread.state());
            if was_closed {
                // It is numbered from the cut now.
                cuts.retain_mut(|cut| {
                    let now = parted.edges[cut.edge].map(|edge| edge as usize);
                    cut.edge = now.unwrap_or(cut.edge);
                    now.is_some()
                });
                cuts.sort_by_key(|cut| std::cmp::Reverse(cut.edge));
            }
            self.memory.loop_min = -1.0;
            out.event(name, self.lines.first().entity, None, tick.time.as_secs_f64());
        }
        Ok(())
    }

    /// If the scene's obstacles have changed since the last tick, contacts with the remaining ones keep their state.
    fn follow(&mut self) -> Result<(), String> {
        if self.parts.are(&self.memory.met) {
            return Ok(());
        }
        let mut state = self.thread.state().clone();
        self.parts.renumber(&self.memory.met, &mut state.contacts);
        self.thread = Thread::restore(*self.thread.material(), state).map_err(|error| error.to_string())?;
        Ok(())
    }

    /// Updates the knot, and the shortest length of its loop since.
    fn look(&mut self, tick: &Tick<'_>) -> Result<(), String> {
        let looked = self.knot.look(self.thread.state(), self.thread.material().radius, tick)?;
        self.has_knot &= !looked.changed;
        if looked.is_another {
            self.memory.loop_min = -1.0;
        }
        if let Some(strands) = self.thread.state().strands() {
            let (now, least) = (strands.loop_length(), self.memory.loop_min);
            self.memory.loop_min = if least < 0.0 { now } else { least.min(now) };
        }
        Ok(())
    }

    fn write(&mut self, out: &mut Commands) {
        let entity = self.lines.first().entity;
        if !self.has_knot {
            self.has_knot = true;
            out.put(entity, self.knot.state().clone());
        }
        self.lines.write(self.thread.state(), out);
        out.put(entity, self.memory.clone());
        self.led.publish(entity, out);
        if let Some(tied) = &mut self.tied {
            tied.write(out);
        }
        if let Some(lying) = &self.lying {
            lying.publish(entity, out);
        }
    }

    fn measure(&self, measured: &mut Measured) {
        let (name, state) = (&self.lines.first().name, self.thread.state());
        for (name, tension) in self.lines.tensions(state) {
            measured.values.insert(format!("{name}.tension_n"), tension);
        }
        let mut put = |what: &str, value: f64| {
            measured.values.insert(format!("{name}.{what}"), value);
        };
        put("held_nodes", self.memory.grips.iter().map(|grip| grip.nodes.len()).sum::<usize>() as f64);
        put("held_force_n", self.pulls.iter().map(|(_, pull)| pull.force.norm()).sum());
        put("contact_force_n", self.reactions.iter().map(|reaction| reaction.force.norm()).sum());
        let now = state.strands().map_or(0.0, |strands| strands.loop_length());
        put("pieces", state.threads().count() as f64);
        put("loop_m", now);
        put("slip_m", if self.memory.loop_min < 0.0 { 0.0 } else { now - self.memory.loop_min });
        put("penetration_m", self.memory.penetration_max);
        put("strain", self.report.strain_max);
        put("contacts", self.report.contacts as f64);
        put("iterations", self.report.iterations as f64);
        put("frozen", f64::from(u8::from(self.frozen)));
        if let Some(lying) = &self.lying {
            put("lying_force_n", self.reactions.first().map_or(0.0, |reaction| reaction.force.norm()));
            put("coupling_behind_m", lying.behind());
        }
        self.knot.state().measure(name, &mut measured.values);
        if let Some(tied) = &self.tied {
            let pressing = state.contacts.iter().filter(|contact| contact.key.with == 1);
            let tension = |edge: u32| state.tensions.get(edge as usize).copied().unwrap_or(0.0);
            let tensions = pressing.map(|contact| (tension(contact.key.edge), contact.force.norm()));
            tied.measure(tensions, self.frozen, &mut measured.values);
        }
    }
}

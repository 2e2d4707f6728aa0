//! The frame of every controller of soft bodies: whichever method moves a body, instruments touch, hold and cut it in the
//! same way, what it exerts on them is told in the same list, and what its solver refuses stops that body alone.
//!
//! A method is a [`SoftMethod`]: how it is built from the scene, how it steps, what it measures. [`SoftController`] is the
//! rest. In each tick and for each body: blades cut it, rods touch it, jaws take and let go, it steps, the scene is told.

use std::collections::BTreeMap;

use nalgebra::{Isometry3, Point3, Vector3};
use trocar_scene::{
    Access, BuildContext, Collision, CollisionList, Commands, Component, Controller, ControllerError,
    Detection, Entity, EntitySet, Frozen, Instrument, InstrumentKind, JawState, Measured, Pose, Primitive,
    Snapshot, Tick, Velocity,
};

use super::answering::Answering;
pub use super::answering::Outlook;
use super::deformable::Deformable;
use super::grips::{Grips, Holder};
use super::tools::{Rod, rods_of_all};
use super::touch::{COLLISIONS_MAX, Skin, Touch, collision, touches};
use crate::picking::{Jaws, Led, Pick};

/// What meets a body in one tick; everything in the frame of the body.
#[derive(Clone, Copy)]
pub struct Site<'a> {
    /// The scene that the tick reads.
    pub scene: &'a Snapshot,
    /// The tick.
    pub tick: &'a Tick<'a>,
    /// Where the body is.
    pub world_from_body: &'a Isometry3<f64>,
    /// Gravity \[m/s²\].
    pub gravity: Vector3<f64>,
    /// The rods of all instruments.
    pub rods: &'a [Rod],
    /// Where rods touch the body and push it.
    pub touches: &'a [Touch],
    /// Forces on vertices that others have given the body \[N\].
    pub forces: &'a [(u32, Vector3<f64>)],
    /// Vertices that jaws hold, and where they have them at the end of the tick; ascending, none that is anchored.
    pub led: &'a [Led],
}

impl Site<'_> {
    /// How long the step is \[s\].
    #[must_use]
    pub fn period_secs(&self) -> f64 {
        self.tick.period.as_secs_f64()
    }
}

/// What a change of shape did to the triangles of a body. Those that are new have the highest numbers.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Reshaped {
    /// The new number of each old triangle, where it is still there; `None` when all have the numbers they had.
    pub kept: Option<Vec<Option<u32>>>,
    /// For each new triangle the one that it is a part of.
    pub parents: Vec<u32>,
}

impl Reshaped {
    /// What jaws hold of the body follows.
    pub(super) fn followed_by(
        &self,
        grips: &mut Grips,
        site: &Site<'_>,
        triangles: &[[u32; 3]],
        positions: &[Point3<f64>],
    ) {
        if let Some(kept) = &self.kept {
            grips.picks.renumber(kept);
        }
        let holders = Holder::all(site, &[], triangles);
        let jaws: Vec<Jaws<'_>> = holders.iter().map(Holder::jaws).collect();
        grips.picks.follow(&self.parents, triangles, positions, &jaws);
    }
}

/// A method that moves the vertices of bodies.
pub trait SoftMethod: Send + Sized + 'static {
    /// The component by which a scene says that a body is moved by it.
    type Kind: Component + Clone;
    /// The kind of its controller, for messages.
    const CONTROLLER: &'static str;

    /// The solver of one body, where the scene says that the body is.
    ///
    /// # Errors
    /// What is wrong with the body.
    fn build(kind: &Self::Kind, body: &mut Deformable, scene: &Snapshot) -> Result<Self, String>;

    /// What it reads and writes besides what every soft body does.
    fn access(access: Access, _bodies: &[Entity]) -> Access {
        access
    }

    /// Vertices now \[m\].
    fn positions(&self) -> &[Point3<f64>];
    /// And how they move \[m/s\].
    fn velocities(&self) -> &[Vector3<f64>];
    /// What of it may be touched.
    fn skin<'a>(&'a self, body: &'a Deformable) -> Skin<'a>;

    /// Whether blades cut it; then they do not push it.
    fn is_cut_by_blades(&self) -> bool {
        false
    }

    /// Changes of its shape before anything touches it: cuts, elements that others have removed. `touches` and `led` of the
    /// site are empty. Brings `body` up to date and tells the scene of its new meshes.
    ///
    /// # Errors
    /// Why it cannot go on.
    fn reshape(
        &mut self,
        _body: &mut Deformable,
        _site: &Site<'_>,
        _out: &mut Commands,
    ) -> Result<Option<Reshaped>, String> {
        Ok(None)
    }

    /// One step. Fills `forces` with what each touch exerts on the body \[N\].
    ///
    /// # Errors
    /// Why it cannot go on; the body is where it was.
    fn step(
        &mut self,
        body: &Deformable,
        site: &Site<'_>,
        forces: &mut Vec<Vector3<f64>>,
    ) -> Result<(), String>;

    /// What is to be expected of the next step, after one; `active` are the vertices that others gave something in it.
    fn look_ahead(&mut self, _body: &Deformable, _site: &Site<'_>, _active: &[u32], _outlook: &mut Outlook) {}

    /// What the body exerts now on whoever holds these vertices \[N\]; ascending.
    fn pull_by(&mut self, held: &[u32]) -> Vector3<f64>;

    /// What a later life needs besides positions and velocities.
    fn publish(&mut self, _body: &Deformable, _out: &mut Commands) {}

    /// What is worth knowing of it.
    fn measure(&self, body: &Deformable, measures: &mut Measures<'_>);
}

/// Where a method puts its measures: `NAME.what`.
pub struct Measures<'a> {
    name: &'a str,
    values: &'a mut BTreeMap<String, f64>,
}

impl<'a> Measures<'a> {
    pub(super) fn new(name: &'a str, values: &'a mut BTreeMap<String, f64>) -> Self {
        Self { name, values }
    }

    /// Tells one; the unit is the end of its name.
    pub fn put(&mut self, what: &str, value: f64) {
        self.values.insert(format!("{}.{what}", self.name), value);
    }
}

struct Body<M> {
    body: Deformable,
    method: M,
    is_pinned: Vec<bool>,
    grips: Grips,
    /// If others are coupled with it.
    answering: Option<Answering>,
    frozen: bool,
}

/// Lists that are filled anew for each body.
#[derive(Default)]
struct Scratch {
    rods: Vec<Rod>,
    touches: Vec<Touch>,
    forces: Vec<Vector3<f64>>,
    given: Vec<(u32, Vector3<f64>)>,
}

/// Steps every body that carries the component of a method.
pub struct SoftController<M> {
    gravity_in_world: Vector3<f64>,
    bodies: Vec<Body<M>>,
    scratch: Scratch,
}

impl<M: SoftMethod> SoftController<M> {
    /// Reads the bodies, and goes on from where an earlier life left them.
    ///
    /// # Errors
    /// Names the body, and what is wrong with it.
    pub fn new(gravity_in_world: Vector3<f64>, context: &BuildContext<'_>) -> Result<Self, ControllerError> {
        let mut bodies = Vec::new();
        for entity in Deformable::carriers::<M::Kind>(context.scene) {
            let Some(kind) = context.scene.get::<M::Kind>(entity) else { continue };
            let mut body = Deformable::read(context.scene, entity)?;
            let method = M::build(kind, &mut body, context.scene)
                .map_err(|why| ControllerError::Scene(format!("'{}': {why}", body.name)))?;
            let is_pinned = body.stays();
            let grips = context.scene.get::<Grips>(entity).cloned().unwrap_or_default();
            let frozen = context.scene.get::<Frozen>(entity).is_some();
            let answering = Answering::new(&body, context.scene);
            bodies.push(Body { body, method, is_pinned, grips, answering, frozen });
        }
        if bodies.is_empty() {
            let (controller, kind) = (M::CONTROLLER, M::Kind::NAME);
            return Err(ControllerError::Scene(format!("{controller}: no entity has a '{kind}'")));
        }
        Ok(Self { gravity_in_world, bodies, scratch: Scratch::default() })
    }
}

impl<M: SoftMethod> Controller for SoftController<M> {
    fn access(&self) -> Access {
        let bodies: Vec<Entity> = self.bodies.iter().map(|body| body.body.entity).collect();
        let access = Deformable::access(&bodies)
            .reads::<M::Kind>()
            .reads::<Pose>()
            .reads::<Velocity>()
            .reads::<Instrument>()
            .reads::<JawState>()
            .writes::<Grips>(EntitySet::Of(bodies.clone()))
            .writes::<Measured>(EntitySet::Own)
            .contributes::<CollisionList>();
        M::access(Answering::access(access, &bodies), &bodies)
    }

    fn tick(&mut self, tick: &Tick<'_>, scene: &Snapshot, out: &mut Commands) -> Result<(), ControllerError> {
        let mut found = Found::default();
        let mut measured = Measured::default();
        for body in &mut self.bodies {
            let world_from_body = scene.world_pose(body.body.entity);
            let gravity = Deformable::gravity(&self.gravity_in_world, &world_from_body);
            found.pushed = 0.0;
            found.pulled = 0.0;
            if !body.frozen {
                let nothing = Site {
                    scene,
                    tick,
                    world_from_body: &world_from_body,
                    gravity,
                    rods: &[],
                    touches: &[],
                    forces: &[],
                    led: &[],
                };
                if let Err(reason) = body.step(&nothing, &mut self.scratch, &mut found, out) {
                    body.frozen = true;
                    body.body.freeze(&reason, tick, out);
                }
            }
            let mut measures = Measures::new(&body.body.name, &mut measured.values);
            measures.put("contact_force_n", found.pushed);
            measures.put("held_force_n", found.pulled);
            measures.put("held_vertices", body.grips.vertices() as f64);
            measures.put("frozen", f64::from(u8::from(body.frozen)));
            body.method.measure(&body.body, &mut measures);
        }
        found.collisions.sort_by(|a, b| b.depth.total_cmp(&a.depth));
        found.collisions.truncate(COLLISIONS_MAX);
        out.contribute(CollisionList { collisions: found.collisions, penetration_max: found.depth_max });
        out.put(tick.me, measured);
        Ok(())
    }
}

/// What a tick found out about contacts.
#[derive(Default)]
struct Found {
    collisions: Vec<Collision>,
    /// Deepest touch \[m\].
    depth_max: f64,
    /// Sums of the sizes of forces on the present body, of touches and of grips \[N\].
    pushed: f64,
    pulled: f64,
}

impl<M: SoftMethod> Body<M> {
    fn step(
        &mut self,
        nothing: &Site<'_>,
        scratch: &mut Scratch,
        found: &mut Found,
        out: &mut Commands,
    ) -> Result<(), String> {
        let Scratch { rods, touches: touched, forces, given } = scratch;
        rods_of_all(nothing.scene, nothing.world_from_body, rods);
        let site = Site { rods, ..*nothing };
        let entity = self.body.entity;
        if let Some(reshaped) = self.method.reshape(&mut self.body, &site, out)? {
            self.is_pinned = self.body.stays();
            reshaped.followed_by(&mut self.grips, &site, &self.body.triangles, self.method.positions());
            out.put(entity, self.grips.clone());
        }

        touches(rods, &self.method.skin(&self.body), touched);
        let led = self.hold(&site, touched, out)?;
        // What is held goes where it is led, and what is anchored stays, whatever touches it.
        let (is_pinned, cut) = (&self.is_pinned, self.method.is_cut_by_blades());
        touched.retain(|touch| {
            let is_led = |node: &u32| led.binary_search_by_key(node, |led| led.vertex).is_ok();
            let stays = touch.nodes.iter().all(|&node| is_pinned[node as usize]);
            let is_cut = cut && is_blade(site.scene, rods[touch.rod].instrument);
            !(stays || is_cut || touch.nodes.iter().any(is_led))
        });

        given.clear();
        if let Some(answering) = &mut self.answering {
            answering.take(&site, self.method.velocities(), given);
        }
        let site = Site { touches: touched, led: &led, forces: given, ..site };
        self.method.step(&self.body, &site, forces)?;
        self.body.write(self.method.positions(), self.method.velocities(), out);
        self.method.publish(&self.body, out);
        let world_from_body = site.world_from_body;
        for (touch, force) in touched.iter().zip(forces.iter()) {
            found.depth_max = found.depth_max.max(touch.depth);
            found.pushed += force.norm();
            let rod = &rods[touch.rod];
            found.collisions.push(collision(touch, rod, entity, force, world_from_body, site.tick.time));
        }
        for pick in &self.grips.picks.picks {
            let held: Vec<u32> = pick.vertices.iter().map(|held| held.vertex).collect();
            let pull = self.method.pull_by(&held);
            found.pulled += pull.norm();
            found.collisions.extend(self.grip(pick, &pull, &site));
        }
        if let Some(answering) = &mut self.answering {
            let (body, method) = (&self.body, &mut self.method);
            answering.look(|active, outlook| method.look_ahead(body, &site, active, outlook));
            answering.tell(&site, &self.is_pinned, method.velocities(), out);
        }
        Ok(())
    }

    /// Lets jaws take and let go, and says where they have what they hold.
    fn hold(&mut self, site: &Site<'_>, touched: &[Touch], out: &mut Commands) -> Result<Vec<Led>, String> {
        if self.body.triangles.is_empty() {
            return Ok(Vec::new());
        }
        let holders = Holder::all(site, touched, &self.body.triangles);
        let jaws: Vec<Jaws<'_>> = holders.iter().map(Holder::jaws).collect();
        let before = self.grips.picks.picks.len();
        let held_by =
            |grips: &Grips| -> Vec<u64> { grips.picks.picks.iter().map(|p| p.instrument).collect() };
        let before_by = held_by(&self.grips);
        self.grips
            .picks
            .update(&self.body.triangles, self.method.positions(), &jaws)
            .map_err(|error| error.to_string())?;
        if before != self.grips.picks.picks.len() || before_by != held_by(&self.grips) {
            out.put(self.body.entity, self.grips.clone());
        }
        let mut led = self.grips.picks.led(&jaws);
        led.retain(|led| !self.is_pinned[led.vertex as usize]);
        Ok(led)
    }

    /// A grip as everybody sees it. Its depth is how far the jaws have drawn what they hold from where it is at rest, so that
    /// force over depth is how stiff it feels.
    fn grip(&self, pick: &Pick, pull_in_body: &Vector3<f64>, site: &Site<'_>) -> Option<Collision> {
        let instrument = Entity::from_bits(pick.instrument);
        let count = pick.vertices.len();
        let triangle = *pick.triangles.first()?;
        if count == 0 {
            return None;
        }
        let mean = |points: &[Point3<f64>]| {
            let sum: Vector3<f64> =
                pick.vertices.iter().map(|held| points[held.vertex as usize].coords).sum();
            sum / count as f64
        };
        let (now, rest) = (mean(self.method.positions()), mean(&self.body.rest));
        let place = site.world_from_body * Point3::from(now);
        let force_on_body = site.world_from_body.rotation * -pull_in_body;
        Some(Collision {
            a: instrument,
            primitive_a: Primitive::Shaft,
            b: self.body.entity,
            primitive_b: Primitive::Triangle(triangle),
            points_in_world: [place; 2],
            normal_in_world: force_on_body.try_normalize(1e-12).unwrap_or_else(Vector3::z),
            depth: (now - rest).norm(),
            force_in_world: force_on_body,
            velocity_constraint: 0.0,
            method: Detection::Simulator,
            detected_at: site.tick.time,
        })
    }
}

/// Whether an instrument has blades.
fn is_blade(scene: &Snapshot, instrument: Entity) -> bool {
    scene.get::<Instrument>(instrument).is_some_and(|instrument| instrument.kind == InstrumentKind::Scissors)
}

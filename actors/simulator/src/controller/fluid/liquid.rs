//! The controller of a liquid: emitted by vessels and irrigators, bounded by walls, removed by suckers.

use std::collections::BTreeMap;
use std::sync::Arc;

use nalgebra::{Isometry3, Point3, Vector3};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use trocar_dynamics::soft_body::frozen::{FrozenPart, freeze};
use trocar_scene::{
    Access, Activation, BuildContext, Commands, Component, ComponentError, Controller, ControllerError,
    Entity, EntitySet, Frozen, Measured, OutOfValidity, Particles, Pose, RecordPolicy, RestPositions,
    Snapshot, SurfaceMesh, Tick, VertexPositions,
};

use super::bleeding::{VesselState, rest_of};
use super::irrigation::{self, Irrigator, Sucker, Suction};
use crate::fluid::boundary_samples::{WallSample, sample};
use crate::fluid::{Emitter, Fluid, FluidConfig, FluidState};

/// Maximum number of samples per wall.
const SAMPLES_MAX: usize = 200_000;

/// A wall farther away is invalid \[m\].
const FAR: f64 = 1e3;

/// A liquid; its particles are the entity's particles, which define its appearance. Particles exist within the entity's
/// box.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Component)]
#[component(name = "liquid", check = Self::ranges, schema)]
#[serde(default, deny_unknown_fields)]
pub struct Liquid {
    /// Particle spacing at rest \[m\].
    pub spacing: f64,
    /// Rest density \[kg/m³\].
    pub density: f64,
    /// Kinematic viscosity \[m²/s\]. Particles carry no less than about their spacing times the speed of the flow: the
    /// liquid then flows as one of that viscosity, which the event `viscosity_not_carried` says at the start, for the speed
    /// at which a particle falls its own size, and the measured `viscosity_min_m2_per_s` all the time.
    pub viscosity: f64,
    /// Lower corner of the box, in the entity's frame \[m\]; particles that leave it are absorbed.
    #[schemars(with = "[f64; 3]")]
    pub min: Point3<f64>,
    /// Upper corner of the box \[m\].
    #[schemars(with = "[f64; 3]")]
    pub max: Point3<f64>,
    /// Maximum number of particles; beyond it the oldest are absorbed.
    pub particles_max: u32,
}

impl Default for Liquid {
    /// Blood.
    fn default() -> Self {
        let blood = FluidConfig::default();
        Self {
            spacing: blood.spacing,
            density: blood.density,
            viscosity: blood.viscosity,
            min: blood.min,
            max: blood.max,
            particles_max: 4_000,
        }
    }
}

impl Liquid {
    fn ranges(&self) -> Result<(), ComponentError> {
        ComponentError::range("spacing", self.spacing, 1e-4..=0.1, "1e-4 to 0.1 m")?;
        ComponentError::range("density", self.density, 1.0..=1e5, "1 to 1e5 kg/m³")?;
        ComponentError::range("viscosity", self.viscosity, 0.0..=1.0, "0 to 1 m²/s")?;
        for axis in 0..3 {
            let size = self.max[axis] - self.min[axis];
            ComponentError::range("max", size, self.spacing..=1e3, "beyond min, within 1000 m")?;
        }
        let room = trocar_scene::PARTICLES_MAX as f64 / 2.0;
        ComponentError::range("particles_max", f64::from(self.particles_max), 1.0..=room, "1 to 32768")
    }
}

/// A wall: a surface that liquids do not cross.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema, Component)]
#[component(name = "liquid_wall", schema)]
#[serde(default, deny_unknown_fields)]
pub struct LiquidWall {
    /// Free slip. Otherwise the wall drags the liquid, which has the wall's velocity half a spacing before it.
    pub smooth: bool,
}

/// State for a restart.
#[derive(Clone, Debug, Serialize, Deserialize, Component)]
// Too large to be recorded; it is derived from recorded data.
#[component(name = "liquid_state", record = RecordPolicy::Derived)]
pub struct LiquidState {
    /// The particles.
    pub fluid: Arc<FluidState>,
    /// Emission of each vessel and irrigator so far.
    pub spouts: Vec<(Entity, Emitter)>,
    /// Suction of each sucker so far.
    #[serde(default)]
    pub suctions: Vec<(Entity, Suction)>,
}

/// A wall at its last sampling, with its samples.
struct Wall {
    entity: Entity,
    triangles: Arc<Vec<[u32; 3]>>,
    samples: Vec<WallSample>,
    positions: Arc<Vec<Point3<f64>>>,
    liquid_from_wall: Isometry3<f64>,
}

/// Simulates the liquid of the scene.
pub struct FluidController {
    liquid: Entity,
    name: String,
    look: Particles,
    fluid: Fluid,
    gravity_in_world: Vector3<f64>,
    spouts: BTreeMap<Entity, Emitter>,
    suctions: BTreeMap<Entity, Suction>,
    walls: Vec<Wall>,
    places: Vec<Point3<f64>>,
    speeds: Vec<Vector3<f64>>,
    normals: Vec<Vector3<f64>>,
    order: Vec<(u64, u32)>,
    walls_move: bool,
    /// Walls kept at their last valid position, because their current one in the scene is invalid.
    held: Vec<Entity>,
    frozen: bool,
}

impl FluidController {
    /// Reads the liquid, and resumes its state from the scene.
    ///
    /// # Errors
    /// There is none, or more than one; a parameter is invalid, or the state does not match.
    pub fn new(gravity_in_world: Vector3<f64>, context: &BuildContext<'_>) -> Result<Self, ControllerError> {
        let scene = context.scene;
        let mut liquids = scene.iter::<Liquid>();
        let (Some((liquid, kind)), None) = (liquids.next(), liquids.next()) else {
            return Err(ControllerError::Scene("fluid: one entity has to be a 'liquid'".into()));
        };
        let name = scene.name(liquid);
        let wrong = |what: String| ControllerError::Scene(format!("'{name}': {what}"));
        let config = FluidConfig {
            spacing: kind.spacing,
            density: kind.density,
            viscosity: kind.viscosity,
            gravity: scene.world_pose(liquid).rotation.inverse() * gravity_in_world,
            min: kind.min,
            max: kind.max,
            particles_max: kind.particles_max as usize,
            ..FluidConfig::default()
        };
        let mut fluid = Fluid::new(config).map_err(|error| wrong(error.to_string()))?;
        irrigation::check(scene)?;
        let (mut spouts, mut suctions) = (BTreeMap::new(), BTreeMap::new());
        if let Some(known) = scene.get::<LiquidState>(liquid) {
            fluid.restore(&known.fluid).map_err(|error| wrong(error.to_string()))?;
            for (entity, emitter) in &known.spouts {
                emitter.check().map_err(|error| wrong(error.to_string()))?;
                spouts.insert(*entity, *emitter);
            }
            suctions.extend(known.suctions.iter().copied());
        }
        let look = scene.get::<Particles>(liquid).cloned().unwrap_or_default();
        Ok(Self {
            liquid,
            look,
            fluid,
            gravity_in_world,
            spouts,
            suctions,
            walls: Vec::new(),
            places: Vec::new(),
            speeds: Vec::new(),
            normals: Vec::new(),
            order: Vec::new(),
            walls_move: false,
            held: Vec::new(),
            frozen: scene.get::<Frozen>(liquid).is_some(),
            name: name.clone(),
        })
    }

    /// Updates the walls; the solver is informed only when one has moved.
    fn follow_walls(&mut self, dt: f64, scene: &Snapshot) -> Result<(), String> {
        let liquid_from_world = scene.world_pose(self.liquid).inverse();
        let mut walls = std::mem::take(&mut self.walls);
        let mut known = walls.drain(..).peekable();
        let (mut moved, mut now) = (false, Vec::new());
        let mut carriers: Vec<Entity> = scene.iter::<LiquidWall>().map(|(entity, _)| entity).collect();
        carriers.sort_unstable();
        self.places.clear();
        self.speeds.clear();
        self.held.clear();
        for entity in carriers {
            let (Some(surface), Some(vertices)) =
                (scene.get::<SurfaceMesh>(entity), scene.get::<VertexPositions>(entity))
            else {
                continue;
            };
            let liquid_from_wall = liquid_from_world * scene.world_pose(entity);
            let before = known.next_if(|wall| wall.entity == entity);
            let (triangles, positions) = (surface.triangles.clone(), vertices.positions.clone());
            let same = |wall: &Wall| {
                Arc::ptr_eq(&wall.triangles, &triangles) && wall.positions.len() == positions.len()
            };
            if !is_somewhere(&liquid_from_wall, &positions, &triangles) {
                self.held.push(entity);
                if let Some(wall) = before {
                    let places = wall.samples.iter();
                    let places = places.map(|of| wall.liquid_from_wall * of.place(&wall.positions));
                    self.places.extend(places);
                    self.speeds.resize(self.places.len(), Vector3::zeros());
                    now.push(wall);
                }
                continue;
            }
            let wall = match before.filter(same) {
                Some(mut wall) => {
                    let still =
                        Arc::ptr_eq(&wall.positions, &positions) && wall.liquid_from_wall == liquid_from_wall;
                    moved |= !still;
                    for sample in &wall.samples {
                        let place = liquid_from_wall * sample.place(&positions);
                        let before = wall.liquid_from_wall * sample.place(&wall.positions);
                        self.places.push(place);
                        self.speeds.push(if still { Vector3::zeros() } else { (place - before) / dt });
                    }
                    (wall.positions, wall.liquid_from_wall) = (positions, liquid_from_wall);
                    wall
                }
                None => {
                    moved = true;
                    // Sampled at rest, so that a restart finds the same samples.
                    let rest = rest_of(scene, entity).filter(|rest| rest.len() == positions.len());
                    let samples = sample(
                        rest.unwrap_or(&positions),
                        &triangles,
                        self.fluid.config().spacing,
                        SAMPLES_MAX,
                    );
                    let places = samples.iter().map(|sample| liquid_from_wall * sample.place(&positions));
                    self.places.extend(places);
                    self.speeds.resize(self.places.len(), Vector3::zeros());
                    Wall { entity, triangles, samples, positions, liquid_from_wall }
                }
            };
            now.push(wall);
        }
        moved |= known.next().is_some();
        drop(known);
        self.walls = now;
        // Once more when they have stopped.
        if moved || self.walls_move {
            self.normals.clear();
            for wall in &self.walls {
                let is_smooth = scene.get::<LiquidWall>(wall.entity).is_some_and(|kind| kind.smooth);
                let normal = |sample: &WallSample| {
                    if is_smooth {
                        wall.liquid_from_wall * sample.across(&wall.positions)
                    } else {
                        Vector3::zeros()
                    }
                };
                self.normals.extend(wall.samples.iter().map(normal));
            }
            self.fluid
                .set_walls(&self.places, &self.speeds)
                .and_then(|()| self.fluid.set_wall_normals(&self.normals))
                .map_err(|error| format!("its walls: {error}"))?;
        }
        self.walls_move = moved;
        Ok(())
    }

    /// One step; if it fails, the liquid keeps its state.
    fn step(&mut self, dt: f64, scene: &Snapshot) -> Result<(), String> {
        let world_from_liquid = scene.world_pose(self.liquid);
        self.fluid.set_gravity(world_from_liquid.rotation.inverse() * self.gravity_in_world);
        self.follow_walls(dt, scene)?;
        for (entity, vessel) in scene.iter::<VesselState>() {
            let liquid_from_vessel = world_from_liquid.inverse() * scene.world_pose(entity);
            let hole = vessel.hole_in(&liquid_from_vessel);
            self.spouts.entry(entity).or_default().emit(vessel.bleeding.lost, dt, &hole, &mut self.fluid);
        }
        let liquid_from_world = world_from_liquid.inverse();
        for (entity, irrigator) in scene.iter::<Irrigator>() {
            let emitter = self.spouts.entry(entity).or_default();
            irrigator.emit((scene, entity), &liquid_from_world, dt, emitter, &mut self.fluid);
        }
        for (entity, sucker) in scene.iter::<Sucker>() {
            let suction = self.suctions.entry(entity).or_default();
            sucker.remove_within((scene, entity), &liquid_from_world, dt, suction, &mut self.fluid);
        }
        self.fluid.step(dt).map(drop).map_err(|error| error.to_string())
    }

    /// Restores the scene's state: discards the emission of a failed step.
    fn restore(&mut self, scene: &Snapshot) {
        let Some(known) = scene.get::<LiquidState>(self.liquid) else { return };
        if self.fluid.restore(&known.fluid).is_ok() {
            self.spouts = known.spouts.iter().copied().collect();
            self.suctions = known.suctions.iter().copied().collect();
        }
    }

    /// The smallest viscosity that its particles carry at the speed at which they fall their own size \[m²/s\].
    fn viscosity_min(&self) -> f64 {
        let spacing = self.fluid.config().spacing;
        Fluid::viscosity_min(spacing, (spacing * self.gravity_in_world.norm()).sqrt())
    }

    /// Reports once that a wall in the scene is invalid.
    fn validity_warning(&self, tick: &Tick<'_>, scene: &Snapshot, out: &mut Commands) {
        let Some(wall) = self.held.first().filter(|_| scene.get::<OutOfValidity>(self.liquid).is_none())
        else {
            return;
        };
        let reason = format!(
            "its wall '{}' is taken where it was last: a vertex is farther than {FAR} m away or a triangle names one \
             that there is none of",
            scene.name(*wall)
        );
        out.put(self.liquid, OutOfValidity { reason, since: tick.time });
        out.event("wall_held", *wall, None, tick.time.as_secs_f64());
    }

    /// Writes the particles in the order of their numbers; a gap in the numbers becomes an invisible particle.
    fn show(&mut self) {
        let state = self.fluid.state();
        self.order.clear();
        self.order.extend(state.numbers.iter().zip(0..).map(|(number, index)| (*number, index)));
        self.order.sort_unstable();
        // Old particles do not keep room for all numbers since.
        let room = trocar_scene::PARTICLES_MAX as u64;
        let first =
            state.next.saturating_sub(room).max(self.order.first().map_or(state.next, |first| first.0));
        let (mut positions, mut densities) = (Vec::new(), Vec::new());
        for (number, index) in self.order.iter().filter(|(number, _)| *number >= first) {
            let place = state.positions[*index as usize];
            let at = (number - first) as usize;
            positions.resize(at, place);
            densities.resize(at, 0.0);
            positions.push(place);
            densities.push(1.0);
        }
        self.look.first = first;
        self.look.positions = Arc::new(positions);
        self.look.densities = Arc::new(densities);
    }

    fn measure(&self, values: &mut BTreeMap<String, f64>) {
        let mut put = |what: &str, value: f64| values.insert(format!("{}.{what}", self.name), value);
        let volume = self.fluid.particle_volume();
        let state = self.fluid.state();
        let emitted: u64 = self.spouts.values().map(|emitter| emitter.emitted).sum();
        let given: f64 = self.spouts.values().map(|emitter| emitter.given).sum();
        put("volume_m3", state.numbers.len() as f64 * volume);
        put("particles", state.numbers.len() as f64);
        put("frozen", f64::from(u8::from(self.frozen)));
        put("held_walls", self.held.len() as f64);
        put("viscosity_min_m2_per_s", self.viscosity_min());
        put("emitted_m3", emitted as f64 * volume);
        let sucked: u64 = self.suctions.values().map(|suction| suction.taken).sum();
        put("sucked_m3", sucked as f64 * volume);
        put("absorbed_m3", state.absorbed as f64 * volume);
        // Less than one particle of each source is outstanding.
        put("emitted_share", if given > 0.0 { emitted as f64 * volume / given } else { 1.0 });
    }
}

/// Whether the positions of a wall are valid.
fn is_somewhere(
    liquid_from_wall: &Isometry3<f64>,
    positions: &[Point3<f64>],
    triangles: &[[u32; 3]],
) -> bool {
    let near = |place: &Point3<f64>| (liquid_from_wall * place).iter().all(|x| x.abs() <= FAR);
    positions.iter().all(near) && triangles.iter().flatten().all(|&at| (at as usize) < positions.len())
}

impl Controller for FluidController {
    fn access(&self) -> Access {
        let liquid = || EntitySet::Of(vec![self.liquid]);
        Access::new()
            .reads::<Liquid>()
            .reads::<LiquidWall>()
            .reads::<SurfaceMesh>()
            .reads::<VertexPositions>()
            .reads::<RestPositions>()
            .reads::<VesselState>()
            .reads::<Irrigator>()
            .reads::<Sucker>()
            .reads::<Activation>()
            .reads::<Pose>()
            .writes::<Particles>(liquid())
            .writes::<LiquidState>(liquid())
            .reads::<Frozen>()
            .reads::<OutOfValidity>()
            .writes::<Frozen>(liquid())
            .writes::<OutOfValidity>(liquid())
            .writes::<Measured>(EntitySet::Own)
    }

    fn tick(&mut self, tick: &Tick<'_>, scene: &Snapshot, out: &mut Commands) -> Result<(), ControllerError> {
        let dt = tick.period.as_secs_f64();
        if !self.frozen
            && let Err(reason) = self.step(dt, scene)
        {
            self.frozen = true;
            self.restore(scene);
            freeze(self.liquid, FrozenPart::Body, reason, tick, out);
        }
        if tick.number == 1 && self.fluid.config().viscosity < self.viscosity_min() {
            out.event("viscosity_not_carried", self.liquid, None, self.viscosity_min());
        }
        if !self.frozen {
            self.validity_warning(tick, scene, out);
            let was_empty = self.look.positions.is_empty();
            self.show();
            if !(was_empty && self.look.positions.is_empty()) || tick.number == 1 {
                out.put(self.liquid, self.look.clone());
                let spouts = self.spouts.iter().map(|(entity, emitter)| (*entity, *emitter)).collect();
                let suctions = self.suctions.iter().map(|(entity, suction)| (*entity, *suction)).collect();
                let fluid = Arc::new(self.fluid.state().clone());
                out.put(self.liquid, LiquidState { fluid, spouts, suctions });
            }
        }
        let mut measured = Measured::default();
        self.measure(&mut measured.values);
        out.put(tick.me, measured);
        Ok(())
    }
}

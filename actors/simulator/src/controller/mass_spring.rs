//! The controller of the bodies of masses and springs.

use std::collections::BTreeMap;
use std::sync::Arc;

use nalgebra::{Isometry3, Point3, Vector2, Vector3};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use trocar_scene::{
    Access, BuildContext, Collision, CollisionList, Commands, Component, ComponentError, Controller,
    ControllerError, Entity, EntitySet, Frozen, Instrument, InstrumentKind, JawState, Measured, Pose,
    Snapshot, SurfaceMesh, TextureCoordinates, Tick, Velocity,
};

use super::deformable::Deformable;
use super::jaws::{Holder, SurfaceState};
use super::tools::{Rod, rods_of_all};
use super::touch::{COLLISIONS_MAX, Skin, Touch, collision, touches};
use crate::cutting::{Sheet, Sweep, TopologyChange};
use crate::mass_spring::{
    Config, Contact, Input, Integrator, LineMaterial, LinearSolver, MassSpring, Network, Prescribed, State,
    SurfaceMaterial, TooLarge, VolumeMaterial,
};

/// Parts into which a step is divided at most.
const PARTS_MAX: u32 = 200;

/// How its springs are stepped.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Method {
    /// Symplectic Euler, in as many parts as are safe.
    #[default]
    Explicit,
    /// Backward Euler, at any step.
    Implicit,
}

/// What it is made of, by the kind of its mesh.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Springs {
    /// A thread, along its `line_mesh`.
    Line {
        /// Axial stiffness EA \[N\].
        axial_stiffness: f64,
        /// Bending stiffness EI \[N·m²\].
        bending_stiffness: f64,
        /// Mass per length \[kg/m\].
        density: f64,
    },
    /// A cloth or the wall of a tube, along its `surface_mesh`.
    Surface {
        /// Young's modulus times thickness \[N/m\].
        membrane_stiffness: f64,
        /// Flexural rigidity \[N·m\].
        bending_stiffness: f64,
        /// Mass per area \[kg/m²\].
        density: f64,
    },
    /// A volume, along its `tet_mesh`.
    Volume {
        /// Young's modulus \[Pa\].
        young_modulus: f64,
        /// Mass per volume \[kg/m³\].
        density: f64,
    },
}

impl Default for Springs {
    /// Cotton gauze, in round numbers.
    fn default() -> Self {
        Self::Surface { membrane_stiffness: 150.0, bending_stiffness: 2e-6, density: 0.05 }
    }
}

/// A body of masses and springs: it needs a mesh, and `anchors` where it is to be held.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct MassSpringBody {
    /// What it is made of.
    pub springs: Springs,
    /// How it is stepped.
    pub method: Method,
    /// Damping along springs \[s\]: the time by which their force follows their lengthening.
    pub lag: f64,
    /// Damping of every motion \[1/s\].
    pub damping: f64,
    /// How far its surface is from its vertices \[m\]: half the thickness of a cloth.
    pub thickness: f64,
    /// Force per depth of a contact \[N/m\].
    pub contact_stiffness: f64,
    /// Coulomb friction against instruments.
    pub friction: f64,
}

impl Default for MassSpringBody {
    fn default() -> Self {
        Self {
            springs: Springs::default(),
            method: Method::Explicit,
            lag: 2e-4,
            damping: 2.0,
            thickness: 0.0005,
            contact_stiffness: 200.0,
            friction: 0.3,
        }
    }
}

impl Component for MassSpringBody {
    const NAME: &'static str = "mass_spring";
    fn check(&self) -> Result<(), ComponentError> {
        trocar_scene::finite::check(self)?;
        ComponentError::range("lag", self.lag, 0.0..=1.0, "0 to 1 s")?;
        ComponentError::range("damping", self.damping, 0.0..=1e4, "0 to 1e4 1/s")?;
        ComponentError::range("thickness", self.thickness, 0.0..=0.1, "0 to 0.1 m")?;
        ComponentError::range("contact_stiffness", self.contact_stiffness, 0.0..=1e6, "0 to 1e6 N/m")?;
        ComponentError::range("friction", self.friction, 0.0..=10.0, "0 to 10")
    }
    fn schema() -> Option<serde_json::Value> {
        Some(schemars::schema_for!(Self).to_value())
    }
}

impl MassSpringBody {
    fn config(&self) -> Config {
        let integrator = match self.method {
            Method::Explicit => Integrator::Explicit { too_large: TooLarge::Divide { most: PARTS_MAX } },
            Method::Implicit => {
                // A cut changes the matrix: nothing is lost with it.
                let solver = LinearSolver::ConjugateGradients { tolerance: 1e-3, iterations_max: 100 };
                Integrator::Implicit { solver, newton: 1 }
            }
        };
        Config { integrator, lag: self.lag, damping: self.damping, ..Config::default() }
    }

    fn network(&self, body: &Deformable) -> Result<Network, ControllerError> {
        let network = match self.springs {
            Springs::Line { axial_stiffness, bending_stiffness, density } => Network::from_line(
                &body.rest,
                &body.segments,
                &LineMaterial { axial_stiffness, bending_stiffness, density },
            ),
            Springs::Surface { membrane_stiffness, bending_stiffness, density } => Network::from_surface(
                &body.rest,
                &body.triangles,
                &SurfaceMaterial { membrane_stiffness, bending_stiffness, density },
            ),
            Springs::Volume { young_modulus, density } => {
                Network::from_volume(&body.rest, &body.tets, &VolumeMaterial { young_modulus, density })
            }
        };
        network.map_err(|error| ControllerError::Scene(format!("'{}': {error}", body.name)))
    }

    fn skin<'a>(&self, body: &'a Deformable, positions: &'a [Point3<f64>]) -> Skin<'a> {
        let is_line = matches!(self.springs, Springs::Line { .. });
        Skin {
            positions,
            triangles: if is_line { &[] } else { &body.triangles },
            segments: if is_line { &body.segments } else { &[] },
            thickness: if is_line { body.radius } else { self.thickness },
        }
    }
}

struct Body {
    body: Deformable,
    kind: MassSpringBody,
    solver: MassSpring,
    /// A surface can be held and cut.
    sheet: Option<Sheet>,
    surface: SurfaceState,
    frozen: bool,
}

impl Body {
    fn read(scene: &Snapshot, entity: Entity, kind: MassSpringBody) -> Result<Self, ControllerError> {
        let body = Deformable::read(scene, entity)?;
        let wrong =
            |error: &dyn std::fmt::Display| ControllerError::Scene(format!("'{}': {error}", body.name));
        let network = kind.network(&body)?;
        let state = State { positions: body.positions.to_vec(), velocities: body.velocities.to_vec() };
        let solver =
            MassSpring::restore(network, state, &body.pinned, kind.config()).map_err(|e| wrong(&e))?;
        let known = scene.get::<SurfaceState>(entity).cloned();
        let mut surface = known.clone().unwrap_or_default();
        let sheet = match kind.springs {
            Springs::Surface { .. } => {
                let (rest, triangles) = (body.rest.to_vec(), body.triangles.to_vec());
                let sheet = match &known {
                    Some(known) => known.sheet(rest, triangles),
                    None => Sheet::new(rest, triangles),
                };
                Some(sheet.map_err(|e| wrong(&e))?)
            }
            _ => None,
        };
        if let Some(sheet) = &sheet {
            surface.take(sheet.state());
        }
        let frozen = scene.get::<Frozen>(entity).is_some();
        Ok(Self { body, kind, solver, sheet, surface, frozen })
    }

    /// Cuts where blades have swept, and lets springs, textures and what is held follow.
    fn cut(
        &mut self,
        sweeps: &[Sweep],
        uv: &mut Vec<Vector2<f64>>,
    ) -> Result<Option<TopologyChange>, String> {
        let (Some(sheet), Springs::Surface { membrane_stiffness, bending_stiffness, density }) =
            (&mut self.sheet, self.kind.springs)
        else {
            return Ok(None);
        };
        if sweeps.is_empty() {
            return Ok(None);
        }
        let before = self.solver.state().positions.clone();
        let change = sheet.cut(&before, sweeps).map_err(|error| error.to_string())?;
        if change.is_empty() {
            return Ok(None);
        }
        self.surface.cut_length += change.length;
        self.surface.take(sheet.state());
        let material = SurfaceMaterial { membrane_stiffness, bending_stiffness, density };
        // Whoever reads the scene anew finds the same ones.
        let anchored = |point: &Point3<f64>| self.body.anchors.hold(point);
        let rest = sheet.rest().iter().enumerate();
        let pinned: Vec<u32> = rest.filter(|(_, point)| anchored(point)).map(|(at, _)| at as u32).collect();
        let followed = self.solver.rebuild(&pinned, |network, state| {
            change.carry(&mut state.positions, |a, b, share| a + (b - a) * share);
            change.carry(&mut state.velocities, |a, b, share| a + (b - a) * share);
            let about = |vertex| sheet.about(vertex);
            network.update_surface(sheet.rest(), sheet.triangles(), &material, &change.stale, about)
        });
        followed.map_err(|error| error.to_string())?;
        if uv.len() == before.len() {
            change.carry(uv, |a, b, share| a + (b - a) * share);
        }
        self.body.pinned = pinned;
        self.body.rest = Arc::new(sheet.rest().to_vec());
        self.body.triangles = Arc::new(sheet.triangles().to_vec());
        Ok(Some(change))
    }

    /// Cuts where the blades of scissors have been, and tells the scene of the new mesh.
    fn follow_blades(
        &mut self,
        scene: &Snapshot,
        world_from_body: &Isometry3<f64>,
        out: &mut Commands,
    ) -> Result<(), String> {
        let sweeps = self.surface.sweeps(scene, world_from_body);
        let entity = self.body.entity;
        let texture = scene.get::<TextureCoordinates>(entity);
        let mut uv =
            if sweeps.is_empty() { Vec::new() } else { texture.map_or_else(Vec::new, |t| t.uv.to_vec()) };
        let Some(change) = self.cut(&sweeps, &mut uv)? else { return Ok(()) };
        let holders = Holder::all(scene, world_from_body, &[], &[], |_| Vec::new());
        let jaws: Vec<_> = holders.iter().map(Holder::jaws).collect();
        let positions = &self.solver.state().positions;
        self.surface.picks.follow(&change.triangles, &self.body.triangles, positions, &jaws);
        if texture.is_some() {
            out.put(entity, TextureCoordinates { uv: Arc::new(uv) });
        }
        self.body.changed_topology();
        out.put(entity, SurfaceMesh { triangles: self.body.triangles.clone() });
        Ok(())
    }

    /// Lets jaws take and let go, and says where they have what they hold.
    fn hold(
        &mut self,
        scene: &Snapshot,
        world_from_body: &Isometry3<f64>,
        rods: &[Rod],
        touches: &[Touch],
    ) -> Result<Vec<Prescribed>, String> {
        let Some(sheet) = &self.sheet else { return Ok(Vec::new()) };
        let holders =
            Holder::all(scene, world_from_body, rods, touches, |vertex| sheet.about(vertex).to_vec());
        let jaws: Vec<_> = holders.iter().map(Holder::jaws).collect();
        let positions = &self.solver.state().positions;
        self.surface.picks.update(sheet.triangles(), positions, &jaws).map_err(|error| error.to_string())?;
        let led = self.surface.picks.led(&jaws);
        let free = led.into_iter().filter(|led| self.body.pinned.binary_search(&led.vertex).is_err());
        Ok(free.map(|led| Prescribed { node: led.vertex, position: led.position_in_world }).collect())
    }

    /// Areas of its pieces, the largest first \[m²\].
    fn areas(&self) -> Vec<f64> {
        let Some(sheet) = &self.sheet else { return Vec::new() };
        let mut areas: BTreeMap<u32, f64> = BTreeMap::new();
        for (piece, corners) in sheet.pieces().iter().zip(sheet.triangles()) {
            let [a, b, c] = corners.map(|vertex| sheet.rest()[vertex as usize]);
            *areas.entry(*piece).or_default() += 0.5 * (b - a).cross(&(c - a)).norm();
        }
        let mut areas: Vec<f64> = areas.into_values().collect();
        areas.sort_by(|a, b| b.total_cmp(a));
        areas
    }
}

/// Steps every body that carries [`MassSpringBody`].
pub struct MassSpringController {
    gravity_in_world: Vector3<f64>,
    bodies: Vec<Body>,
    rods: Vec<Rod>,
    touches: Vec<Touch>,
    contacts: Vec<Contact>,
}

impl MassSpringController {
    /// Reads the bodies, and goes on where an earlier life left them.
    ///
    /// # Errors
    /// Names the body, and what is wrong with it.
    pub fn new(gravity_in_world: Vector3<f64>, context: &BuildContext<'_>) -> Result<Self, ControllerError> {
        let mut bodies = Vec::new();
        for entity in Deformable::carriers::<MassSpringBody>(context.scene) {
            let Some(kind) = context.scene.get::<MassSpringBody>(entity).copied() else { continue };
            bodies.push(Body::read(context.scene, entity, kind)?);
        }
        if bodies.is_empty() {
            return Err(ControllerError::Scene("mass-spring: no entity has a 'mass_spring'".into()));
        }
        let (rods, touches, contacts) = (Vec::new(), Vec::new(), Vec::new());
        Ok(Self { gravity_in_world, bodies, rods, touches, contacts })
    }
}

impl Controller for MassSpringController {
    fn access(&self) -> Access {
        let bodies: Vec<Entity> = self.bodies.iter().map(|body| body.body.entity).collect();
        let all = || EntitySet::Of(bodies.clone());
        Deformable::access(&bodies)
            .writes::<SurfaceMesh>(all())
            .writes::<SurfaceState>(all())
            .writes::<TextureCoordinates>(all())
            .reads::<MassSpringBody>()
            .reads::<Pose>()
            .reads::<Velocity>()
            .reads::<Instrument>()
            .reads::<JawState>()
            .writes::<Measured>(EntitySet::Own)
            .contributes::<CollisionList>()
    }

    fn tick(&mut self, tick: &Tick<'_>, scene: &Snapshot, out: &mut Commands) -> Result<(), ControllerError> {
        let mut collisions = Vec::new();
        let mut measured = Measured::default();
        let mut depth_max = 0.0_f64;
        for body in &mut self.bodies {
            let world_from_body = scene.world_pose(body.body.entity);
            let mut pushed = 0.0;
            if !body.frozen {
                rods_of_all(scene, &world_from_body, &mut self.rods);
                if let Err(reason) = body.follow_blades(scene, &world_from_body, out) {
                    body.frozen = true;
                    body.body.freeze(&reason, tick, out);
                    measure(body, pushed, &mut measured.values);
                    continue;
                }
                let skin = body.kind.skin(&body.body, &body.solver.state().positions);
                touches(&self.rods, &skin, &mut self.touches);
                let prescribed = match body.hold(scene, &world_from_body, &self.rods, &self.touches) {
                    Ok(prescribed) => prescribed,
                    Err(reason) => {
                        body.frozen = true;
                        body.body.freeze(&reason, tick, out);
                        measure(body, pushed, &mut measured.values);
                        continue;
                    }
                };
                // What is held goes where it is led, whatever touches it; blades cut and do not push.
                let led = |touch: &Touch| {
                    let is_led = |node: &u32| prescribed.iter().any(|led| led.node == *node);
                    touch.nodes.iter().any(is_led) || is_blade(scene, self.rods[touch.rod].instrument)
                };
                self.touches.retain(|touch| !led(touch));
                self.contacts.clear();
                self.contacts.extend(self.touches.iter().map(|touch| contact(touch, &body.kind)));
                let gravity = Deformable::gravity(&self.gravity_in_world, &world_from_body);
                let input =
                    Input { gravity, contacts: &self.contacts, prescribed: &prescribed, ..Input::default() };
                match body.solver.step(tick.period.as_secs_f64(), &input) {
                    Ok(_) => {
                        let State { positions, velocities } = body.solver.state();
                        body.body.write(positions, velocities, out);
                        if body.sheet.is_some() {
                            out.put(body.body.entity, body.surface.clone());
                        }
                        let forces = body.solver.contact_forces();
                        for (touch, force) in self.touches.iter().zip(forces) {
                            depth_max = depth_max.max(touch.depth);
                            pushed += force.norm();
                            let (of, on) = (self.rods[touch.rod], body.body.entity);
                            collisions.push(collision(touch, &of, on, force, &world_from_body, tick.time));
                        }
                    }
                    Err(error) => {
                        body.frozen = true;
                        body.body.freeze(&error, tick, out);
                    }
                }
            }
            measure(body, pushed, &mut measured.values);
        }
        collisions.sort_by(|a: &Collision, b| b.depth.total_cmp(&a.depth));
        collisions.truncate(COLLISIONS_MAX);
        out.contribute(CollisionList { collisions, penetration_max: depth_max });
        out.put(tick.me, measured);
        Ok(())
    }
}

/// Whether an instrument has blades.
fn is_blade(scene: &Snapshot, instrument: Entity) -> bool {
    scene.get::<Instrument>(instrument).is_some_and(|instrument| instrument.kind == InstrumentKind::Scissors)
}

fn contact(touch: &Touch, kind: &MassSpringBody) -> Contact {
    Contact {
        nodes: touch.nodes,
        weights: touch.weights,
        normal: touch.normal,
        depth: touch.depth,
        velocity: touch.velocity,
        stiffness: kind.contact_stiffness,
        damping: 0.0,
        friction: kind.friction,
    }
}

fn measure(body: &Body, pushed: f64, values: &mut BTreeMap<String, f64>) {
    let name = &body.body.name;
    values.insert(format!("{name}.contact_force_n"), pushed);
    values.insert(format!("{name}.elastic_energy_j"), body.solver.elastic_energy());
    values.insert(format!("{name}.kinetic_energy_j"), body.solver.kinetic_energy());
    let lowest =
        body.solver.state().positions.iter().map(|position| position.z).fold(f64::INFINITY, f64::min);
    values.insert(format!("{name}.lowest_m"), lowest);
    let highest = body.solver.state().positions.iter().map(|p| p.z).fold(f64::NEG_INFINITY, f64::max);
    values.insert(format!("{name}.highest_m"), highest);
    if body.sheet.is_some() {
        let areas = body.areas();
        values.insert(format!("{name}.pieces"), areas.len() as f64);
        values.insert(format!("{name}.cut_area_m2"), areas.get(1).copied().unwrap_or(0.0));
        values.insert(format!("{name}.cut_length_m"), body.surface.cut_length);
        let held: usize = body.surface.picks.picks.iter().map(|pick| pick.vertices.len()).sum();
        values.insert(format!("{name}.held_vertices"), held as f64);
    }
    values.insert(format!("{name}.frozen"), f64::from(u8::from(body.frozen)));
}

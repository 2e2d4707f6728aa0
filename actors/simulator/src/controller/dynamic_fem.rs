//! The controller of soft volumes in motion: dynamic finite elements.

use std::collections::BTreeMap;

use nalgebra::Vector3;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use trocar_scene::{
    Access, BuildContext, Collision, CollisionList, Commands, Component, ComponentError, Controller,
    ControllerError, Entity, EntitySet, Frozen, Instrument, JawState, Measured, Pose, Snapshot, Tick,
    Velocity,
};

use super::deformable::Deformable;
use super::dynamic_fem_memory::DynamicFemMemory;
use super::tools::{Rod, rods_of_all};
use super::touch::{COLLISIONS_MAX, Skin, Touch, collision, touches};
use crate::dynamic_fem::{Config, Constitution, Contact, DynamicFem, Inputs};
use crate::elasticity::Elastic;
use crate::tet_mesh::{MeshRules, TetMesh};

/// A soft volume: it needs a mesh of tetrahedra, and `anchors` where it is to be held.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct DynamicFemBody {
    /// Young's modulus \[Pa\].
    pub young_modulus: f64,
    /// Poisson's ratio.
    pub poisson_ratio: f64,
    /// Density \[kg/m³\].
    pub density: f64,
    /// Whether it is neo-Hookean, for large strains; else corotational.
    pub neo_hookean: bool,
    /// Rayleigh damping of the mass \[1/s\].
    pub mass_damping: f64,
    /// Rayleigh damping of the stiffness \[s\].
    pub stiffness_damping: f64,
    /// Force per depth of a contact \[N/m\].
    pub contact_stiffness: f64,
}

impl Default for DynamicFemBody {
    /// A soft organ, in round numbers: the moduli of liver and stomach measured in vivo lie between 2 and 20 kPa (Carter et
    /// al. 2001; Nava et al. 2008).
    fn default() -> Self {
        Self {
            young_modulus: 8e3,
            poisson_ratio: 0.45,
            density: 1060.0,
            neo_hookean: false,
            mass_damping: 1.0,
            stiffness_damping: 0.005,
            contact_stiffness: 300.0,
        }
    }
}

impl Component for DynamicFemBody {
    const NAME: &'static str = "dynamic_fem";
    fn check(&self) -> Result<(), ComponentError> {
        trocar_scene::finite::check(self)?;
        ComponentError::range("young_modulus", self.young_modulus, 1.0..=1e12, "1 to 1e12 Pa")?;
        ComponentError::range("poisson_ratio", self.poisson_ratio, 0.0..=0.499, "0 to 0.499")?;
        ComponentError::range("density", self.density, 1.0..=1e5, "1 to 1e5 kg/m³")?;
        ComponentError::range("contact_stiffness", self.contact_stiffness, 0.0..=1e6, "0 to 1e6 N/m")
    }
    fn schema() -> Option<serde_json::Value> {
        Some(schemars::schema_for!(Self).to_value())
    }
}

impl DynamicFemBody {
    fn solver(&self, body: &Deformable, memory: &DynamicFemMemory) -> Result<DynamicFem, String> {
        let mesh = TetMesh::new(&body.rest, &body.tets, &MeshRules::default()).map_err(|e| e.to_string())?;
        let elastic = Elastic::new(self.young_modulus, self.poisson_ratio).map_err(|e| e.to_string())?;
        let constitution =
            if self.neo_hookean { Constitution::NeoHookean } else { Constitution::Corotational };
        let config = Config {
            constitution,
            density: self.density,
            mass_damping: self.mass_damping,
            stiffness_damping: self.stiffness_damping,
            ..Config::default()
        };
        let mut solver = DynamicFem::new(mesh, &elastic, &config, &body.pinned).map_err(|e| e.to_string())?;
        let state = memory.state(&body.positions, &body.velocities);
        solver.restore(&state).map_err(|e| e.to_string())?;
        Ok(solver)
    }
}

struct Body {
    body: Deformable,
    kind: DynamicFemBody,
    solver: DynamicFem,
    memory: DynamicFemMemory,
    is_pinned: Vec<bool>,
    frozen: bool,
}

/// Steps every body that carries [`DynamicFemBody`].
pub struct DynamicFemController {
    gravity_in_world: Vector3<f64>,
    bodies: Vec<Body>,
    rods: Vec<Rod>,
    touches: Vec<Touch>,
    contacts: Vec<Contact>,
}

impl DynamicFemController {
    /// Reads the bodies, and goes on from where an earlier life left them.
    ///
    /// # Errors
    /// Names the body, and what is wrong with it.
    pub fn new(gravity_in_world: Vector3<f64>, context: &BuildContext<'_>) -> Result<Self, ControllerError> {
        let mut bodies = Vec::new();
        for entity in Deformable::carriers::<DynamicFemBody>(context.scene) {
            let Some(kind) = context.scene.get::<DynamicFemBody>(entity).copied() else { continue };
            let body = Deformable::read(context.scene, entity)?;
            let memory = context.scene.get::<DynamicFemMemory>(entity).cloned().unwrap_or_default();
            let solver = kind
                .solver(&body, &memory)
                .map_err(|why| ControllerError::Scene(format!("'{}': {why}", body.name)))?;
            let mut is_pinned = vec![false; body.rest.len()];
            body.pinned.iter().for_each(|&node| is_pinned[node as usize] = true);
            let frozen = context.scene.get::<Frozen>(entity).is_some();
            bodies.push(Body { body, kind, solver, memory, is_pinned, frozen });
        }
        if bodies.is_empty() {
            return Err(ControllerError::Scene("dynamic-fem: no entity has a 'dynamic_fem'".into()));
        }
        let (rods, touches, contacts) = (Vec::new(), Vec::new(), Vec::new());
        Ok(Self { gravity_in_world, bodies, rods, touches, contacts })
    }
}

impl Controller for DynamicFemController {
    fn access(&self) -> Access {
        let bodies: Vec<Entity> = self.bodies.iter().map(|body| body.body.entity).collect();
        Deformable::access(&bodies)
            .reads::<DynamicFemBody>()
            .reads::<Pose>()
            .reads::<Velocity>()
            .reads::<Instrument>()
            .reads::<JawState>()
            .writes::<DynamicFemMemory>(EntitySet::Of(bodies))
            .writes::<Measured>(EntitySet::Own)
            .contributes::<CollisionList>()
    }

    fn tick(&mut self, tick: &Tick<'_>, scene: &Snapshot, out: &mut Commands) -> Result<(), ControllerError> {
        let mut collisions: Vec<Collision> = Vec::new();
        let mut measured = Measured::default();
        let mut depth_max = 0.0_f64;
        for body in &mut self.bodies {
            let world_from_body = scene.world_pose(body.body.entity);
            let mut pushed = 0.0;
            if !body.frozen {
                rods_of_all(scene, &world_from_body, &mut self.rods);
                let skin = Skin {
                    positions: body.solver.positions(),
                    triangles: &body.body.triangles,
                    segments: &[],
                    thickness: 0.0,
                };
                touches(&self.rods, &skin, &mut self.touches);
                // What is held anyway cannot be pushed.
                let held = |touch: &Touch| touch.nodes.iter().all(|&node| body.is_pinned[node as usize]);
                self.touches.retain(|touch| !held(touch));
                self.contacts.clear();
                self.contacts.extend(self.touches.iter().map(|touch| contact(touch, &self.rods, &body.kind)));
                let acceleration = Deformable::gravity(&self.gravity_in_world, &world_from_body);
                let inputs = Inputs { acceleration, contacts: &self.contacts, ..Inputs::default() };
                match body.solver.step(tick.period.as_secs_f64(), &inputs) {
                    Ok(_) => {
                        body.body.write(body.solver.positions(), body.solver.velocities(), out);
                        body.memory.take(&body.solver);
                        out.put(body.body.entity, body.memory.clone());
                        for (touch, contact) in self.touches.iter().zip(&self.contacts) {
                            let force = force_of(contact, body.solver.positions());
                            depth_max = depth_max.max(touch.depth);
                            pushed += force.norm();
                            let (rod, on) = (self.rods[touch.rod], body.body.entity);
                            collisions.push(collision(touch, &rod, on, &force, &world_from_body, tick.time));
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
        collisions.sort_by(|a, b| b.depth.total_cmp(&a.depth));
        collisions.truncate(COLLISIONS_MAX);
        out.contribute(CollisionList { collisions, penetration_max: depth_max });
        out.put(tick.me, measured);
        Ok(())
    }
}

/// The plane that touches the rod where the body is nearest to it.
fn contact(touch: &Touch, rods: &[Rod], kind: &DynamicFemBody) -> Contact {
    let ([a, b, c], [u, v, w]) = (touch.nodes, touch.weights);
    let weights =
        if b == a { [(a, 1.0), (a, 0.0), (a, 0.0), (a, 0.0)] } else { [(a, u), (b, v), (c, w), (a, 0.0)] };
    Contact {
        weights,
        point: touch.on_axis + touch.normal * rods[touch.rod].radius,
        normal: touch.normal,
        stiffness: kind.contact_stiffness,
    }
}

/// What a contact exerts on the body where it is now \[N\].
fn force_of(contact: &Contact, positions: &[nalgebra::Point3<f64>]) -> Vector3<f64> {
    let place = contact.weights.iter().fold(Vector3::zeros(), |sum, &(node, weight)| {
        if weight == 0.0 { sum } else { sum + positions[node as usize].coords * weight }
    });
    let depth = (contact.point.coords - place).dot(&contact.normal);
    contact.normal * (contact.stiffness * depth.max(0.0))
}

fn measure(body: &Body, pushed: f64, values: &mut BTreeMap<String, f64>) {
    let name = &body.body.name;
    values.insert(format!("{name}.contact_force_n"), pushed);
    let energies = body.solver.energies();
    values.insert(format!("{name}.kinetic_energy_j"), energies.kinetic);
    values.insert(format!("{name}.elastic_energy_j"), energies.elastic);
    let moved =
        body.solver.positions().iter().zip(body.body.rest.iter()).map(|(now, rest)| (now - rest).norm());
    values.insert(format!("{name}.displacement_max_m"), moved.fold(0.0, f64::max));
    values.insert(format!("{name}.frozen"), f64::from(u8::from(body.frozen)));
}

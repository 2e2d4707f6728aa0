//! The controller of dynamic finite elements: soft volumes with inertia.

pub(crate) mod factor_job;
mod jaws;
pub mod saved_state;

use nalgebra::{Point3, Vector3};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use trocar_dynamics::elasticity::{Elastic, POISSON_MAX};
use trocar_dynamics::soft_body::instrument_rods::Rod;
use trocar_dynamics::soft_body::jaw_friction::GripForce;
use trocar_dynamics::soft_body::method::{
    ContactParams, Measures, StepContext, StepPrediction, SurfaceChange, bearing_stiffness,
};
use trocar_dynamics::soft_body::rod_contact::{ContactSurface, RodContact};
use trocar_dynamics::soft_body::{Deformable, SoftController, SoftMethod};
use trocar_dynamics::tet_mesh::{MeshRules, TetMesh};
use trocar_scene::{
    Access, Commands, Component, ComponentError, Entity, EntitySet, OutOfValidity, Snapshot, SoftAbilities,
};

use super::cutting::divisible_volume::DivisibleVolume;
use super::cutting::volume::{Elements, FailureCriteria, Split};
use super::thermal_damage::{CoagulatedElement, ThermalDamage};
use crate::dynamic_fem::{Config, Constitution, Contact, DynamicFem, Inputs, Report};
use factor_job::{Built, Former};
use jaws::JawStep;
use saved_state::DynamicFemMemory;

/// Consecutive unconverged steps after which a body counts as doubtful: an impact takes a few.
const UNSOLVED_MAX: u32 = 20;

/// A soft volume. It needs a tetrahedral mesh, and `anchors` where it is to be fixed.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Component)]
#[component(
    name = "dynamic_fem", check = Self::ranges, schema,
    soft_body = SoftAbilities {
        responds_to_contacts: true,
        bears: true,
        answers_couplings: true,
        loses_elements: true,
        ..SoftAbilities::NONE
    },
)]
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
    /// Mass-proportional Rayleigh damping \[1/s\].
    pub mass_damping: f64,
    /// Stiffness-proportional Rayleigh damping \[s\].
    pub stiffness_damping: f64,
    /// Contact stiffness: force per penetration depth \[N/m\].
    pub contact_stiffness: f64,
    /// Coulomb friction against other bodies, for contacts that detectors find; contact with instruments is
    /// frictionless.
    pub friction: f64,
    /// Whether blades cut it; then they do not push it.
    pub cut: bool,
    /// Tensile strength \[Pa\]; absent: it never tears.
    pub strength: Option<f64>,
}

impl Default for DynamicFemBody {
    /// A soft organ, in round numbers; for measured values of each organ see [`trocar_scene::tissue`].
    fn default() -> Self {
        Self {
            young_modulus: 8e3,
            poisson_ratio: 0.45,
            density: 1060.0,
            neo_hookean: false,
            mass_damping: 1.0,
            stiffness_damping: 0.005,
            contact_stiffness: 300.0,
            friction: 0.3,
            cut: false,
            strength: None,
        }
    }
}

impl DynamicFemBody {
    fn failure_criteria(&self) -> Result<FailureCriteria, String> {
        let elastic = Elastic::new(self.young_modulus, self.poisson_ratio).map_err(|e| e.to_string())?;
        let lame = [elastic.lambda(), elastic.mu()];
        Ok(FailureCriteria {
            cut: self.cut,
            halves: true,
            hangs_on: false,
            tears: self.strength.map(|strength| (strength, lame)),
            is_linear: false,
            young_modulus: self.young_modulus,
        })
    }

    /// A validated mesh; where the body was cut, duplicate nodes may coincide.
    pub(super) fn mesh(rest: &[Point3<f64>], tets: &[[u32; 4]], is_parted: bool) -> Result<TetMesh, String> {
        let coincident_within = if is_parted { None } else { Some(0.0) };
        let rules = MeshRules { coincident_within, ..MeshRules::default() };
        TetMesh::new(rest, tets, &rules).map_err(|e| e.to_string())
    }

    /// A solver at rest, with thermal damage applied to its elements.
    pub(super) fn at_rest(
        &self,
        mesh: TetMesh,
        pinned: &[u32],
        heated: &ThermalDamage,
    ) -> Result<DynamicFem, String> {
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
        let mut solver = DynamicFem::new(mesh, &elastic, &config, pinned).map_err(|e| e.to_string())?;
        heat(&mut solver, heated);
        Ok(solver)
    }

    /// The solver of a body with thermal damage.
    fn solver(
        &self,
        body: &Deformable,
        memory: &DynamicFemMemory,
        heated: &ThermalDamage,
    ) -> Result<DynamicFem, String> {
        let state = memory.state(&body.positions, &body.velocities);
        if let Some(lent) = memory.lent.as_ref().filter(|_| memory.fits(body.rest.len())) {
            let DynamicFemMemory { factor_positions, factor_dt, factor_couplings, .. } = memory;
            let former = Former { tets: &lent.tets, nodes: factor_positions.len() };
            let mut solver = former.solver(self, &body.rest, &body.pinned, heated)?;
            solver
                .factor_at(factor_positions, *factor_dt, factor_couplings)
                .map_err(|error| error.to_string())?;
            let mesh = Self::mesh(&body.rest, &body.tets, true)?;
            let done = solver.split_nodes(mesh, &body.pinned, &lent.births, |solver| heat(solver, heated));
            done.map_err(|error| error.to_string())?;
            solver.resume(&state);
            return Ok(solver);
        }
        let mesh = Self::mesh(&body.rest, &body.tets, body.is_parted)?;
        let mut solver = self.at_rest(mesh, &body.pinned, heated)?;
        solver.restore(&state).map_err(|e| e.to_string())?;
        Ok(solver)
    }

    fn ranges(&self) -> Result<(), ComponentError> {
        ComponentError::range("young_modulus", self.young_modulus, 1.0..=1e12, "1 to 1e12 Pa")?;
        ComponentError::range("poisson_ratio", self.poisson_ratio, 0.0..=POISSON_MAX, "0 to 0.45")?;
        ComponentError::range("density", self.density, 1.0..=1e5, "1 to 1e5 kg/m³")?;
        ComponentError::range("contact_stiffness", self.contact_stiffness, 0.0..=1e6, "0 to 1e6 N/m")?;
        ComponentError::range("friction", self.friction, 0.0..=10.0, "0 to 10")?;
        ComponentError::range("strength", self.strength.unwrap_or(1.0), 1.0..=1e9, "1 to 1e9 Pa")
    }
}

pub(super) fn heat(solver: &mut DynamicFem, heated: &ThermalDamage) {
    heated.coagulated.iter().for_each(|of| solver.alter(of.element, of.stiffness, of.length));
    solver.remove(&heated.removed);
}

/// The solver of one body, whose elements may be removed.
pub(super) struct Solver {
    pub(super) kind: DynamicFemBody,
    pub(super) solver: DynamicFem,
    pub(super) memory: DynamicFemMemory,
    /// A factor from a background job, not in use yet.
    pub(super) ready: Option<Built>,
}

impl Elements for Solver {
    fn positions(&self) -> &[Point3<f64>] {
        self.solver.positions()
    }

    fn velocities(&self) -> &[Vector3<f64>] {
        self.solver.velocities()
    }

    fn remove(&mut self, elements: &[u32]) -> Result<(), String> {
        self.solver.remove(elements);
        Ok(())
    }

    fn alter(&mut self, elements: &[CoagulatedElement]) -> Result<(), String> {
        elements.iter().for_each(|of| self.solver.alter(of.element, of.stiffness, of.length));
        Ok(())
    }

    fn split(&mut self, body: &Deformable, split: &Split<'_>) -> Result<(), String> {
        let (mesh, heated) = (DynamicFemBody::mesh(&body.rest, &body.tets, true)?, (split.heated)());
        if self.solver.has_factor() {
            let former = self.solver.mesh();
            self.memory.split(split.born, || former.tets().to_vec());
        }
        let done = self.solver.split_nodes(mesh, &body.pinned, split.born, |solver| heat(solver, &heated));
        done.map_err(|error| error.to_string())?;
        self.memory.take(&self.solver);
        Ok(())
    }
}

/// Dynamic finite elements for one body.
pub struct DynamicFemMethod {
    of: Solver,
    divisible: Option<DivisibleVolume>,
    /// Inverse mass of each node, 0 where it is anchored \[1/kg\].
    mobility: Vec<f64>,
    /// Stiffness of each contact with a rigid body that moves \[N/m\].
    bearing_stiffness: f64,
    contacts: Vec<Contact>,
    prescribed: Vec<(u32, Point3<f64>)>,
    forces: Vec<(u32, Vector3<f64>)>,
    jaws: JawStep,
    /// Report of the last step.
    report: Option<Report>,
    /// Unconverged steps: consecutive ones up to the last step, and all since the start.
    unsolved: [u32; 2],
}

impl SoftMethod for DynamicFemMethod {
    type Kind = DynamicFemBody;
    const CONTROLLER: &'static str = "dynamic-fem";

    fn build(kind: &DynamicFemBody, body: &mut Deformable, scene: &Snapshot) -> Result<Self, String> {
        let memory = scene.get::<DynamicFemMemory>(body.entity).cloned().unwrap_or_default();
        let divisible = DivisibleVolume::new(body, kind.failure_criteria()?, scene)?;
        let heated = divisible.as_ref().map(DivisibleVolume::heated).unwrap_or_default();
        let solver = kind.solver(body, &memory, &heated)?;
        let mobility = mobility(&solver, body);
        let mut of = Solver { kind: *kind, solver, memory, ready: None };
        of.resume(body, &heated);
        let (contacts, prescribed, forces, jaws) = Default::default();
        let bearing_stiffness = bearing_stiffness(kind.contact_stiffness, kind.young_modulus, body);
        Ok(Self {
            of,
            divisible,
            mobility,
            bearing_stiffness,
            contacts,
            prescribed,
            forces,
            jaws,
            report: None,
            unsolved: [0; 2],
        })
    }

    fn access(access: Access, bodies: &[Entity]) -> Access {
        DivisibleVolume::access(access, bodies).writes::<DynamicFemMemory>(EntitySet::Of(bodies.to_vec()))
    }

    fn is_cut_by_blades(&self) -> bool {
        self.divisible.as_ref().is_some_and(DivisibleVolume::is_cut)
    }

    fn reshape(
        &mut self,
        body: &mut Deformable,
        site: &StepContext<'_>,
        out: &mut Commands,
    ) -> Result<Option<SurfaceChange>, String> {
        let Some(divisible) = &mut self.divisible else { return Ok(None) };
        self.of.take_over(site)?;
        let reshaped = divisible.reshape(&mut self.of, body, site, out)?;
        self.of.ask(body, site, || divisible.heated());
        if reshaped.is_some() {
            self.mobility = mobility(&self.of.solver, body);
        }
        Ok(reshaped)
    }

    fn terms(&self) -> Option<ContactParams<'_>> {
        let DynamicFemBody { contact_stiffness: stiffness, friction, .. } = self.of.kind;
        let bearing_stiffness = self.bearing_stiffness;
        let young_modulus = self.of.kind.young_modulus;
        let masses_inverse = &self.mobility;
        Some(ContactParams { masses_inverse, stiffness, bearing_stiffness, young_modulus, friction })
    }

    fn publish(&mut self, body: &Deformable, site: &StepContext<'_>, out: &mut Commands) {
        if self.unsolved[0] == UNSOLVED_MAX && site.scene.get::<OutOfValidity>(body.entity).is_none() {
            out.put(body.entity, OutOfValidity { reason: self.validity_warning(), since: site.tick.time });
        }
        let Solver { solver, memory, .. } = &mut self.of;
        memory.take(solver);
        out.put(body.entity, memory.clone());
    }

    fn positions(&self) -> &[Point3<f64>] {
        self.of.solver.positions()
    }

    fn velocities(&self) -> &[Vector3<f64>] {
        self.of.solver.velocities()
    }

    fn contact_surface<'a>(&'a self, body: &'a Deformable) -> ContactSurface<'a> {
        ContactSurface {
            positions: self.positions(),
            triangles: &body.triangles,
            segments: &[],
            thickness: 0.0,
            closed: true,
        }
    }

    fn step(
        &mut self,
        _body: &Deformable,
        site: &StepContext<'_>,
        forces: &mut Vec<Vector3<f64>>,
    ) -> Result<(), String> {
        self.contacts.clear();
        self.contacts.extend(site.touches.iter().map(|touch| contact(touch, site.rods, &self.of.kind)));
        self.prescribed.clear();
        self.prescribed.extend(site.driven.iter().map(|driven| (driven.vertex, driven.position_in_body)));
        self.forces.clear();
        self.forces.extend_from_slice(site.forces);
        let watches = self.jaws.begin(&self.of.solver, site);
        let mut report = self.solve(site)?;
        if watches && self.jaws.slips(&self.of.solver, site, &mut self.prescribed, &mut self.forces) {
            self.of.solver.take_back(&self.jaws.before);
            report = self.solve(site)?;
        }
        self.report = Some(report);
        let [row, all] = self.unsolved;
        self.unsolved = if report.solved { [0, all] } else { [row.saturating_add(1), all.saturating_add(1)] };
        forces.clear();
        forces.extend(self.contacts.iter().map(|contact| force_of(contact, self.of.solver.positions())));
        let rigid = site.rigid.contacts.iter().zip(self.of.solver.rigid_forces());
        forces.extend(rigid.map(|(contact, force)| contact.normal * *force));
        Ok(())
    }

    fn look_ahead(
        &mut self,
        _body: &Deformable,
        site: &StepContext<'_>,
        active: &[u32],
        outlook: &mut StepPrediction,
    ) {
        let (solver, dt) = (&mut self.of.solver, site.period_secs());
        let inputs = inputs((&self.contacts, &self.prescribed, &self.forces), site);
        solver.expected(dt, &inputs, &mut outlook.expected);
        outlook.yielding = solver.yielding(dt, active);
        outlook.masses.clear();
        outlook.masses.extend_from_slice(solver.masses());
    }

    fn grip_forces(&self) -> &[GripForce] {
        &self.jaws.grips
    }

    fn pull_by(&mut self, held: &[u32]) -> Vector3<f64> {
        let reactions = self.of.solver.reactions().iter();
        -reactions
            .filter(|(node, _)| held.binary_search(node).is_ok())
            .map(|(_, force)| force)
            .sum::<Vector3<f64>>()
    }

    fn measure(&self, body: &Deformable, measures: &mut Measures<'_>) {
        let energies = self.of.solver.energies();
        measures.put("kinetic_energy_j", energies.kinetic);
        measures.put("elastic_energy_j", energies.elastic);
        measures.put("unsolved_steps", f64::from(self.unsolved[1]));
        measures.put("lent_factor", f64::from(u8::from(self.of.solver.has_stale_factor())));
        measures.put("analysed_in_ticks", f64::from(self.of.solver.analysed()));
        if let Some(report) = &self.report {
            measures.put("residual", report.residual);
            measures.put("inverted_elements", f64::from(report.inverted));
        }
        self.divisible.iter().for_each(|divisible| divisible.measure(measures));
        let moved = self.positions().iter().zip(body.rest.iter()).map(|(now, rest)| (now - rest).norm());
        measures.put("displacement_max_m", moved.fold(0.0, f64::max));
    }
}

impl DynamicFemMethod {
    /// Steps the solver.
    fn solve(&mut self, site: &StepContext<'_>) -> Result<Report, String> {
        let inputs = inputs((&self.contacts, &self.prescribed, &self.forces), site);
        self.of.solver.step(site.period_secs(), &inputs).map_err(|error| error.to_string())
    }

    fn validity_warning(&self) -> String {
        let residual = self.report.map_or(0.0, |report| report.residual);
        let inverted = self.report.and_then(|report| Some((report.inverted, report.first_inverted?)));
        let inverted = inverted.map_or_else(String::new, |(count, first)| {
            format!(", {count} elements are inside out (first {first})")
        });
        format!(
            "{UNSOLVED_MAX} steps in a row ended out of balance, the last by {:.1e} of the forces{inverted}: a shorter step, \
             a softer or a less squeezed body converges",
            residual
        )
    }
}

/// Inverse mass of each node, 0 where it is anchored or has no mass left \[1/kg\].
fn mobility(solver: &DynamicFem, body: &Deformable) -> Vec<f64> {
    let inverse = |mass: &f64| if *mass > 0.0 { mass.recip() } else { 0.0 };
    let mut mobility: Vec<f64> = solver.masses().iter().map(inverse).collect();
    for &node in &body.pinned {
        if let Some(mobility) = mobility.get_mut(node as usize) {
            *mobility = 0.0;
        }
    }
    mobility
}

/// Steps every body that carries [`DynamicFemBody`].
pub type DynamicFemController = SoftController<DynamicFemMethod>;

/// What acts on a body: contacts, prescribed positions \[m\] and forces \[N\] of nodes.
type Acting<'a> = (&'a [Contact], &'a [(u32, Point3<f64>)], &'a [(u32, Vector3<f64>)]);

fn inputs<'a>((contacts, prescribed, forces): Acting<'a>, site: &StepContext<'a>) -> Inputs<'a> {
    Inputs {
        acceleration: site.gravity,
        contacts,
        prescribed,
        forces,
        rigid: site.rigid,
        ..Inputs::default()
    }
}

/// Contact plane: tangent to the rod at the point nearest to the body.
fn contact(touch: &RodContact, rods: &[Rod], kind: &DynamicFemBody) -> Contact {
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

/// Force of a contact on the body at its current position \[N\].
fn force_of(contact: &Contact, positions: &[Point3<f64>]) -> Vector3<f64> {
    let place = contact.weights.iter().fold(Vector3::zeros(), |sum, &(node, weight)| {
        if weight == 0.0 { sum } else { sum + positions[node as usize].coords * weight }
    });
    let depth = (contact.point.coords - place).dot(&contact.normal);
    contact.normal * (contact.stiffness * depth.max(0.0))
}

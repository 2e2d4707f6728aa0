//! The controller of mass-spring bodies.

pub mod component;
pub mod factor_job;

use nalgebra::{Point3, Vector3};
use trocar_dynamics::elasticity::Alteration;
use trocar_dynamics::particles::State;
use trocar_dynamics::soft_body::jaw_friction::GripForce;
use trocar_dynamics::soft_body::method::{
    ContactParams, Measures, StepContext, SurfaceChange, bearing_stiffness,
};
use trocar_dynamics::soft_body::rod_contact::{ContactSurface, RodContact};
use trocar_dynamics::soft_body::{Deformable, SoftController, SoftMethod};
use trocar_dynamics::tet_mesh::NodeAdjacency;
use trocar_scene::{Access, Commands, Entity, EntitySet, LineMesh, Snapshot};

use super::cauterised::CauterisedBody;
use super::cutting::divisible_volume::DivisibleVolume;
use super::cutting::line::{LineCuts, LineFailureCriteria};
use super::cutting::membrane::{Membrane, MembraneChange, MembraneFailureCriteria};
use super::cutting::volume::{Elements, Split};
use super::thermal_damage::{CoagulatedElement, ThermalDamage};
use crate::mass_spring::{
    ChangedMesh, Contact, Input, LinearSolver, MassSpring, NodeForce, Prescribed, SurfaceMaterial,
    VolumeMaterial,
};
use component::{MassSpringBody, Method, SolvedBy, Springs};
use factor_job::{FactorKeeper, SpringFactor};

/// Mass-spring system of one body, whose elements may be removed.
struct Solver {
    kind: MassSpringBody,
    solver: MassSpring,
    /// Whether the springs were updated after a topology change, since the last query.
    has_followed: bool,
    /// For a divisible volume: the change of each tetrahedron, the elements at each node, and the mesh that its springs
    /// were last derived from.
    altered: Vec<Alteration>,
    stars: NodeAdjacency,
    body: Deformable,
}

impl Solver {
    fn new(kind: &MassSpringBody, body: &Deformable, altered: Vec<Alteration>) -> Result<Self, String> {
        let network = kind.network(body, &altered)?;
        let state = State { positions: body.positions.to_vec(), velocities: body.velocities.to_vec() };
        let solver = MassSpring::restore(network, state, &body.staying(), kind.config())
            .map_err(|error| error.to_string())?;
        let (stars, body) = (NodeAdjacency::default(), body.clone());
        Ok(Self { kind: *kind, solver, has_followed: false, altered, stars, body })
    }

    /// Follows a line that was cut at nodes; `copies` are the nodes that the new ones duplicate.
    fn copy(&mut self, body: &Deformable, copies: &[u32]) -> Result<(), String> {
        let mut state = self.solver.state().clone();
        for &of in copies {
            state.positions.push(state.positions[of as usize]);
            state.velocities.push(state.velocities[of as usize]);
        }
        let network = self.kind.network(body, &[])?;
        self.solver = MassSpring::restore(network, state, &body.staying(), self.kind.config())
            .map_err(|error| error.to_string())?;
        self.body = body.clone();
        Ok(())
    }

    /// The change of each tetrahedron.
    fn alterations(tets: usize, heated: &ThermalDamage) -> Vec<Alteration> {
        let mut altered = vec![Alteration::NONE; tets];
        for of in heated.coagulated.iter() {
            if let Some(known) = altered.get_mut(of.element as usize) {
                *known = Alteration { stiffness: of.stiffness, length: of.length };
            }
        }
        for &tet in heated.removed.iter() {
            if let Some(known) = altered.get_mut(tet as usize) {
                *known = Alteration::GONE;
            }
        }
        altered
    }

    /// Builds the node-to-element adjacency.
    fn split_nodes(&mut self) {
        let there = (0..).zip(self.body.tets.iter().copied());
        let there = there.filter(|(tet, _)| self.altered[*tet as usize] != Alteration::GONE);
        self.stars = NodeAdjacency::new(self.body.rest.len(), there);
    }

    /// Updates the springs of tetrahedra whose old or new corners are in `stale`; `carry` sets the state of new nodes.
    fn follow(&mut self, mut stale: Vec<u32>, carry: impl FnOnce(&mut State)) -> Result<(), String> {
        let Springs::Volume { young_modulus, density } = self.kind.springs else { return Ok(()) };
        stale.sort_unstable();
        stale.dedup();
        let (body, stars, altered) = (&self.body, &self.stars, &self.altered);
        let patch = ChangedMesh {
            rest: &body.rest,
            elements: &body.tets,
            altered: &|tet| altered[tet as usize],
            about: &|node| stars.about(node),
            stale: &stale,
        };
        let stays = |node: u32| body.pinned.binary_search(&node).is_ok() || stars.about(node).is_empty();
        let material = VolumeMaterial { young_modulus, density };
        self.has_followed = true;
        let followed = self
            .solver
            .follow(&patch, stays, carry, |network, patch| network.follow_volume(patch, &material));
        followed.map(drop).map_err(|error| error.to_string())
    }
}

impl Elements for Solver {
    fn positions(&self) -> &[Point3<f64>] {
        &self.solver.state().positions
    }

    fn velocities(&self) -> &[Vector3<f64>] {
        &self.solver.state().velocities
    }

    fn remove(&mut self, elements: &[u32]) -> Result<(), String> {
        let mut stale = Vec::new();
        for &tet in elements {
            let corners = self.body.tets[tet as usize];
            self.altered[tet as usize] = Alteration::GONE;
            self.stars.remove(tet, &corners);
            stale.extend(corners);
        }
        self.follow(stale, |_| ())
    }

    fn alter(&mut self, elements: &[CoagulatedElement]) -> Result<(), String> {
        let mut stale = Vec::new();
        for of in elements {
            let Some(known) = self.altered.get_mut(of.element as usize) else { continue };
            if *known != Alteration::GONE {
                *known = Alteration { stiffness: of.stiffness, length: of.length };
                stale.extend(self.body.tets[of.element as usize]);
            }
        }
        self.follow(stale, |_| ())
    }

    fn split(&mut self, body: &Deformable, split: &Split<'_>) -> Result<(), String> {
        let before = std::mem::replace(&mut self.body, body.clone()).tets;
        self.altered.resize(body.tets.len(), Alteration::NONE);
        let mut stale = Vec::new();
        for &tet in split.changed {
            if let Some(corners) = before.get(tet as usize) {
                self.stars.remove(tet, corners);
                stale.extend(corners);
            }
            let corners = body.tets[tet as usize];
            self.stars.add(tet, &corners);
            stale.extend(corners);
            self.altered[tet as usize] = (split.altered)(tet);
        }
        self.follow(stale, |state| split.carry(state))
    }
}

/// Mass-spring method for one body.
pub struct MassSpringMethod {
    of: Solver,
    contacts: Vec<Contact>,
    prescribed: Vec<Prescribed>,
    forces: Vec<NodeForce>,
    grips: Vec<u32>,
    /// Stiffness of each contact with a rigid body that moves \[N/m\].
    bearing_stiffness: f64,
    /// Largest safe step of the last tick, contacts included \[s\]: longer steps are divided.
    safe_step: f64,
    /// Iterations of the last implicit step, and its relative residual.
    solved: (u32, f64),
    /// Whether a factor is used; unknown before the first step.
    is_warped: Option<bool>,
    factor: FactorKeeper,
    /// Cutting and tearing of a surface.
    membrane: Option<Membrane>,
    /// Of a volume.
    divisible: Option<DivisibleVolume>,
    /// Of a line.
    line: Option<LineCuts>,
}

impl MassSpringMethod {
    /// Updates the springs after a topology change of a membrane.
    fn follow(&mut self, body: &Deformable, parted: &MembraneChange) -> Result<(), String> {
        let Springs::Surface { membrane_stiffness, bending_stiffness, density } = self.of.kind.springs else {
            return Ok(());
        };
        let Some(membrane) = &self.membrane else { return Ok(()) };
        self.of.has_followed = true;
        let material = SurfaceMaterial { membrane_stiffness, bending_stiffness, density };
        let followed = membrane.follow(parted, |patch| {
            let stays = |vertex| body.is_staying(vertex);
            let carry = |state: &mut State| parted.carry(state);
            self.of
                .solver
                .follow(patch, stays, carry, |network, patch| network.follow_surface(patch, &material))
        });
        followed.map(drop).map_err(|error| error.to_string())
    }

    /// Whether a factor is used; the first call configures the springs.
    fn choose(&mut self, site: &StepContext<'_>) -> Result<bool, String> {
        if let Some(is_warped) = self.is_warped {
            return Ok(is_warped);
        }
        let by = self.of.kind.solver(site.period_secs());
        let is_warped = self.of.kind.method == Method::Implicit && matches!(by, LinearSolver::Warped { .. });
        if self.of.kind.solver == SolvedBy::Auto && is_warped {
            self.of.solver.solve_by(by).map_err(|error| error.to_string())?;
        }
        self.is_warped = Some(is_warped);
        Ok(is_warped)
    }

    /// Applies the topology changes of this tick.
    fn split_nodes(
        &mut self,
        body: &mut Deformable,
        site: &StepContext<'_>,
        out: &mut Commands,
    ) -> Result<Option<SurfaceChange>, String> {
        if let Some(divisible) = &mut self.divisible {
            return divisible.reshape(&mut self.of, body, site, out);
        }
        if let Some(line) = &mut self.line {
            let copies = line.reshape(&self.of.solver.state().positions, body, site, out);
            let Some(copies) = copies else { return Ok(None) };
            self.of.copy(body, &copies)?;
            self.safe_step = self.of.solver.safe_step();
            // Its segments keep their numbers.
            return Ok(Some(SurfaceChange::default()));
        }
        let Some(membrane) = &mut self.membrane else { return Ok(None) };
        let positions = &self.of.solver.state().positions;
        let Some(parted) = membrane.reshape(positions, body, site, out)? else { return Ok(None) };
        self.follow(body, &parted)?;
        Ok(parted.reshaped)
    }

    fn contact(&self, touch: &RodContact) -> Contact {
        Contact {
            nodes: touch.nodes,
            weights: touch.weights,
            normal: touch.normal,
            depth: touch.depth,
            velocity: touch.velocity,
            stiffness: self.of.kind.contact_stiffness,
            damping: 0.0,
            friction: self.of.kind.friction,
        }
    }
}

impl SoftMethod for MassSpringMethod {
    type Kind = MassSpringBody;
    const CONTROLLER: &'static str = "mass-spring";

    fn build(kind: &MassSpringBody, body: &mut Deformable, scene: &Snapshot) -> Result<Self, String> {
        let (is_surface, is_volume) =
            (matches!(kind.springs, Springs::Surface { .. }), matches!(kind.springs, Springs::Volume { .. }));
        if kind.tears_at.is_some() && is_volume {
            return Err("'tears_at' is of surfaces and lines: a volume has a 'strength'".into());
        }
        if kind.strength.is_some() && !is_volume {
            return Err("'strength' is of volumes: surfaces and lines have 'tears_at'".into());
        }
        if !(is_surface || is_volume) && scene.get::<CauterisedBody>(body.entity).is_some() {
            return Err("a line of 'mass_spring' does not burn: surfaces and volumes do".into());
        }
        let membrane = match is_surface {
            true => {
                Membrane::new(body, MembraneFailureCriteria { cut: true, tears_at: kind.tears_at }, scene)?
            }
            false => None,
        };
        let divisible =
            if is_volume { DivisibleVolume::new(body, kind.failure_criteria(), scene)? } else { None };
        let altered = match (&membrane, &divisible) {
            (Some(membrane), _) => membrane.alterations(),
            (None, Some(divisible)) => Solver::alterations(body.tets.len(), &divisible.heated()),
            (None, None) => Vec::new(),
        };
        let failure_criteria = LineFailureCriteria { cut: true, tears_at: kind.tears_at };
        let line = (!is_surface && !is_volume).then(|| LineCuts::new(body, failure_criteria, scene));
        let mut of = Solver::new(kind, body, altered)?;
        if divisible.is_some() {
            of.split_nodes();
        }
        let safe_step = of.solver.safe_step();
        let bearing_stiffness = match kind.springs {
            Springs::Volume { young_modulus, .. } => {
                bearing_stiffness(kind.contact_stiffness, young_modulus, body)
            }
            _ => kind.contact_stiffness,
        };
        let (contacts, prescribed, forces, grips) = Default::default();
        let factor = FactorKeeper::new(scene.get::<SpringFactor>(body.entity));
        let (is_warped, solved) = (None, (0, 0.0));
        Ok(Self {
            of,
            contacts,
            prescribed,
            forces,
            grips,
            bearing_stiffness,
            safe_step,
            solved,
            is_warped,
            factor,
            membrane,
            divisible,
            line,
        })
    }

    fn check_step(&self, step_secs: f64) -> Result<(), String> {
        self.of.solver.check_step(step_secs).map_err(|error| error.to_string())
    }

    fn access(access: Access, bodies: &[Entity]) -> Access {
        let access = access
            .writes::<LineMesh>(EntitySet::Of(bodies.to_vec()))
            .writes::<SpringFactor>(EntitySet::Of(bodies.to_vec()));
        Membrane::access(DivisibleVolume::access(access, bodies), bodies)
    }

    fn positions(&self) -> &[Point3<f64>] {
        &self.of.solver.state().positions
    }

    fn velocities(&self) -> &[Vector3<f64>] {
        &self.of.solver.state().velocities
    }

    fn contact_surface<'a>(&'a self, body: &'a Deformable) -> ContactSurface<'a> {
        self.of.kind.contact_surface(body, self.positions())
    }

    fn terms(&self) -> Option<ContactParams<'_>> {
        let MassSpringBody { contact_stiffness: stiffness, friction, .. } = self.of.kind;
        let (masses_inverse, bearing_stiffness) = (self.of.solver.mobility(), self.bearing_stiffness);
        let young_modulus = self.of.kind.volume().unwrap_or(0.0);
        Some(ContactParams { masses_inverse, stiffness, bearing_stiffness, young_modulus, friction })
    }

    fn is_cut_by_blades(&self) -> bool {
        self.membrane.is_some() || self.divisible.is_some() || self.line.is_some()
    }

    fn reshape(
        &mut self,
        body: &mut Deformable,
        site: &StepContext<'_>,
        out: &mut Commands,
    ) -> Result<Option<SurfaceChange>, String> {
        let reshaped = self.split_nodes(body, site, out);
        let has_followed = std::mem::take(&mut self.of.has_followed);
        if self.choose(site)? && has_followed {
            self.factor.parted(site.tick.time);
        }
        reshaped
    }

    fn step(
        &mut self,
        body: &Deformable,
        site: &StepContext<'_>,
        forces: &mut Vec<Vector3<f64>>,
    ) -> Result<(), String> {
        if self.is_warped == Some(true) {
            self.factor.provide(&mut self.of.solver, body.entity, site);
        }
        let mut contacts = std::mem::take(&mut self.contacts);
        contacts.clear();
        contacts.extend(site.touches.iter().map(|touch| self.contact(touch)));
        self.contacts = contacts;
        self.prescribed.clear();
        let driven = site
            .driven
            .iter()
            .map(|driven| Prescribed { node: driven.vertex, position: driven.position_in_body });
        self.prescribed.extend(driven);
        self.forces.clear();
        self.forces.extend(site.forces.iter().map(|&(node, force)| NodeForce { node, force }));
        let input = Input {
            gravity: site.gravity,
            forces: &self.forces,
            contacts: &self.contacts,
            prescribed: &self.prescribed,
            rigid: site.rigid,
            jaws: site.jaw_friction(&mut self.grips),
        };
        let report = self.of.solver.step(site.period_secs(), &input).map_err(|error| error.to_string())?;
        self.safe_step = report.safe_step;
        self.solved = (report.iterations, report.residual);
        forces.clear();
        forces.extend_from_slice(self.of.solver.contact_forces());
        let rigid = site.rigid.contacts.iter().zip(self.of.solver.rigid_forces());
        forces.extend(rigid.map(|(contact, force)| contact.normal * *force));
        Ok(())
    }

    fn grip_forces(&self) -> &[GripForce] {
        self.of.solver.grip_forces()
    }

    fn pull_by(&mut self, held: &[u32]) -> Vector3<f64> {
        self.of.solver.pull_on(held)
    }

    fn publish(&mut self, body: &Deformable, _site: &StepContext<'_>, out: &mut Commands) {
        if let Some(membrane) = &mut self.membrane {
            membrane.publish(body, out);
        }
        if let Some(line) = &mut self.line {
            line.publish(body, out);
        }
        if let Some(factor) = self.factor.take_changes() {
            out.put(body.entity, factor);
        }
    }

    fn measure(&self, _body: &Deformable, measures: &mut Measures<'_>) {
        measures.put("elastic_energy_j", self.of.solver.elastic_energy());
        measures.put("kinetic_energy_j", self.of.solver.kinetic_energy());
        match self.of.kind.method {
            Method::Explicit => measures.put("safe_step_s", self.safe_step),
            Method::Implicit => {
                measures.put("iterations", f64::from(self.solved.0));
                measures.put("residual", self.solved.1);
            }
        }
        let heights = || self.positions().iter().map(|position| position.z);
        measures.put("lowest_m", heights().fold(f64::INFINITY, f64::min));
        measures.put("highest_m", heights().fold(f64::NEG_INFINITY, f64::max));
        if let Some(membrane) = &self.membrane {
            membrane.measure(measures);
        }
        if let Some(divisible) = &self.divisible {
            divisible.measure(measures);
        }
        if let Some(line) = &self.line {
            line.measure(measures);
        }
    }
}

/// Steps every body that carries [`MassSpringBody`].
pub type MassSpringController = SoftController<MassSpringMethod>;

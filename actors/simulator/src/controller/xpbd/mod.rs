//! The controller of position-based (XPBD) bodies: volumes, cloths and rods.
//!
//! Contacts are found once per step and tracked through its substeps. A body that bounces off within a step is detected
//! again in the next one only after it has penetrated. So a body under instruments needs several hundred steps a second
//! with few substeps, not few steps with many: at 100 Hz a light body rattles.

pub mod component;
pub(crate) mod island;

use std::sync::Arc;

use nalgebra::{Point3, Vector3};
use trocar_dynamics::coupling::external_nodes::ExternalNodesState;
use trocar_dynamics::elasticity::Alteration;
use trocar_dynamics::particles::State;
use trocar_dynamics::soft_body::instrument_limits::InstrumentLimit;
use trocar_dynamics::soft_body::jaw_friction::GripForce;
use trocar_dynamics::soft_body::method::{
    ContactParams, Measures, Step, StepContext, SurfaceChange, bearing_stiffness,
};
use trocar_dynamics::soft_body::rod_contact::{ContactSurface, RodContact};
use trocar_dynamics::soft_body::{Deformable, SoftController, SoftMethod};
use trocar_scene::{Access, Commands, Entity, EntitySet, LineMesh, Snapshot};

use super::coupling::fast_side::FastSide;
use super::cutting::divisible_volume::DivisibleVolume;
use super::cutting::line::{LineCuts, LineFailureCriteria};
use super::cutting::membrane::{Membrane, MembraneChange, MembraneFailureCriteria};
use super::cutting::volume::{Elements, Split};
use super::thermal_damage::CoagulatedElement;
use crate::mass_spring::{Contact, Network, NetworkError, NodeForce, Prescribed};
use crate::xpbd::{Groups, SplitTets, Xpbd};
use component::{Matter, XpbdBody, XpbdGroups};
use island::step_island;

/// Whether rigid bodies that move, or instruments that hands lead, touch a body in a step: sweeps over its constraints
/// do not carry them.
pub(super) fn is_loaded(site: &StepContext<'_>) -> bool {
    site.meets_instruments || !site.rigid.contacts.is_empty()
}

/// The solver of one body, whose elements may be removed.
pub(super) struct Solver {
    kind: XpbdBody,
    pub solver: Xpbd,
    /// Network of a cloth or a rod.
    network: Option<Network>,
    /// Whether constraints have changed their group since the mesh was built.
    regrouped: bool,
}

impl Solver {
    /// Writes the constraint groups for a restart, if they have changed.
    fn publish_groups(&mut self, entity: Entity, out: &mut Commands) {
        if std::mem::take(&mut self.regrouped) {
            let Groups { distances, bends, tets } = self.solver.groups();
            let [distances, bends, tets] = [distances, bends, tets].map(|groups| Arc::new(groups.to_vec()));
            out.put(entity, XpbdGroups { distances, bends, tets });
        }
    }

    /// Makes a cloth or a rod ready for a step in which something may press or hang on it.
    fn meet(&mut self, site: &StepContext<'_>) -> Result<(), String> {
        match &self.network {
            Some(network) if is_loaded(site) && !self.solver.has_network() => {
                self.solver.take_network(network).map_err(|error| error.to_string())
            }
            _ => Ok(()),
        }
    }

    /// Follows a rod that was cut at nodes; `copies` are the nodes that the new ones duplicate.
    fn copy(&mut self, body: &Deformable, copies: &[u32]) -> Result<(), NetworkError> {
        let mut state = self.solver.state().clone();
        for &of in copies {
            state.positions.push(state.positions[of as usize]);
            state.velocities.push(state.velocities[of as usize]);
        }
        (self.solver, self.network) = self.kind.solver(body, &[], &[], &XpbdGroups::default())?;
        self.solver.restore(state)
    }

    /// Updates the constraints after a topology change of a membrane.
    fn follow(
        &mut self,
        membrane: &Membrane,
        body: &Deformable,
        parted: &MembraneChange,
    ) -> Result<(), NetworkError> {
        let Self { kind, solver, network: Some(network), .. } = self else { return Ok(()) };
        let Some(material) = kind.cloth() else { return Ok(()) };
        membrane.follow(parted, |patch| {
            let followed = network.follow_surface(patch, &material)?;
            let carry = |state: &mut State| parted.carry(state);
            solver.follow_network(network, &followed, patch, |vertex| body.is_staying(vertex), carry)
        })?;
        self.regrouped = true;
        Ok(())
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
        self.solver.remove(elements);
        Ok(())
    }

    fn alter(&mut self, elements: &[CoagulatedElement]) -> Result<(), String> {
        elements.iter().for_each(|of| self.solver.alter(of.element, of.stiffness, of.length));
        Ok(())
    }

    fn split(&mut self, body: &Deformable, split: &Split<'_>) -> Result<(), String> {
        let tets = SplitTets { rest: &body.rest, tets: &body.tets, changed: split.changed };
        let stays = |node: u32| body.pinned.binary_search(&node).is_ok();
        let carry = |state: &mut State| split.carry(state);
        self.solver.split(&tets, stays, carry).map_err(|error| error.to_string())?;
        for &tet in split.changed {
            let Alteration { stiffness, length } = (split.altered)(tet);
            self.solver.alter(tet, stiffness, length);
        }
        self.regrouped = true;
        Ok(())
    }
}

/// XPBD method for one body.
pub struct XpbdMethod {
    pub(super) of: Solver,
    divisible: Option<DivisibleVolume>,
    membrane: Option<Membrane>,
    line: Option<LineCuts>,
    /// Its couplings, if it has any.
    pub(super) coupled: Option<FastSide>,
    /// Stiffness of each contact with a rigid body that moves \[N/m\].
    bearing_stiffness: f64,
    /// Longest substep under a rigid body \[s\].
    pub(super) bearing_substep: f64,
    pub(super) contacts: Vec<Contact>,
    pub(super) prescribed: Vec<Prescribed>,
    pub(super) forces: Vec<NodeForce>,
    pub(super) grips: Vec<u32>,
    /// Forces of ties to bodies in the same island, on its vertices in the last step \[N\].
    pub(super) tied: Vec<(u32, Vector3<f64>)>,
    pub(super) island: ExternalNodesState,
}

impl XpbdMethod {
    /// Sets the external forces, contacts and prescribed positions of a step.
    pub(super) fn set_up(&mut self, body: &Deformable, site: &StepContext<'_>) -> Result<(), String> {
        let kind = &self.of.kind;
        self.contacts.clear();
        self.contacts.extend(site.touches.iter().map(|touch| Self::contact(kind, touch)));
        self.prescribed.clear();
        let driven = site
            .driven
            .iter()
            .map(|driven| Prescribed { node: driven.vertex, position: driven.position_in_body });
        self.prescribed.extend(driven);
        site.jaw_friction(&mut self.grips);
        self.forces.clear();
        self.forces.extend(site.forces.iter().map(|&(node, force)| NodeForce { node, force }));
        self.of.meet(site)?;
        match &mut self.coupled {
            Some(coupled) => coupled.begin_step(body, self.of.solver.state(), site),
            None => Ok(()),
        }
    }

    fn contact(kind: &XpbdBody, touch: &RodContact) -> Contact {
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
}

impl SoftMethod for XpbdMethod {
    type Kind = XpbdBody;
    const CONTROLLER: &'static str = "xpbd";

    fn build(kind: &XpbdBody, body: &mut Deformable, scene: &Snapshot) -> Result<Self, String> {
        let of_another = match kind.matter {
            Matter::Volume { .. } => {
                kind.tears_at.map(|_| "'tears_at' is of cloth and rods: a volume has a 'strength'")
            }
            Matter::Cloth { .. } => kind.strength.map(|_| "'strength' is of volumes: cloth 'tears_at'"),
            Matter::Rod { .. } => kind.strength.map(|_| "'strength' is of volumes: a rod 'tears_at'"),
        };
        if let Some(what) = of_another {
            return Err(what.into());
        }
        let (divisible, membrane) = match kind.matter {
            Matter::Volume { .. } => (DivisibleVolume::new(body, kind.failure_criteria(), scene)?, None),
            Matter::Cloth { .. } => {
                let failure_criteria = MembraneFailureCriteria { cut: kind.cut, tears_at: kind.tears_at };
                (None, Membrane::new(body, failure_criteria, scene)?)
            }
            Matter::Rod { .. } => (None, None),
        };
        let failure_criteria = LineFailureCriteria { cut: kind.cut, tears_at: kind.tears_at };
        let is_weak_rod = matches!(kind.matter, Matter::Rod { .. }) && (kind.cut || kind.tears_at.is_some());
        let line = is_weak_rod.then(|| LineCuts::new(body, failure_criteria, scene));
        let altered = membrane.as_ref().map(Membrane::alterations).unwrap_or_default();
        let heated = divisible.as_ref().map(DivisibleVolume::heated).unwrap_or_default();
        let groups = scene.get::<XpbdGroups>(body.entity).cloned().unwrap_or_default();
        let made = kind.solver(body, &altered, &heated.removed, &groups);
        let (solver, network) = made.map_err(|error| error.to_string())?;
        let mut of = Solver { kind: *kind, solver, network, regrouped: false };
        of.alter(&heated.coagulated)?;
        let thickness = if matches!(kind.matter, Matter::Rod { .. }) { body.radius } else { kind.thickness };
        let coupled = FastSide::new(body, thickness, scene)?;
        let (contacts, prescribed, forces, grips, tied, island) = Default::default();
        let bearing_stiffness = match kind.matter {
            Matter::Volume { young_modulus, .. } => {
                bearing_stiffness(kind.contact_stiffness, young_modulus, body)
            }
            Matter::Cloth { .. } | Matter::Rod { .. } => kind.contact_stiffness,
        };
        Ok(Self {
            of,
            divisible,
            membrane,
            line,
            coupled,
            bearing_stiffness,
            bearing_substep: kind.bearing_substep(body),
            contacts,
            prescribed,
            forces,
            grips,
            tied,
            island,
        })
    }

    fn access(access: Access, bodies: &[Entity]) -> Access {
        let access = access.writes::<LineMesh>(EntitySet::Of(bodies.to_vec()));
        let access = Membrane::access(DivisibleVolume::access(access, bodies), bodies);
        FastSide::access(access, bodies).writes::<XpbdGroups>(EntitySet::Of(bodies.to_vec()))
    }

    fn terms(&self) -> Option<ContactParams<'_>> {
        let XpbdBody { contact_stiffness: stiffness, friction, .. } = self.of.kind;
        let (masses_inverse, bearing_stiffness) = (self.of.solver.mobility(), self.bearing_stiffness);
        let young_modulus = self.of.kind.volume().map_or(0.0, |[young_modulus, _]| young_modulus);
        Some(ContactParams { masses_inverse, stiffness, bearing_stiffness, young_modulus, friction })
    }

    /// Measured with light cloths: stronger and faster ones pass, or are thrown aside.
    fn instrument_limit(&self, period: f64) -> InstrumentLimit {
        const MIDDLE: f64 = 1.0 / 500.0;
        const SLOW: f64 = 1.0 / 200.0;
        let is_cloth = matches!(self.of.kind.matter, Matter::Cloth { .. });
        if !is_cloth || period <= MIDDLE * (1.0 + 1e-6) {
            return InstrumentLimit::NONE;
        }
        InstrumentLimit {
            force_max: 10.0,
            speed_max: if period <= SLOW * (1.0 + 1e-6) { f64::INFINITY } else { 0.5 },
            remedy: "take a 'rate_hz' of 500 or more, or 'mass_spring' with method = \"implicit\"",
        }
    }

    fn is_cut_by_blades(&self) -> bool {
        self.divisible.as_ref().is_some_and(DivisibleVolume::is_cut)
            || self.membrane.as_ref().is_some_and(Membrane::is_cut)
            || self.line.as_ref().is_some_and(LineCuts::is_cut)
    }

    fn reshape(
        &mut self,
        body: &mut Deformable,
        site: &StepContext<'_>,
        out: &mut Commands,
    ) -> Result<Option<SurfaceChange>, String> {
        if let Some(membrane) = &mut self.membrane {
            let positions = &self.of.solver.state().positions;
            let Some(parted) = membrane.reshape(positions, body, site, out)? else { return Ok(None) };
            self.of.follow(membrane, body, &parted).map_err(|error| error.to_string())?;
            self.of.publish_groups(body.entity, out);
            return Ok(parted.reshaped);
        }
        if let Some(line) = &mut self.line {
            let copies = line.reshape(self.of.positions(), body, site, out);
            let Some(copies) = copies else { return Ok(None) };
            self.of.copy(body, &copies).map_err(|error| error.to_string())?;
            // Its segments keep their numbers.
            return Ok(Some(SurfaceChange::default()));
        }
        let Some(divisible) = &mut self.divisible else { return Ok(None) };
        let reshaped = divisible.reshape(&mut self.of, body, site, out)?;
        self.of.publish_groups(body.entity, out);
        Ok(reshaped)
    }

    fn positions(&self) -> &[Point3<f64>] {
        &self.of.solver.state().positions
    }

    fn velocities(&self) -> &[Vector3<f64>] {
        &self.of.solver.state().velocities
    }

    fn contact_surface<'a>(&'a self, body: &'a Deformable) -> ContactSurface<'a> {
        let is_rod = matches!(self.of.kind.matter, Matter::Rod { .. });
        ContactSurface {
            positions: self.positions(),
            triangles: if is_rod { &[] } else { &body.triangles },
            segments: if is_rod { &body.segments } else { &[] },
            thickness: if is_rod { body.radius } else { self.of.kind.thickness },
            closed: matches!(self.of.kind.matter, Matter::Volume { .. }),
        }
    }

    fn step(
        &mut self,
        body: &Deformable,
        site: &StepContext<'_>,
        forces: &mut Vec<Vector3<f64>>,
    ) -> Result<(), String> {
        let step = Step { method: self, body, site: *site, forces: std::mem::take(forces), done: Ok(()) };
        let mut island = [step];
        step_island(&mut island.iter_mut().collect::<Vec<_>>());
        let [step] = island;
        *forces = step.forces;
        step.done
    }

    fn step_all(steps: &mut [Step<'_, Self>]) {
        let entities: Vec<Entity> = steps.iter().map(|step| step.body.entity).collect();
        let mut islands: Vec<usize> = (0..steps.len()).collect();
        for (index, step) in steps.iter().enumerate() {
            for fused in step.method.coupled.iter().flat_map(FastSide::fused) {
                if let Some(with) = entities.iter().position(|entity| *entity == fused.entity) {
                    let (from, to) = (islands[index].max(islands[with]), islands[index].min(islands[with]));
                    islands.iter_mut().filter(|island| **island == from).for_each(|island| *island = to);
                }
            }
        }
        for island in 0..steps.len() {
            let members = steps.iter_mut().zip(&islands).filter(|(_, of)| **of == island);
            let mut members: Vec<&mut Step<'_, Self>> = members.map(|(step, _)| step).collect();
            if !members.is_empty() {
                step_island(&mut members);
            }
        }
    }

    fn publish(&mut self, body: &Deformable, _site: &StepContext<'_>, out: &mut Commands) {
        if let Some(membrane) = &mut self.membrane {
            membrane.publish(body, out);
        }
        if let Some(line) = &mut self.line {
            line.publish(body, out);
        }
        if let Some(coupled) = &self.coupled {
            coupled.publish(body.entity, out);
        }
    }

    fn grip_forces(&self) -> &[GripForce] {
        self.of.solver.grip_forces()
    }

    fn pull_by(&mut self, held: &[u32]) -> Vector3<f64> {
        let tied = self.tied.iter().filter(|(node, _)| held.binary_search(node).is_ok());
        self.of.solver.pull_on(held) + tied.map(|(_, force)| force).sum::<Vector3<f64>>()
    }

    fn measure(&self, body: &Deformable, measures: &mut Measures<'_>) {
        measures.put("elastic_energy_j", self.of.solver.elastic_energy());
        measures.put("kinetic_energy_j", self.of.solver.kinetic_energy());
        measures.put("inverted_elements", self.of.solver.inverted().count as f64);
        let moved = self.positions().iter().zip(body.rest.iter()).map(|(now, rest)| (now - rest).norm());
        measures.put("displacement_max_m", moved.fold(0.0, f64::max));
        let heights = || self.positions().iter().map(|position| position.z);
        self.divisible.iter().for_each(|divisible| divisible.measure(measures));
        self.membrane.iter().for_each(|membrane| membrane.measure(measures));
        self.line.iter().for_each(|line| line.measure(measures));
        self.coupled.iter().for_each(|coupled| coupled.measure(measures));
        measures.put("lowest_m", heights().fold(f64::INFINITY, f64::min));
        measures.put("highest_m", heights().fold(f64::NEG_INFINITY, f64::max));
    }
}

/// Steps every body that carries [`XpbdBody`].
pub type XpbdController = SoftController<XpbdMethod>;

//! Extended position-based dynamics with small steps (Macklin, Müller and Chentanez, *XPBD: position-based simulation
//! of compliant constrained dynamics*, 2016; Macklin et al., *Small steps in physics simulation*, 2019): distance
//! constraints with physical stiffness, bending of sheets and lines, two constraints per tetrahedron for volumes, and
//! contacts with friction.
//!
//! An unconverged solution is too soft: static deflections are too large by a fraction that decreases with the square
//! of the substep and with the number of iterations. Substeps are therefore a better use of time than iterations. The
//! fraction grows with an element's ratio of stiffness to mass: soft tissue with centimetre elements converges in a few
//! substeps; stiff or fine bodies do not and need `dynamic_fem`.
//!
//! Where rigid bodies or instruments meet a cloth or a rod, its constraints are solved together (`direct.rs`).
//!
//! Constraints are coloured, four tetrahedra at a time, and projected sequentially or on the caller's rayon pool, with
//! bit-identical results.

mod colouring;
mod constraint;
mod contact;
mod direct;
pub(crate) mod island;
mod jaws;
pub(crate) mod remesh;
mod rigid_contact;
pub(crate) mod tetrahedra;

pub use constraint::{Bend, Distance, Elasticity, distances_of};
pub use island::{Member, step_together};
pub use remesh::SplitTets;

use nalgebra::{Point3, Vector3};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use trocar_dynamics::coupling::external_nodes::{ExternalNodes, ExternalNodesState, GhostImpulses};
use trocar_dynamics::faulty::Faulty;
use trocar_dynamics::particles::{State, StepError};
use trocar_dynamics::soft_body::bearing::rigid_response::RigidPresses;
use trocar_dynamics::soft_body::jaw_friction::{GripForce, JawFriction};

use crate::mass_spring::{
    Contact, MassSpring, NetworkError, NodeForce, Prescribed, check_contacts, check_elements,
};
use colouring::Coloured;
use constraint::{Constraint, Nodes};
use contact::ContactState;
use jaws::JawStates;
use rigid_contact::RigidContactStates;
use tetrahedra::{TetPack, Tets};

/// Constraints of a colour (packs of tetrahedra count as one) above which threads pay off.
const PARALLEL: usize = 512;
/// Maximum number of substeps of a step.
pub const PARTS_MAX: u32 = 1000;
/// Definition of a body.
#[derive(Clone, Debug, Default)]
pub struct Body<'a> {
    /// Rest shape \[m\].
    pub rest: &'a [Point3<f64>],
    /// Mass of each node besides that of tetrahedra \[kg\]; may be empty where all nodes have tetrahedra.
    pub masses: &'a [f64],
    /// Distance constraints.
    pub distances: &'a [Distance],
    /// Bending constraints, from the hinges of a network.
    pub bends: &'a [Bend],
    /// Tetrahedra, positively oriented.
    pub tets: &'a [[u32; 4]],
    /// Material of the tetrahedra.
    pub elasticity: Option<Elasticity>,
    /// Removed tetrahedra: their numbers are kept.
    pub gone: &'a [u32],
    /// Saved colours of the constraints; empty for a new body.
    pub groups: Groups<'a>,
}

/// Colour of each constraint, in the order of a body's lists. Constraints of a kind are projected colour by colour, and
/// their colours depend on the whole history of mesh changes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Groups<'a> {
    /// Colours of distance constraints.
    pub distances: &'a [u16],
    /// Colours of bending constraints.
    pub bends: &'a [u16],
    /// Colours of tetrahedra.
    pub tets: &'a [u16],
}

/// Solver settings of a body.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct XpbdConfig {
    /// Number of equal substeps, 1 to 1000.
    pub parts: u32,
    /// Iterations over all constraints in each substep, 1 to 1000. With small steps, use 1.
    pub iterations: u32,
    /// Global damping rate \[1/s\].
    pub damping: f64,
    /// Speed limit \[m/s\]; a faster node counts as diverged.
    pub speed_max: f64,
}

impl Default for XpbdConfig {
    fn default() -> Self {
        Self { parts: 10, iterations: 1, damping: 0.0, speed_max: 100.0 }
    }
}

/// Inputs of one step.
#[derive(Clone, Copy, Debug, Default)]
pub struct XpbdInput<'a> {
    /// Gravity \[m/s²\].
    pub gravity: Vector3<f64>,
    /// Forces on nodes.
    pub forces: &'a [NodeForce],
    /// Nodes with a prescribed position, approached at constant velocity; of two entries for one node the last counts.
    pub prescribed: &'a [Prescribed],
    /// Contacts.
    pub contacts: &'a [Contact],
    /// Contacts with rigid bodies that move.
    pub rigid: RigidPresses<'a>,
    /// Number of substeps at least, whatever the configuration says; at most [`PARTS_MAX`] count.
    pub parts_min: u32,
    /// External nodes of other bodies, and the ties to them.
    pub external_nodes: ExternalNodes<'a>,
    /// How much the jaws hold that prescribe positions.
    pub jaws: JawFriction<'a>,
    /// Whether the constraints are solved together, where the body has a network ([`Xpbd::take_network`]) and no external
    /// nodes: then it takes one step.
    pub direct: bool,
}

/// The solver.
#[derive(Clone, Debug)]
pub struct Xpbd {
    config: XpbdConfig,
    state: State,
    mobility: Vec<f64>,
    masses: Vec<f64>,
    distances: Coloured<Distance>,
    bends: Coloured<Bend>,
    tets: Tets,
    /// Density of the tetrahedra \[kg/m³\].
    density: f64,
    /// Masses besides those of tetrahedra; empty where there are none \[kg\].
    own: Vec<f64>,
    pinned: Vec<u32>,
    /// The network of its constraints, for steps that solve them together.
    network: Option<Box<MassSpring>>,
    scratch: Scratch,
}

#[derive(Clone, Debug, Default)]
struct Scratch {
    next: State,
    places: Vec<[f64; 4]>,
    before: Vec<[f64; 4]>,
    forces: Vec<Vector3<f64>>,
    contacts: Vec<ContactState>,
    contact_forces: Vec<Vector3<f64>>,
    external_nodes: ExternalNodesState,
    rigid: RigidContactStates,
    jaws: JawStates,
    distances: Sweep<Distance>,
    bends: Sweep<Bend>,
    tets: Sweep<TetPack>,
    /// Inverse squared length of the last substep \[1/s²\].
    rate: f64,
    /// Whether the last step was solved directly.
    was_direct: bool,
}

/// Workspace of a sweep.
#[derive(Clone, Debug)]
struct Sweep<C: Constraint> {
    multipliers: Vec<C::Multiplier>,
    moves: Vec<C::Correction>,
}
impl<C: Constraint> Default for Sweep<C> {
    fn default() -> Self {
        Self { multipliers: Vec::new(), moves: Vec::new() }
    }
}

impl Xpbd {
    /// A body at rest in its rest shape, with the listed nodes pinned.
    ///
    /// # Errors
    /// Whatever is wrong with mesh, material or configuration, elements by their index.
    pub fn new(body: &Body<'_>, pinned: &[u32], config: XpbdConfig) -> Result<Self, NetworkError> {
        let nodes = body.rest.len();
        let invalid = |what, value, valid| Err(NetworkError::Parameter { what, value, valid });
        for (what, value) in [("parts", config.parts), ("iterations", config.iterations)] {
            if !(1..=PARTS_MAX).contains(&value) {
                return invalid(what, f64::from(value), "1 to 1000");
            }
        }
        for (what, value) in [("damping", config.damping), ("speed_max", config.speed_max)] {
            if !(value >= 0.0 && value.is_finite()) {
                return invalid(what, value, "0 or more and finite");
            }
        }
        let pairs: Vec<[u32; 2]> = body.distances.iter().map(|distance| distance.nodes).collect();
        check_elements("distance", body.rest, &pairs)?;
        check_elements("tetrahedron", body.rest, body.tets)?;
        Faulty::among(body.distances.len(), |index| {
            let Distance { rest, compliance, .. } = body.distances[index];
            ![rest, compliance].iter().all(|value| *value >= 0.0 && value.is_finite())
        })
        .refuse(|faulty| NetworkError::Numbers { kind: "distance", faulty })?;
        Faulty::among(body.bends.len(), |index| {
            let of = body.bends[index].nodes;
            of.iter().any(|&node| node as usize >= nodes)
        })
        .refuse(|faulty| NetworkError::Nodes { kind: "bend", nodes, faulty })?;
        Faulty::among(body.bends.len(), |index| {
            let Bend { weights, rest, side, stiffness, .. } = body.bends[index];
            let finite = weights.iter().chain([&side]).all(|value| value.is_finite());
            !(finite && rest >= 0.0 && rest.is_finite() && stiffness > 0.0 && stiffness.is_finite())
        })
        .refuse(|faulty| NetworkError::Numbers { kind: "bend", faulty })?;
        if !body.masses.is_empty() && body.masses.len() != nodes {
            return Err(NetworkError::Length { what: "masses", given: body.masses.len(), expected: nodes });
        }
        let mut tets = Tets::default();
        if let Some(elasticity) = &body.elasticity {
            let Elasticity { young_modulus, poisson_ratio, density } = *elasticity;
            if !(young_modulus > 0.0 && young_modulus.is_finite()) {
                return invalid("young_modulus", young_modulus, "above 0 and finite");
            } else if !(0.0..0.5).contains(&poisson_ratio) {
                return invalid("poisson_ratio", poisson_ratio, "0 to below 0.5");
            } else if !(density > 0.0 && density.is_finite()) {
                return invalid("density", density, "above 0 and finite");
            }
            Faulty::among(body.tets.len(), |index| {
                let volume = tetrahedra::volume_of(body.rest, &body.tets[index]);
                volume.is_nan() || volume <= tetrahedra::LEAST
            })
            .refuse(|faulty| NetworkError::NoExtent { kind: "tetrahedron", faulty })?;
            let mut is_gone = vec![false; body.tets.len()];
            body.gone.iter().for_each(|&tet| {
                if let Some(is_gone) = is_gone.get_mut(tet as usize) {
                    *is_gone = true;
                }
            });
            tets = Tets::new(body.rest, body.tets, elasticity, body.groups.tets, |tet| is_gone[tet])?;
        } else if !body.tets.is_empty() {
            return invalid("elasticity", 0.0, "given where there are tetrahedra");
        }
        Faulty::among(pinned.len(), |index| pinned[index] as usize >= nodes)
            .refuse(|faulty| NetworkError::Nodes { kind: "pin", nodes, faulty })?;
        let mut pinned = pinned.to_vec();
        pinned.sort_unstable();
        pinned.dedup();
        let state = State { positions: body.rest.to_vec(), velocities: vec![Vector3::zeros(); nodes] };
        let mut solver = Self {
            config,
            state,
            mobility: vec![0.0; nodes],
            masses: vec![0.0; nodes],
            distances: Coloured::new(nodes, body.distances, body.groups.distances)?,
            // On a line the middle node appears twice: for colouring it is enough that it appears.
            bends: Coloured::new(nodes, body.bends, body.groups.bends)?,
            tets,
            density: body.elasticity.map_or(0.0, |elasticity| elasticity.density),
            own: body.masses.to_vec(),
            pinned,
            network: None,
            scratch: Scratch::default(),
        };
        (0..nodes as u32).for_each(|node| solver.weigh(node));
        let masses = &solver.masses;
        Faulty::among(nodes, |node| !(masses[node] > 0.0 && masses[node].is_finite()))
            .refuse(NetworkError::Masses)?;
        solver.remove(body.gone);
        Ok(solver)
    }

    /// Computes the mass of a node and whether it is free: a pinned node is not, nor one without remaining elements.
    fn weigh(&mut self, node: u32) {
        let index = node as usize;
        let own = self.own.get(index).copied().unwrap_or(0.0);
        let mass = self.tets.mass(node, own, self.density);
        self.masses[index] = mass;
        let moves = mass > 0.0 && self.pinned.binary_search(&node).is_err();
        self.mobility[index] = if moves { 1.0 / mass } else { 0.0 };
        if mass == 0.0 {
            self.state.velocities[index] = Vector3::zeros();
        }
    }

    /// Removes tetrahedra and their masses; already removed ones are ignored. A node without remaining elements keeps
    /// its position.
    pub fn remove(&mut self, tets: &[u32]) {
        for &number in tets {
            let Some(corners) = self.tets.remove(number) else { continue };
            corners.into_iter().for_each(|node| self.weigh(node));
        }
    }

    /// Sets stiffness and rest length of a tetrahedron, as factors of the original values, as heating does.
    pub fn alter(&mut self, tet: u32, stiffness: f64, length: f64) {
        self.tets.alter(tet, stiffness, length);
    }

    /// Continues from a state, bit for bit.
    ///
    /// # Errors
    /// A state of another body, or a non-finite one; nothing has changed then.
    pub fn restore(&mut self, state: State) -> Result<(), NetworkError> {
        crate::mass_spring::check_state(&state, self.mobility.len())?;
        self.state = state;
        Ok(())
    }

    /// Positions and velocities of the nodes.
    #[must_use]
    pub fn state(&self) -> &State {
        &self.state
    }
    /// Inverted tetrahedra, by their index.
    #[must_use]
    pub fn inverted(&self) -> Faulty {
        let all = self.tets.inverted(&self.state.positions);
        Faulty { count: all.len(), first: all.into_iter().take(16).collect() }
    }
    /// Masses of the nodes \[kg\].
    #[must_use]
    pub fn masses(&self) -> &[f64] {
        &self.masses
    }
    /// Inverse mass of each node, 0 where it is held \[1/kg\].
    #[must_use]
    pub fn mobility(&self) -> &[f64] {
        &self.mobility
    }
    /// The colours of its constraints, needed to continue bit for bit.
    #[must_use]
    pub fn groups(&self) -> Groups<'_> {
        Groups { distances: &self.distances.of, bends: &self.bends.of, tets: &self.tets.groups }
    }
    /// Number of tetrahedra.
    #[must_use]
    pub fn tets(&self) -> usize {
        self.tets.count
    }
    /// Force of each contact of the last step on the body, averaged over it, in the order of the input \[N\].
    #[must_use]
    pub fn contact_forces(&self) -> &[Vector3<f64>] {
        &self.scratch.contact_forces
    }
    /// Force of each contact with a rigid body in the last step, averaged over it, along its normal \[N\].
    pub fn rigid_forces(&self, dt: f64) -> impl Iterator<Item = f64> + '_ {
        self.scratch.rigid.impulses().iter().map(move |impulse| impulse / dt)
    }
    /// What the jaws of each watched grip did in the last step.
    #[must_use]
    pub fn grip_forces(&self) -> &[GripForce] {
        &self.scratch.jaws.forces
    }
    /// Impulses on external nodes in the last step.
    #[must_use]
    pub fn external_nodes(&self) -> &GhostImpulses {
        self.scratch.external_nodes.moved()
    }
    /// Total force of distances, bends, tetrahedra and ties on these nodes (ascending) in the last substep of the last
    /// step \[N\], for ties the mean over the step: the reaction on jaws that hold them. Zero before the first step.
    #[must_use]
    pub fn pull_on(&mut self, nodes: &[u32]) -> Vector3<f64> {
        if let Some(solver) = self.network.as_mut().filter(|_| self.scratch.was_direct) {
            return solver.pull_on(nodes);
        }
        let Scratch { places, distances, bends, tets, rate, external_nodes, .. } = &mut self.scratch;
        let mut sum = Vector3::zeros();
        let mut each = |node: u32, impulse: Vector3<f64>| {
            if nodes.binary_search(&node).is_ok() {
                sum += impulse;
            }
        };
        let now = Nodes { places, rate: *rate };
        let of = self.distances.all().zip(&distances.multipliers);
        of.for_each(|(of, multiplier)| of.impulses(&now, multiplier, &mut each));
        let of = self.bends.all().zip(&bends.multipliers);
        of.for_each(|(of, multiplier)| of.impulses(&now, multiplier, &mut each));
        let of = self.tets.packs.iter().flatten().zip(&tets.multipliers);
        of.for_each(|(of, multiplier)| of.impulses(&now, multiplier, &mut each));
        sum * *rate + external_nodes.pull_on(nodes)
    }
    /// Elastic energy of distances, bends and tetrahedra \[J\]; distances without compliance hold none.
    #[must_use]
    pub fn elastic_energy(&self) -> f64 {
        let positions = &self.state.positions;
        let mut energy = self.tets.energy(positions);
        for Distance { nodes: [a, b], rest, compliance } in
            self.distances.all().filter(|d| d.compliance > 0.0)
        {
            let off = (positions[*b as usize] - positions[*a as usize]).norm() - rest;
            energy += 0.5 * off * off / compliance;
        }
        for bend in self.bends.all() {
            let off = bend.vector(positions).norm() - bend.sense(positions) * bend.rest;
            energy += 0.5 * bend.stiffness * off * off;
        }
        energy
    }
    /// Kinetic energy \[J\].
    #[must_use]
    pub fn kinetic_energy(&self) -> f64 {
        let of = |(mass, velocity): (&f64, &Vector3<f64>)| 0.5 * mass * velocity.norm_squared();
        self.masses.iter().zip(&self.state.velocities).map(of).sum()
    }

    /// Steps by `dt` seconds.
    ///
    /// # Errors
    /// Invalid input, or a result that is not finite or too fast; the state is then unchanged.
    pub fn step(&mut self, dt: f64, input: &XpbdInput<'_>) -> Result<(), StepError> {
        let mut external_nodes = std::mem::take(&mut self.scratch.external_nodes);
        let done = step_together(
            dt,
            &mut [Member { body: self, input: *input }],
            &input.external_nodes,
            &mut external_nodes,
        );
        self.scratch.external_nodes = external_nodes;
        done.map_err(|(_, error)| error)
    }

    fn check_input(&self, input: &XpbdInput<'_>) -> Result<(), StepError> {
        let nodes = self.mobility.len();
        let wrong = |what, index, problem| Err(StepError::Input { what, index, problem });
        for (index, force) in input.forces.iter().enumerate() {
            if force.node as usize >= nodes {
                return wrong("force", index, "names a node that does not exist");
            }
        }
        for (index, driven) in input.prescribed.iter().enumerate() {
            if driven.node as usize >= nodes {
                return wrong("prescribed node", index, "does not exist");
            } else if !driven.position.iter().all(|value| value.is_finite()) {
                return wrong("prescribed node", index, "has a position that is not finite");
            }
        }
        check_contacts(input.contacts, nodes)
    }

    fn prepare(&mut self, dt: f64, input: &XpbdInput<'_>) {
        let nodes = self.mobility.len();
        let scratch = &mut self.scratch;
        scratch.was_direct = false;
        scratch.next.positions.clone_from(&self.state.positions);
        scratch.next.velocities.clone_from(&self.state.velocities);
        scratch.places.clear();
        for (position, mobility) in self.state.positions.iter().zip(&self.mobility) {
            scratch.places.push([position.x, position.y, position.z, *mobility]);
        }
        // The spare node.
        scratch.places.push([0.0; 4]);
        for (velocity, mobility) in scratch.next.velocities.iter_mut().zip(&self.mobility) {
            if *mobility == 0.0 {
                *velocity = Vector3::zeros();
            }
        }
        scratch.forces.clear();
        scratch.forces.resize(nodes, Vector3::zeros());
        input.forces.iter().for_each(|force| scratch.forces[force.node as usize] += force.force);
        scratch.jaws.begin_step(input.jaws.limits);
        for (place, driven) in input.prescribed.iter().enumerate() {
            let node = driven.node as usize;
            let velocity = (driven.position - self.state.positions[node]) / dt;
            if let Some((grip, _)) = input.jaws.watched(place).filter(|_| self.mobility[node] > 0.0) {
                scratch.jaws.hold(driven.node, grip, &self.state.positions[node], velocity);
                continue;
            }
            scratch.places[node][3] = 0.0;
            scratch.next.velocities[node] = velocity;
        }
        scratch.contacts.clear();
        let positions = &self.state.positions;
        scratch.contacts.extend(input.contacts.iter().map(|contact| ContactState::new(contact, positions)));
        scratch.rigid.begin_step(&input.rigid, dt, &self.state);
    }

    /// Prediction at the beginning of a substep of `h` seconds.
    fn predict(&mut self, h: f64, input: &XpbdInput<'_>) {
        let scratch = &mut self.scratch;
        let velocities = &mut scratch.next.velocities;
        scratch.before.clone_from(&scratch.places);
        let nodes = Nodes { places: &mut scratch.places, rate: 1.0 / (h * h) };
        for (contact, pressed) in input.contacts.iter().zip(&mut scratch.contacts) {
            pressed.begin(contact, &nodes);
        }
        let kept = 1.0 / (1.0 + h * self.config.damping);
        for ((velocity, place), force) in
            velocities.iter_mut().zip(nodes.places.iter_mut()).zip(&scratch.forces)
        {
            if place[3] > 0.0 {
                // External accelerations are not damped: otherwise hanging bodies would weigh too little.
                *velocity = *velocity * kept + (input.gravity + force * place[3]) * h;
            }
            (0..3).for_each(|axis| place[axis] += velocity[axis] * h);
        }
        scratch.rate = nodes.rate;
        let mut nodes = nodes;
        scratch.rigid.begin(input.rigid.contacts, &mut nodes, &scratch.before, h);
        scratch.jaws.begin(h);
        scratch.distances.reset(&self.distances.groups);
        scratch.bends.reset(&self.bends.groups);
        scratch.tets.reset(&self.tets.packs);
    }

    /// One iteration of a substep that ends `since` seconds after the beginning of the step.
    fn sweep(&mut self, h: f64, since: f64, input: &XpbdInput<'_>) {
        let scratch = &mut self.scratch;
        let mut nodes = Nodes { places: &mut scratch.places, rate: scratch.rate };
        scratch.distances.run(&self.distances.groups, &mut nodes);
        scratch.bends.run(&self.bends.groups, &mut nodes);
        scratch.tets.run(&self.tets.packs, &mut nodes);
        for (contact, pressed) in input.contacts.iter().zip(&mut scratch.contacts) {
            pressed.project(contact, &mut nodes, since, h);
        }
        scratch.rigid.project(input.rigid.contacts, &mut nodes, &scratch.before, h);
        scratch.jaws.project(&mut nodes, input.jaws.limits, h);
    }

    /// End of a substep: velocities from displacements.
    fn settle(&mut self, h: f64, input: &XpbdInput<'_>) {
        let scratch = &mut self.scratch;
        for (contact, pressed) in input.contacts.iter().zip(&mut scratch.contacts) {
            pressed.end(contact, h);
        }
        scratch.rigid.end(h);
        scratch.jaws.end(&scratch.places, h);
        let velocities = &mut scratch.next.velocities;
        for ((velocity, place), before) in velocities.iter_mut().zip(&scratch.places).zip(&scratch.before) {
            if place[3] > 0.0 {
                *velocity = Vector3::from_fn(|axis, _| (place[axis] - before[axis]) / h);
            }
        }
    }

    fn finish(&mut self, dt: f64, input: &XpbdInput<'_>) -> Result<(), StepError> {
        let Scratch { next, places, contacts, contact_forces, jaws, .. } = &mut self.scratch;
        jaws.end_step(dt);
        for (position, place) in next.positions.iter_mut().zip(places.iter()) {
            *position = Point3::new(place[0], place[1], place[2]);
        }
        for (place, driven) in input.prescribed.iter().enumerate() {
            if !input.jaws.watched(place).is_some_and(|(grip, _)| jaws.forces[grip].slipped) {
                next.positions[driven.node as usize] = driven.position;
            }
        }
        let limit = self.config.speed_max;
        for (node, (position, velocity)) in next.positions.iter().zip(&next.velocities).enumerate() {
            let (index, speed) = (node as u32, velocity.norm());
            if !(speed.is_finite() && position.iter().all(|value| value.is_finite())) {
                return Err(StepError::NotFinite { node: index });
            }
            if speed > limit && places[node][3] > 0.0 {
                return Err(StepError::Runaway { node: index, speed, limit });
            }
        }
        contact_forces.clear();
        contact_forces.extend(contacts.iter().map(|pressed| pressed.impulse / dt));
        std::mem::swap(&mut self.state, next);
        Ok(())
    }
}

impl<C: Constraint> Sweep<C> {
    fn reset(&mut self, groups: &[Vec<C>]) {
        self.multipliers.clear();
        self.multipliers.resize(groups.iter().map(Vec::len).sum(), C::Multiplier::default());
    }

    /// Projects all constraints of a kind once, colour by colour.
    fn run(&mut self, groups: &[Vec<C>], nodes: &mut Nodes<'_>) {
        let mut from = 0;
        for group in groups {
            let multipliers = &mut self.multipliers[from..from + group.len()];
            from += group.len();
            if group.len() >= PARALLEL && rayon::current_num_threads() > 1 {
                let (seen, known): (&Nodes<'_>, &[C::Multiplier]) = (nodes, multipliers);
                let projected = group.par_iter().zip(known).map(|(of, known)| of.project(seen, *known));
                projected.collect_into_vec(&mut self.moves);
                for ((of, moved), multiplier) in group.iter().zip(&self.moves).zip(multipliers) {
                    of.apply(moved, nodes, multiplier);
                }
            } else {
                for (of, multiplier) in group.iter().zip(multipliers) {
                    let moved = of.project(nodes, *multiplier);
                    of.apply(&moved, nodes, multiplier);
                }
            }
        }
    }
}

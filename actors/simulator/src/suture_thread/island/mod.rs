//! One step of a thread with all of its contacts: Newton iterations on the implicit rod, each with contact forces that
//! obey Coulomb's law for the linearised rod.
// One index runs over several arrays.
#![allow(clippy::needless_range_loop)]

pub(crate) mod active_contacts;
mod boundary;
pub(crate) mod contact_forces;
pub(crate) mod coupled_body;
mod elastic;
mod moving_obstacles;

use nalgebra::{Point3, Vector3, Vector6};

use coupled_body::{CoupledBody, Link, Tie, TieResult, Tolerance};
pub(crate) use elastic::TiedAround;

use super::contact::{
    Candidates, Complementarity, CoulombState, ForceLaw, FrictionLimit, LedMotion, Motion, Rows, Yielded,
    passed_through, passed_through_face,
};
use super::discrete_elastic_rod::{RodIterate, assemble};
use super::elastic::SurfacePoint;
use super::state::{ContactKey, ContactMemory, ThreadState};
use super::{
    FailureCause, LedInstrument, Reaction, Surroundings, ThreadMaterial, ThreadReport, ThreadStepError,
};
use crate::linear_algebra::block_banded::{Added, BlockBand, Cell, Factors, LaneCell};
use crate::linear_algebra::block_sparse_lu::BlockSparse;

/// Maximum linearised solutions in one substep.
const ITERATIONS_MAX: usize = 6;
/// Maximum number of halvings of a step.
const HALVINGS_MAX: u32 = 8;
/// Maximum number of substeps in one step.
const PARTS_MAX: usize = 512;
/// Another iteration is needed when edge lengths differ from those implied by the tension by more than this.
const LENGTH_TOLERANCE: f64 = 2e-4;
/// Shorter steps are needed when they differ by more than this.
const LENGTH_ERROR_MAX: f64 = 2e-2;
/// A contact satisfies its law when its error is at most this \[m\].
const TOLERANCE: f64 = 1e-9;

/// A contact in the solution.
#[derive(Clone, Debug)]
struct Active {
    key: ContactKey,
    rows: Rows,
    friction: f64,
    /// What limits its friction in the current solution.
    limit: FrictionLimit,
    /// Surface separation, and displacement from the sticking point, before this iteration \[m\].
    offset: [f64; 3],
    force: [f64; 3],
    compliance: f64,
    /// For a contact with an obstacle: its state in the current and in the next factors.
    coulomb: CoulombState,
    next: CoulombState,
    /// Contact point on the obstacle \[m\].
    surface: Point3<f64>,
    drawn: [f64; 2],
    /// Contact point on a compliant surface.
    gives: Option<SurfacePoint>,
    /// The tie that it belongs to, if it is not a contact.
    tie: Option<BodyTie>,
}

/// A tie of a coupled body, which is not a contact of the rod.
#[derive(Clone, Copy, Debug)]
struct BodyTie {
    /// Index in the coupled body's list.
    number: usize,
    law: ForceLaw,
    yields: [f64; 3],
}

/// The best approximation of the contact laws so far.
#[derive(Clone, Debug, Default)]
struct BestIterate {
    /// Its error \[m\].
    error: f64,
    moved: Vec<Cell>,
    forces: Vec<[f64; 3]>,
    /// How far the obstacles that give way do so.
    gives: Vec<Vector6<f64>>,
}

/// Workspace of a step.
#[derive(Clone, Debug, Default)]
pub(crate) struct Island {
    /// Newton steps on the contacts of one linearised solution, at most.
    pub sweeps_max: usize,
    trial: ThreadState,
    at: RodIterate,
    matrix: BlockBand,
    added: Added,
    factors: Factors,
    /// Factors of a rod with strand contacts, and of a closed one.
    sparse: BlockSparse,
    /// Number of obstacle contacts in `sprung`; strand contacts follow them. Without strand contacts the banded factors
    /// are used.
    with_obstacles: usize,
    nearest: BestIterate,
    right: Vec<Cell>,
    moved: Vec<Cell>,
    expected: Vec<Cell>,
    last: Vec<Cell>,
    rest: Vec<Cell>,
    lanes: Vec<LaneCell>,
    reach: Vec<f64>,
    motions: Vec<Motion>,
    /// How far each obstacle has given way in this step.
    yielded: Vec<Yielded>,
    /// Motions of the led instruments in this step.
    led: Vec<LedMotion>,
    giving: moving_obstacles::GivingObstacles,
    candidates: Candidates,
    /// Contacts with compliant bodies, ties, and strand contacts solved beside those.
    dense: Vec<Active>,
    /// Contacts that are springs in the rod's matrix: with obstacles, and between strands.
    sprung: Vec<Active>,
    former: Vec<ContactMemory>,
    problem: Complementarity,
    hold_forces: Vec<Vector3<f64>>,
    hold_torques: Vec<f64>,
    reactions: Vec<Reaction>,
    /// Triangles of compliant bodies near edges.
    near: Vec<elastic::NearTriangle>,
    joined: elastic::CoupledLinks,
    ties: Vec<Tie>,
    tied: Vec<TieResult>,
}

/// Why and where a substep failed.
pub(crate) struct Failure {
    pub node: usize,
    pub why: FailureCause,
}

impl Island {
    pub fn new(sweeps_max: usize) -> Self {
        Self { sweeps_max, ..Self::default() }
    }

    pub fn hold_forces(&self) -> &[Vector3<f64>] {
        &self.hold_forces
    }

    pub fn hold_torques(&self) -> &[f64] {
        &self.hold_torques
    }

    pub fn reactions(&self) -> &[Reaction] {
        &self.reactions
    }

    /// How each obstacle has given way in the step.
    pub fn yielded(&self) -> &[Yielded] {
        &self.yielded
    }

    /// How each led instrument has moved in the step.
    pub fn led(&self) -> &[LedMotion] {
        &self.led
    }

    /// Adds to the reaction of an obstacle: a force at a point, both in the world.
    pub fn add_reaction(
        &mut self,
        index: usize,
        force: &Vector3<f64>,
        at: &Point3<f64>,
        origin: &Point3<f64>,
    ) {
        if let Some(reaction) = self.reactions.get_mut(index) {
            reaction.force += force;
            reaction.torque += (at - origin).cross(force);
        }
    }

    /// Results of the ties of the last iteration, in the coupled body's order.
    pub fn tied(&self) -> &[TieResult] {
        &self.tied
    }

    /// Links of coupled bodies and their forces, of the last iteration.
    pub fn links(&self) -> (&[Link], &[[f64; 3]]) {
        (&self.joined.links, &self.joined.forces)
    }

    /// The rod at the end of the completed substeps.
    pub fn trial(&self) -> &ThreadState {
        &self.trial
    }

    /// Begins a step of a rod in this `state`.
    pub fn begin(&mut self, state: &ThreadState, surroundings: &Surroundings) {
        self.trial.clone_from(state);
        self.hold_forces.clear();
        self.hold_forces.resize(surroundings.holds.len(), Vector3::zeros());
        self.hold_torques.clear();
        self.hold_torques.resize(surroundings.twist_holds.len(), 0.0);
        self.reactions.clear();
        self.reactions.resize(surroundings.obstacles.len(), Reaction::default());
        self.yielded.clear();
        self.yielded.resize(surroundings.obstacles.len(), Yielded::default());
        self.led.clear();
        let begun = |led: &LedInstrument| LedMotion {
            offset: led.offset,
            velocity: led.velocity,
            ..LedMotion::default()
        };
        self.led.extend(surroundings.led.iter().map(begun));
    }

    /// Advances the state by `dt`, or leaves it unchanged.
    pub fn step(
        &mut self,
        material: &ThreadMaterial,
        state: &mut ThreadState,
        dt: f64,
        surroundings: &Surroundings,
        companion: &mut impl CoupledBody,
    ) -> Result<ThreadReport, ThreadStepError> {
        self.begin(state, surroundings);
        let mut report = ThreadReport::default();
        // Time in units of the shortest substep, so that substeps add up exactly.
        let whole = 1_u32 << HALVINGS_MAX;
        let (mut done, mut part) = (0_u32, whole);
        while done < whole {
            part = part.min(whole - done);
            let fractions = [f64::from(done) / f64::from(whole), f64::from(done + part) / f64::from(whole)];
            let divisible = part > 1 && report.parts < PARTS_MAX;
            let length = dt * (fractions[1] - fractions[0]);
            match self.part(material, length, fractions, surroundings, divisible, &mut report, companion) {
                Ok(()) => {
                    companion.finish(&self.joined.links, &self.joined.forces);
                    self.finish(material, length, fractions, surroundings);
                    done += part;
                    report.parts += 1;
                    // A substep is as long as alignment allows: 1, 2, 4 … of the shortest.
                    while done < whole && part < whole && done % (2 * part) == 0 {
                        part *= 2;
                    }
                }
                Err(failure) if !divisible => {
                    return Err(ThreadStepError::Diverged {
                        node: failure.node,
                        time: dt * fractions[0],
                        why: failure.why,
                        shortest: length,
                    });
                }
                Err(_) => part /= 2,
            }
        }
        self.fill_report(material, surroundings, &mut report);
        std::mem::swap(&mut self.trial, state);
        Ok(report)
    }

    /// Fills in the report at the end of a step.
    pub fn fill_report(
        &self,
        material: &ThreadMaterial,
        surroundings: &Surroundings,
        report: &mut ThreadReport,
    ) {
        report.contacts = self.contacts().filter(|contact| contact.force[0] > 0.0).count();
        let strains = self.at.lengths.iter().zip(&self.trial.rest_lengths).filter(|(_, rest)| **rest > 0.0);
        report.strain_max =
            strains.fold(0.0, |most, (length, rest)| f64::max(most, (length / rest - 1.0).abs()));
        report.penetration_max = self.penetration(material, surroundings);
    }

    /// Solves one substep; `divisible` says whether a shorter one is possible.
    #[expect(clippy::too_many_arguments, reason = "a step, a part of it and what is around it")]
    pub fn part(
        &mut self,
        material: &ThreadMaterial,
        dt: f64,
        fractions: [f64; 2],
        surroundings: &Surroundings,
        divisible: bool,
        report: &mut ThreadReport,
        companion: &mut impl CoupledBody,
    ) -> Result<(), Failure> {
        let diameter = material.diameter();
        let tolerance = companion.tolerance().unwrap_or(Tolerance {
            free: (0.1 * diameter, LENGTH_TOLERANCE),
            touching: (0.1 * diameter, LENGTH_TOLERANCE),
            moved_at_most: f64::INFINITY,
            iterations: ITERATIONS_MAX,
        });
        self.at.begin(&self.trial);
        self.motions.clear();
        self.motions.extend(surroundings.obstacles.iter().map(|obstacle| Motion::of(obstacle, fractions)));
        self.reach.clear();
        let speeds = self.trial.velocities.iter().map(|v| 1.2 * dt * v.norm() + 0.1 * diameter);
        self.reach.extend(speeds);
        for hold in surroundings.holds {
            let left = 1.0 - fractions[0];
            let way =
                (hold.to - self.trial.positions[hold.node]).norm() * (fractions[1] - fractions[0]) / left;
            self.reach[hold.node] = self.reach[hold.node].max(1.1 * way);
        }
        self.former.clone_from(&self.trial.contacts);
        self.begin_giving_way(surroundings, dt);
        companion.begin(dt, &self.motions);
        self.seek(material, surroundings);
        self.expect_giving_way(material, surroundings);
        self.tied.clear();
        for iteration in 0..tolerance.iterations {
            report.iterations += 1;
            self.linearise(material, dt, fractions, surroundings);
            self.gather(material, surroundings, if iteration == 0 { dt } else { 0.0 }, companion)?;
            self.answer(companion, report)?;
            let damped = self.damp(iteration);
            let of_rod = self.advance(material)?;
            let of_led = self.advance_obstacles();
            let of_companion = self.advance_companion(companion)?;
            let largest = of_rod.max(of_companion).max(of_led);
            self.guard(material, surroundings, companion)?;
            let error = self.length_error(material);
            let touches = self.contacts().any(|contact| contact.force[0] > 0.0);
            let (moved, length) = if touches { tolerance.touching } else { tolerance.free };
            if error.1 < length && largest < moved && !damped {
                break;
            }
            if iteration + 1 < tolerance.iterations {
                continue;
            }
            if error.1 > LENGTH_ERROR_MAX {
                return Err(Failure { node: error.0, why: FailureCause::Strain });
            }
            // A rod whose contacts alternate is accepted as it is.
            if (if touches { of_companion } else { largest }) > tolerance.moved_at_most {
                return Err(Failure { node: error.0, why: FailureCause::Wanders });
            }
            // A pair that came near only in the last iterate has not been solved for.
            if let Some(node) =
                self.deepest_penetration(material, surroundings, companion).filter(|_| divisible)
            {
                return Err(Failure { node, why: FailureCause::PassedThrough });
            }
        }
        Ok(())
    }

    /// Moves the coupled body by the solved forces.
    fn advance_companion(&mut self, companion: &mut impl CoupledBody) -> Result<f64, Failure> {
        self.link_forces();
        companion.advance(&self.joined.links, &self.joined.forces).map_err(|why| Failure { node: 0, why })
    }

    fn seek(&mut self, material: &ThreadMaterial, surroundings: &Surroundings) {
        self.see_led();
        if self.trial.positions.is_empty() {
            self.candidates.found.clear();
            return;
        }
        self.candidates.find(
            &self.trial.positions,
            &self.reach,
            &self.trial.rest_lengths,
            material.radius,
            0.2 * material.diameter(),
            surroundings.obstacles,
            &self.motions,
        );
        if !surroundings.spared.is_empty() {
            let spared = |key: &ContactKey| {
                surroundings.spared.iter().any(|spared| {
                    key.with as usize == spared.obstacle + 1
                        && (spared.edges[0]..=spared.edges[1]).contains(&(key.edge as usize))
                })
            };
            self.candidates.found.retain(|candidate| !spared(&candidate.key));
        }
    }

    /// The rod's matrix and forces at the iterate, with boundary conditions.
    fn linearise(
        &mut self,
        material: &ThreadMaterial,
        dt: f64,
        fractions: [f64; 2],
        surroundings: &Surroundings,
    ) {
        let nodes = self.at.positions.len();
        self.matrix.clear(nodes);
        self.right.clear();
        self.right.resize(nodes, Cell::zeros());
        assemble(
            material,
            &self.trial,
            &self.at,
            dt,
            &surroundings.gravity,
            &mut self.matrix,
            &mut self.right,
        );
        for load in surroundings.loads {
            for k in 0..3 {
                self.right[load.node][k] += load.force[k];
            }
        }
        let share = (fractions[1] - fractions[0]) / (1.0 - fractions[0]);
        for hold in surroundings.holds {
            let (pull, stiffness) = self.pull(hold, share);
            let mut diagonal = self.matrix.diagonal[hold.node].fixed_view_mut::<3, 3>(0, 0);
            diagonal += stiffness;
            for k in 0..3 {
                self.right[hold.node][k] += pull[k];
            }
        }
        for hold in surroundings.twist_holds {
            let edge = hold.edge;
            let stiffness = boundary::twist_hold_stiffness(material, self.trial.rest_lengths[edge]);
            self.right[edge][3] += stiffness * self.turn_left(hold, share);
            self.matrix.diagonal[edge][(3, 3)] += stiffness;
        }
    }

    /// All contacts in the solution.
    fn contacts(&self) -> impl Iterator<Item = &Active> {
        self.dense.iter().chain(&self.sprung).filter(|contact| contact.tie.is_none())
    }

    /// Halves a change of the iterate that reverses the previous one: contacts that jump between two edges, or turn
    /// with a free end, would oscillate for ever. Returns whether it did.
    fn damp(&mut self, iteration: usize) -> bool {
        if iteration == 0 {
            self.last.clear();
        }
        let place = |cell: &Cell| Vector3::new(cell[0], cell[1], cell[2]);
        let (mut both, mut now, mut before) = (0.0, 0.0, 0.0);
        for (moved, last) in self.moved.iter().map(place).zip(self.last.iter().map(place)) {
            both += moved.dot(&last);
            now += moved.norm_squared();
            before += last.norm_squared();
        }
        let damped = both < -0.5 * before && now > 0.25 * before;
        if damped {
            self.moved.iter_mut().for_each(|moved| *moved *= 0.5);
            self.giving.damp();
        }
        self.last.clone_from(&self.moved);
        damped
    }

    /// Moves the iterate; returns the largest displacement of a node \[m\].
    fn advance(&mut self, material: &ThreadMaterial) -> Result<f64, Failure> {
        let at = &mut self.at;
        let change =
            |moved: &[Cell], node: usize| Vector3::new(moved[node][0], moved[node][1], moved[node][2]);
        for edge in 0..at.tangents.len() {
            let rest = self.trial.rest_lengths[edge];
            if !self.trial.joins(edge) {
                continue;
            }
            let end = self.trial.after(edge);
            let by = at.tangents[edge].dot(&(change(&self.moved, end) - change(&self.moved, edge)));
            at.tensions[edge] = material.axial_stiffness / rest * (at.lengths[edge] + by - rest);
        }
        let mut largest = 0.0_f64;
        let edges = at.turns.len();
        for node in 0..at.positions.len() {
            let by = change(&self.moved, node);
            let size = by.norm();
            if !size.is_finite() || !self.moved[node][3].is_finite() {
                return Err(Failure { node, why: FailureCause::NotFinite });
            }
            largest = largest.max(size);
            at.positions[node] += by;
            if node < edges {
                at.turns[node] += self.moved[node][3];
            }
        }
        at.follow(&self.trial);
        self.former.clear();
        let contacts = self.dense.iter().chain(&self.sprung).filter(|contact| contact.tie.is_none());
        self.former.extend(contacts.filter(|contact| contact.force[0] > 0.0).map(|contact| {
            let drawn = contact.rows.vector(&[0.0, contact.drawn[0], contact.drawn[1]]);
            ContactMemory { key: contact.key, force: contact.rows.vector(&contact.force), drawn }
        }));
        self.former.sort_unstable_by_key(|memory| memory.key);
        Ok(largest)
    }

    /// Rejects an iterate that has passed through something; repeats detection where it moved further than predicted.
    fn guard(
        &mut self,
        material: &ThreadMaterial,
        surroundings: &Surroundings,
        companion: &impl CoupledBody,
    ) -> Result<(), Failure> {
        let mut further = false;
        for node in 0..self.at.positions.len() {
            let way = (self.at.positions[node] - self.trial.positions[node]).norm();
            if way > self.reach[node] {
                self.reach[node] = 1.5 * way;
                further = true;
            }
        }
        // An instrument that the thread has pushed out of the way in which contacts were sought.
        further |= self.led_beyond(0.1 * material.diameter());
        if further {
            self.seek(material, surroundings);
        }
        let (from, to) = (&self.trial.positions, &self.at.positions);
        // An edge next to a spared one reaches with its end into the same body.
        let beside_spared = |key: &ContactKey| {
            surroundings.spared.iter().any(|spared| {
                let edge = key.edge as usize;
                key.with as usize == spared.obstacle + 1
                    && (self.trial.after(edge) == spared.edges[0]
                        || edge == self.trial.after(spared.edges[1]))
            })
        };
        for candidate in self.candidates.found.iter().filter(|candidate| !beside_spared(&candidate.key)) {
            let key = &candidate.key;
            let face = companion
                .swept()
                .filter(|_| companion.surface().is_some_and(|surface| key.with as usize == surface + 1))
                .zip(surroundings.face(key));
            let passed = match face {
                Some((swept, nodes)) => {
                    let corners = swept.map(|nodes_at| nodes.map(|node| nodes_at[node as usize]));
                    passed_through_face(key.edge as usize, [from, to], material.radius, corners)
                }
                None => passed_through(key, from, to, material.radius, surroundings.obstacles, &self.motions),
            };
            if passed {
                return Err(Failure { node: candidate.key.edge as usize, why: FailureCause::PassedThrough });
            }
        }
        match companion.stops([from, to], &self.motions) {
            Some(node) => Err(Failure { node, why: FailureCause::PassedThrough }),
            None => Ok(()),
        }
    }

    /// The edge whose length differs most from that implied by its tension, and the relative error.
    fn length_error(&self, material: &ThreadMaterial) -> (usize, f64) {
        let mut worst = (0, 0.0);
        for (edge, length) in self.at.lengths.iter().enumerate() {
            let rest = self.trial.rest_lengths[edge];
            if !self.trial.joins(edge) {
                continue;
            }
            let error = (length / rest - 1.0 - self.at.tensions[edge] / material.axial_stiffness).abs();
            // NaN counts as the worst.
            if error > worst.1 || error.is_nan() {
                worst = (edge, if error.is_nan() { f64::INFINITY } else { error });
            }
        }
        worst
    }

    /// Makes the iterate the state at the end of the substep, and accumulates the reactions.
    pub fn finish(
        &mut self,
        material: &ThreadMaterial,
        dt: f64,
        fractions: [f64; 2],
        surroundings: &Surroundings,
    ) {
        self.feel(material, fractions, surroundings);
        self.end_giving_way(dt);
        let state = &mut self.trial;
        for node in 0..state.positions.len() {
            state.velocities[node] = (self.at.positions[node] - state.positions[node]) / dt;
        }
        for edge in 0..state.spins.len() {
            state.spins[edge] = self.at.turns[edge] / dt;
        }
        state.positions.clone_from(&self.at.positions);
        state.directors.clone_from(&self.at.directors);
        state.twists.clone_from(&self.at.twists);
        state.tensions.clone_from(&self.at.tensions);
        state.contacts.clone_from(&self.former);
    }
}

//! One step of a thread and all of its contacts together: Newton iterations on the implicit rod, each of them ending in
//! contact forces that obey Coulomb's law for the rod as it is linearised there.
// One index walks several arrays.
#![allow(clippy::needless_range_loop)]

mod boundary;
mod elastic;

use nalgebra::{Point3, Vector3};

use crate::thread::block_band::{BlockBand, Cell, LANES, LaneCell};
use crate::thread::contact::{
    CONTACTS_MAX, Candidates, Complementarity, Motion, Rows, Side, nearest_on_obstacle, nearest_segments,
    passed_through, place, tangents,
};
use crate::thread::elastic::{Press, SurfacePlace};
use crate::thread::rod::{Iterate, assemble};
use crate::thread::state::{ContactKey, ContactMemory, ThreadState};
use crate::thread::{Reaction, Surroundings, ThreadMaterial, ThreadReport, ThreadStepError, Trouble};

/// Linearised solutions of one part of a step at most.
const ITERATIONS_MAX: usize = 6;
/// A part of a step is not divided more often than this.
const HALVINGS_MAX: u32 = 8;
/// Parts of one step at most.
const PARTS_MAX: usize = 512;
/// Lengths of edges that differ from what their tension says by more than this ask for another iteration.
const LENGTH_TOLERANCE: f64 = 2e-4;
/// And by more than this for shorter steps.
const LENGTH_ERROR_MAX: f64 = 2e-2;
/// A place obeys its law when it would not have to move further than this for it \[m\].
const TOLERANCE: f64 = 1e-9;

/// A contact that is solved for.
#[derive(Clone, Debug)]
struct Active {
    key: ContactKey,
    rows: Rows,
    friction: f64,
    /// Between the surfaces, and how far they have been drawn from where they stick, before this iteration \[m\].
    offset: [f64; 3],
    force: [f64; 3],
    compliance: f64,
    /// On the obstacle \[m\].
    surface: Point3<f64>,
    drawn: [f64; 2],
    /// On the elastic body.
    gives: Option<SurfacePlace>,
}

/// Room for a step.
#[derive(Clone, Debug, Default)]
pub(crate) struct Island {
    /// Over the contacts of one linearised solution at most.
    pub sweeps_max: usize,
    trial: ThreadState,
    at: Iterate,
    matrix: BlockBand,
    right: Vec<Cell>,
    moved: Vec<Cell>,
    lanes: Vec<LaneCell>,
    reach: Vec<f64>,
    motions: Vec<Motion>,
    candidates: Candidates,
    active: Vec<Active>,
    former: Vec<ContactMemory>,
    problem: Complementarity,
    hold_forces: Vec<Vector3<f64>>,
    hold_torques: Vec<f64>,
    reactions: Vec<Reaction>,
    /// On the elastic body, at the end of the last part.
    presses: Vec<Press>,
    /// Triangles of the elastic body that are near to edges.
    near: Vec<elastic::Near>,
    places: Vec<elastic::GivingPlace>,
}

/// What went wrong in a part of the step, and where.
struct Failure {
    node: usize,
    why: Trouble,
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

    pub fn presses(&self) -> &[Press] {
        &self.presses
    }

    /// Takes the state on by `dt`, or leaves it as it is.
    pub fn step(
        &mut self,
        material: &ThreadMaterial,
        state: &mut ThreadState,
        dt: f64,
        around: &Surroundings,
    ) -> Result<ThreadReport, ThreadStepError> {
        self.trial.clone_from(state);
        self.hold_forces.clear();
        self.hold_forces.resize(around.holds.len(), Vector3::zeros());
        self.hold_torques.clear();
        self.hold_torques.resize(around.twist_holds.len(), 0.0);
        self.reactions.clear();
        self.reactions.resize(around.obstacles.len(), Reaction::default());
        self.presses.clear();
        if let Some(elastic) = &around.elastic {
            self.presses.extend_from_slice(elastic.body.presses());
        }
        let mut report = ThreadReport::default();
        // Time in units of the shortest part, so that the parts add up exactly.
        let whole = 1_u32 << HALVINGS_MAX;
        let (mut done, mut part) = (0_u32, whole);
        while done < whole {
            part = part.min(whole - done);
            let fractions = [f64::from(done) / f64::from(whole), f64::from(done + part) / f64::from(whole)];
            match self.part(material, dt * (fractions[1] - fractions[0]), fractions, around, &mut report) {
                Ok(()) => {
                    self.feel(material, fractions, around);
                    self.press(around);
                    self.finish(dt * (fractions[1] - fractions[0]));
                    done += part;
                    report.parts += 1;
                    // A part is as long as the place it begins at allows: 1, 2, 4 … of the shortest.
                    while done < whole && part < whole && done % (2 * part) == 0 {
                        part *= 2;
                    }
                }
                Err(failure) if part == 1 || report.parts >= PARTS_MAX => {
                    return Err(ThreadStepError::Diverged {
                        node: failure.node,
                        time: dt * fractions[0],
                        why: failure.why,
                        shortest: dt * (fractions[1] - fractions[0]),
                    });
                }
                Err(_) => part /= 2,
            }
        }
        report.contacts = self.active.len();
        report.strain_max = self
            .at
            .lengths
            .iter()
            .zip(&self.trial.rest_lengths)
            .fold(0.0, |most, (length, rest)| f64::max(most, (length / rest - 1.0).abs()));
        report.penetration_max = self.penetration(material, around);
        std::mem::swap(&mut self.trial, state);
        Ok(report)
    }

    /// Finds the end of one part of the step.
    fn part(
        &mut self,
        material: &ThreadMaterial,
        dt: f64,
        fractions: [f64; 2],
        around: &Surroundings,
        report: &mut ThreadReport,
    ) -> Result<(), Failure> {
        let diameter = material.diameter();
        self.at.begin(&self.trial);
        self.motions.clear();
        self.motions.extend(around.obstacles.iter().map(|obstacle| Motion::of(obstacle, fractions)));
        self.reach.clear();
        let speeds = self.trial.velocities.iter().map(|v| 1.2 * dt * v.norm() + 0.1 * diameter);
        self.reach.extend(speeds);
        for hold in around.holds {
            let left = 1.0 - fractions[0];
            let way =
                (hold.to - self.trial.positions[hold.node]).norm() * (fractions[1] - fractions[0]) / left;
            self.reach[hold.node] = self.reach[hold.node].max(1.1 * way);
        }
        self.seek(material, around);
        self.former.clone_from(&self.trial.contacts);
        for iteration in 0..ITERATIONS_MAX {
            report.iterations += 1;
            self.linearise(material, dt, fractions, around)?;
            self.gather(material, around);
            self.answer(around, report)?;
            let largest = self.advance(material)?;
            self.guard(material, around)?;
            let error = self.length_error(material);
            if error.1 < LENGTH_TOLERANCE && largest < 0.1 * diameter {
                break;
            }
            if iteration + 1 == ITERATIONS_MAX && error.1 > LENGTH_ERROR_MAX {
                return Err(Failure { node: error.0, why: Trouble::Strain });
            }
        }
        Ok(())
    }

    fn seek(&mut self, material: &ThreadMaterial, around: &Surroundings) {
        self.candidates.find(
            &self.trial.positions,
            &self.reach,
            &self.trial.rest_lengths,
            material.radius,
            0.2 * material.diameter(),
            around.obstacles,
            &self.motions,
        );
        if !around.spared.is_empty() {
            let spared = |key: &ContactKey| {
                around.spared.iter().any(|spared| {
                    key.with as usize == spared.obstacle + 1
                        && (spared.edges[0]..=spared.edges[1]).contains(&(key.edge as usize))
                })
            };
            self.candidates.found.retain(|candidate| !spared(&candidate.key));
        }
    }

    /// The rod's matrix and forces at the iterate, with what holds and pulls it.
    fn linearise(
        &mut self,
        material: &ThreadMaterial,
        dt: f64,
        fractions: [f64; 2],
        around: &Surroundings,
    ) -> Result<(), Failure> {
        let nodes = self.at.positions.len();
        self.matrix.clear(nodes);
        self.right.clear();
        self.right.resize(nodes, Cell::zeros());
        assemble(material, &self.trial, &self.at, dt, &around.gravity, &mut self.matrix, &mut self.right);
        for load in around.loads {
            for k in 0..3 {
                self.right[load.node][k] += load.force[k];
            }
        }
        let share = (fractions[1] - fractions[0]) / (1.0 - fractions[0]);
        for hold in around.holds {
            let (pull, slips) = self.pull(hold, share);
            for k in 0..3 {
                self.right[hold.node][k] += pull[k];
                if !slips {
                    self.matrix.diagonal[hold.node][(k, k)] += hold.stiffness;
                }
            }
        }
        for hold in around.twist_holds {
            let edge = hold.edge;
            let stiffness = boundary::twist_hold_stiffness(material, self.trial.rest_lengths[edge]);
            self.right[edge][3] += stiffness * self.turn_left(hold, share);
            self.matrix.diagonal[edge][(3, 3)] += stiffness;
        }
        self.matrix.factor().map_err(|node| Failure {
            node,
            why: if self.at.positions[node].iter().all(|x| x.is_finite()) {
                Trouble::NotPositive
            } else {
                Trouble::NotFinite
            },
        })
    }

    /// The candidates that are near, as rows, with the forces of the last time.
    fn gather(&mut self, material: &ThreadMaterial, around: &Surroundings) {
        self.moved.clear();
        self.moved.extend((0..self.at.positions.len()).map(|node| {
            let by = self.at.positions[node] - self.trial.positions[node];
            Cell::new(by.x, by.y, by.z, self.at.turns.get(node).copied().unwrap_or(0.0))
        }));
        self.active.clear();
        self.near.clear();
        for index in 0..self.candidates.found.len() {
            let key = self.candidates.found[index].key;
            if around.elastic.is_some_and(|elastic| key.with as usize == elastic.obstacle + 1) {
                self.note_near(material, around, key);
            } else if let Some(active) = self.contact(material, around, key) {
                self.active.push(active);
            }
        }
        self.touch_elastic(material, around);
    }

    fn contact(&self, material: &ThreadMaterial, around: &Surroundings, key: ContactKey) -> Option<Active> {
        let edge = key.edge as usize;
        let of = |edge: usize| [self.at.positions[edge], self.at.positions[edge + 1]];
        let room = |edge: usize| self.reach[edge].max(self.reach[edge + 1]);
        let radius = material.radius;
        let side = |edge: usize, along: f64, arm: Vector3<f64>| Side {
            edge,
            along,
            arm,
            tangent: self.at.tangents[edge],
            length: self.at.lengths[edge],
        };
        if key.with == 0 {
            let other = key.feature as usize;
            let (first, second) = (of(edge), of(other));
            let [s, t] = nearest_segments(&first, &second);
            let between = place(&first, s) - place(&second, t);
            let distance = between.norm();
            let gap = distance - 2.0 * radius;
            if gap > room(edge) + room(other) || distance.is_nan() || distance < 1e-9 {
                return None;
            }
            let normal = between / distance;
            let [t1, t2] = tangents(&normal, &self.at.tangents[edge]);
            let rows = Rows::new(
                &side(edge, s, normal * -radius),
                Some(&side(other, t, normal * radius)),
                [normal, t1, t2],
            );
            return Some(self.remembered(
                key,
                rows,
                material.friction,
                gap,
                None,
                material.contact_compliance,
            ));
        }
        let index = key.with as usize - 1;
        let obstacle = &around.obstacles[index];
        let found = nearest_on_obstacle(&obstacle.shape, &self.motions[index], key.feature, &of(edge))?;
        let gap = found.distance - radius;
        let way = (found.surface[1] - found.surface[0]).norm();
        if gap > room(edge) + way {
            return None;
        }
        let [t1, t2] = tangents(&found.normal, &self.at.tangents[edge]);
        let rows = Rows::new(&side(edge, found.along, found.normal * -radius), None, [found.normal, t1, t2]);
        let compliance = 0.5 * material.contact_compliance;
        Some(self.remembered(key, rows, obstacle.friction, gap, Some(found.surface), compliance))
    }

    fn remembered(
        &self,
        key: ContactKey,
        rows: Rows,
        friction: f64,
        gap: f64,
        surface: Option<[Point3<f64>; 2]>,
        compliance: f64,
    ) -> Active {
        let of = |list: &[ContactMemory]| {
            list.binary_search_by_key(&key, |memory| memory.key).ok().map(|place| list[place])
        };
        // The force of the last iteration, but drawn from where it stuck when the step began.
        let force = of(&self.former).map_or(Vector3::zeros(), |memory| memory.force);
        let drawn = of(&self.trial.contacts).map_or(Vector3::zeros(), |memory| memory.drawn);
        let apart = rows.apart(&self.moved);
        let carried = surface.map_or(Vector3::zeros(), |[from, to]| to - from);
        let slipped = |k: usize| drawn.dot(&rows.directions[k]) + apart[k] - carried.dot(&rows.directions[k]);
        let normal = force.dot(&rows.directions[0]).max(0.0);
        let held = [force.dot(&rows.directions[1]), force.dot(&rows.directions[2])];
        let size = held[0].hypot(held[1]);
        let scale = if size > friction * normal { friction * normal / size } else { 1.0 };
        Active {
            key,
            rows,
            friction,
            offset: [gap, slipped(1), slipped(2)],
            force: [normal, held[0] * scale, held[1] * scale],
            compliance,
            surface: surface.map_or_else(Point3::origin, |[_, to]| to),
            drawn: [0.0; 2],
            gives: None,
        }
    }

    /// Solves the linearised island: leaves the change of the iterate in `moved` and forces in the contacts.
    fn answer(&mut self, around: &Surroundings, report: &mut ThreadReport) -> Result<(), Failure> {
        let push = |active: &[Active], right: &mut [Cell]| {
            for contact in active {
                contact.rows.push(&contact.force, right);
            }
        };
        // With the forces of the last time the rod moves nearly as it will; what it then stays away from is no contact.
        self.moved.clone_from(&self.right);
        push(&self.active, &mut self.moved);
        self.matrix.solve(&mut self.moved);
        let moved = &self.moved;
        self.active.retain(|contact| {
            contact.force[0] > 0.0 || contact.offset[0] + contact.rows.apart(moved)[0] < 3e-5
        });
        if self.active.is_empty() {
            return Ok(());
        }
        if let Some(beyond) = self.active.get(CONTACTS_MAX) {
            return Err(Failure { node: beyond.key.edge as usize, why: Trouble::TooManyContacts });
        }
        self.active.sort_unstable_by_key(|contact| (contact.rows.first(), contact.key));
        self.pose();
        self.yield_to_each_other(around);
        let sweeps = self.problem.solve(self.sweeps_max.max(1), TOLERANCE);
        report.sweeps += sweeps;
        for (place, contact) in self.active.iter_mut().enumerate() {
            contact.force.copy_from_slice(&self.problem.force[3 * place..][..3]);
            let gap = self.problem.gap(place);
            let sticks =
                contact.force[1].hypot(contact.force[2]) < contact.friction * contact.force[0] * (1.0 - 1e-9);
            for k in 0..2 {
                let yields = contact.compliance * contact.force[k + 1];
                contact.drawn[k] = if sticks { gap[k + 1] - yields } else { -yields };
            }
        }
        self.moved.clone_from(&self.right);
        push(&self.active, &mut self.moved);
        self.matrix.solve(&mut self.moved);
        Ok(())
    }

    /// The contacts' problem: their compliance through the rod, column by column.
    fn pose(&mut self) {
        let places = self.active.len();
        let rows = 3 * places;
        self.problem.clear(places);
        for (place, contact) in self.active.iter().enumerate() {
            self.problem.frictions.push(contact.friction);
            let apart = contact.rows.apart(&self.moved);
            for k in 0..3 {
                self.problem.force[3 * place + k] = contact.force[k];
                self.problem.gap[3 * place + k] =
                    contact.offset[k] + apart[k] + contact.compliance * contact.force[k];
            }
        }
        let nodes = self.right.len();
        for first in (0..rows).step_by(LANES) {
            let columns = first..(first + LANES).min(rows);
            // In their order along the thread, none of the places that are still to be read lies before the first.
            let from = self.active[first / 3].rows.first();
            self.lanes.clear();
            self.lanes.resize(nodes, [[0.0; LANES]; 4]);
            for column in columns.clone() {
                let of = &self.active[column / 3].rows;
                for k in 0..of.used {
                    let cell = &mut self.lanes[of.nodes[k] as usize];
                    for axis in 0..4 {
                        cell[axis][column - first] += of.cells[column % 3][k][axis];
                    }
                }
            }
            self.matrix.solve_lanes(&mut self.lanes, from, from);
            for (place, contact) in self.active.iter().enumerate().skip(first / 3) {
                for k in 0..3 {
                    let apart = contact.rows.apart_lanes(k, &self.lanes);
                    let row = 3 * place + k;
                    for column in columns.clone() {
                        let value = apart[column - first];
                        self.problem.compliance[column * rows + row] = value;
                        self.problem.compliance[row * rows + column] = value;
                    }
                }
            }
        }
        for (place, contact) in self.active.iter().enumerate() {
            for k in 0..3 {
                self.problem.compliance[(3 * place + k) * (rows + 1)] += contact.compliance;
            }
        }
    }

    /// Moves the iterate; returns how far the furthest node moved \[m\].
    fn advance(&mut self, material: &ThreadMaterial) -> Result<f64, Failure> {
        let at = &mut self.at;
        let change =
            |moved: &[Cell], node: usize| Vector3::new(moved[node][0], moved[node][1], moved[node][2]);
        for edge in 0..at.tangents.len() {
            let rest = self.trial.rest_lengths[edge];
            let by = at.tangents[edge].dot(&(change(&self.moved, edge + 1) - change(&self.moved, edge)));
            at.tensions[edge] = material.axial_stiffness / rest * (at.lengths[edge] + by - rest);
        }
        let mut largest = 0.0_f64;
        let edges = at.turns.len();
        for node in 0..at.positions.len() {
            let by = change(&self.moved, node);
            let size = by.norm();
            if !size.is_finite() || !self.moved[node][3].is_finite() {
                return Err(Failure { node, why: Trouble::NotFinite });
            }
            largest = largest.max(size);
            at.positions[node] += by;
            if node < edges {
                at.turns[node] += self.moved[node][3];
            }
        }
        at.follow(&self.trial);
        self.former.clear();
        self.former.extend(self.active.iter().filter(|contact| contact.force[0] > 0.0).map(|contact| {
            let drawn = contact.rows.vector(&[0.0, contact.drawn[0], contact.drawn[1]]);
            ContactMemory { key: contact.key, force: contact.rows.vector(&contact.force), drawn }
        }));
        self.former.sort_unstable_by_key(|memory| memory.key);
        Ok(largest)
    }

    /// Refuses an iterate that has passed through something; looks further where it moved further than foreseen.
    fn guard(&mut self, material: &ThreadMaterial, around: &Surroundings) -> Result<(), Failure> {
        let mut further = false;
        for node in 0..self.at.positions.len() {
            let way = (self.at.positions[node] - self.trial.positions[node]).norm();
            if way > self.reach[node] {
                self.reach[node] = 1.5 * way;
                further = true;
            }
        }
        if further {
            self.seek(material, around);
        }
        let (from, to) = (&self.trial.positions, &self.at.positions);
        for candidate in &self.candidates.found {
            if passed_through(&candidate.key, from, to, material.radius, around.obstacles, &self.motions) {
                return Err(Failure { node: candidate.key.edge as usize, why: Trouble::PassedThrough });
            }
        }
        Ok(())
    }

    /// The edge whose length differs most from what its tension says, and by how much of it.
    fn length_error(&self, material: &ThreadMaterial) -> (usize, f64) {
        let mut worst = (0, 0.0);
        for (edge, length) in self.at.lengths.iter().enumerate() {
            let rest = self.trial.rest_lengths[edge];
            let error = (length / rest - 1.0 - self.at.tensions[edge] / material.axial_stiffness).abs();
            // Not a number is the worst of all.
            if error > worst.1 || error.is_nan() {
                worst = (edge, if error.is_nan() { f64::INFINITY } else { error });
            }
        }
        worst
    }

    /// How deep the contacts are where they ended \[m\].
    fn penetration(&self, material: &ThreadMaterial, around: &Surroundings) -> f64 {
        let of = |edge: u32| [self.at.positions[edge as usize], self.at.positions[edge as usize + 1]];
        self.active.iter().fold(0.0, |most, contact| {
            let key = &contact.key;
            let gap = if contact.gives.is_some() {
                // The surface has given way since it was measured: what is left is what the contact itself does.
                -contact.compliance * contact.force[0]
            } else if key.with == 0 {
                let (first, second) = (of(key.edge), of(key.feature));
                let [s, t] = nearest_segments(&first, &second);
                (place(&first, s) - place(&second, t)).norm() - 2.0 * material.radius
            } else {
                let index = key.with as usize - 1;
                let shape = &around.obstacles[index].shape;
                nearest_on_obstacle(shape, &self.motions[index], key.feature, &of(key.edge))
                    .map_or(0.0, |found| found.distance - material.radius)
            };
            f64::max(most, -gap)
        })
    }

    /// Makes the iterate the state at the end of the part.
    fn finish(&mut self, dt: f64) {
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

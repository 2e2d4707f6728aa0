//! One step of needle, thread and tissue together: Newton iterations on needle and rod, each ending in forces that obey
//! the laws of everything between them through the compliance of all three (as Duriez, Guébert, Marchal, Cotin, Grisoni
//! 2009, *Interactive simulation of flexible needle insertions based on constraint models*, do with tissue and needle).
// One index walks several arrays.
#![allow(clippy::needless_range_loop)]

use nalgebra::{Isometry3, Matrix3, Point3, Vector3, Vector6};

use super::Around;
use super::material::Resistance;
use super::rows::{self, Mobility, Row, Site};
use super::solve::{Bounded, Law};
use super::state::{SutureState, Tip};
use super::tissue::{Place, Tissue};
use crate::needle::{NeedleState, Solid};
use crate::thread::block_band::{BlockBand, Cell, Factors, LANES, LaneCell};
use crate::thread::rod::{Iterate, assemble};
use crate::thread::{ThreadMaterial, ThreadState};

/// Linearised solutions of one part of a step at most.
const ITERATIONS_MAX: usize = 8;
/// Nothing moves further in the last of them \[m\].
const TOLERANCE: f64 = 1e-8;
/// At the last iteration nothing moves further than this, or the step is divided \[m\].
const WANDER_MAX: f64 = 1e-4;
/// Lengths of the thread's edges may differ from what their tension says by this share, and at the last iteration by more.
const LENGTH_TOLERANCE: f64 = 1e-6;
const LENGTH_ERROR_MAX: f64 = 2e-2;
/// Further than this the needle does not go in one part \[m\], nor turn \[rad\].
const WAY_MAX: f64 = 2.5e-3;
const TURN_MAX: f64 = 0.2;
/// How far along a thread the place at a point of the tissue is looked for from where it was \[m\].
const WINDOW: f64 = 6e-3;

/// Where the rows of each kind begin.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Layout {
    pub swage: Option<usize>,
    pub grips: usize,
    pub holds: usize,
    /// Three of each place: along, and two across.
    pub channel: usize,
    /// Three: along or off the surface, and two across.
    pub tip: Option<usize>,
}

/// What does not change in a step.
#[derive(Clone, Copy)]
pub(super) struct Bodies<'a> {
    pub solid: &'a Solid,
    pub thread: Option<&'a ThreadMaterial>,
    pub resistance: &'a Resistance,
}

/// Room for a step.
#[derive(Clone, Debug, Default)]
pub(super) struct Island {
    /// The needle at the iterate.
    pub needle: Option<NeedleState>,
    pub at: Iterate,
    pub rows: Vec<Row>,
    pub layout: Layout,
    pub problem: Bounded,
    /// Of the places in the channel, in their order.
    pub sites: Vec<Site>,
    pub iterations: usize,
    pub rounds: usize,
    matrix: BlockBand,
    factors: Factors,
    right: Vec<Cell>,
    moved: Vec<Cell>,
    lanes: Vec<LaneCell>,
    places: Vec<Place>,
    mutual: Vec<Matrix3<f64>>,
    answers: Vec<Vector6<f64>>,
    forces: Vec<f64>,
}

impl Island {
    /// Finds where everything is at the end of a part of the step that begins at `start`: in `needle`, `at`, `rows`,
    /// `problem` and the tissue.
    pub fn find(
        &mut self,
        of: &Bodies<'_>,
        start: &SutureState,
        tissue: &mut Tissue,
        dt: f64,
        fractions: [f64; 2],
        around: &Around<'_>,
    ) -> Result<(), &'static str> {
        self.needle = Some(start.needle);
        if let Some(thread) = &start.thread {
            self.at.begin(thread);
        }
        self.forces.clear();
        self.problem.forget();
        self.sites.clear();
        self.mutual(start, tissue);
        for iteration in 0..ITERATIONS_MAX {
            self.iterations += 1;
            let furthest = self.iterate(of, start, tissue, dt, fractions, around)?;
            let error = self.length_error(of, start);
            if furthest < TOLERANCE && error < LENGTH_TOLERANCE {
                return Ok(());
            }
            if iteration + 1 == ITERATIONS_MAX && !(error <= LENGTH_ERROR_MAX && furthest <= WANDER_MAX) {
                return Err("the iterations do not end");
            }
        }
        Ok(())
    }

    /// One linearised solution; how far it moved anything \[m\].
    fn iterate(
        &mut self,
        of: &Bodies<'_>,
        start: &SutureState,
        tissue: &mut Tissue,
        dt: f64,
        fractions: [f64; 2],
        around: &Around<'_>,
    ) -> Result<f64, &'static str> {
        let needle = self.needle.unwrap_or(start.needle);
        let mobility = Mobility::new(of.solid, &needle, dt).ok_or("the needle has no inertia")?;
        let left = self.residual(of, start, &needle, dt, &around.gravity);
        self.linearise(of, start, dt, around)?;
        self.gather(of, start, tissue, &needle, fractions, around);
        let free = mobility.answer(&left);
        self.moved.clone_from(&self.right);
        if start.thread.is_some() {
            self.factors.solve(&mut self.moved);
        }
        self.pose(tissue, &mobility, &free);
        let solved = self.problem.solve();
        self.rounds += solved.rounds;
        if !solved.settled {
            return Err("the forces were not found");
        }
        self.forces.clone_from(&self.problem.force);
        // Everything moves by these forces.
        let mut load = left;
        self.moved.clone_from(&self.right);
        for (row, force) in self.rows.iter().zip(&self.problem.force) {
            load += row.needle * *force;
            for (node, cell) in &row.thread[..row.used] {
                self.moved[*node as usize] += cell * *force;
            }
        }
        if start.thread.is_some() {
            self.factors.solve(&mut self.moved);
        }
        let by = mobility.answer(&load);
        let (way, turn) = (by.fixed_rows::<3>(0).norm(), by.fixed_rows::<3>(3).norm());
        if !(way <= WAY_MAX && turn <= TURN_MAX) {
            return Err("the needle would go too far");
        }
        self.needle = Some(rows::carried(&needle, &by));
        let mut furthest = way.max(turn * of.solid.shape().radius);
        if let (Some(material), Some(thread)) = (of.thread, &start.thread) {
            furthest = furthest.max(self.advance(material, thread)?);
        }
        let (rows, forces, places) = (&self.rows, &self.problem.force, &self.places);
        tissue.deform(rows.iter().zip(forces).filter_map(|(row, force)| {
            let (place, direction) = row.tissue?;
            Some((places[place as usize], direction * -*force))
        }));
        Ok(furthest)
    }

    /// Force and torque that the needle's inertia and weight leave over at the iterate.
    fn residual(
        &self,
        of: &Bodies<'_>,
        start: &SutureState,
        needle: &NeedleState,
        dt: f64,
        gravity: &Vector3<f64>,
    ) -> Vector6<f64> {
        let moved = needle.center - start.needle.center;
        let turned = (needle.rotation * start.needle.rotation.inverse()).scaled_axis();
        let force = (start.needle.momentum - moved * (of.solid.mass() / dt)) / dt + gravity * of.solid.mass();
        let torque = (start.needle.angular_momentum - needle.inertia(of.solid) * turned / dt) / dt;
        Vector6::new(force.x, force.y, force.z, torque.x, torque.y, torque.z)
    }

    /// The rod's matrix, factored, and its forces.
    fn linearise(
        &mut self,
        of: &Bodies<'_>,
        start: &SutureState,
        dt: f64,
        around: &Around<'_>,
    ) -> Result<(), &'static str> {
        let (Some(material), Some(thread)) = (of.thread, &start.thread) else {
            self.right.clear();
            return Ok(());
        };
        let nodes = self.at.positions.len();
        self.matrix.clear(nodes);
        self.right.clear();
        self.right.resize(nodes, Cell::zeros());
        assemble(material, thread, &self.at, dt, &around.gravity, &mut self.matrix, &mut self.right);
        for load in around.loads {
            for k in 0..3 {
                self.right[load.node][k] += load.force[k];
            }
        }
        self.factors.find(&self.matrix, None).map_err(|_| "the thread's matrix is not positive definite")
    }

    /// All rows at the iterate.
    fn gather(
        &mut self,
        of: &Bodies<'_>,
        start: &SutureState,
        tissue: &Tissue,
        needle: &NeedleState,
        fractions: [f64; 2],
        around: &Around<'_>,
    ) {
        self.rows.clear();
        self.layout = Layout::default();
        if start.thread.is_some() {
            self.layout.swage = Some(0);
            self.rows.extend(rows::swage(of.solid, needle, &self.at, start.swage_turn));
        }
        self.layout.grips = self.rows.len();
        for grip in around.grips {
            let wanted = between(&grip.from, &grip.to, fractions[1]);
            self.rows.extend(rows::grip(needle, &wanted, grip));
        }
        self.layout.holds = self.rows.len();
        if let Some(thread) = &start.thread {
            let share = (fractions[1] - fractions[0]) / (1.0 - fractions[0]);
            for hold in around.holds {
                let from = thread.positions[hold.node];
                self.rows.extend(rows::hold(&self.at, hold, &(from + (hold.to - from) * share)));
            }
        }
        self.layout.channel = self.rows.len();
        for index in 0..start.channel.len() {
            self.pass(of, start, tissue, needle, index);
        }
        if start.tip != Tip::Free {
            self.layout.tip = Some(self.rows.len());
            self.tip(of, start, tissue, needle);
        }
        if self.forces.len() == self.rows.len() {
            self.rows.iter_mut().zip(&self.forces).for_each(|(row, force)| row.force = *force);
        }
    }

    /// The rows of a place in the channel: along, with friction, and two across.
    fn pass(
        &mut self,
        of: &Bodies<'_>,
        start: &SutureState,
        tissue: &Tissue,
        needle: &NeedleState,
        index: usize,
    ) {
        let point = &start.channel[index];
        let now = tissue.now(&point.place);
        let last = self.sites.get(index).map_or(point.along, |site| site.along);
        let site = self.site(of.solid, needle, start.thread.as_ref(), &now, last);
        if index < self.sites.len() {
            self.sites[index] = site;
        } else {
            self.sites.push(site);
        }
        let [n1, n2] = rows::across(&site.tangent, &(needle.pose() * Vector3::z()));
        let at = self.rows.len() as u32;
        let mut three = rows::passage(&site, &needle.center, (index as u32, &now), &[site.tangent, n1, n2]);
        let length = share_of_channel(start, index, of.solid.shape().length());
        let material = of.resistance;
        let (grip, coefficient) = match site.edge {
            None => (material.needle_grip, material.needle_friction),
            Some(_) => (material.thread_grip, material.thread_friction),
        };
        let radius = match (site.edge, of.thread) {
            (Some(_), Some(thread)) => thread.radius,
            _ => of.solid.shape().wire_radius,
        };
        let share = length.max(0.25 * of.resistance.spacing);
        for row in &mut three[1..] {
            row.compliance += tissue.gives_way_about(radius) / share;
        }
        three[0].gap = point.stuck - site.along;
        three[0].law = Law::Rubs { base: grip * length, coefficient, by: [at + 1, at + 2] };
        for row in &mut three {
            row.force = row.tissue.map_or(0.0, |(_, direction)| point.force.dot(&direction));
        }
        self.rows.extend(three);
    }

    /// Needle or thread at a point of the world, near an arc length.
    fn site(
        &self,
        solid: &Solid,
        needle: &NeedleState,
        thread: Option<&ThreadState>,
        at: &Point3<f64>,
        near: f64,
    ) -> Site {
        let pose = needle.pose();
        let along = solid.nearest(&pose.inverse_transform_point(at));
        let rest = thread.map_or(&[][..], |thread| &thread.rest_lengths);
        let is_near = near > -2e-3 && along >= 0.0 && (along - near).abs() < 5e-3;
        if rest.is_empty() || is_near {
            let tangent = pose * solid.tangent(along);
            return Site { along, point: pose * solid.point(along), tangent, edge: None };
        }
        // Lengths are those at rest: what stretches farther up does not slide here.
        let mut best: Option<(f64, Site)> = None;
        let mut begin = 0.0;
        for (edge, rest) in rest.iter().enumerate() {
            if begin > WINDOW - near {
                break;
            }
            if begin + rest >= -near - WINDOW {
                let (from, tangent, length) =
                    (self.at.positions[edge], self.at.tangents[edge], self.at.lengths[edge]);
                let share = ((at - from).dot(&tangent) / length).clamp(0.0, 1.0);
                let point = from + tangent * (share * length);
                let distance = (at - point).norm_squared();
                if best.as_ref().is_none_or(|(known, _)| distance < *known) {
                    let along = -(begin + share * rest);
                    let site = Site { along, point, tangent: -tangent, edge: Some((edge, share)) };
                    best = Some((distance, site));
                }
            }
            begin += rest;
        }
        let last = self.at.lengths.len().saturating_sub(1);
        best.map_or_else(
            || Site {
                along: -begin,
                point: self.at.positions[last + 1],
                tangent: -self.at.tangents[last],
                edge: Some((last, 1.0)),
            },
            |(_, site)| site,
        )
    }

    /// The rows of the tip where it meets the tissue.
    fn tip(&mut self, of: &Bodies<'_>, start: &SutureState, tissue: &Tissue, needle: &NeedleState) {
        let pose = needle.pose();
        let length = of.solid.shape().length();
        let tangent = pose * of.solid.tangent(length);
        let Some(place) = start.tip.place() else { return };
        let now = tissue.now(place);
        let site = Site { along: length, point: pose * of.solid.point(length), tangent, edge: None };
        let material = of.resistance;
        let at = self.rows.len() as u32;
        let (first, law) = match start.tip {
            Tip::Touching(_, triangle) => {
                (tissue.normal(triangle), Law::Within { least: 0.0, most: material.puncture_force })
            }
            Tip::Leaving(..) => (tangent, Law::Within { least: -material.exit_force, most: 0.0 }),
            _ => (tangent, Law::Within { least: -material.cutting_force, most: 0.0 }),
        };
        // The first direction across is that in which the tip goes, so that friction acts along one row of the two.
        let along = match start.tip {
            Tip::Touching(..) => tangent,
            _ => pose * Vector3::z(),
        };
        let [n1, n2] = rows::across(&first, &along);
        let number = start.channel.len() as u32;
        let mut three = rows::passage(&site, &needle.center, (number, &now), &[first, n1, n2]);
        three[0].law = law;
        if matches!(start.tip, Tip::Touching(..)) {
            for row in &mut three[1..] {
                row.law = Law::Rubs { base: 0.0, coefficient: material.needle_friction, by: [at, at] };
            }
        }
        for row in &mut three {
            row.force = row.tissue.map_or(0.0, |(_, direction)| start.tip_force.dot(&direction));
        }
        self.rows.extend(three);
    }

    /// How places of the tissue move each other; only of those that are new.
    fn mutual(&mut self, start: &SutureState, tissue: &Tissue) {
        let count = start.channel.len() + usize::from(start.tip.place().is_some());
        let place = |index: usize| {
            start
                .channel
                .get(index)
                .map(|point| point.place)
                .or(start.tip.place().copied())
                .unwrap_or_default()
        };
        let same = self.places.len() == count;
        if !same {
            self.places.clear();
            self.mutual.clear();
            self.mutual.resize(count * count, Matrix3::zeros());
        }
        for i in 0..count {
            let own = place(i);
            let known = same && self.places[i] == own;
            if same {
                self.places[i] = own;
            } else {
                self.places.push(own);
            }
            if known {
                continue;
            }
            for j in 0..count {
                let between = tissue.between(&own, &place(j));
                self.mutual[i * count + j] = between;
                self.mutual[j * count + i] = between.transpose();
            }
        }
    }

    /// The problem of the rows: their compliance through all three bodies, and their gaps without forces.
    fn pose(&mut self, tissue: &Tissue, mobility: &Mobility, free: &Vector6<f64>) {
        let count = self.rows.len();
        self.problem.clear(count);
        self.answers.clear();
        self.answers.extend(self.rows.iter().map(|row| mobility.answer(&row.needle)));
        for (index, row) in self.rows.iter().enumerate() {
            let mut gap = row.gap + row.moved(free, &self.moved);
            if let Some((place, direction)) = row.tissue {
                let place = &self.places[place as usize];
                gap += direction.dot(&(tissue.now(place) - tissue.at_rest(place)));
            }
            self.problem.gap[index] = gap;
            self.problem.force[index] = row.force;
            self.problem.laws.push(row.law);
        }
        let places = self.places.len();
        for (i, row) in self.rows.iter().enumerate() {
            for j in 0..=i {
                let other = &self.rows[j];
                let mut value = row.needle.dot(&self.answers[j]);
                if let (Some((a, u)), Some((b, v))) = (row.tissue, other.tissue) {
                    value += u.dot(&(self.mutual[a as usize * places + b as usize] * v));
                }
                if i == j {
                    value += row.compliance;
                }
                self.problem.compliance[i * count + j] = value;
                self.problem.compliance[j * count + i] = value;
            }
        }
        self.through_thread();
    }

    /// Adds what the rows give way through the thread.
    fn through_thread(&mut self) {
        let (count, nodes) = (self.rows.len(), self.right.len());
        if nodes == 0 {
            return;
        }
        let mut done = 0;
        while done < count {
            // The next rows that act on the thread, as many as are solved for at once.
            let mut columns = [usize::MAX; LANES];
            let mut used = 0;
            while done < count && used < LANES {
                if self.rows[done].used > 0 {
                    columns[used] = done;
                    used += 1;
                }
                done += 1;
            }
            if used == 0 {
                break;
            }
            self.lanes.clear();
            self.lanes.resize(nodes, [[0.0; LANES]; 4]);
            let mut from = nodes - 1;
            for (lane, &column) in columns[..used].iter().enumerate() {
                let row = &self.rows[column];
                for (node, cell) in &row.thread[..row.used] {
                    from = from.min(*node as usize);
                    for axis in 0..4 {
                        self.lanes[*node as usize][axis][lane] += cell[axis];
                    }
                }
            }
            self.factors.solve_lanes(&mut self.lanes, from, 0);
            for (index, row) in self.rows.iter().enumerate() {
                for (node, cell) in &row.thread[..row.used] {
                    let moved = &self.lanes[*node as usize];
                    for (lane, &column) in columns[..used].iter().enumerate() {
                        let by: f64 = (0..4).map(|axis| cell[axis] * moved[axis][lane]).sum();
                        // One triangle, and the other from it, so that rounding does not tell them apart.
                        if index >= column {
                            self.problem.compliance[index * count + column] += by;
                            if index > column {
                                self.problem.compliance[column * count + index] += by;
                            }
                        }
                    }
                }
            }
        }
    }

    /// Moves the thread's iterate; how far the furthest node moved \[m\].
    fn advance(&mut self, material: &ThreadMaterial, start: &ThreadState) -> Result<f64, &'static str> {
        let at = &mut self.at;
        let change = |node: usize| self.moved[node].fixed_rows::<3>(0).into_owned();
        for edge in 0..at.tangents.len() {
            let rest = start.rest_lengths[edge];
            let by = at.tangents[edge].dot(&(change(edge + 1) - change(edge)));
            at.tensions[edge] = material.axial_stiffness / rest * (at.lengths[edge] + by - rest);
        }
        let edges = at.turns.len();
        let mut largest = 0.0_f64;
        for node in 0..at.positions.len() {
            let by = change(node);
            if !by.iter().all(|x| x.is_finite()) || !self.moved[node][3].is_finite() {
                return Err("the thread's motion is not finite");
            }
            largest = largest.max(by.norm());
            at.positions[node] += by;
            if node < edges {
                at.turns[node] += self.moved[node][3];
            }
        }
        at.follow(start);
        Ok(largest)
    }

    /// By which share the length of an edge differs at most from what its tension says.
    fn length_error(&self, of: &Bodies<'_>, start: &SutureState) -> f64 {
        let (Some(material), Some(thread)) = (of.thread, &start.thread) else { return 0.0 };
        let mut worst = 0.0_f64;
        for (edge, length) in self.at.lengths.iter().enumerate() {
            let strain = length / thread.rest_lengths[edge] - 1.0;
            let error = (strain - self.at.tensions[edge] / material.axial_stiffness).abs();
            worst = if error.is_nan() { f64::INFINITY } else { worst.max(error) };
        }
        worst
    }

    /// Force of a row's three on needle or thread \[N\].
    pub fn force(&self, first: usize) -> Vector3<f64> {
        let of = |k: usize| {
            self.rows[first + k]
                .tissue
                .map_or_else(Vector3::zeros, |(_, direction)| direction * self.problem.force[first + k])
        };
        of(0) + of(1) + of(2)
    }
}

/// The length of channel that a place stands for \[m\]: half of the way to either neighbour in its bite, and all of that
/// to a tip in the tissue.
pub(super) fn share_of_channel(state: &SutureState, index: usize, needle_length: f64) -> f64 {
    let own = &state.channel[index];
    let neighbour = |other: Option<&super::state::ChannelPoint>| {
        other.filter(|other| other.bite == own.bite).map(|other| (other.along - own.along).abs())
    };
    let before = index.checked_sub(1).and_then(|before| neighbour(state.channel.get(before)));
    let after = neighbour(state.channel.get(index + 1));
    let ahead = match (after, &state.tip) {
        (Some(way), _) => 0.5 * way,
        (None, Tip::Inside(_) | Tip::Leaving(..)) if index + 1 == state.channel.len() => {
            (needle_length - own.along).max(0.0)
        }
        _ => 0.0,
    };
    ahead + 0.5 * before.unwrap_or(0.0)
}

/// Between two poses.
fn between(from: &Isometry3<f64>, to: &Isometry3<f64>, share: f64) -> Isometry3<f64> {
    from.try_lerp_slerp(to, share, 1e-12).unwrap_or(*to)
}

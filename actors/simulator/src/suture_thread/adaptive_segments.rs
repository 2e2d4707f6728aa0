//! Adaptive segments: short edges where strands are near to each other or the thread bends sharply, long ones elsewhere
//! (Spillmann, Teschner, *An adaptive contact model for the robust simulation of knots*, 2008).
//!
//! An edge is divided on its straight line, which deepens no contact and keeps length, mass and momentum; two edges are
//! merged only where the thread is almost straight and free of contact, so that the chord cannot pass through anything.

use nalgebra::Vector3;
use trocar_collision::primitive::closest_segments;

use super::bishop_frame::{angle_about, perpendicular, transport, turn, unwrapped};
use super::contact::nearest_segments;
use super::state::{ContactKey, ContactMemory, NODES_MAX, ThreadState};
use super::{Thread, ThreadError};

/// Growth rate of the edge length with distance from where edges have to be short.
const GRADE: f64 = 0.5;
/// Largest angle between consecutive edges before they are to be shorter \[rad\].
const TURN_MAX: f64 = 0.5;
/// An edge is divided when it exceeds its target length by this factor; halves of an edge just above the target would
/// be needlessly short.
const TOLERATED: f64 = 1.15;
/// Two edges are merged where their angle is below this \[rad\],
const STRAIGHT: f64 = 0.1;
/// and their total length below this fraction of the target, so that they are not divided again at once.
const HYSTERESIS: f64 = 0.95;

/// Target edge lengths.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fineness {
    /// Near another strand and in sharp bends \[m\], to within a seventh: 1.3 diameters hold a knot.
    pub fine: f64,
    /// Elsewhere, to within a seventh \[m\].
    pub coarse: f64,
    /// Surface distance at which strands count as near \[m\]: more than they approach before the next adaptation.
    pub reach: f64,
    /// Maximum number of nodes; once it is reached, no edge is divided.
    pub nodes_max: usize,
}

/// New numbers of nodes and edges.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Renumbered {
    /// New number of each former node, unless it was removed.
    pub nodes: Vec<Option<u32>>,
    /// First and last new edge in place of each former edge.
    pub edges: Vec<[u32; 2]>,
    /// Edges that stayed too long because of the node limit.
    pub too_long: usize,
}

impl Fineness {
    fn check(&self) -> Result<(), ThreadError> {
        let length = |name, value: f64| {
            let is_valid = value.is_finite() && value > 0.0;
            if is_valid { Ok(()) } else { Err(ThreadError::Material { name, value, valid: "above 0" }) }
        };
        length("fine", self.fine)?;
        length("reach", self.reach)?;
        if !(self.coarse >= self.fine && self.coarse.is_finite()) {
            return Err(ThreadError::Material {
                name: "coarse",
                value: self.coarse,
                valid: "not below 'fine'",
            });
        }
        if self.nodes_max > NODES_MAX {
            return Err(ThreadError::Nodes(self.nodes_max));
        }
        Ok(())
    }
}

impl Thread {
    /// Adapts edge lengths to the targets; the nodes in `keep` stay. `None` when nothing changes.
    ///
    /// # Errors
    /// The name of an invalid target. The thread is then unchanged.
    pub fn adapt(&mut self, fineness: &Fineness, keep: &[usize]) -> Result<Option<Renumbered>, ThreadError> {
        self.state.adapt(self.material.radius, fineness, keep)
    }
}

impl ThreadState {
    /// The same for the state of a thread of `radius` \[m\].
    ///
    /// # Errors
    /// The name of an invalid target. The state is then unchanged.
    pub fn adapt(
        &mut self,
        radius: f64,
        fineness: &Fineness,
        keep: &[usize],
    ) -> Result<Option<Renumbered>, ThreadError> {
        fineness.check()?;
        let wanted = wanted_lengths(self, radius, fineness);
        let Some((state, renumbered)) = divided(self, &wanted, fineness.nodes_max, keep) else {
            return Ok(None);
        };
        state.check(radius)?;
        *self = state;
        Ok(Some(renumbered))
    }
}

/// Target length of each edge \[m\].
fn wanted_lengths(state: &ThreadState, radius: f64, fineness: &Fineness) -> Vec<f64> {
    let (points, rest) = (&state.positions, &state.rest_lengths);
    let mut wanted = vec![fineness.coarse; rest.len()];
    let arcs = state.arcs();
    // Sweep along x, sorted by lower bounds: an edge that begins beyond the end of another is not near to it, nor are
    // later ones.
    let near = 2.0 * radius + fineness.reach;
    let range = |edge: usize| {
        let (a, b) = (points[edge].x, points[edge + 1].x);
        [a.min(b), a.max(b)]
    };
    let mut order: Vec<usize> = (0..rest.len()).filter(|edge| state.joins(*edge)).collect();
    order.sort_by(|&a, &b| range(a)[0].total_cmp(&range(b)[0]).then(a.cmp(&b)));
    for (place, &first) in order.iter().enumerate() {
        for &second in &order[place + 1..] {
            if range(second)[0] > range(first)[1] + near {
                break;
            }
            let [low, high] = [first.min(second), first.max(second)];
            let segment = |edge: usize| [points[edge], points[edge + 1]];
            if high < low + 2 || (wanted[low] <= fineness.fine && wanted[high] <= fineness.fine) {
                continue;
            }
            let distance = closest_segments(&segment(low), &segment(high)).distance_squared.sqrt();
            // Distance along the strand rules out neighbours; a strand that returns to itself is nearer in space than
            // along itself.
            let along = arcs[high] - arcs[low + 1];
            if distance < near && along > std::f64::consts::FRAC_PI_2 * distance.max(2.0 * radius) {
                (wanted[low], wanted[high]) = (fineness.fine, fineness.fine);
            }
        }
    }
    let inner = |node: &usize| state.joins(node - 1) && state.joins(*node);
    for node in (1..rest.len()).filter(inner) {
        let turns = turning(state, node);
        if turns > TURN_MAX {
            let length = (0.5 * (rest[node - 1] + rest[node]) * TURN_MAX / turns).max(fineness.fine);
            (node - 1..=node).for_each(|edge| wanted[edge] = wanted[edge].min(length));
        }
    }
    for edge in (1..rest.len()).filter(inner) {
        wanted[edge] = wanted[edge].min(wanted[edge - 1] + GRADE * rest[edge - 1]);
    }
    for edge in (1..rest.len()).rev().filter(inner) {
        wanted[edge - 1] = wanted[edge - 1].min(wanted[edge] + GRADE * rest[edge]);
    }
    wanted
}

fn tangent(state: &ThreadState, edge: usize) -> Vector3<f64> {
    (state.positions[edge + 1] - state.positions[edge]).normalize()
}

/// Turning angle of the thread at a node \[rad\].
fn turning(state: &ThreadState, node: usize) -> f64 {
    let (before, after) = (tangent(state, node - 1), tangent(state, node));
    before.cross(&after).norm().atan2(before.dot(&after))
}

/// What happens to an edge.
#[derive(Clone, Copy, Debug, PartialEq)]
enum EdgeAction {
    /// It is divided into this many.
    Parts(usize),
    /// It is merged with the next one.
    Joined,
}

/// The state with edges no longer than their targets and no shorter than necessary; `None` where nothing changes.
fn divided(
    state: &ThreadState,
    wanted: &[f64],
    nodes_max: usize,
    keep: &[usize],
) -> Option<(ThreadState, Renumbered)> {
    let count = wanted.len();
    let mut touched = vec![false; count];
    for contact in &state.contacts {
        touched[contact.key.edge as usize] = true;
        if contact.key.with == 0 {
            touched[contact.key.feature as usize] = true;
        }
    }
    // Each thread has at least three nodes.
    let mut spare: Vec<usize> = vec![0; count];
    for [first, last] in state.threads() {
        spare[first..last].fill(last + 1 - first - 3);
    }
    let mut joined = 0;
    let mut actions = vec![EdgeAction::Parts(1); count];
    let mut edge = 0;
    let mut nodes = count + 1;
    while edge + 1 < count {
        let sum = state.rest_lengths[edge] + state.rest_lengths[edge + 1];
        if edge > 0 && !state.joins(edge - 1) {
            joined = 0;
        }
        let joins = state.joins(edge)
            && state.joins(edge + 1)
            && sum <= HYSTERESIS * wanted[edge].min(wanted[edge + 1])
            && !touched[edge]
            && !touched[edge + 1]
            && !keep.contains(&(edge + 1))
            && turning(state, edge + 1) < STRAIGHT
            && joined < spare[edge];
        if joins {
            joined += 1;
            actions[edge] = EdgeAction::Joined;
            nodes -= 1;
            edge += 1;
        }
        edge += 1;
    }
    let mut too_long = 0;
    for edge in 0..count {
        let is_second = edge > 0 && actions[edge - 1] == EdgeAction::Joined;
        if actions[edge] == EdgeAction::Joined || is_second {
            continue;
        }
        let parts = (state.rest_lengths[edge] / (TOLERATED * wanted[edge])).ceil();
        let parts = parts.clamp(1.0, NODES_MAX as f64) as usize;
        if parts > 1 && nodes + parts - 1 <= nodes_max {
            actions[edge] = EdgeAction::Parts(parts);
            nodes += parts - 1;
        } else {
            too_long += usize::from(parts > 1);
        }
    }
    if actions.iter().all(|action| *action == EdgeAction::Parts(1)) {
        return None;
    }
    let mut to = ThreadState::default();
    let mut renumbered = Renumbered { too_long, ..Renumbered::default() };
    to.positions.push(state.positions[0]);
    to.twists.push(0.0);
    renumbered.nodes.push(Some(0));
    let mut edge = 0;
    while edge < count {
        let first = to.rest_lengths.len() as u32;
        match actions[edge] {
            EdgeAction::Parts(parts) => {
                divide(state, edge, parts, &mut to);
                renumbered.edges.push([first, first + parts as u32 - 1]);
            }
            EdgeAction::Joined => {
                join(state, edge, &mut to);
                renumbered.edges.extend([[first; 2]; 2]);
                renumbered.nodes.push(None);
                edge += 1;
            }
        }
        renumbered.nodes.push(Some(to.rest_lengths.len() as u32));
        edge += 1;
    }
    twist(state, &actions, &mut to);
    carry_velocities(state, &actions, &mut to);
    to.contacts = contacts(state, &renumbered);
    Some((to, renumbered))
}

/// Appends the parts of a divided edge, and the nodes at their ends.
fn divide(state: &ThreadState, edge: usize, parts: usize, to: &mut ThreadState) {
    let [from, end] = [state.positions[edge], state.positions[edge + 1]];
    for part in 1..=parts {
        let is_last = part == parts;
        to.positions.push(if is_last { end } else { from.lerp(&end, part as f64 / parts as f64) });
        to.rest_lengths.push(state.rest_lengths[edge] / parts as f64);
        to.directors.push(state.directors[edge]);
        to.twists.push(if is_last { state.twists[edge + 1] } else { 0.0 });
        to.spins.push(state.spins[edge]);
        to.tensions.push(state.tensions[edge]);
    }
}

/// Rotation of a merged edge against the first of the two, as a fraction of the twist between them: the average of
/// both, but the ends of the thread keep theirs.
fn turned(state: &ThreadState, edge: usize) -> f64 {
    let rest = &state.rest_lengths;
    if edge == 0 || !state.joins(edge - 1) {
        0.0
    } else if !state.joins(edge + 2) {
        1.0
    } else {
        rest[edge + 1] / (rest[edge] + rest[edge + 1])
    }
}

/// Appends one edge in place of two.
fn join(state: &ThreadState, edge: usize, to: &mut ThreadState) {
    let rest = [state.rest_lengths[edge], state.rest_lengths[edge + 1]];
    let second = rest[1] / (rest[0] + rest[1]);
    let mean = |of: &[f64]| of[edge] * (1.0 - second) + of[edge + 1] * second;
    let chord = (state.positions[edge + 2] - state.positions[edge]).normalize();
    let carried = transport(&tangent(state, edge), &chord, &state.directors[edge]);
    to.positions.push(state.positions[edge + 2]);
    to.rest_lengths.push(rest[0] + rest[1]);
    let director =
        turn(&perpendicular(&carried, &chord), &chord, turned(state, edge) * state.twists[edge + 1]);
    to.directors.push(perpendicular(&director, &chord));
    to.twists.push(state.twists[edge + 2]);
    to.spins.push(mean(&state.spins));
    to.tensions.push(mean(&state.tensions));
}

/// Twists at the ends of merged edges: the twist between the two is distributed to the nodes before and after.
fn twist(state: &ThreadState, actions: &[EdgeAction], to: &mut ThreadState) {
    let mut more = vec![0.0; to.twists.len()];
    let (mut at, mut edge) = (0, 0);
    while edge < actions.len() {
        match actions[edge] {
            EdgeAction::Parts(parts) => at += parts,
            EdgeAction::Joined => {
                let share = turned(state, edge);
                more[at] += share * state.twists[edge + 1];
                more[at + 1] += (1.0 - share) * state.twists[edge + 1];
                at += 1;
                edge += 1;
            }
        }
        edge += 1;
    }
    let last = to.rest_lengths.len();
    for (node, more) in more.iter().enumerate().take(last).skip(1) {
        if !to.joins(node - 1) || !to.joins(node) {
            to.twists[node] = 0.0;
            continue;
        }
        let (before, after) = (tangent(to, node - 1), tangent(to, node));
        let carried = transport(&before, &after, &to.directors[node - 1]);
        let angle = angle_about(&carried, &to.directors[node], &after);
        to.twists[node] = unwrapped(angle, to.twists[node] + more);
    }
    (to.twists[0], to.twists[last]) = (0.0, 0.0);
}

/// Velocities: interpolated at new nodes; neighbours of a removed node take over its momentum.
fn carry_velocities(state: &ThreadState, actions: &[EdgeAction], to: &mut ThreadState) {
    let half = |rest: &[f64], node: usize| {
        let before = if node > 0 { rest[node - 1] } else { 0.0 };
        0.5 * (before + rest.get(node).copied().unwrap_or(0.0))
    };
    // Momentum over mass per length, edge by edge: half of each edge belongs to either end.
    let mut momentum = vec![Vector3::zeros(); to.positions.len()];
    let (mut at, mut edge) = (0, 0);
    while edge < actions.len() {
        let velocity = |k: usize| state.velocities[edge + k];
        let rest = |k: usize| state.rest_lengths[edge + k];
        match actions[edge] {
            EdgeAction::Parts(parts) => {
                let length = rest(0) / parts as f64;
                for part in 0..parts {
                    for k in 0..2 {
                        let share = (part + k) as f64 / parts as f64;
                        let own = velocity(0) * (1.0 - share) + velocity(1) * share;
                        momentum[at + part + k] += own * (0.5 * length);
                    }
                }
                at += parts;
            }
            EdgeAction::Joined => {
                // Of the removed node's momentum, each end takes the part of its added mass.
                momentum[at] += velocity(0) * (0.5 * rest(0)) + velocity(1) * (0.5 * rest(1));
                momentum[at + 1] += velocity(2) * (0.5 * rest(1)) + velocity(1) * (0.5 * rest(0));
                at += 1;
                edge += 1;
            }
        }
        edge += 1;
    }
    to.velocities = momentum.iter().enumerate().map(|(node, of)| of / half(&to.rest_lengths, node)).collect();
}

/// Contact memories under their new numbers.
fn contacts(state: &ThreadState, renumbered: &Renumbered) -> Vec<ContactMemory> {
    let mut found: Vec<ContactMemory> = Vec::with_capacity(state.contacts.len());
    for contact in &state.contacts {
        let key = contact.key;
        let [first, last] = renumbered.edges[key.edge as usize];
        if key.with == 0 {
            let segment = |edge: u32| [state.positions[edge as usize], state.positions[edge as usize + 1]];
            let [s, t] = nearest_segments(&segment(key.edge), &segment(key.feature));
            let part = |edge: u32, share: f64| {
                let [first, last] = renumbered.edges[edge as usize];
                first + ((share * f64::from(last - first + 1)) as u32).min(last - first)
            };
            let key = ContactKey { with: 0, edge: part(key.edge, s), feature: part(key.feature, t) };
            found.push(ContactMemory { key, ..*contact });
        } else {
            // The position along the former edge is not stored: the new contact starts without slip.
            let parts = f64::from(last - first + 1);
            found.extend((first..=last).map(|edge| ContactMemory {
                key: ContactKey { edge, ..key },
                force: contact.force / parts,
                drawn: contact.drawn,
            }));
        }
    }
    found.sort_unstable_by_key(|contact| contact.key);
    found.dedup_by_key(|contact| contact.key);
    found
}

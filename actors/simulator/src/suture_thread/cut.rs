//! Cutting or breaking a thread: it becomes two threads, whose new ends are one diameter apart, so that they do not
//! touch. The piece between them is removed, as if crushed by the blades.
//!
//! A closed thread becomes one open thread, numbered from the cut.
//!
//! The cut is placed with an accuracy of half a radius; the edge is divided there. The remaining nodes keep position,
//! velocity, twist and tension.

use nalgebra::{Point3, Vector3};

use super::state::{ContactKey, ContactMemory, ThreadState, end_of};
use super::{Thread, ThreadError};

/// Least length of either piece, in radii: a shorter one has no node at which it could bend.
const LEAST: f64 = 4.0;
/// A node nearer than this to the new end becomes the end, in radii; no edge is shorter.
const NEAR: f64 = 0.5;

/// Where a thread is cut.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CutAt {
    /// The edge.
    pub edge: usize,
    /// The fraction along the edge.
    pub share: f64,
}

/// New numbers of nodes and edges after a cut.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CutNumbering {
    /// New number of each former node, unless it was removed.
    pub nodes: Vec<Option<u32>>,
    /// New number of each former edge that was left whole.
    pub edges: Vec<Option<u32>>,
    /// Where each new node lies: a former edge and the fraction along it; the very last node lies at the end of the
    /// last edge.
    pub at: Vec<CutAt>,
}

impl CutNumbering {
    /// Values at the new nodes, interpolated from the values `before` at the former nodes \[m\].
    #[must_use]
    pub fn places(&self, before: &[Point3<f64>]) -> Vec<Point3<f64>> {
        self.at.iter().map(|at| between(before, at)).collect()
    }
}

fn between(points: &[Point3<f64>], at: &CutAt) -> Point3<f64> {
    // An unmoved node keeps its value bit for bit.
    match at.share {
        0.0 => points[at.edge],
        1.0 => points[end_of(at.edge, points.len())],
        share => points[at.edge].lerp(&points[end_of(at.edge, points.len())], share),
    }
}

impl Thread {
    /// Cuts the thread. `None` where it is already cut, or a piece would be shorter than two diameters.
    ///
    /// # Errors
    /// The number of nodes would exceed the limit. The thread is then unchanged.
    pub fn cut(&mut self, at: CutAt) -> Result<Option<CutNumbering>, ThreadError> {
        self.state.cut(self.material.radius, at)
    }
}

impl ThreadState {
    /// The same for the state of a thread of `radius` \[m\].
    ///
    /// # Errors
    /// As [`Thread::cut`].
    pub fn cut(&mut self, radius: f64, at: CutAt) -> Result<Option<CutNumbering>, ThreadError> {
        let Some((state, parted)) = parted(self, radius, at) else { return Ok(None) };
        state.check(radius)?;
        *self = state;
        Ok(Some(parted))
    }
}

/// Nodes of one remaining piece, as lengths from its outer end \[m\], chosen from the existing nodes; the piece is
/// `end` long \[m\], or slightly less.
fn side(lengths: &[f64], end: f64, radius: f64) -> Vec<f64> {
    let mut kept: Vec<f64> = lengths.iter().copied().take_while(|at| *at <= end).collect();
    // The outer end is always kept: a piece is longer than that.
    if kept.last().is_some_and(|last| end - last > NEAR * radius) {
        kept.push(end);
    }
    if let [first, last] = kept[..] {
        kept.insert(1, 0.5 * (first + last));
    }
    kept
}

fn parted(state: &ThreadState, radius: f64, cut: CutAt) -> Option<(ThreadState, CutNumbering)> {
    if !state.joins(cut.edge) || !(0.0..=1.0).contains(&cut.share) {
        return None;
    }
    if state.is_closed() {
        return opened(state, radius, cut);
    }
    let [first, last] = state.threads().find(|[first, last]| (*first..*last).contains(&cut.edge))?;
    let mut arcs = vec![0.0];
    arcs.extend(state.rest_lengths[first..last].iter().scan(0.0, |arc, rest| {
        *arc += rest;
        Some(*arc)
    }));
    let length = arcs[last - first];
    let at = arcs[cut.edge - first] + cut.share * state.rest_lengths[cut.edge];
    if at.min(length - at) < LEAST * radius {
        return None;
    }
    let before = side(&arcs, at - radius, radius);
    let lengths: Vec<f64> = arcs.iter().rev().map(|arc| length - arc).collect();
    let mut after = side(&lengths, length - at - radius, radius);
    after.reverse();
    // Back to edges and fractions. Arc lengths of nodes are unchanged, except for rounding when measured from the other
    // end.
    let place = |arc: f64| {
        let near = 1e-9 * length;
        let edge = arcs.partition_point(|node| *node <= arc + near).clamp(1, arcs.len() - 1) - 1;
        let share = (arc - arcs[edge]) / state.rest_lengths[first + edge];
        let share = if share * state.rest_lengths[first + edge] <= near { 0.0 } else { share };
        let is_end = arc + near >= length;
        CutAt { edge: first + edge, share: if is_end { 1.0 } else { share } }
    };
    let own = |node: usize| CutAt { edge: node, share: 0.0 };
    let count = state.positions.len();
    let mut nodes: Vec<CutAt> = (0..first).map(own).collect();
    nodes.extend(before.iter().map(|arc| place(*arc)));
    let end = nodes.len() - 1;
    nodes.extend(after.iter().map(|from_end| place(length - from_end)));
    nodes.extend((last + 1..count).map(own));
    if let Some(node) = nodes.last_mut()
        && node.share == 0.0
        && node.edge + 1 == count
    {
        *node = CutAt { edge: node.edge - 1, share: 1.0 };
    }
    Some(rebuilt(state, nodes, end))
}

/// A closed thread without a piece of one diameter about the cut.
fn opened(state: &ThreadState, radius: f64, cut: CutAt) -> Option<(ThreadState, CutNumbering)> {
    let count = state.positions.len();
    let length = state.rest_length();
    if length - 2.0 * radius < 2.0 * LEAST * radius {
        return None;
    }
    // Arc lengths from the cut of all nodes, from the one after it to the one before it.
    let mut arc = (1.0 - cut.share) * state.rest_lengths[cut.edge];
    let mut whole: Vec<(f64, usize)> = Vec::with_capacity(count);
    for step in 0..count {
        let node = (cut.edge + 1 + step) % count;
        whole.push((arc, node));
        arc += state.rest_lengths[node];
    }
    // A place between two of them, or before the first or after the last.
    let place = |at: f64| {
        let before = whole.partition_point(|(arc, _)| *arc <= at);
        let (from, edge) = match before.checked_sub(1) {
            Some(index) => whole[index],
            None => (whole[0].0 - state.rest_lengths[cut.edge], cut.edge),
        };
        CutAt { edge, share: ((at - from) / state.rest_lengths[edge]).clamp(0.0, 1.0) }
    };
    let near = NEAR * radius;
    let (begin, end) = (radius, length - radius);
    let mut kept: Vec<CutAt> = Vec::with_capacity(count + 2);
    let inner = whole.iter().filter(|(arc, _)| (begin - 1e-9 * length..=end + 1e-9 * length).contains(arc));
    let inner: Vec<(f64, usize)> = inner.copied().collect();
    // A node nearer than that to the new end becomes the end.
    if inner.first().is_none_or(|(arc, _)| arc - begin > near) {
        kept.push(place(begin));
    }
    kept.extend(inner.iter().map(|(_, node)| CutAt { edge: *node, share: 0.0 }));
    if inner.last().is_none_or(|(arc, _)| end - arc > near) {
        kept.push(place(end));
    }
    if kept.len() < 3 {
        return None;
    }
    let last = kept.len() - 1;
    Some(rebuilt(state, kept, last))
}

/// The state with these nodes, and a dummy edge between node `end` and the next.
fn rebuilt(state: &ThreadState, at: Vec<CutAt>, end: usize) -> (ThreadState, CutNumbering) {
    let mut to = ThreadState::default();
    let count = state.positions.len();
    let edges = state.rest_lengths.len();
    let mut parted = CutNumbering { nodes: vec![None; count], edges: vec![None; edges], at: Vec::new() };
    let node_of = |at: &CutAt| match at.share {
        0.0 => Some(at.edge),
        1.0 => Some(state.after(at.edge)),
        _ => None,
    };
    for (index, place) in at.iter().enumerate() {
        let node = node_of(place);
        if let Some(node) = node {
            parted.nodes[node] = Some(index as u32);
        }
        to.positions.push(between(&state.positions, place));
        let [from, next] = [place.edge, state.after(place.edge)].map(|node| state.velocities[node]);
        to.velocities.push(if place.share == 1.0 { next } else { from.lerp(&next, place.share) });
        let is_end = index == end || index == end + 1 || (state.is_closed() && index == 0);
        to.twists.push(node.filter(|_| !is_end).map_or(0.0, |node| state.twists[node]));
        let Some(following) = at.get(index + 1) else { break };
        if index == end {
            to.rest_lengths.push(0.0);
            to.directors.push(Vector3::x());
            to.spins.push(0.0);
            to.tensions.push(0.0);
            continue;
        }
        // A node at the end of an edge begins the next edge.
        let edge = if place.share == 1.0 { state.after(place.edge) } else { place.edge };
        let from = if place.share == 1.0 { 0.0 } else { place.share };
        let until = if following.edge == edge { following.share } else { 1.0 };
        if (from, until) == (0.0, 1.0) {
            parted.edges[edge] = Some(index as u32);
        }
        to.rest_lengths.push(state.rest_lengths[edge] * (until - from));
        to.directors.push(state.directors[edge]);
        to.spins.push(state.spins[edge]);
        to.tensions.push(state.tensions[edge]);
    }
    to.contacts = state.contacts.iter().filter_map(|contact| renumbered(contact, &parted.edges)).collect();
    to.contacts.sort_unstable_by_key(|contact| contact.key);
    parted.at = at;
    (to, parted)
}

/// A contact's memory under its new numbers; none for an edge that is no longer whole.
fn renumbered(contact: &ContactMemory, edges: &[Option<u32>]) -> Option<ContactMemory> {
    let now = |edge: u32| edges.get(edge as usize).copied().flatten();
    let edge = now(contact.key.edge)?;
    let feature = if contact.key.with == 0 { now(contact.key.feature)? } else { contact.key.feature };
    if contact.key.with == 0 && edge > feature {
        // The first of two edges is the one with the lower number; its force is that of the other one, reversed.
        let key = ContactKey { edge: feature, feature: edge, ..contact.key };
        return Some(ContactMemory { key, force: -contact.force, drawn: -contact.drawn });
    }
    Some(ContactMemory { key: ContactKey { edge, feature, ..contact.key }, ..*contact })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::suture_thread::ThreadMaterial;

    fn thread(edges: usize, length: f64) -> ThreadState {
        let points: Vec<_> =
            (0..=edges).map(|k| Point3::new(length * k as f64 / edges as f64, 0.0, 0.0)).collect();
        let mut state = ThreadState::at_rest(&points);
        for (k, velocity) in state.velocities.iter_mut().enumerate() {
            *velocity = Vector3::new(0.0, k as f64, 0.0);
        }
        state
    }

    #[test]
    fn a_cut_is_where_it_was_made_and_its_ends_are_a_diameter_apart() {
        let radius = ThreadMaterial::silk_2_0().radius;
        for share in [0.0, 0.02, 0.3, 0.5, 0.97, 1.0] {
            let before = thread(20, 0.04);
            let mut state = before.clone();
            let parted = state.cut(radius, CutAt { edge: 7, share }).expect("sound").expect("a cut");
            let pieces: Vec<_> = state.threads().collect();
            assert_eq!(pieces.len(), 2, "{share}");
            let [end, begin] = [pieces[0][1], pieces[1][0]];
            let middle = state.positions[end].x.midpoint(state.positions[begin].x);
            let wanted = 0.002 * (7.0 + share);
            assert!((middle - wanted).abs() <= 0.5 * radius, "{share}: at {middle} m of {wanted} m");
            let gap = state.positions[begin].x - state.positions[end].x;
            assert!((2.0 - 1e-9..=3.0).contains(&(gap / radius)), "{share}: {gap} m");
            // The pieces keep their current lengths.
            for [first, last] in pieces {
                let (long, lies): (f64, f64) = (
                    state.rest_lengths[first..last].iter().sum(),
                    state.positions[last].x - state.positions[first].x,
                );
                assert!((long - lies).abs() < 1e-12, "{share}");
            }
            for (node, now) in parted.nodes.iter().enumerate() {
                if let Some(now) = now {
                    assert_eq!(state.positions[*now as usize], before.positions[node]);
                    assert_eq!(state.velocities[*now as usize], before.velocities[node]);
                }
            }
            assert_eq!(parted.places(&before.positions), state.positions);
        }
    }

    #[test]
    fn no_piece_is_shorter_than_two_diameters_and_each_can_bend() {
        let radius = ThreadMaterial::silk_2_0().radius;
        let mut state = thread(10, 0.03);
        for share in [0.0, 0.1, 0.19] {
            assert_eq!(state.cut(radius, CutAt { edge: 0, share }), Ok(None), "{share}");
            assert_eq!(state.cut(radius, CutAt { edge: 9, share: 1.0 - share }), Ok(None), "{share}");
        }
        for share in [0.21, 0.9] {
            let mut one = state.clone();
            one.cut(radius, CutAt { edge: 0, share }).expect("sound").expect("a cut");
            assert!(one.threads().all(|[first, last]| last - first >= 2), "{share}");
        }
        // Until no piece is long enough to be cut.
        let mut cuts = 0;
        let longest = |state: &ThreadState| {
            let edges = (0..state.rest_lengths.len()).filter(|edge| state.joins(*edge));
            edges.max_by(|a, b| state.rest_lengths[*a].total_cmp(&state.rest_lengths[*b]))
        };
        while let Some(edge) = longest(&state) {
            if state.cut(radius, CutAt { edge, share: 0.5 }).expect("sound").is_none() {
                break;
            }
            cuts += 1;
            assert!(cuts < 100);
        }
        assert!(cuts > 8, "{cuts}");
        assert_eq!(state.cut(radius, CutAt { edge: 10_000, share: 0.5 }), Ok(None));
        let parting = (0..state.rest_lengths.len()).find(|edge| !state.joins(*edge)).expect("one");
        assert_eq!(state.cut(radius, CutAt { edge: parting, share: 0.5 }), Ok(None));
    }

    #[test]
    fn contacts_of_whole_edges_keep_what_they_remember() {
        let radius = ThreadMaterial::silk_2_0().radius;
        let mut state = thread(20, 0.04);
        let contact = |with, edge, feature| ContactMemory {
            key: ContactKey { with, edge, feature },
            force: Vector3::x() * f64::from(edge),
            drawn: Vector3::zeros(),
        };
        state.contacts = vec![contact(0, 2, 15), contact(0, 9, 17), contact(1, 12, 5), contact(2, 9, 0)];
        let parted = state.cut(radius, CutAt { edge: 9, share: 0.5 }).expect("sound").expect("a cut");
        let now = |edge: usize| parted.edges[edge].expect("whole");
        let found: Vec<_> =
            state.contacts.iter().map(|of| (of.key.with, of.key.edge, of.key.feature)).collect();
        assert_eq!(found, [(0, 2, now(15)), (1, now(12), 5)]);
        assert_eq!(state.contacts[1].force.x, 12.0);
    }
}

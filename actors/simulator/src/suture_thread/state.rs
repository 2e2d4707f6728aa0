//! State of a thread: all that a bit-exact restart needs.

use nalgebra::{Point3, Vector3};
use serde::{Deserialize, Serialize};

use super::ThreadError;
use super::bishop_frame::{angle_about, perpendicular, transport, turn};
use crate::clone_in_place::clones_in_place;

/// Maximum number of nodes.
pub const NODES_MAX: usize = 4096;

/// Least number of nodes of a closed thread: with fewer, a node would be coupled with another one from both sides.
pub const CLOSED_NODES_MIN: usize = 5;

/// The node at the end of an edge, of a thread of so many nodes.
#[inline]
#[must_use]
pub(crate) fn end_of(edge: usize, nodes: usize) -> usize {
    if edge + 1 < nodes { edge + 1 } else { 0 }
}

/// Arc length that separates two threads of one state \[m\]: longer than any thread.
pub(crate) const PARTED: f64 = 1e3;

/// State of a thread of `n` nodes and `n − 1` edges, or of several threads whose nodes are numbered consecutively, or of one
/// closed thread of as many edges as nodes, whose last edge leads back to the first node. The
/// edge from the last node of one thread to the first node of the next is a dummy: it has no length, mass or stiffness.
#[derive(Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ThreadState {
    /// Positions of the nodes, in the world \[m\].
    pub positions: Vec<Point3<f64>>,
    /// Velocities of the nodes \[m/s\].
    pub velocities: Vec<Vector3<f64>>,
    /// Rest lengths of the edges \[m\]; 0 for a dummy edge between threads.
    pub rest_lengths: Vec<f64>,
    /// Material director of each edge: a unit vector perpendicular to it.
    pub directors: Vec<Vector3<f64>>,
    /// Twist angle of each edge's director against that of the previous edge \[rad\], whole turns included; one per
    /// node, 0 at the end nodes. Of a closed thread the first one is that of the seam, against the last edge.
    pub twists: Vec<f64>,
    /// Spin of each edge about its own axis \[rad/s\].
    pub spins: Vec<f64>,
    /// Tensions of the edges \[N\]; positive when stretched.
    pub tensions: Vec<f64>,
    /// Warm-start memory of the contacts, sorted by key.
    pub contacts: Vec<ContactMemory>,
}

clones_in_place!(ThreadState {
    positions,
    velocities,
    rest_lengths,
    directors,
    twists,
    spins,
    tensions,
    contacts,
});

/// The two features in contact.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct ContactKey {
    /// 0 for another edge of the thread, else 1 + the obstacle's index.
    pub with: u32,
    /// The edge of the thread.
    pub edge: u32,
    /// The other edge, or the triangle of the obstacle.
    pub feature: u32,
}

/// What a contact keeps from step to step.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ContactMemory {
    /// The contact's features.
    pub key: ContactKey,
    /// Force on the edge by the other feature, in the world \[N\].
    pub force: Vector3<f64>,
    /// Displacement of the surfaces from their sticking point, in the world \[m\]: static friction is a spring to that
    /// point, not a function of velocity.
    pub drawn: Vector3<f64>,
}

impl ThreadState {
    /// A thread at rest through `positions` \[m\], unstrained and untwisted.
    #[must_use]
    pub fn at_rest(positions: &[Point3<f64>]) -> Self {
        let n = positions.len();
        let edges = n.saturating_sub(1);
        let mut state = Self {
            positions: positions.to_vec(),
            velocities: vec![Vector3::zeros(); n],
            rest_lengths: positions.windows(2).map(|pair| (pair[1] - pair[0]).norm()).collect(),
            directors: Vec::with_capacity(edges),
            twists: vec![0.0; n],
            spins: vec![0.0; edges],
            tensions: vec![0.0; edges],
            ..Self::default()
        };
        let mut last: Option<(Vector3<f64>, Vector3<f64>)> = None;
        for pair in positions.windows(2) {
            let tangent = (pair[1] - pair[0]).try_normalize(0.0).unwrap_or_else(Vector3::x);
            let director = last.map_or_else(
                || perpendicular(&Vector3::z(), &tangent),
                |(before, director)| perpendicular(&transport(&before, &tangent, &director), &tangent),
            );
            state.directors.push(director);
            last = Some((tangent, director));
        }
        state
    }

    /// A closed thread at rest through `positions` \[m\], whose last edge leads back to the first node: unstrained, and
    /// glued end to end without a turn. A director that is carried once around a loop comes back turned by the loop's
    /// holonomy (Bishop 1975; Fuller 1971); the material closes on itself, so that it is twisted by that angle, by at most
    /// half a turn, in equal parts all around.
    #[must_use]
    pub fn closed_at_rest(positions: &[Point3<f64>]) -> Self {
        let mut state = Self::at_rest(positions);
        let ([.., last], [first, ..]) = (positions, positions) else { return state };
        let n = positions.len();
        let along = first - last;
        state.rest_lengths.push(along.norm());
        state.spins.push(0.0);
        state.tensions.push(0.0);
        let tangent = |edge: usize| {
            let way = positions[(edge + 1) % n] - positions[edge];
            way.try_normalize(0.0).unwrap_or_else(Vector3::x)
        };
        let carried = |from: usize, to: usize, director: &Vector3<f64>| {
            perpendicular(&transport(&tangent(from), &tangent(to), director), &tangent(to))
        };
        let Some(before) = state.directors.last().copied().filter(|_| n >= 3) else { return state };
        state.directors.push(carried(n - 2, n - 1, &before));
        let back = carried(n - 1, 0, &state.directors[n - 1]);
        let holonomy = angle_about(&back, &state.directors[0], &tangent(0));
        let span = |node: usize| 0.5 * (state.rest_lengths[(node + n - 1) % n] + state.rest_lengths[node]);
        let length: f64 = state.rest_lengths.iter().sum();
        let twists: Vec<f64> = (0..n).map(|node| holonomy * span(node) / length).collect();
        let mut turned = 0.0;
        for (edge, twist) in twists.iter().enumerate().skip(1) {
            turned += twist;
            state.directors[edge] = turn(&state.directors[edge], &tangent(edge), turned);
        }
        state.twists = twists;
        state
    }

    /// The same, turned about its own axis by whole turns before it is glued end to end.
    #[must_use]
    pub fn closed_with_turns(positions: &[Point3<f64>], turns: i32) -> Self {
        let mut state = Self::closed_at_rest(positions);
        let n = positions.len();
        if state.twists.len() != state.rest_lengths.len() {
            return state;
        }
        let length: f64 = state.rest_lengths.iter().sum();
        let all = std::f64::consts::TAU * f64::from(turns);
        let mut turned = 0.0;
        for edge in 0..n {
            let span = 0.5 * (state.rest_lengths[(edge + n - 1) % n] + state.rest_lengths[edge]);
            let more = all * span / length;
            state.twists[edge] += more;
            if edge > 0 {
                turned += more;
                let way = positions[(edge + 1) % n] - positions[edge];
                let tangent = way.try_normalize(0.0).unwrap_or_else(Vector3::x);
                state.directors[edge] = turn(&state.directors[edge], &tangent, turned);
            }
        }
        state
    }

    /// Several threads at rest, each through its own positions \[m\], one after the other.
    #[must_use]
    pub fn of_several(threads: &[&[Point3<f64>]]) -> Self {
        let mut all = Self::default();
        for positions in threads {
            let one = Self::at_rest(positions);
            if !all.positions.is_empty() {
                all.rest_lengths.push(0.0);
                all.directors.push(Vector3::x());
                all.spins.push(0.0);
                all.tensions.push(0.0);
            }
            all.positions.extend(one.positions);
            all.velocities.extend(one.velocities);
            all.rest_lengths.extend(one.rest_lengths);
            all.directors.extend(one.directors);
            all.twists.extend(one.twists);
            all.spins.extend(one.spins);
            all.tensions.extend(one.tensions);
        }
        all
    }

    /// Whether an edge is part of a thread, not the dummy edge between two threads.
    #[must_use]
    pub fn joins(&self, edge: usize) -> bool {
        self.rest_lengths.get(edge).is_some_and(|rest| *rest > 0.0)
    }

    /// Whether it is one closed thread.
    #[must_use]
    pub fn is_closed(&self) -> bool {
        !self.positions.is_empty() && self.rest_lengths.len() == self.positions.len()
    }

    /// The node at the end of an edge.
    #[must_use]
    pub fn after(&self, edge: usize) -> usize {
        end_of(edge, self.positions.len())
    }

    /// The edge that ends at a node, if there is one, or the dummy edge between two threads.
    #[must_use]
    pub fn before(&self, node: usize) -> Option<usize> {
        if node == 0 && self.is_closed() { Some(self.positions.len() - 1) } else { node.checked_sub(1) }
    }

    /// The edge before a node at which the thread bends: one with an edge on either side.
    #[must_use]
    pub fn bends(&self, node: usize) -> Option<usize> {
        self.before(node).filter(|before| self.joins(*before) && self.joins(node))
    }

    /// First and last node of each thread.
    pub fn threads(&self) -> impl Iterator<Item = [usize; 2]> + '_ {
        let last = self.positions.len().saturating_sub(1);
        let breaks = || (0..last).filter(|edge| self.rest_lengths[*edge] == 0.0);
        std::iter::once(0)
            .chain(breaks().map(|edge| edge + 1))
            .zip(breaks().chain([last]))
            .map(<[usize; 2]>::from)
    }

    /// Real edges, each with the arc lengths of its ends at rest, from the first node \[m\]; arc lengths of different
    /// threads are further apart than any thread is long.
    pub fn spans(&self) -> impl Iterator<Item = (usize, [f64; 2])> + '_ {
        let spans = self.rest_lengths.iter().enumerate().scan(0.0, |arc, (edge, rest)| {
            let begin = *arc;
            *arc += if *rest > 0.0 { *rest } else { PARTED };
            Some((edge, [begin, *arc], *rest > 0.0))
        });
        spans.filter(|(_, _, joins)| *joins).map(|(edge, span, _)| (edge, span))
    }

    /// Arc lengths of the ends of each thread, as in [`ThreadState::spans`] \[m\].
    pub(crate) fn pieces(&self) -> impl Iterator<Item = [f64; 2]> + '_ {
        let mut spans = self.spans().peekable();
        std::iter::from_fn(move || {
            let (_, [begin, mut end]) = spans.next()?;
            while let Some((_, [_, further])) = spans.next_if(|(_, [next, _])| *next == end) {
                end = further;
            }
            Some([begin, end])
        })
    }

    /// Rest arc length of each node, from the first one \[m\]; nodes of different threads are further apart than any
    /// thread is long.
    pub(crate) fn arcs(&self) -> Vec<f64> {
        let mut arcs = Vec::with_capacity(self.positions.len());
        arcs.push(0.0);
        for rest in &self.rest_lengths {
            arcs.push(arcs[arcs.len() - 1] + if *rest > 0.0 { *rest } else { PARTED });
        }
        arcs
    }

    /// Total rest length \[m\].
    #[must_use]
    pub fn rest_length(&self) -> f64 {
        self.rest_lengths.iter().sum()
    }

    /// Rejects a state that is impossible for a thread of this radius; lists every invalid element.
    pub(crate) fn check(&self, radius: f64) -> Result<(), ThreadError> {
        let n = self.positions.len();
        let (is_closed, least) = if self.is_closed() { (true, CLOSED_NODES_MIN) } else { (false, 3) };
        if !(least..=NODES_MAX).contains(&n) {
            return Err(if is_closed { ThreadError::ClosedNodes(n) } else { ThreadError::Nodes(n) });
        }
        let edges = if is_closed { n } else { n - 1 };
        for (list, found, expected) in [
            ("velocities", self.velocities.len(), n),
            ("rest_lengths", self.rest_lengths.len(), edges),
            ("directors", self.directors.len(), edges),
            ("twists", self.twists.len(), n),
            ("spins", self.spins.len(), edges),
            ("tensions", self.tensions.len(), edges),
        ] {
            if found != expected {
                return Err(ThreadError::Length { list, found, expected });
            }
        }
        let place = |i: &usize| {
            self.positions[*i].iter().chain(self.velocities[*i].iter()).all(|x| x.is_finite())
                && self.twists[*i].is_finite()
        };
        let edge = |i: &usize| {
            *i == edges
                || (self.directors[*i].iter().all(|x| x.is_finite())
                    && self.spins[*i].is_finite()
                    && self.tensions[*i].is_finite())
        };
        let mut bad: Vec<_> = (0..n).filter(|i| !place(i)).collect();
        if bad.is_empty() {
            // Directors depend on positions: one invalid node makes all of them invalid.
            bad = (0..n).filter(|i| !edge(i)).collect();
        }
        if !bad.is_empty() {
            return Err(ThreadError::NotFinite(bad));
        }
        let short = |i: &usize| {
            let length = (self.positions[self.after(*i)] - self.positions[*i]).norm();
            let rest = self.rest_lengths[*i];
            let is_dummy = rest == 0.0 && !is_closed;
            let is_none = rest.is_nan() || rest.is_infinite() || (rest < 0.01 * radius && !is_dummy);
            length < 0.01 * radius || is_none
        };
        let bad: Vec<_> = (0..edges).filter(short).collect();
        if !bad.is_empty() {
            return Err(ThreadError::NoLength(bad));
        }
        if let Some([first, last]) = self.threads().find(|[first, last]| last - first < 2) {
            return Err(ThreadError::Nodes(last + 1 - first));
        }
        let folded = |i: &usize| {
            let Some(before) = self.bends(*i) else { return false };
            let e = self.positions[*i] - self.positions[before];
            let f = self.positions[self.after(*i)] - self.positions[*i];
            e.dot(&f) < -0.99 * e.norm() * f.norm()
        };
        let bad: Vec<_> = (0..n).filter(folded).collect();
        if !bad.is_empty() {
            return Err(ThreadError::Folded(bad));
        }
        Ok(())
    }
}

//! Queries of two surfaces' trees: first contact, all pairs in contact, exact distance, tolerance (Larsen, Gottschalk,
//! Lin, Manocha, *Fast Proximity Queries with Swept Sphere Volumes*, 1999).

use nalgebra::{Isometry3, Point3};

use super::descend::{Relation, Side, sorted};
use super::f64_traversal::FarPending;
use super::lanes::Lanes;
use super::{ObbTree, WIDTH};
use crate::primitive::{TriangleTriangle, closest_triangles, common_segment, triangles_overlap};

/// Two intersecting triangles.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TouchingPair {
    /// Triangle of the first and of the second surface.
    pub triangles: [u32; 2],
    /// Ends of their intersection segment, in the frame of the first surface \[m\].
    pub points_in_a: [Point3<f64>; 2],
}

/// The nearest points of two surfaces, or of a pair within the tolerance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Proximity {
    /// Triangle of the first and of the second surface.
    pub triangles: [u32; 2],
    /// Point on each of them, in the frame of the first surface \[m\]; equal if they overlap.
    pub points_in_a: [Point3<f64>; 2],
    /// Their distance \[m\]; 0 if the surfaces overlap.
    pub distance: f64,
}

/// A pair of subtrees still to be visited.
#[derive(Clone, Copy, Debug)]
pub(super) struct Pending {
    pub nodes: [u32; 2],
    /// Lower bound of their squared distance, in the unit of the first tree.
    pub bound: f32,
}

/// Buffers of queries. They grow to the largest query, so that nothing is allocated after warm-up. No other state is
/// kept: results depend only on the query.
#[derive(Clone, Debug, Default)]
pub struct TreeQuery {
    pub(super) pending: Vec<Pending>,
    pub(super) pairs: Vec<TouchingPair>,
    far: Vec<FarPending>,
}

impl TreeQuery {
    /// Empty buffers.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Some pair of triangles in contact, the same one for the same query; `None` when the surfaces are apart.
    ///
    /// `last` is a warm start, a pair of an earlier result for surfaces that move little; invalid indices are ignored.
    pub fn first_contact(
        &mut self,
        a: &ObbTree,
        b: &ObbTree,
        b_in_a: &Isometry3<f64>,
        last: Option<[u32; 2]>,
    ) -> Option<TouchingPair> {
        let relation = Relation::new(a, b, b_in_a);
        self.first(&relation, last)
    }

    /// Every pair of triangles in contact, in an order that is the same for the same query.
    pub fn all_contacts(&mut self, a: &ObbTree, b: &ObbTree, b_in_a: &Isometry3<f64>) -> &[TouchingPair] {
        let relation = Relation::new(a, b, b_in_a);
        let mut pairs = std::mem::take(&mut self.pairs);
        pairs.clear();
        self.touching(&relation, |pair| {
            pairs.push(pair);
            false
        });
        self.pairs = pairs;
        &self.pairs
    }

    /// The nearest points of two surfaces; `None` when one of them has no triangle. `last` as for
    /// [`first_contact`](Self::first_contact): it makes the query faster and changes the result only among equally near
    /// pairs.
    pub fn distance(
        &mut self,
        a: &ObbTree,
        b: &ObbTree,
        b_in_a: &Isometry3<f64>,
        last: Option<[u32; 2]>,
    ) -> Option<Proximity> {
        self.nearest(a, b, b_in_a, f64::INFINITY, false, last)
    }

    /// Some pair of triangles at most `tolerance` \[m\] apart, not the nearest one; `None` when the surfaces are
    /// farther apart, or for a tolerance below 0 or NaN. `last` as for [`first_contact`](Self::first_contact).
    pub fn within(
        &mut self,
        a: &ObbTree,
        b: &ObbTree,
        b_in_a: &Isometry3<f64>,
        tolerance: f64,
        last: Option<[u32; 2]>,
    ) -> Option<Proximity> {
        if tolerance >= 0.0 { self.nearest(a, b, b_in_a, tolerance, true, last) } else { None }
    }

    fn first(&mut self, relation: &Relation<'_>, last: Option<[u32; 2]>) -> Option<TouchingPair> {
        if let Some([place_a, place_b]) = places(relation, last)
            && let Some(pair) = exactly(relation, place_a, place_b)
        {
            return Some(pair);
        }
        let mut found = None;
        self.touching(relation, |pair| {
            found = Some(pair);
            true
        });
        found
    }

    /// Visits pairs in contact, presumably deepest first, until the visitor stops.
    fn touching(&mut self, relation: &Relation<'_>, mut enough: impl FnMut(TouchingPair) -> bool) {
        let (a, b) = (relation.a, relation.b);
        self.pending.clear();
        if a.is_empty() || b.is_empty() {
            return;
        }
        if relation.blind {
            relation.descend_far(&mut self.far, 0.0, |in_a, in_b| {
                let seen = touching_leaves(relation, in_a, in_b, |_, _| true, &mut enough);
                (!seen).then_some(0.0)
            });
            return;
        }
        self.pending.push(Pending { nodes: [0, 0], bound: 0.0 });
        while let Some(Pending { nodes: [in_a, in_b], .. }) = self.pending.pop() {
            let (side, node, (bits, depth)) = match relation.larger(in_a, in_b) {
                Some(Side::A) => {
                    let node = &a.nodes[in_a as usize];
                    (Side::A, node, node.quad.overlapping(&relation.placed_b(in_b), relation.slack[0]))
                }
                Some(Side::B) => {
                    let node = &b.nodes[in_b as usize];
                    (Side::B, node, node.quad.overlapping(&relation.placed_a(in_a), relation.slack[1]))
                }
                None => {
                    if touching_leaves(relation, in_a, in_b, |_, _| true, &mut enough) {
                        return;
                    }
                    continue;
                }
            };
            let (order, count) = sorted(bits, depth.0);
            for &lane in &order[..count] {
                let child = node.children[lane];
                let nodes = match side {
                    Side::A => [child, in_b],
                    Side::B => [in_a, child],
                };
                self.pending.push(Pending { nodes, bound: 0.0 });
            }
        }
    }

    fn nearest(
        &mut self,
        a: &ObbTree,
        b: &ObbTree,
        b_in_a: &Isometry3<f64>,
        limit: f64,
        any: bool,
        last: Option<[u32; 2]>,
    ) -> Option<Proximity> {
        let relation = Relation::new(a, b, b_in_a);
        if a.is_empty() || b.is_empty() {
            return None;
        }
        if let Some(TouchingPair { triangles, points_in_a: [from, to] }) = self.first(&relation, last) {
            let point = nalgebra::center(&from, &to);
            return Some(Proximity { triangles, points_in_a: [point; 2], distance: 0.0 });
        }
        let mut best = NearestPair::new(&relation, limit);
        if let Some([place_a, place_b]) = places(&relation, last) {
            best.offer(&relation, place_a, place_b);
        }
        if relation.far {
            relation.descend_far(&mut self.far, best.square.sqrt(), |in_a, in_b| {
                best.look_far(&relation, in_a, in_b);
                (!any || best.found.is_none()).then_some(best.square.sqrt())
            });
            return best.found;
        }
        self.pending.clear();
        self.pending.push(Pending { nodes: [0, 0], bound: 0.0 });
        while let Some(Pending { nodes: [in_a, in_b], bound }) = self.pending.pop() {
            if any && best.found.is_some() {
                break;
            }
            if bound > best.limits[0] {
                continue;
            }
            let (side, node, (bounds, between)) = match relation.larger(in_a, in_b) {
                Some(Side::A) => {
                    let node = &a.nodes[in_a as usize];
                    (Side::A, node, node.quad.distance_squared(&relation.placed_b(in_b), relation.slack[0]))
                }
                Some(Side::B) => {
                    let node = &b.nodes[in_b as usize];
                    (Side::B, node, node.quad.distance_squared(&relation.placed_a(in_a), relation.slack[1]))
                }
                None => {
                    best.look(&relation, in_a, in_b);
                    continue;
                }
            };
            let unit = match side {
                Side::A => 1.0,
                Side::B => relation.into_a.scale * relation.into_a.scale,
            };
            let limit = best.limits[side as usize];
            let mut bits = 0;
            let mut measure = [0.0; WIDTH];
            for (lane, measure) in measure.iter_mut().enumerate() {
                bits |= u32::from(bounds.0[lane] <= limit) << lane;
                // Overlapping boxes all have distance 0: of these the ones with the nearest centres come first.
                *measure = bounds.0[lane] + 1e-3 * between.0[lane];
            }
            let (order, count) = sorted(bits, measure);
            for &lane in &order[..count] {
                let child = node.children[lane];
                let nodes = match side {
                    Side::A => [child, in_b],
                    Side::B => [in_a, child],
                };
                self.pending.push(Pending { nodes, bound: bounds.0[lane] * unit });
            }
        }
        best.found
    }
}

/// Leaf positions of two triangles, if they exist.
fn places(relation: &Relation<'_>, pair: Option<[u32; 2]>) -> Option<[usize; 2]> {
    let [a, b] = pair?;
    let place_a = *relation.a.places.get(a as usize)?;
    let place_b = *relation.b.places.get(b as usize)?;
    Some([place_a as usize, place_b as usize])
}

/// Exact contact of two triangles, by their positions.
pub(super) fn exactly(relation: &Relation<'_>, place_a: usize, place_b: usize) -> Option<TouchingPair> {
    let (first, second) = (relation.a.triangle(place_a), relation.triangle_of_b(place_b));
    triangles_overlap(&first, &second).then(|| TouchingPair {
        triangles: [relation.a.numbers[place_a], relation.b.numbers[place_b]],
        points_in_a: common_segment(&first, &second),
    })
}

/// Visits the `wanted` pairs in contact of two leaves, by their positions; returns whether the visitor stopped.
#[inline]
pub(super) fn touching_leaves(
    relation: &Relation<'_>,
    in_a: u32,
    in_b: u32,
    wanted: impl Fn(usize, usize) -> bool,
    enough: &mut impl FnMut(TouchingPair) -> bool,
) -> bool {
    let (a, b) = (relation.a, relation.b);
    let (leaf_a, leaf_b) = (in_a as usize - a.nodes.len(), in_b as usize - b.nodes.len());
    let slack = relation.slack[0];
    let from_a = a.leaves[leaf_a].reaching(&relation.placed_b(in_b), slack);
    if from_a == 0 {
        return false;
    }
    let placed = b.leaves[leaf_b].placed(&relation.into_a);
    let from_b = placed.reaching(&a.boxes[in_a as usize], slack);
    if from_b == 0 {
        return false;
    }
    let faced = placed.faced(slack);
    let places_b = b.places_of(leaf_b);
    for (lane, place_a) in a.places_of(leaf_a).enumerate() {
        if from_a >> lane & 1 == 0 {
            continue;
        }
        let mut bits = from_b & faced.overlapping(&a.leaves[leaf_a].one(lane), slack);
        while bits != 0 {
            let place_b = places_b.start + bits.trailing_zeros() as usize;
            bits &= bits - 1;
            if place_b < places_b.end
                && wanted(place_a, place_b)
                && let Some(pair) = exactly(relation, place_a, place_b)
                && enough(pair)
            {
                return true;
            }
        }
    }
    false
}

/// The nearest pair so far.
struct NearestPair {
    found: Option<Proximity>,
    /// Upper limit of the squared distance \[m²\].
    square: f64,
    /// The same, rounded up, in the units of the two trees.
    limits: [f32; 2],
}

impl NearestPair {
    fn new(relation: &Relation<'_>, limit: f64) -> Self {
        let mut best = Self { found: None, square: 0.0, limits: [0.0; 2] };
        best.set(relation, limit * limit);
        best
    }

    fn set(&mut self, relation: &Relation<'_>, square: f64) {
        self.square = square;
        self.limits = [relation.a.scale, relation.b.scale]
            .map(|scale| ((square / scale / scale * (1.0 + 1e-6)) as f32).next_up());
    }

    fn offer(&mut self, relation: &Relation<'_>, place_a: usize, place_b: usize) {
        let (first, second) = (relation.a.triangle(place_a), relation.triangle_of_b(place_b));
        let TriangleTriangle { points, distance_squared } = closest_triangles(&first, &second);
        let nearer =
            distance_squared < self.square || (self.found.is_none() && distance_squared <= self.square);
        if nearer {
            self.found = Some(Proximity {
                triangles: [relation.a.numbers[place_a], relation.b.numbers[place_b]],
                points_in_a: points,
                distance: distance_squared.sqrt(),
            });
            self.set(relation, distance_squared);
        }
    }

    /// Measures all triangles of two leaves.
    fn look_far(&mut self, relation: &Relation<'_>, in_a: u32, in_b: u32) {
        let (a, b) = (relation.a, relation.b);
        for place_a in a.places_of(in_a as usize - a.nodes.len()) {
            for place_b in b.places_of(in_b as usize - b.nodes.len()) {
                self.offer(relation, place_a, place_b);
            }
        }
    }

    /// Measures the triangles of two leaves, the presumably nearest first.
    fn look(&mut self, relation: &Relation<'_>, in_a: u32, in_b: u32) {
        let (a, b) = (relation.a, relation.b);
        let (leaf_a, leaf_b) = (in_a as usize - a.nodes.len(), in_b as usize - b.nodes.len());
        let slack = relation.slack[0];
        let limit = Lanes::all(self.limits[0]);
        let from_a = a.leaves[leaf_a].distance_squared(&relation.placed_b(in_b), slack).at_most(limit);
        if from_a == 0 {
            return;
        }
        let placed = b.leaves[leaf_b].placed(&relation.into_a);
        let from_b = placed.distance_squared(&a.boxes[in_a as usize], slack).at_most(limit);
        if from_b == 0 {
            return;
        }
        let faced = placed.faced(slack);
        let (places_a, places_b) = (a.places_of(leaf_a), b.places_of(leaf_b));
        let mut bounds = [[f32::INFINITY; WIDTH]; WIDTH];
        for lane in (0..places_a.len()).filter(|lane| from_a >> lane & 1 == 1) {
            let found = faced.distance_squared(&a.leaves[leaf_a].one(lane), slack, self.limits[0]).0;
            for other in (0..places_b.len()).filter(|other| from_b >> other & 1 == 1) {
                bounds[lane][other] = found[other];
            }
        }
        loop {
            let (mut least, mut at) = (f32::INFINITY, [0, 0]);
            for (i, row) in bounds.iter().enumerate() {
                for (j, &bound) in row.iter().enumerate() {
                    if bound < least {
                        (least, at) = (bound, [i, j]);
                    }
                }
            }
            if least == f32::INFINITY || least > self.limits[0] {
                return;
            }
            bounds[at[0]][at[1]] = f32::INFINITY;
            self.offer(relation, places_a.start + at[0], places_b.start + at[1]);
        }
    }
}

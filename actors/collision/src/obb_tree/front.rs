//! Front-based contact query, for two surfaces that move little between queries: the traversal of both trees continues
//! where the last one ended (Li and Chen, *Incremental 3D collision detection with hierarchical data structures*, 1998;
//! Klosowski et al., *Efficient collision detection using bounding volume hierarchies of k-DOPs*, 1998).
//!
//! The end of a traversal is its *front*: pairs of subtrees with separated boxes, and pairs of leaves without
//! separation. Each separated pair has a certificate, its gap at the last test; the largest possible motion since then
//! is subtracted, and only expired pairs are tested again. Within two leaves the same applies to each pair of
//! triangles. So the cost of a step depends on the pairs in contact and those that have come near. Contacts are decided
//! by the same exact test as in [`TreeQuery::all_contacts`], and reported in index order: the result depends only on
//! the query, the front affects only the cost.

use nalgebra::{Isometry3, Matrix3, Vector3};

use super::descend::{Relation, Side};
use super::lanes::Lanes;
use super::obb::ObbQuad;
use super::query::exactly;
use super::{ObbTree, TouchingPair, TreeQuery, WIDTH};
use crate::generation::Known;

/// Most pairs of a front; if more are needed, every query starts at the roots.
const PAIRS_MAX: usize = 1 << 20;
/// A front only becomes finer. It is restarted when its number of pairs has grown by this factor.
const GROWTH: usize = 2;
/// Leaves count as apart again if they will stay apart for this many steps like the last one.
const STEPS_APART: f64 = 16.0;
/// Expiry of two triangles in contact: always tested again.
const TOUCHING: f64 = f64::NEG_INFINITY;
/// Rounding error of a motion, relative to all lengths involved.
const ROUNDING: f64 = 1e-14;

/// Cost of the queries so far.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct FrontCost {
    /// Number of queries.
    pub asked: u64,
    /// Queries without any motion.
    pub at_rest: u64,
    /// Queries that started at the roots.
    pub anew: u64,
    /// Pairs of subtrees with an expired certificate.
    pub expired: u64,
}

/// State of the two surfaces at the last query.
#[derive(Clone, Debug)]
struct LastQuery {
    trees: [Known; 2],
    motions: [f64; 2],
    refits: [u64; 2],
    b_in_a: Isometry3<f64>,
    rotation: Matrix3<f64>,
}

/// Two leaves whose triangles may touch, and the travelled distance at which each pair expires \[m\].
#[derive(Clone, Debug)]
struct LeafPair {
    nodes: [u32; 2],
    due: [[f64; WIDTH]; WIDTH],
}

/// The front of two surfaces, kept between queries.
#[derive(Clone, Debug, Default)]
pub struct TreeFront {
    last: Option<LastQuery>,
    /// Separated pairs, and the travelled distance at which each expires \[m\].
    apart: Vec<[u32; 2]>,
    due: Vec<f64>,
    /// Leaves that may touch.
    near: Vec<LeafPair>,
    pending: Vec<[u32; 2]>,
    pairs: Vec<TouchingPair>,
    /// Largest possible approach of the two surfaces since the front began \[m\].
    travelled: f64,
    last_step: f64,
    begun_with: usize,
    rested: bool,
    anew: TreeQuery,
    cost: FrontCost,
}

impl TreeFront {
    /// An empty front.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// The cost of its queries.
    #[must_use]
    pub fn cost(&self) -> &FrontCost {
        &self.cost
    }

    /// Whether nothing had moved at the last query, so that its result was unchanged.
    #[must_use]
    pub fn rested(&self) -> bool {
        self.rested
    }

    /// The result of the last query.
    #[must_use]
    pub fn pairs(&self) -> &[TouchingPair] {
        &self.pairs
    }

    /// Every pair of triangles in contact, in index order: those of [`TreeQuery::all_contacts`].
    pub fn all_contacts(&mut self, a: &ObbTree, b: &ObbTree, b_in_a: &Isometry3<f64>) -> &[TouchingPair] {
        self.cost.asked += 1;
        let relation = Relation::new(a, b, b_in_a);
        let moved = self.moved(&relation, b_in_a);
        self.rested = moved == Some(0.0);
        if self.rested {
            self.cost.at_rest += 1;
            return &self.pairs;
        }
        self.pairs.clear();
        self.last = None;
        if !a.is_empty() && !b.is_empty() {
            if relation.blind || self.apart.len() + self.near.len() > PAIRS_MAX {
                self.cost.anew += 1;
                self.forget();
                self.pairs.extend_from_slice(self.anew.all_contacts(a, b, b_in_a));
            } else {
                self.advance(&relation, moved);
                self.last = Some(LastQuery {
                    trees: [Known::of(&a.identity), Known::of(&b.identity)],
                    motions: [a.motion, b.motion],
                    refits: [a.refits, b.refits],
                    b_in_a: *b_in_a,
                    rotation: relation.rotation,
                });
            }
        }
        self.pairs.sort_unstable_by_key(|pair| pair.triangles);
        &self.pairs
    }

    fn forget(&mut self) {
        self.apart.clear();
        self.due.clear();
        self.near.clear();
        self.travelled = 0.0;
    }

    /// Largest possible approach of the two surfaces since the last query \[m\]; `None` without an earlier query.
    fn moved(&self, relation: &Relation<'_>, b_in_a: &Isometry3<f64>) -> Option<f64> {
        let (a, b) = (relation.a, relation.b);
        let last = self.last.as_ref()?;
        if !(last.trees[0].is(&a.identity) && last.trees[1].is(&b.identity)) {
            return None;
        }
        if last.refits == [a.refits, b.refits] && last.b_in_a == *b_in_a {
            return Some(0.0);
        }
        let deformed = (a.motion - last.motions[0]) + (b.motion - last.motions[1]);
        // Any point is the centre plus an offset within the extent along each axis; a rotation moves the offset by at
        // most the norm of the difference of both rotations, which has two equal singular values and a zero one.
        let (middle, reach) = (b.origin.coords, 3.0_f64.sqrt() * b.scale);
        let turned: Matrix3<f64> = relation.rotation - last.rotation;
        let shifted: Vector3<f64> = relation.translation - last.b_in_a.translation.vector;
        let moved = (turned * middle + shifted).norm() + turned.norm() * reach;
        let lengths = middle.norm() + reach + relation.translation.norm() + a.motion + b.motion;
        Some(deformed + moved + ROUNDING * lengths)
    }

    /// Updates the front to the current state.
    fn advance(&mut self, relation: &Relation<'_>, moved: Option<f64>) {
        self.pending.clear();
        match moved {
            Some(moved) => {
                self.travelled += moved;
                self.last_step = moved;
            }
            None => self.begin(),
        }
        let expired = self.due.iter().filter(|due| **due <= self.travelled).count();
        if moved.is_some()
            && (2 * expired > self.due.len() || self.due.len() > GROWTH * self.begun_with + WIDTH)
        {
            self.begin();
        }
        let begins = !self.pending.is_empty();
        if begins {
            self.cost.anew += 1;
        } else {
            self.cost.expired += expired as u64;
            self.look_again(relation);
        }
        self.descend(relation);
        if begins {
            self.begun_with = self.due.len();
        }
        self.touch(relation);
    }

    fn begin(&mut self) {
        self.forget();
        self.pending.push([0, 0]);
    }

    /// Tests the pairs with an expired certificate again: those still apart stay in the front.
    fn look_again(&mut self, relation: &Relation<'_>) {
        for index in (0..self.due.len()).rev() {
            if self.due[index] > self.travelled {
                continue;
            }
            let pair = self.apart[index];
            let [in_a, in_b] = pair;
            let boxes = ObbQuad::alike(&relation.a.boxes[in_a as usize]);
            let gap = boxes.apart(&relation.placed_b(in_b), relation.slack[0]).0[0];
            if gap > 0.0 {
                self.due[index] = self.travelled + f64::from(gap) * relation.a.scale;
            } else {
                self.due.swap_remove(index);
                self.apart.swap_remove(index);
                self.pending.push(pair);
            }
        }
    }

    /// Descends from all pending pairs, as far as boxes overlap.
    fn descend(&mut self, relation: &Relation<'_>) {
        let (a, b) = (relation.a, relation.b);
        while let Some(pair) = self.pending.pop() {
            let [in_a, in_b] = pair;
            let (side, node, gaps, unit) = match relation.larger(in_a, in_b) {
                Some(Side::A) => {
                    let node = &a.nodes[in_a as usize];
                    let gaps = node.quad.apart(&relation.placed_b(in_b), relation.slack[0]);
                    (Side::A, node, gaps, a.scale)
                }
                Some(Side::B) => {
                    let node = &b.nodes[in_b as usize];
                    let gaps = node.quad.apart(&relation.placed_a(in_a), relation.slack[1]);
                    (Side::B, node, gaps, b.scale)
                }
                None => {
                    self.near.push(LeafPair::new(relation, pair, self.travelled));
                    continue;
                }
            };
            let children = node.children[..node.count as usize].iter();
            for (&child, gap) in children.zip(gaps.0) {
                let nodes = match side {
                    Side::A => [child, in_b],
                    Side::B => [in_a, child],
                };
                if gap > 0.0 {
                    self.apart.push(nodes);
                    self.due.push(self.travelled + f64::from(gap) * unit);
                } else {
                    self.pending.push(nodes);
                }
            }
        }
    }

    /// Tests the leaves that may touch. Those that cannot touch for some time become separated pairs.
    fn touch(&mut self, relation: &Relation<'_>) {
        for index in (0..self.near.len()).rev() {
            let due = self.near[index].touch(relation, self.travelled, &mut self.pairs);
            if due > self.travelled + STEPS_APART * self.last_step {
                self.apart.push(self.near.swap_remove(index).nodes);
                self.due.push(due);
            }
        }
    }
}

impl LeafPair {
    /// Two leaves with all pairs of triangles untested.
    fn new(relation: &Relation<'_>, nodes: [u32; 2], travelled: f64) -> Self {
        let (a, b) = (relation.a, relation.b);
        let counts = [
            a.places_of(nodes[0] as usize - a.nodes.len()).len(),
            b.places_of(nodes[1] as usize - b.nodes.len()).len(),
        ];
        let mut due = [[f64::INFINITY; WIDTH]; WIDTH];
        for row in &mut due[..counts[0]] {
            row[..counts[1]].fill(travelled);
        }
        Self { nodes, due }
    }

    /// Finds the pairs in contact, and returns the earliest expiry of any pair.
    fn touch(&mut self, relation: &Relation<'_>, travelled: f64, pairs: &mut Vec<TouchingPair>) -> f64 {
        let (a, b) = (relation.a, relation.b);
        let [leaf_a, leaf_b] =
            [self.nodes[0] as usize - a.nodes.len(), self.nodes[1] as usize - b.nodes.len()];
        let slack = relation.slack[0];
        let mut faced = None;
        let mut soonest = f64::INFINITY;
        for (lane, row) in self.due.iter_mut().enumerate() {
            let expired = row.iter().any(|due| *due <= travelled && *due != TOUCHING);
            if expired {
                // The gap, if they are certainly apart.
                let faced =
                    faced.get_or_insert_with(|| b.leaves[leaf_b].placed(&relation.into_a).faced(slack));
                let bounds = faced.distance_squared(&a.leaves[leaf_a].one(lane), slack, f32::INFINITY);
                for (due, square) in row.iter_mut().zip(bounds.0) {
                    if *due <= travelled && *due != TOUCHING {
                        // A square root of a rounded square.
                        *due = travelled + f64::from(square).sqrt() * (1.0 - 1e-6) * a.scale;
                    }
                }
            }
            for (other, due) in row.iter_mut().enumerate() {
                if *due <= travelled {
                    let pair = exactly(relation, leaf_a * WIDTH + lane, leaf_b * WIDTH + other);
                    *due = if pair.is_some() { TOUCHING } else { travelled };
                    pairs.extend(pair);
                }
                soonest = if *due < soonest { *due } else { soonest };
            }
        }
        soonest
    }
}

impl ObbQuad {
    /// Four copies of one box.
    fn alike(obb: &super::Obb) -> Self {
        let mut quad = Self::NONE;
        (0..WIDTH).for_each(|lane| quad.set(lane, obb));
        quad
    }

    /// Lower bound of the distance of each from `one`, minus rounding; 0 or less if they may overlap.
    #[inline]
    fn apart(&self, one: &super::Obb, slack: f32) -> Lanes {
        self.gaps(one) - Lanes::all(slack)
    }
}

//! Self-collision of a deforming surface: the tree is traversed against itself, each pair of subtrees once.

use nalgebra::Isometry3;

use super::descend::Relation;
use super::query::{Pending, touching_leaves};
use super::{ObbTree, TouchingPair, TreeQuery};

impl TreeQuery {
    /// Every pair of triangles of one surface in contact, the lower number first, in an order that is the same for the
    /// same query. Triangles that share a vertex always touch and are left out; two that meet in different vertices at
    /// the same position, as along an unwelded seam, are in contact.
    pub fn self_contacts(&mut self, tree: &ObbTree) -> &[TouchingPair] {
        let relation = Relation::new(tree, tree, &Isometry3::identity());
        let mut pairs = std::mem::take(&mut self.pairs);
        pairs.clear();
        self.pending.clear();
        if !tree.is_empty() {
            self.pending.push(Pending { nodes: [0, 0], bound: 0.0 });
        }
        let mut keep = |mut pair: TouchingPair| {
            pair.triangles.sort_unstable();
            pairs.push(pair);
            false
        };
        while let Some(Pending { nodes: [first, second], .. }) = self.pending.pop() {
            if first == second && Relation::is_inner(tree, first) {
                self.descend_into_itself(tree, first, relation.slack[0]);
            } else if let Some(side) = relation.larger(first, second) {
                let [inner, other] = relation.ordered(side, [first, second]);
                let node = &tree.nodes[inner as usize];
                let (bits, _) = node.quad.overlapping(&tree.boxes[other as usize], relation.slack[0]);
                for lane in (0..node.count as usize).filter(|lane| bits >> lane & 1 == 1) {
                    self.pending.push(Pending { nodes: [node.children[lane], other], bound: 0.0 });
                }
            } else {
                let distinct = |a: usize, b: usize| {
                    (first != second || a < b)
                        && !tree.corners[a].iter().any(|corner| tree.corners[b].contains(corner))
                };
                touching_leaves(&relation, first, second, distinct, &mut keep);
            }
        }
        self.pairs = pairs;
        &self.pairs
    }

    /// Tests each child against itself and against later children.
    fn descend_into_itself(&mut self, tree: &ObbTree, index: u32, slack: f32) {
        let node = &tree.nodes[index as usize];
        let children = &node.children[..node.count as usize];
        for (lane, &child) in children.iter().enumerate() {
            self.pending.push(Pending { nodes: [child, child], bound: 0.0 });
            let (bits, _) = node.quad.overlapping(&tree.boxes[child as usize], slack);
            for (other, &second) in children.iter().enumerate().skip(lane + 1) {
                if bits >> other & 1 == 1 {
                    self.pending.push(Pending { nodes: [child, second], bound: 0.0 });
                }
            }
        }
    }
}

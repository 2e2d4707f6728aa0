//! Top-down construction: triangles are split at the median of their centroids along the direction of greatest spread,
//! twice for each node, so that a node has four children and every leaf but one four triangles.

use super::fit::Moments;
use super::lanes::{each, three};
use super::leaf::Leaf;
use super::obb::{Obb, ObbQuad};
use super::{Node, ObbTree, WIDTH};

/// A triangle to be sorted into a leaf.
#[derive(Clone, Copy)]
struct Item {
    number: u32,
    middle: [f32; 3],
    key: f32,
}

struct Builder<'a> {
    items: &'a mut [Item],
    corners: &'a [[u32; 3]],
    units: &'a [[f32; 3]],
    nodes: Vec<Node>,
    node_axes: Vec<[[f32; 3]; 3]>,
    leaf_axes: Vec<[[f32; 3]; 3]>,
}

/// A child, before the number of inner nodes is known.
#[derive(Clone, Copy)]
enum Child {
    Node(u32),
    Leaf(u32),
}

/// Sorts the triangles of a tree into leaf order and creates its nodes, with axes but without extents.
pub(super) fn sort(tree: &mut ObbTree) {
    let mut items: Vec<Item> = tree
        .corners
        .iter()
        .enumerate()
        .map(|(number, corners)| {
            let [a, b, c] = each(*corners, |vertex| tree.units[vertex as usize]);
            let middle = three(|axis| (a[axis] + b[axis] + c[axis]) / 3.0);
            Item { number: number as u32, middle, key: 0.0 }
        })
        .collect();
    let leaves = items.len().div_ceil(WIDTH);
    let mut builder = Builder {
        items: &mut items,
        corners: &tree.corners,
        units: &tree.units,
        nodes: Vec::with_capacity(leaves),
        node_axes: Vec::with_capacity(leaves),
        leaf_axes: vec![[[0.0; 3]; 3]; leaves],
    };
    let mut children = Vec::with_capacity(leaves);
    if leaves > 0 {
        builder.subtree(0, leaves, &mut children);
    }
    let Builder { mut nodes, node_axes, leaf_axes, .. } = builder;
    let inner = nodes.len() as u32;
    for (node, children) in nodes.iter_mut().zip(children) {
        for (index, child) in node.children.iter_mut().zip(children) {
            *index = match child {
                Child::Node(node) => node,
                Child::Leaf(leaf) => inner + leaf,
            };
        }
    }
    tree.boxes = node_axes.into_iter().chain(leaf_axes).map(|axes| Obb { axes, ..Obb::NONE }).collect();
    tree.leaves = vec![Leaf::NONE; leaves];
    tree.nodes = nodes;
    tree.corners = items.iter().map(|item| tree.corners[item.number as usize]).collect();
    tree.numbers = items.iter().map(|item| item.number).collect();
}

impl Builder<'_> {
    /// Builds the subtree over some leaves; returns its child and its height.
    fn subtree(&mut self, from: usize, to: usize, all: &mut Vec<[Child; WIDTH]>) -> (Child, u32) {
        let axes = self.axes(from, to);
        if to - from == 1 {
            self.leaf_axes[from] = axes;
            return (Child::Leaf(from as u32), 0);
        }
        let index = self.nodes.len();
        self.nodes.push(Node {
            quad: ObbQuad::NONE,
            children: [0; WIDTH],
            count: 0,
            leaves: [from as u32, to as u32],
            height: 0,
            end: 0,
        });
        self.node_axes.push(axes);
        all.push([Child::Leaf(0); WIDTH]);
        let middle = self.halve(from, to, &axes);
        let mut children = [Child::Leaf(0); WIDTH];
        let (mut count, mut height) = (0, 0);
        for (from, to) in [(from, middle), (middle, to)] {
            let cut = if to - from > 1 { self.halve(from, to, &self.axes(from, to)) } else { to };
            for (from, to) in [(from, cut), (cut, to)] {
                if from < to {
                    let (child, below) = self.subtree(from, to, all);
                    children[count] = child;
                    count += 1;
                    height = height.max(below + 1);
                }
            }
        }
        all[index] = children;
        self.nodes[index].count = count as u32;
        self.nodes[index].height = height;
        self.nodes[index].end = self.nodes.len() as u32;
        for lane in count..WIDTH {
            self.nodes[index].quad.set(lane, &Obb::NONE);
        }
        (Child::Node(index as u32), height)
    }

    fn of(&self, from: usize, to: usize) -> std::ops::Range<usize> {
        from * WIDTH..(to * WIDTH).min(self.items.len())
    }

    fn axes(&self, from: usize, to: usize) -> [[f32; 3]; 3] {
        let items = &self.items[self.of(from, to)];
        let mut spread = Moments::about(items[0].middle);
        for item in items {
            for vertex in self.corners[item.number as usize] {
                spread.add(self.units[vertex as usize]);
            }
        }
        spread.axes()
    }

    /// Splits the triangles of some leaves along the first axis; returns the start of the second half.
    fn halve(&mut self, from: usize, to: usize, axes: &[[f32; 3]; 3]) -> usize {
        let range = self.of(from, to);
        let middle = from + (to - from).div_ceil(2);
        let axis = axes[0];
        let items = &mut self.items[range];
        for item in items.iter_mut() {
            item.key = axis[0] * item.middle[0] + axis[1] * item.middle[1] + axis[2] * item.middle[2];
        }
        // The index makes the order of equal keys unique.
        items.select_nth_unstable_by((middle - from) * WIDTH, |a, b| {
            a.key.total_cmp(&b.key).then(a.number.cmp(&b.number))
        });
        middle
    }
}

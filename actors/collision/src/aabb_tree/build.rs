//! Construction of the AABB tree: triangles are split at the median of their centroids, along the longest side.

use super::{LANES, Node};
use crate::Surface;

/// A range of triangles, and the lane to store its node in.
struct Task {
    from: usize,
    to: usize,
    parent: usize,
    lane: usize,
}

/// Fills `nodes` with children only; a refit computes the boxes.
pub(super) fn build(nodes: &mut Vec<Node>, surface: &Surface) {
    let count = surface.triangles().len();
    nodes.clear();
    if count == 0 {
        return;
    }
    let middles: Vec<[f32; 3]> = (0..count as u32)
        .map(|index| {
            let [a, b, c] = surface.triangle(index);
            let third = |axis: usize| (a[axis] / 3.0 + b[axis] / 3.0 + c[axis] / 3.0) as f32;
            [third(0), third(1), third(2)]
        })
        .collect();
    let mut order: Vec<u32> = (0..count as u32).collect();
    let mut tasks = Vec::new();
    divide(nodes, &mut tasks, &mut order, &middles, (0, count));
    while let Some(Task { from, to, parent, lane }) = tasks.pop() {
        nodes[parent].child[lane] = nodes.len() as u32;
        divide(nodes, &mut tasks, &mut order, &middles, (from, to));
    }
}

/// Creates a node for a range: one triangle per lane for up to four, else a quarter of the range per lane.
fn divide(
    nodes: &mut Vec<Node>,
    tasks: &mut Vec<Task>,
    order: &mut [u32],
    middles: &[[f32; 3]],
    (from, to): (usize, usize),
) {
    let parent = nodes.len();
    let mut node = Node::EMPTY;
    if to - from <= LANES {
        for (lane, &triangle) in order[from..to].iter().enumerate() {
            node.child[lane] = triangle;
            node.leaves |= 1 << lane;
        }
        nodes.push(node);
        return;
    }
    let middle = halve(order, middles, from, to);
    let cuts = [from, halve(order, middles, from, middle), middle, halve(order, middles, middle, to), to];
    for lane in 0..LANES {
        let (from, to) = (cuts[lane], cuts[lane + 1]);
        match to - from {
            0 => {}
            1 => {
                node.child[lane] = order[from];
                node.leaves |= 1 << lane;
            }
            _ => tasks.push(Task { from, to, parent, lane }),
        }
    }
    nodes.push(node);
}

/// Splits a range; the first half is a multiple of four, so that the lowest nodes are full.
fn halve(order: &mut [u32], middles: &[[f32; 3]], from: usize, to: usize) -> usize {
    if to - from <= LANES {
        return to;
    }
    let fours = (to - from).div_ceil(LANES);
    let cut = LANES * fours.div_ceil(2);
    let range = &mut order[from..to];
    let (mut low, mut high) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
    for &triangle in range.iter() {
        for axis in 0..3 {
            low[axis] = low[axis].min(middles[triangle as usize][axis]);
            high[axis] = high[axis].max(middles[triangle as usize][axis]);
        }
    }
    let mut longest = 0;
    for axis in 1..3 {
        if high[axis] - low[axis] > high[longest] - low[longest] {
            longest = axis;
        }
    }
    // Equal centroids are ordered by index, so that the tree does not depend on the sort.
    range.select_nth_unstable_by(cut, |&first, &second| {
        let (a, b) = (middles[first as usize][longest], middles[second as usize][longest]);
        a.total_cmp(&b).then(first.cmp(&second))
    });
    from + cut
}

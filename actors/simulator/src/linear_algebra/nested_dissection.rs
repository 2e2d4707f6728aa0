//! Nested dissection ordering (George 1973) of a mesh's nodes from their positions, by planes perpendicular to the
//! longest side. On solid meshes it gives less fill than minimum degree, and contiguous separators, which form dense
//! blocks. Unconnected components are kept apart, so that their columns are, too.

use nalgebra::Point3;

/// Parts of up to this many nodes are not divided.
const LEAF: usize = 24;

/// The nodes in elimination order, for a graph given by its edges and node positions. Any positions give a valid order;
/// those with neighbours close together give a good one.
#[must_use]
pub fn nested_dissection(places: &[Point3<f64>], edges: impl Iterator<Item = (u32, u32)>) -> Vec<u32> {
    let mut both: Vec<(u32, u32)> =
        edges.filter(|(a, b)| a != b).flat_map(|(a, b)| [(a, b), (b, a)]).collect();
    both.sort_unstable();
    both.dedup();
    let mut starts = vec![0_usize; places.len() + 1];
    for &(node, _) in &both {
        starts[node as usize + 1] += 1;
    }
    for node in 0..places.len() {
        starts[node + 1] += starts[node];
    }
    let graph = Graph { places, starts, neighbours: both.into_iter().map(|(_, other)| other).collect() };
    let pieces = graph.pieces();
    let mut order: Vec<u32> = (0..places.len() as u32).collect();
    order.sort_by_key(|&node| pieces[node as usize]);
    // Parts by position in the order; a part's separator is at its end.
    let mut parts = Vec::new();
    let mut start = 0;
    for piece in order.chunk_by(|&a, &b| pieces[a as usize] == pieces[b as usize]) {
        parts.push((start, start + piece.len()));
        start += piece.len();
    }
    let mut side = vec![Side::Out; places.len()];
    while let Some((start, end)) = parts.pop() {
        let own = &mut order[start..end];
        if own.len() <= LEAF {
            continue;
        }
        if let Some([below, above]) = graph.split(own, &mut side) {
            parts.push((start, start + below));
            parts.push((start + below, start + below + above));
        }
    }
    order
}

struct Graph<'a> {
    places: &'a [Point3<f64>],
    starts: Vec<usize>,
    neighbours: Vec<u32>,
}

#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Side {
    Below,
    Above,
    Between,
    /// In another part.
    Out,
}

impl Graph<'_> {
    fn neighbours(&self, node: u32) -> &[u32] {
        &self.neighbours[self.starts[node as usize]..self.starts[node as usize + 1]]
    }

    /// Component of each node, as its first node.
    fn pieces(&self) -> Vec<u32> {
        let none = u32::MAX;
        let mut piece = vec![none; self.places.len()];
        let mut reached = Vec::new();
        for first in 0..self.places.len() as u32 {
            if piece[first as usize] != none {
                continue;
            }
            piece[first as usize] = first;
            reached.push(first);
            while let Some(node) = reached.pop() {
                for &next in self.neighbours(node) {
                    if piece[next as usize] == none {
                        piece[next as usize] = first;
                        reached.push(next);
                    }
                }
            }
        }
        piece
    }

    /// Sorts a part into below a plane, above it, and separator; `None` where no plane separates.
    fn split(&self, part: &mut [u32], side: &mut [Side]) -> Option<[usize; 2]> {
        let at = |node: u32| self.places[node as usize];
        let mut low = at(part[0]);
        let mut high = low;
        for &node in &*part {
            low = low.inf(&at(node));
            high = high.sup(&at(node));
        }
        let axis = (high - low).imax();
        part.sort_unstable_by(|&a, &b| at(a)[axis].total_cmp(&at(b)[axis]).then(a.cmp(&b)));
        // A whole layer of a grid falls on one side.
        let middle = at(part[part.len() / 2])[axis] - 1e-9 * (high - low)[axis];
        let mut first = part.partition_point(|&node| at(node)[axis] < middle);
        if first == 0 {
            first = part.len() / 2;
        }
        part[..first].iter().for_each(|&node| side[node as usize] = Side::Below);
        part[first..].iter().for_each(|&node| side[node as usize] = Side::Above);
        let beside = |nodes: &[u32], other: Side| -> Vec<u32> {
            let touches =
                |node: &u32| self.neighbours(*node).iter().any(|&next| side[next as usize] == other);
            nodes.iter().copied().filter(touches).collect()
        };
        let (below, above) = (beside(&part[..first], Side::Above), beside(&part[first..], Side::Below));
        let separator = if below.len() <= above.len() { below } else { above };
        separator.iter().for_each(|&node| side[node as usize] = Side::Between);
        part.sort_by_key(|&node| side[node as usize]);
        let count = |which: Side| part.iter().filter(|&&node| side[node as usize] == which).count();
        let counts = [count(Side::Below), count(Side::Above)];
        part.iter().for_each(|&node| side[node as usize] = Side::Out);
        // All of one side touches the other: no gain.
        (counts[0] > 0 && counts[1] > 0).then_some(counts)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Nodes of a cube with this many to a side, and the edges of a grid.
    fn grid(side: u32) -> (Vec<Point3<f64>>, Vec<(u32, u32)>) {
        let number = |i: u32, j: u32, k: u32| (i * side + j) * side + k;
        let mut places = Vec::new();
        let mut edges = Vec::new();
        for i in 0..side {
            for j in 0..side {
                for k in 0..side {
                    places.push(Point3::new(f64::from(i), f64::from(j), f64::from(k)));
                    for [a, b, c] in [[1, 0, 0], [0, 1, 0], [0, 0, 1]] {
                        if i + a < side && j + b < side && k + c < side {
                            edges.push((number(i, j, k), number(i + a, j + b, k + c)));
                        }
                    }
                }
            }
        }
        (places, edges)
    }

    /// Entries of the factor below the diagonal, by elimination.
    fn fill(order: &[u32], edges: &[(u32, u32)]) -> usize {
        let mut place = vec![0; order.len()];
        order.iter().enumerate().for_each(|(at, &node)| place[node as usize] = at);
        let mut below = vec![std::collections::BTreeSet::new(); order.len()];
        for &(a, b) in edges {
            let (a, b) = (place[a as usize], place[b as usize]);
            below[a.min(b)].insert(a.max(b));
        }
        for at in 0..order.len() {
            let rows: Vec<usize> = below[at].iter().copied().collect();
            if let Some((&parent, rest)) = rows.split_first() {
                below[parent].extend(rest);
            }
        }
        below.iter().map(|rows| rows.len()).sum()
    }

    #[test]
    fn every_node_comes_once_and_less_is_filled_than_row_by_row() {
        let (places, edges) = grid(9);
        let order = nested_dissection(&places, edges.iter().copied());
        let mut sorted = order.clone();
        sorted.sort_unstable();
        assert_eq!(sorted, (0..places.len() as u32).collect::<Vec<_>>());
        let natural: Vec<u32> = (0..places.len() as u32).collect();
        let (found, natural) = (fill(&order, &edges), fill(&natural, &edges));
        assert!(3 * found < 2 * natural, "{found} entries, row by row {natural}");
    }

    #[test]
    fn what_is_not_joined_stands_apart() {
        // Two interleaved grids, with alternating node numbers.
        let (places, edges) = grid(6);
        let both: Vec<_> = places.iter().flat_map(|place| [*place; 2]).collect();
        let joined = edges.iter().flat_map(|&(a, b)| [(2 * a, 2 * b), (2 * a + 1, 2 * b + 1)]);
        let order = nested_dissection(&both, joined);
        let (first, second) = order.split_at(places.len());
        let alone = nested_dissection(&places, edges.iter().copied());
        assert!(first.iter().zip(&alone).all(|(node, alone)| *node == 2 * alone));
        assert!(second.iter().zip(&alone).all(|(node, alone)| *node == 2 * alone + 1));
    }

    #[test]
    fn nodes_at_one_place_and_nodes_without_edges_come_once_too() {
        let order = nested_dissection(&vec![Point3::origin(); 100], (0..99).map(|node| (node, node + 1)));
        let mut sorted = order.clone();
        sorted.sort_unstable();
        assert_eq!(sorted, (0..100).collect::<Vec<_>>());
        assert_eq!(nested_dissection(&[], std::iter::empty()), Vec::<u32>::new());
        assert_eq!(nested_dissection(&vec![Point3::origin(); 60], std::iter::empty()).len(), 60);
    }
}

//! Coarse meshes: farthest point sampling (Eldar et al. 1997) on the graph of a mesh's edges. What remains depends on the
//! connections of the vertices only, so a body keeps its coarse mesh while it deforms.

use std::collections::{BTreeSet, VecDeque};

/// A coarser mesh on some of the vertices.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(super) struct Coarse<const N: usize> {
    /// The vertices that remain, as indices of the fine mesh, ascending.
    pub(super) vertices: Vec<u32>,
    /// Its triangles or segments, as indices of `vertices`.
    pub(super) cells: Vec<[u32; N]>,
}

const NONE: u32 = u32::MAX;

/// Keeps at most `most` vertices: evenly spread ones, each of which stands for those nearest to it. Cells with vertices
/// beyond `count` are left out.
pub(super) fn coarsen<const N: usize>(cells: &[[u32; N]], count: usize, most: usize) -> Coarse<N> {
    let cells: Vec<[u32; N]> =
        cells.iter().filter(|cell| cell.iter().all(|vertex| (*vertex as usize) < count)).copied().collect();
    let mut used = vec![false; count];
    cells.iter().flatten().for_each(|vertex| used[*vertex as usize] = true);
    let used: Vec<u32> = (0..count as u32).filter(|vertex| used[*vertex as usize]).collect();
    let owner = if used.len() <= most {
        let mut owner = vec![NONE; count];
        used.iter().for_each(|vertex| owner[*vertex as usize] = *vertex);
        owner
    } else {
        nearest_of_the_kept(&Neighbours::new(&cells, count), &used, most)
    };
    let vertices: Vec<u32> =
        used.iter().copied().filter(|vertex| owner[*vertex as usize] == *vertex).collect();
    let mut place = vec![NONE; count];
    vertices.iter().zip(0..).for_each(|(vertex, index)| place[*vertex as usize] = index);
    let mut seen = BTreeSet::new();
    let mut coarse = Vec::new();
    for cell in &cells {
        let owners = cell.map(|vertex| owner[vertex as usize]);
        let is_whole = owners.iter().all(|owner| *owner != NONE);
        let is_flat = (0..N).any(|a| (0..a).any(|b| owners[a] == owners[b]));
        if !is_whole || is_flat {
            continue;
        }
        let mut cell = owners.map(|owner| place[owner as usize]);
        // The same corners from another side are another triangle; from another corner on they are not.
        let lowest = (0..N).min_by_key(|corner| cell[*corner]).unwrap_or(0);
        cell.rotate_left(lowest);
        if seen.insert(cell) {
            coarse.push(cell);
        }
    }
    Coarse { vertices, cells: coarse }
}

/// For each vertex the nearest of the vertices that are kept: each of these is as far as possible from those before it.
fn nearest_of_the_kept(neighbours: &Neighbours, used: &[u32], most: usize) -> Vec<u32> {
    let count = neighbours.begins.len() - 1;
    let (mut owner, mut steps) = (vec![NONE; count], vec![NONE; count]);
    let mut queue = VecDeque::new();
    for _ in 0..most {
        // Of several that are equally far the lowest.
        let farthest = used.iter().copied().max_by_key(|v| (steps[*v as usize], std::cmp::Reverse(*v)));
        let Some(kept) = farthest.filter(|vertex| steps[*vertex as usize] > 0) else { break };
        (owner[kept as usize], steps[kept as usize]) = (kept, 0);
        queue.push_back(kept);
        while let Some(vertex) = queue.pop_front() {
            let next = steps[vertex as usize] + 1;
            for neighbour in neighbours.of(vertex) {
                if next < steps[*neighbour as usize] {
                    (owner[*neighbour as usize], steps[*neighbour as usize]) = (kept, next);
                    queue.push_back(*neighbour);
                }
            }
        }
    }
    owner
}

/// The neighbours of each vertex.
struct Neighbours {
    begins: Vec<usize>,
    vertices: Vec<u32>,
}

impl Neighbours {
    fn new<const N: usize>(cells: &[[u32; N]], count: usize) -> Self {
        let mut begins = vec![0; count + 1];
        let edges = || {
            cells.iter().flat_map(|cell| (0..N).flat_map(move |a| (0..N).map(move |b| (cell[a], cell[b]))))
        };
        edges().for_each(|(from, _)| begins[from as usize + 1] += 1);
        for vertex in 0..count {
            begins[vertex + 1] += begins[vertex];
        }
        let mut ends = begins.clone();
        let mut vertices = vec![0; begins[count]];
        for (from, to) in edges() {
            vertices[ends[from as usize]] = to;
            ends[from as usize] += 1;
        }
        Self { begins, vertices }
    }

    fn of(&self, vertex: u32) -> &[u32] {
        &self.vertices[self.begins[vertex as usize]..self.begins[vertex as usize + 1]]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A square of `side` × `side` quads, and its vertices per row.
    fn sheet(side: u32) -> Vec<[u32; 3]> {
        let row = side + 1;
        let quads = (0..side * side).map(|quad| (quad / side * row + quad % side, row));
        quads.flat_map(|(a, row)| [[a, a + 1, a + row + 1], [a, a + row + 1, a + row]]).collect()
    }

    #[test]
    fn a_mesh_within_the_limit_stays_as_it_is_and_unused_vertices_go() {
        let cells = [[1, 2, 3], [3, 2, 5], [7, 8, 9]];
        let coarse = coarsen(&cells, 7, 100);
        assert_eq!(coarse.vertices, [1, 2, 3, 5]);
        assert_eq!(coarse.cells, [[0, 1, 2], [1, 3, 2]]);
    }

    #[test]
    fn a_coarse_sheet_has_as_many_vertices_as_allowed_and_covers_the_sheet() {
        let side = 40;
        let coarse = coarsen(&sheet(side), (side * side + 2 * side + 1) as usize, 100);
        assert_eq!(coarse.vertices.len(), 100);
        let at = |corner: u32| {
            let vertex = coarse.vertices[corner as usize];
            (f64::from(vertex % (side + 1)), f64::from(vertex / (side + 1)))
        };
        let area: f64 = coarse
            .cells
            .iter()
            .map(|cell| {
                let [(ax, ay), (bx, by), (cx, cy)] = cell.map(at);
                0.5 * ((bx - ax) * (cy - ay) - (cx - ax) * (by - ay))
            })
            .sum();
        assert!(area > 0.75 * f64::from(side * side), "the sign and most of the area are kept: {area}");
    }

    #[test]
    fn a_thread_stays_in_one_piece_and_parts_that_hang_together_are_all_kept() {
        let thread: Vec<[u32; 2]> = (0..99).map(|point| [point, point + 1]).collect();
        let coarse = coarsen(&thread, 100, 10);
        assert_eq!((coarse.vertices.len(), coarse.cells.len()), (10, 9));
        let pieces: Vec<[u32; 2]> = (0..50).map(|piece| [2 * piece, 2 * piece + 1]).collect();
        let coarse = coarsen(&pieces, 100, 60);
        assert_eq!(coarse.vertices.len(), 60);
        assert_eq!(coarsen::<3>(&[], 0, 10), Coarse::default());
    }
}

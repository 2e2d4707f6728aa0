//! Sparse block LU of a rod with strand contacts: the 4 × 4 blocks near the diagonal of `block_banded.rs`, and those of
//! touching nodes that are far apart along the rod. Block rows are eliminated in minimum-degree order (Tinney, Walker
//! 1967; George, Liu, *The Evolution of the Minimum Degree Ordering Algorithm*, 1989). A knot is long and thin: in one
//! of 257 nodes and 165 contacts no block row has more than 19 neighbours when it is eliminated, and the factorisation
//! takes 3 million operations, where the dense contact problem takes 47.
//!
//! There is no pivoting. The rod's own part is positive definite; a sliding contact adds `p nᵀ`, its force against its
//! normal, with `p·n = 1`, which elimination handles like a symmetric term.
// One index runs over several arrays.
#![allow(clippy::needless_range_loop)]

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use super::block_banded::{
    Added, Block, BlockBand, Cell, Columns, columns, inverse, product, subtract_from, subtract_product, times,
};
use crate::simd::dispatch::wide;

/// Position of a block: its slot, and whether its block row is eliminated after its block column.
#[derive(Clone, Copy, Debug, Default)]
struct BlockPosition {
    slot: u32,
    below: bool,
}

/// Pattern, values and factors.
#[derive(Clone, Debug, Default)]
pub(crate) struct BlockSparse {
    rows: usize,
    /// Whether the rod is closed: its last node is followed by its first.
    is_closed: bool,
    /// Touching edges in the pattern.
    couples: Vec<[u32; 2]>,
    /// Block rows in elimination order, and the position of each.
    order: Vec<u32>,
    places: Vec<u32>,
    /// Start of each eliminated column, and its neighbours: later positions, ascending.
    begins: Vec<u32>,
    below: Vec<u32>,
    /// For every column and every pair of its neighbours, the slot of their block.
    targets: Vec<u32>,
    /// Positions of the blocks left of the diagonal, and of the next ones.
    band: Vec<[BlockPosition; 2]>,
    /// Positions of the blocks of two edges: either node of the first with either of the second.
    far: Vec<[BlockPosition; 4]>,
    /// Pivots, then their inverses, in elimination order.
    pivots: Vec<Columns>,
    /// Below the diagonal, divided by the pivot, and above it.
    lower: Vec<Columns>,
    upper: Vec<Columns>,
    slanted: bool,
    neighbours: Vec<Vec<u32>>,
    marks: Vec<u32>,
    heap: BinaryHeap<Reverse<(u32, u32)>>,
    spread: Vec<[f64; 4]>,
}

impl BlockSparse {
    /// Computes an elimination order for this many block rows, of a closed rod or an open one, and touching edges; skipped
    /// where it is known. A closed rod has at least five block rows.
    pub fn analyse(&mut self, rows: usize, is_closed: bool, couples: impl Iterator<Item = [u32; 2]> + Clone) {
        let is_known = (rows, is_closed) == (self.rows, self.is_closed);
        if is_known && couples.clone().eq(self.couples.iter().copied()) {
            return;
        }
        (self.rows, self.is_closed) = (rows, is_closed);
        self.couples.clear();
        self.couples.extend(couples);
        self.find_neighbours();
        self.eliminate();
        self.find_slots();
    }

    fn find_neighbours(&mut self) {
        let rows = self.rows;
        self.neighbours.resize_with(self.neighbours.len().max(rows), Vec::new);
        for (row, list) in self.neighbours[..rows].iter_mut().enumerate() {
            list.clear();
            if self.is_closed {
                list.extend([2, 1].map(|back| ((row + rows - back) % rows) as u32));
                list.extend([1, 2].map(|ahead| ((row + ahead) % rows) as u32));
            } else {
                let near = [row.wrapping_sub(2), row.wrapping_sub(1), row + 1, row + 2];
                list.extend(near.into_iter().filter(|other| *other < rows).map(|other| other as u32));
            }
        }
        for &[first, second] in &self.couples {
            for a in [first as usize, self.after(first)] {
                for b in [second as usize, self.after(second)] {
                    self.neighbours[a].push(b as u32);
                    self.neighbours[b].push(a as u32);
                }
            }
        }
        for (row, list) in self.neighbours[..rows].iter_mut().enumerate() {
            list.sort_unstable();
            list.dedup();
            // Edges that touch beside each other across the seam share a node.
            list.retain(|other| *other as usize != row);
        }
    }

    /// The node at the end of an edge.
    fn after(&self, edge: u32) -> usize {
        let node = edge as usize + 1;
        if node < self.rows { node } else { 0 }
    }

    /// The node that far before one, if there is any.
    fn before(&self, row: usize, back: usize) -> Option<usize> {
        if self.is_closed { Some((row + self.rows - back) % self.rows) } else { row.checked_sub(back) }
    }

    /// The order, and the neighbours of each column, by block rows.
    fn eliminate(&mut self) {
        let rows = self.rows;
        let Self { neighbours, marks, heap, order, places, begins, below, .. } = self;
        marks.clear();
        marks.resize(rows, 0);
        let mut mark = 0;
        heap.clear();
        heap.extend((0..rows).map(|row| Reverse((neighbours[row].len() as u32, row as u32))));
        for list in [&mut *order, &mut *begins, &mut *below] {
            list.clear();
        }
        places.clear();
        places.resize(rows, u32::MAX);
        while let Some(Reverse((degree, row))) = heap.pop() {
            let own = row as usize;
            if places[own] != u32::MAX || neighbours[own].len() as u32 != degree {
                continue;
            }
            places[own] = order.len() as u32;
            order.push(row);
            begins.push(below.len() as u32);
            let touched = std::mem::take(&mut neighbours[own]);
            below.extend_from_slice(&touched);
            // Its neighbours become neighbours of each other.
            for &other in &touched {
                let list = &mut neighbours[other as usize];
                list.retain(|of| *of != row);
                mark += 1;
                list.iter().for_each(|of| marks[*of as usize] = mark);
                marks[other as usize] = mark;
                list.extend(touched.iter().copied().filter(|of| marks[*of as usize] != mark));
                heap.push(Reverse((list.len() as u32, other)));
            }
            neighbours[own] = touched;
        }
        begins.push(below.len() as u32);
        for column in 0..rows {
            let of = &mut below[begins[column] as usize..begins[column + 1] as usize];
            of.iter_mut().for_each(|row| *row = places[*row as usize]);
            of.sort_unstable();
        }
    }

    fn find_slots(&mut self) {
        let mut targets = std::mem::take(&mut self.targets);
        targets.clear();
        for column in 0..self.rows {
            let touched = &self.below[self.column(column)];
            for (index, &first) in touched.iter().enumerate() {
                // The first neighbour's column contains all the others as well.
                let mut slot = self.begins[first as usize];
                for &second in &touched[index + 1..] {
                    while self.below[slot as usize] != second {
                        slot += 1;
                    }
                    targets.push(slot);
                }
            }
        }
        self.targets = targets;
        let (mut band, mut far) = (std::mem::take(&mut self.band), std::mem::take(&mut self.far));
        band.clear();
        band.extend((0..self.rows).map(|row| {
            [1, 2].map(|back| {
                self.before(row, back).map_or(BlockPosition::default(), |other| self.place(row, other))
            })
        }));
        far.clear();
        far.extend(self.couples.iter().map(|&[a, b]| {
            let [(a, a_end), (b, b_end)] = [a, b].map(|edge| (edge as usize, self.after(edge)));
            [(a, b), (a, b_end), (a_end, b), (a_end, b_end)].map(|(row, column)| self.place(row, column))
        }));
        (self.band, self.far) = (band, far);
    }

    fn column(&self, column: usize) -> std::ops::Range<usize> {
        self.begins[column] as usize..self.begins[column + 1] as usize
    }

    /// Position of an off-diagonal block.
    fn place(&self, row: usize, column: usize) -> BlockPosition {
        let [row, column] = [row, column].map(|of| self.places[of]);
        let range = self.column(row.min(column) as usize);
        let within = self.below[range.clone()].partition_point(|of| *of < row.max(column));
        BlockPosition { slot: (range.start + within) as u32, below: row > column }
    }

    /// Loads the values near the diagonal and those added to them, without far contacts.
    pub fn begin(&mut self, matrix: &BlockBand, added: Option<&Added>) {
        self.slanted = added.is_some_and(|added| added.slanted);
        let slots = self.below.len();
        self.pivots.resize(self.rows, [[0.0; 4]; 4]);
        for list in [&mut self.lower, &mut self.upper] {
            list.clear();
            list.resize(slots, [[0.0; 4]; 4]);
        }
        for row in 0..self.rows {
            let block = matrix.diagonal[row];
            self.pivots[self.places[row] as usize] =
                columns(&added.map_or(block, |added| block + added.diagonal[row]));
            for (back, blocks) in [&matrix.first, &matrix.second].into_iter().enumerate() {
                if row <= back && !self.is_closed {
                    continue;
                }
                let mut pair = [blocks[row], blocks[row].transpose()];
                if let Some(added) = added.filter(|_| back == 0) {
                    pair[0] += added.below[row];
                    pair[1] += added.above[row];
                }
                self.put_pair(self.band[row][back], &pair);
            }
        }
    }

    /// Adds a block and its transpose partner.
    fn put_pair(&mut self, place: BlockPosition, [block, across]: &[Block; 2]) {
        let slot = place.slot as usize;
        let (below, above) = if place.below { (block, across) } else { (across, block) };
        sum(&mut self.lower[slot], below);
        sum(&mut self.upper[slot], above);
    }

    /// Adds the contact of one pair of edges: the blocks of their four nodes, row by row.
    pub fn add_couple(&mut self, number: usize, blocks: &[[Block; 4]; 4], slanted: bool) {
        self.slanted |= slanted;
        let [(first, first_end), (second, second_end)] =
            self.couples[number].map(|edge| (edge as usize, self.after(edge)));
        for (k, node) in [first, first_end, second, second_end].into_iter().enumerate() {
            sum(&mut self.pivots[self.places[node] as usize], &blocks[k][k]);
        }
        for (end, k) in [(first_end, 0), (second_end, 2)] {
            self.put_pair(self.band[end][0], &[blocks[k + 1][k], blocks[k][k + 1]]);
        }
        for (place, (row, column)) in self.far[number].into_iter().zip([(0, 2), (0, 3), (1, 2), (1, 3)]) {
            self.put_pair(place, &[blocks[row][column], blocks[column][row]]);
        }
    }

    /// Factorises, or returns the block row at which it fails.
    pub fn factorise(&mut self) -> Result<(), usize> {
        wide(
            #[inline(always)]
            || self.factorise_here(),
        )
    }

    #[inline(always)]
    fn factorise_here(&mut self) -> Result<(), usize> {
        let mut target = 0;
        for column in 0..self.rows {
            let pivot = inverse(&self.pivots[column], self.slanted).ok_or(self.order[column] as usize)?;
            self.pivots[column] = pivot;
            let (begin, end) = (self.begins[column] as usize, self.begins[column + 1] as usize);
            for block in &mut self.lower[begin..end] {
                *block = product(block, &pivot);
            }
            let (lower, later_lower) = self.lower.split_at_mut(end);
            let (upper, later_upper) = self.upper.split_at_mut(end);
            let (lower, upper, below) = (&lower[begin..], &upper[begin..], &self.below[begin..end]);
            for first in 0..below.len() {
                let (left, right) = (lower[first], upper[first]);
                subtract_product(&mut self.pivots[below[first] as usize], &left, &right);
                let rest = below.len() - first - 1;
                let slots = &self.targets[target..target + rest];
                target += rest;
                for ((slot, l), u) in slots.iter().zip(&lower[first + 1..]).zip(&upper[first + 1..]) {
                    let slot = *slot as usize - end;
                    subtract_product(&mut later_lower[slot], l, &right);
                    subtract_product(&mut later_upper[slot], &left, u);
                }
            }
        }
        Ok(())
    }

    /// Solves for one right-hand side in place.
    pub fn solve(&mut self, x: &mut [Cell]) {
        let mut spread = std::mem::take(&mut self.spread);
        spread.clear();
        spread.extend(self.order.iter().map(|row| <[f64; 4]>::from(x[*row as usize])));
        for column in 0..self.rows {
            let value = spread[column];
            let range = self.column(column);
            for (row, block) in self.below[range.clone()].iter().zip(&self.lower[range]) {
                subtract_from(&mut spread[*row as usize], block, &value);
            }
        }
        for column in (0..self.rows).rev() {
            let mut value = spread[column];
            let range = self.column(column);
            for (row, block) in self.below[range.clone()].iter().zip(&self.upper[range]) {
                subtract_from(&mut value, block, &spread[*row as usize]);
            }
            spread[column] = times(&self.pivots[column], &value);
        }
        for (row, value) in self.order.iter().zip(&spread) {
            x[*row as usize] = (*value).into();
        }
        self.spread = spread;
    }
}

fn sum(to: &mut Columns, block: &Block) {
    for (column, of) in block.data.0.iter().enumerate() {
        for (row, value) in of.iter().enumerate() {
            to[column][row] += value;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{DMatrix, DVector};
    use rand::{Rng, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    /// A rod with this many block rows and edges in contact, near and far, and the same as a dense matrix.
    fn random(
        rows: usize,
        is_closed: bool,
        couples: &[[u32; 2]],
        slanted: bool,
    ) -> (BlockSparse, DMatrix<f64>) {
        let mut random = Pcg64Mcg::seed_from_u64(rows as u64);
        let mut any = |size: f64| Block::from_fn(|_, _| random.random_range(-size..size));
        let mut band = BlockBand::default();
        band.clear(rows);
        let mut dense = DMatrix::zeros(4 * rows, 4 * rows);
        let put = |dense: &mut DMatrix<f64>, row: usize, column: usize, block: &Block| {
            let mut at = dense.view_mut((4 * row, 4 * column), (4, 4));
            at += block;
        };
        let mut added = Added::default();
        added.clear(rows);
        added.slanted = slanted;
        for i in 0..rows {
            for (back, blocks) in
                [&mut band.diagonal, &mut band.first, &mut band.second].into_iter().enumerate()
            {
                if i < back && !is_closed {
                    continue;
                }
                let left = (i + rows - back) % rows;
                let mut block = any(1.0);
                if back == 0 {
                    block = block + block.transpose() + Block::identity() * 30.0;
                } else {
                    put(&mut dense, left, i, &block.transpose());
                }
                blocks[i] = block;
                put(&mut dense, i, left, &block);
            }
            if slanted && (i > 0 || is_closed) {
                let left = (i + rows - 1) % rows;
                (added.below[i], added.above[i]) = (any(1.0), any(1.0));
                put(&mut dense, i, left, &added.below[i]);
                put(&mut dense, left, i, &added.above[i]);
            }
        }
        let mut sparse = BlockSparse::default();
        sparse.analyse(rows, is_closed, couples.iter().copied());
        sparse.begin(&band, Some(&added));
        for (number, &[a, b]) in couples.iter().enumerate() {
            let mut blocks: [[Block; 4]; 4] = std::array::from_fn(|_| std::array::from_fn(|_| any(1.0)));
            if !slanted {
                for row in 0..4 {
                    for column in 0..=row {
                        let both = blocks[row][column] + blocks[column][row].transpose();
                        (blocks[row][column], blocks[column][row]) = (both, both.transpose());
                    }
                }
            }
            let nodes = [a, a + 1, b, b + 1].map(|node| node as usize % rows);
            for row in 0..4 {
                for column in 0..4 {
                    put(&mut dense, nodes[row], nodes[column], &blocks[row][column]);
                }
            }
            sparse.add_couple(number, &blocks, slanted);
        }
        (sparse, dense)
    }

    const COUPLES: [[u32; 2]; 7] = [[0, 3], [0, 4], [1, 9], [2, 9], [2, 13], [8, 15], [9, 15]];

    #[test]
    fn it_solves_what_a_dense_matrix_solves_symmetric_or_not() {
        const OPEN: [(usize, &[[u32; 2]]); 5] =
            [(1, &[]), (2, &[]), (6, &[[0, 3], [0, 4]]), (17, &COUPLES), (40, &COUPLES)];
        // Across the seam edges 16 and 39 touch others; the shortest ring couples all of its nodes.
        const CLOSED: [(usize, &[[u32; 2]]); 4] = [
            (5, &[]),
            (6, &[[0, 3]]),
            (17, &[[3, 16], [0, 9], [13, 16], [8, 15]]),
            (40, &[[5, 39], [20, 39]]),
        ];
        let all = OPEN.map(|of| (of, false)).into_iter().chain(CLOSED.map(|of| (of, true)));
        for ((rows, couples), is_closed) in all {
            for slanted in [false, true] {
                let (mut sparse, dense) = random(rows, is_closed, couples, slanted);
                sparse.factorise().expect("factors");
                let right = DVector::from_fn(4 * rows, |i, _| (i * 7 % 11) as f64 - 5.0);
                let mut x: Vec<_> = (0..rows).map(|i| Cell::from_fn(|k, _| right[4 * i + k])).collect();
                sparse.solve(&mut x);
                let expected = dense.lu().solve(&right).expect("regular");
                for (i, cell) in x.iter().enumerate() {
                    for k in 0..4 {
                        assert!((cell[k] - expected[4 * i + k]).abs() < 1e-12, "row {i} of {rows}");
                    }
                }
            }
        }
    }

    #[test]
    fn the_factors_of_a_knot_are_as_sparse_as_it_is_long_and_thin() {
        // Two strands side by side, which is one rod that returns: a band would have 2 × 200 block columns of 400.
        let rows = 400;
        let couples: Vec<_> = (0..198).map(|k| [k, 398 - k]).collect();
        let mut sparse = BlockSparse::default();
        sparse.analyse(rows, false, couples.iter().copied());
        let touched = (0..rows).map(|column| sparse.column(column).len()).max().expect("columns");
        assert!(touched <= 8, "{touched} block rows are touched at once");
        assert!(sparse.below.len() < 8 * rows);
        // A known order is not recomputed.
        let order = sparse.order.clone();
        sparse.order.reverse();
        sparse.analyse(rows, false, couples.iter().copied());
        assert!(sparse.order.iter().rev().eq(order.iter()));
        sparse.analyse(rows, false, couples[1..].iter().copied());
        assert!(!sparse.order.iter().rev().eq(order.iter()));
    }

    #[test]
    fn the_factors_of_a_ring_are_as_sparse_as_those_of_two_rods() {
        let mut sparse = BlockSparse::default();
        sparse.analyse(400, true, std::iter::empty());
        let touched = (0..400).map(|column| sparse.column(column).len()).max().expect("columns");
        assert!(touched <= 4, "{touched} block rows are touched at once");
    }

    #[test]
    fn the_block_row_at_which_there_are_no_factors_is_named() {
        let (mut sparse, _) = random(17, false, &COUPLES, false);
        let place = sparse.places[11] as usize;
        sparse.pivots[place][2][2] = f64::NAN;
        assert_eq!(sparse.factorise(), Err(11));
        let mut none = BlockBand::default();
        none.clear(3);
        sparse.analyse(3, false, std::iter::empty());
        sparse.begin(&none, None);
        assert!(sparse.factorise().is_err());
    }
}

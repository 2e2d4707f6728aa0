//! Block-banded solver: 4 × 4 blocks with two neighbours to each side, as for a rod, whose bending couples three
//! neighbouring nodes; factorised and solved directly in O(n) (block `LDU`; Golub, Van Loan, *Matrix Computations*,
//! 2013, §4.3 and §4.5). The rod's own part is symmetric and positive definite; sliding contacts make it unsymmetric,
//! since friction depends on the normal force but not the reverse.
// One index runs over several arrays.
#![allow(clippy::needless_range_loop)]

use nalgebra::{SMatrix, SVector};

use crate::simd::dispatch::wide;

/// One block: the position of a node and the turn angle of the edge that begins at it.
pub(crate) type Block = SMatrix<f64, 4, 4>;
/// One block row of a vector: displacement and angle, or force and torque.
pub(crate) type Cell = SVector<f64, 4>;

/// Number of right-hand sides solved together.
pub(crate) const LANES: usize = 8;
/// One block row of that many right-hand sides.
pub(crate) type LaneCell = [[f64; LANES]; 4];

/// A block, column by column.
pub(crate) type Columns = [[f64; 4]; 4];

/// The lower half of the symmetric matrix. Of a closed rod the matrix is cyclic: the blocks left of the first block
/// column are those at the last ones.
#[derive(Clone, Debug, Default)]
pub(crate) struct BlockBand {
    pub diagonal: Vec<Block>,
    /// Left of the diagonal: block row `i`, block column `i − 1`.
    pub first: Vec<Block>,
    /// Block row `i`, block column `i − 2`.
    pub second: Vec<Block>,
}

impl BlockBand {
    /// A zero matrix of `rows` block rows.
    pub fn clear(&mut self, rows: usize) {
        for blocks in [&mut self.diagonal, &mut self.first, &mut self.second] {
            blocks.clear();
            blocks.resize(rows, Block::zeros());
        }
    }
}

/// A tridiagonal block matrix to be added; it need not be symmetric.
#[derive(Clone, Debug, Default)]
pub(crate) struct Added {
    pub diagonal: Vec<Block>,
    /// Block row `i`, block column `i − 1`.
    pub below: Vec<Block>,
    /// Block row `i − 1`, block column `i`; as those below, cyclic for a closed rod.
    pub above: Vec<Block>,
    /// Whether it is unsymmetric.
    pub slanted: bool,
}

impl Added {
    /// A zero matrix of `rows` block rows.
    pub fn clear(&mut self, rows: usize) {
        for blocks in [&mut self.diagonal, &mut self.below, &mut self.above] {
            blocks.clear();
            blocks.resize(rows, Block::zeros());
        }
        self.slanted = false;
    }
}

/// The factors of a matrix.
#[derive(Clone, Debug, Default)]
pub(crate) struct Factors {
    /// Inverses of the pivots.
    inverse: Vec<Columns>,
    /// Block row `i` of the lower factor, block columns `i − 1` and `i − 2`.
    lower: Vec<[Columns; 2]>,
    /// Block row `i` of the upper factor, block columns `i + 1` and `i + 2`.
    upper: Vec<[Columns; 2]>,
}

impl Factors {
    /// Factorises the sum of a matrix and `added`, or returns the block row at which it fails: where a symmetric matrix
    /// is not positive definite, or an unsymmetric one is singular.
    pub fn find(&mut self, matrix: &BlockBand, added: Option<&Added>) -> Result<(), usize> {
        let rows = matrix.diagonal.len();
        let slanted = added.is_some_and(|added| added.slanted);
        let with = |block: &Block, list: fn(&Added) -> &[Block], i: usize| {
            columns(&added.map_or(*block, |added| block + list(added)[i]))
        };
        self.inverse.resize(rows, [[0.0; 4]; 4]);
        for list in [&mut self.lower, &mut self.upper] {
            list.resize(rows, [[[0.0; 4]; 4]; 2]);
        }
        // Block row i − 1, block column i of the upper factor before division by its pivot.
        let mut above_before = [[0.0; 4]; 4];
        for i in 0..rows {
            let mut pivot = with(&matrix.diagonal[i], |added| &added.diagonal, i);
            if i == 0 {
                self.inverse[i] = inverse(&pivot, slanted).ok_or(i)?;
                continue;
            }
            let mut next = with(&matrix.first[i], |added| &added.below, i);
            let mut above = if slanted {
                with(&matrix.first[i].transpose(), |added| &added.above, i)
            } else {
                [[0.0; 4]; 4]
            };
            if i >= 2 {
                let far = columns(&matrix.second[i]);
                let across = transposed(&far);
                let factor = product(&far, &self.inverse[i - 2]);
                subtract_product(&mut pivot, &factor, &across);
                if slanted {
                    subtract_product(&mut next, &factor, &above_before);
                    subtract_product(&mut above, &self.lower[i - 1][0], &across);
                    self.upper[i - 2][1] = product(&self.inverse[i - 2], &across);
                } else {
                    subtract_product(&mut next, &far, &self.upper[i - 2][0]);
                    self.upper[i - 2][1] = transposed(&factor);
                }
                self.lower[i][1] = factor;
            }
            let factor = product(&next, &self.inverse[i - 1]);
            if slanted {
                subtract_product(&mut pivot, &factor, &above);
                self.upper[i - 1][0] = product(&self.inverse[i - 1], &above);
                above_before = above;
            } else {
                let across = transposed(&factor);
                subtract_product(&mut pivot, &next, &across);
                self.upper[i - 1][0] = across;
            }
            self.lower[i][0] = factor;
            self.inverse[i] = inverse(&pivot, slanted).ok_or(i)?;
        }
        Ok(())
    }

    /// Solves for one right-hand side in place.
    pub fn solve(&self, x: &mut [Cell]) {
        let rows = x.len();
        for i in 1..rows {
            let mut value = x[i].into();
            subtract_from(&mut value, &self.lower[i][0], &x[i - 1].into());
            if i >= 2 {
                subtract_from(&mut value, &self.lower[i][1], &x[i - 2].into());
            }
            x[i] = value.into();
        }
        for i in (0..rows).rev() {
            let mut value = times(&self.inverse[i], &x[i].into());
            if i + 1 < rows {
                subtract_from(&mut value, &self.upper[i][0], &x[i + 1].into());
            }
            if i + 2 < rows {
                subtract_from(&mut value, &self.upper[i][1], &x[i + 2].into());
            }
            x[i] = value.into();
        }
    }

    /// Solves in place for [`LANES`] right-hand sides that are zero in block rows before `from`; the results in block
    /// rows before `until` are not valid.
    pub fn solve_lanes(&self, x: &mut [LaneCell], from: usize, until: usize) {
        wide(
            #[inline(always)]
            || self.solve_lanes_here(x, from, until),
        );
    }

    #[inline(always)]
    fn solve_lanes_here(&self, x: &mut [LaneCell], from: usize, until: usize) {
        let rows = x.len();
        for i in from + 1..rows {
            let mut value = x[i];
            subtract(&mut value, &self.lower[i][0], &x[i - 1]);
            if i >= from + 2 {
                subtract(&mut value, &self.lower[i][1], &x[i - 2]);
            }
            x[i] = value;
        }
        for i in (until..rows).rev() {
            let mut value = [[0.0; LANES]; 4];
            if i >= from {
                add(&mut value, &self.inverse[i], &x[i]);
            }
            if i + 1 < rows {
                subtract(&mut value, &self.upper[i][0], &x[i + 1]);
            }
            if i + 2 < rows {
                subtract(&mut value, &self.upper[i][1], &x[i + 2]);
            }
            x[i] = value;
        }
    }
}

#[inline]
pub(crate) fn columns(block: &Block) -> Columns {
    block.data.0
}

#[inline]
fn transposed(of: &Columns) -> Columns {
    std::array::from_fn(|column| std::array::from_fn(|row| of[row][column]))
}

#[inline(always)]
pub(crate) fn product(a: &Columns, b: &Columns) -> Columns {
    let mut c = [[0.0; 4]; 4];
    for column in 0..4 {
        for k in 0..4 {
            for row in 0..4 {
                c[column][row] += a[k][row] * b[column][k];
            }
        }
    }
    c
}

#[inline(always)]
pub(crate) fn subtract_product(c: &mut Columns, a: &Columns, b: &Columns) {
    for column in 0..4 {
        for k in 0..4 {
            for row in 0..4 {
                c[column][row] -= a[k][row] * b[column][k];
            }
        }
    }
}

#[inline]
pub(crate) fn times(a: &Columns, x: &[f64; 4]) -> [f64; 4] {
    let mut value = [0.0; 4];
    for k in 0..4 {
        for row in 0..4 {
            value[row] += a[k][row] * x[k];
        }
    }
    value
}

#[inline]
pub(crate) fn subtract_from(value: &mut [f64; 4], a: &Columns, x: &[f64; 4]) {
    for k in 0..4 {
        for row in 0..4 {
            value[row] -= a[k][row] * x[k];
        }
    }
}

#[inline(always)]
fn add(value: &mut LaneCell, block: &Columns, x: &LaneCell) {
    for row in 0..4 {
        for column in 0..4 {
            let factor = block[column][row];
            for lane in 0..LANES {
                value[row][lane] += factor * x[column][lane];
            }
        }
    }
}

#[inline(always)]
fn subtract(value: &mut LaneCell, block: &Columns, x: &LaneCell) {
    for row in 0..4 {
        for column in 0..4 {
            let factor = block[column][row];
            for lane in 0..LANES {
                value[row][lane] -= factor * x[column][lane];
            }
        }
    }
}

#[inline]
pub(crate) fn inverse(of: &Columns, slanted: bool) -> Option<Columns> {
    if slanted { inverse_slanted(of) } else { inverse_symmetric(of) }
}

/// By `LDLᵀ`, whose accuracy, like Cholesky's, is independent of row scaling.
#[inline]
fn inverse_symmetric(of: &Columns) -> Option<Columns> {
    let mut lower = [[0.0; 4]; 4];
    let (mut pivots, mut share) = ([0.0; 4], [0.0; 4]);
    for j in 0..4 {
        let mut column = of[j];
        for k in 0..j {
            let factor = lower[k][j] * pivots[k];
            for i in j..4 {
                column[i] -= lower[k][i] * factor;
            }
        }
        let pivot = column[j];
        if pivot.is_nan() || pivot <= 0.0 || pivot.is_infinite() {
            return None;
        }
        (pivots[j], share[j]) = (pivot, 1.0 / pivot);
        for i in j..4 {
            lower[j][i] = column[i] * share[j];
        }
    }
    // The inverse of the lower factor, column by column.
    let mut left = [[0.0; 4]; 4];
    for j in 0..4 {
        left[j][j] = 1.0;
        for i in j + 1..4 {
            let mut value = -lower[j][i];
            for k in j + 1..i {
                value -= lower[k][i] * left[j][k];
            }
            left[j][i] = value;
        }
    }
    let mut inverse = [[0.0; 4]; 4];
    for column in 0..4 {
        for row in column..4 {
            let mut value = 0.0;
            for k in row..4 {
                value += left[row][k] * left[column][k] * share[k];
            }
            (inverse[column][row], inverse[row][column]) = (value, value);
        }
    }
    Some(inverse)
}

/// By elimination without pivoting: with rows of different units, size is no criterion. A pivot may be negative: where
/// sliding increases the normal force faster than compliance reduces it, friction jams (Klarbring, *Examples of
/// non-uniqueness and non-existence of solutions to quasistatic contact problems with friction*, 1990). Newton's method
/// then finds that such a contact sticks; rejecting it would divide steps unnecessarily.
#[inline]
fn inverse_slanted(of: &Columns) -> Option<Columns> {
    let mut left = *of;
    let mut right: Columns = std::array::from_fn(|j| std::array::from_fn(|i| f64::from(u8::from(i == j))));
    for k in 0..4 {
        let pivot = left[k][k];
        if pivot == 0.0 || !pivot.is_finite() {
            return None;
        }
        let share = 1.0 / pivot;
        for column in 0..4 {
            left[column][k] *= share;
            right[column][k] *= share;
        }
        for row in 0..4 {
            if row == k {
                continue;
            }
            let factor = left[k][row];
            for column in 0..4 {
                left[column][row] -= factor * left[column][k];
                right[column][row] -= factor * right[column][k];
            }
        }
    }
    Some(right)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::DMatrix;
    use rand::{Rng, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    /// A random positive definite matrix, and the same as a dense one.
    fn random(rows: usize, seed: u64) -> (BlockBand, DMatrix<f64>) {
        let mut random = Pcg64Mcg::seed_from_u64(seed);
        let mut band = BlockBand::default();
        band.clear(rows);
        let mut dense = DMatrix::zeros(4 * rows, 4 * rows);
        for i in 0..rows {
            for (back, blocks) in
                [&mut band.diagonal, &mut band.first, &mut band.second].into_iter().enumerate()
            {
                if i < back {
                    continue;
                }
                let mut block = Block::from_fn(|_, _| random.random_range(-1.0..1.0));
                if back == 0 {
                    block = block + block.transpose() + Block::identity() * 20.0;
                }
                blocks[i] = block;
                dense.view_mut((4 * i, 4 * (i - back)), (4, 4)).copy_from(&block);
                dense.view_mut((4 * (i - back), 4 * i), (4, 4)).copy_from(&block.transpose());
            }
        }
        (band, dense)
    }

    #[test]
    fn it_solves_what_a_dense_matrix_solves() {
        for rows in [1, 2, 3, 4, 17] {
            let (band, dense) = random(rows, rows as u64);
            let mut factors = Factors::default();
            factors.find(&band, None).expect("positive definite");
            let mut random = Pcg64Mcg::seed_from_u64(9);
            let right = DMatrix::from_fn(4 * rows, 1, |_, _| random.random_range(-1.0..1.0));
            let mut x: Vec<_> = (0..rows).map(|i| Cell::from_fn(|k, _| right[4 * i + k])).collect();
            factors.solve(&mut x);
            let expected = dense.cholesky().expect("positive definite").solve(&right);
            for (i, cell) in x.iter().enumerate() {
                for k in 0..4 {
                    assert!((cell[k] - expected[4 * i + k]).abs() < 1e-13, "row {i}");
                }
            }
        }
    }

    #[test]
    fn what_is_added_need_not_be_symmetric() {
        for rows in [2, 3, 4, 17] {
            let (band, mut dense) = random(rows, 40 + rows as u64);
            let mut random = Pcg64Mcg::seed_from_u64(3);
            let mut added = Added::default();
            added.clear(rows);
            added.slanted = true;
            for i in 0..rows {
                let mut block = || Block::from_fn(|_, _| random.random_range(-1.0..1.0));
                added.diagonal[i] = block();
                let mut put = |row: usize, column: usize, block: Block| {
                    let mut at = dense.view_mut((4 * row, 4 * column), (4, 4));
                    at += block;
                };
                put(i, i, added.diagonal[i]);
                if i > 0 {
                    (added.below[i], added.above[i]) = (block(), block());
                    put(i, i - 1, added.below[i]);
                    put(i - 1, i, added.above[i]);
                }
            }
            let mut factors = Factors::default();
            factors.find(&band, Some(&added)).expect("factors");
            let right = DMatrix::from_fn(4 * rows, 1, |_, _| random.random_range(-1.0..1.0));
            let mut x: Vec<_> = (0..rows).map(|i| Cell::from_fn(|k, _| right[4 * i + k])).collect();
            factors.solve(&mut x);
            let expected = dense.lu().solve(&right).expect("regular");
            for (i, cell) in x.iter().enumerate() {
                for k in 0..4 {
                    assert!((cell[k] - expected[4 * i + k]).abs() < 1e-13, "row {i}");
                }
            }
        }
    }

    #[test]
    fn several_right_hand_sides_at_once_are_the_same() {
        let rows = 12;
        let (band, _) = random(rows, 5);
        let mut factors = Factors::default();
        factors.find(&band, None).expect("positive definite");
        let (from, until) = (4, 2);
        let mut lanes = vec![[[0.0; LANES]; 4]; rows];
        let mut single = vec![vec![Cell::zeros(); rows]; LANES];
        for lane in 0..LANES {
            single[lane][from + lane % 3][lane % 4] = 1.0 + lane as f64;
            lanes[from + lane % 3][lane % 4][lane] = 1.0 + lane as f64;
        }
        let mut narrow = lanes.clone();
        factors.solve_lanes_here(&mut narrow, from, until);
        factors.solve_lanes(&mut lanes, from, until);
        assert_eq!(lanes, narrow, "to the bit, however wide the registers");
        for (lane, x) in single.iter_mut().enumerate() {
            factors.solve(x);
            for i in until..rows {
                for k in 0..4 {
                    assert!((lanes[i][k][lane] - x[i][k]).abs() < 1e-14);
                }
            }
        }
    }

    #[test]
    fn friction_that_jams_has_factors_all_the_same() {
        let (band, dense) = random(6, 3);
        let mut added = Added::default();
        added.clear(6);
        // A normal force that grows with sliding, at one node: a pivot is negative.
        added.diagonal[2][(0, 0)] = -4.0 * dense[(8, 8)];
        added.diagonal[2][(1, 0)] = 0.3;
        added.slanted = true;
        let mut whole = dense.clone();
        whole[(8, 8)] -= 4.0 * dense[(8, 8)];
        whole[(9, 8)] += 0.3;
        let mut factors = Factors::default();
        factors.find(&band, Some(&added)).expect("factors");
        let right = nalgebra::DVector::from_fn(24, |i, _| 1.0 + i as f64);
        let mut found: Vec<Cell> = (0..6).map(|i| Cell::from_fn(|k, _| right[4 * i + k])).collect();
        factors.solve(&mut found);
        let expected = whole.lu().solve(&right).expect("regular");
        for (i, cell) in found.iter().enumerate() {
            for k in 0..4 {
                assert!((cell[k] - expected[4 * i + k]).abs() < 1e-9 * expected.amax());
            }
        }
        // A singular matrix has no factors.
        let mut none = BlockBand::default();
        none.clear(3);
        assert_eq!(
            Factors::default().find(
                &none,
                Some(&{
                    added.clear(3);
                    added.slanted = true;
                    added
                })
            ),
            Err(0)
        );
    }

    #[test]
    fn a_matrix_that_is_not_positive_definite_is_named() {
        let (mut band, _) = random(6, 1);
        band.diagonal[3][(2, 2)] = -1.0;
        assert_eq!(Factors::default().find(&band, None), Err(3));
        let (mut band, _) = random(6, 1);
        band.diagonal[4][(0, 0)] = f64::NAN;
        assert_eq!(Factors::default().find(&band, None), Err(4));
    }
}

//! A symmetric positive definite matrix of 4 × 4 blocks in which a block row touches two block rows to each side, as a
//! rod's does whose bending couples three neighbouring nodes: factorised and solved directly in O(n) (block `LDLᵀ`;
//! Golub, Van Loan, *Matrix Computations*, 2013, §4.3 and §4.5).

use nalgebra::{SMatrix, SVector};

/// One block: the position of a node and the turn of the edge that begins in it.
pub(crate) type Block = SMatrix<f64, 4, 4>;
/// What belongs to one block row: a displacement and an angle, or a force and a torque.
pub(crate) type Cell = SVector<f64, 4>;

/// Right-hand sides that are solved together.
pub(crate) const LANES: usize = 8;
/// One block row of as many right-hand sides as are solved together.
pub(crate) type LaneCell = [[f64; LANES]; 4];

/// The lower half of the matrix; after [`BlockBand::factor`] its factors.
#[derive(Clone, Debug, Default)]
pub(crate) struct BlockBand {
    pub diagonal: Vec<Block>,
    /// Left of the diagonal: block row `i`, block column `i − 1`.
    pub first: Vec<Block>,
    /// Block row `i`, block column `i − 2`.
    pub second: Vec<Block>,
    inverse: Vec<Block>,
}

impl BlockBand {
    /// All zero, of `rows` block rows.
    pub fn clear(&mut self, rows: usize) {
        for blocks in [&mut self.diagonal, &mut self.first, &mut self.second, &mut self.inverse] {
            blocks.clear();
            blocks.resize(rows, Block::zeros());
        }
    }

    /// Replaces the matrix by its factors, or names the block row at which it is not positive definite.
    pub fn factor(&mut self) -> Result<(), usize> {
        for i in 0..self.diagonal.len() {
            let mut pivot = self.diagonal[i];
            let mut next = self.first[i];
            if i >= 2 {
                let far = self.second[i];
                let factor = far * self.inverse[i - 2];
                pivot -= far * factor.transpose();
                next -= far * self.first[i - 1].transpose();
                self.second[i] = factor;
            }
            if i >= 1 {
                let factor = next * self.inverse[i - 1];
                pivot -= next * factor.transpose();
                self.first[i] = factor;
            }
            self.inverse[i] = inverse(&pivot).ok_or(i)?;
        }
        Ok(())
    }

    /// Solves for one right-hand side in place.
    pub fn solve(&self, x: &mut [Cell]) {
        let rows = x.len();
        for i in 1..rows {
            let mut value = x[i] - self.first[i] * x[i - 1];
            if i >= 2 {
                value -= self.second[i] * x[i - 2];
            }
            x[i] = value;
        }
        for i in (0..rows).rev() {
            let mut value = self.inverse[i] * x[i];
            if i + 1 < rows {
                value -= self.first[i + 1].tr_mul(&x[i + 1]);
            }
            if i + 2 < rows {
                value -= self.second[i + 2].tr_mul(&x[i + 2]);
            }
            x[i] = value;
        }
    }

    /// Solves for [`LANES`] right-hand sides in place that are zero in block rows before `from`; what is found in block
    /// rows before `until` is not meant to be read.
    pub fn solve_lanes(&self, x: &mut [LaneCell], from: usize, until: usize) {
        let rows = x.len();
        for i in from + 1..rows {
            let mut value = x[i];
            subtract(&mut value, &self.first[i], &x[i - 1]);
            if i >= from + 2 {
                subtract(&mut value, &self.second[i], &x[i - 2]);
            }
            x[i] = value;
        }
        for i in (until..rows).rev() {
            let mut value = [[0.0; LANES]; 4];
            if i >= from {
                add(&mut value, &self.inverse[i], &x[i]);
            }
            if i + 1 < rows {
                subtract_transposed(&mut value, &self.first[i + 1], &x[i + 1]);
            }
            if i + 2 < rows {
                subtract_transposed(&mut value, &self.second[i + 2], &x[i + 2]);
            }
            x[i] = value;
        }
    }
}

#[inline]
fn add(value: &mut LaneCell, block: &Block, x: &LaneCell) {
    for row in 0..4 {
        for column in 0..4 {
            let factor = block[(row, column)];
            for lane in 0..LANES {
                value[row][lane] += factor * x[column][lane];
            }
        }
    }
}

#[inline]
fn subtract(value: &mut LaneCell, block: &Block, x: &LaneCell) {
    for row in 0..4 {
        for column in 0..4 {
            let factor = block[(row, column)];
            for lane in 0..LANES {
                value[row][lane] -= factor * x[column][lane];
            }
        }
    }
}

#[inline]
fn subtract_transposed(value: &mut LaneCell, block: &Block, x: &LaneCell) {
    for row in 0..4 {
        for column in 0..4 {
            let factor = block[(column, row)];
            for lane in 0..LANES {
                value[row][lane] -= factor * x[column][lane];
            }
        }
    }
}

/// By Cholesky's factors, whose accuracy does not suffer from rows of different units.
#[inline]
fn inverse(of: &Block) -> Option<Block> {
    let mut lower = Block::zeros();
    for j in 0..4 {
        let mut pivot = of[(j, j)];
        for k in 0..j {
            pivot -= lower[(j, k)] * lower[(j, k)];
        }
        if pivot.is_nan() || pivot <= 0.0 || pivot.is_infinite() {
            return None;
        }
        let root = pivot.sqrt();
        lower[(j, j)] = root;
        for i in j + 1..4 {
            let mut value = of[(i, j)];
            for k in 0..j {
                value -= lower[(i, k)] * lower[(j, k)];
            }
            lower[(i, j)] = value / root;
        }
    }
    let mut inverse = Block::zeros();
    for j in 0..4 {
        inverse[(j, j)] = 1.0 / lower[(j, j)];
        for i in j + 1..4 {
            let mut value = 0.0;
            for k in j..i {
                value -= lower[(i, k)] * inverse[(k, j)];
            }
            inverse[(i, j)] = value / lower[(i, i)];
        }
    }
    Some(inverse.tr_mul(&inverse))
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::DMatrix;
    use rand::{Rng, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    /// A random positive definite one and the same as a dense matrix.
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
            let (mut band, dense) = random(rows, rows as u64);
            band.factor().expect("positive definite");
            let mut random = Pcg64Mcg::seed_from_u64(9);
            let right = DMatrix::from_fn(4 * rows, 1, |_, _| random.random_range(-1.0..1.0));
            let mut x: Vec<_> = (0..rows).map(|i| Cell::from_fn(|k, _| right[4 * i + k])).collect();
            band.solve(&mut x);
            let expected = dense.cholesky().expect("positive definite").solve(&right);
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
        let (mut band, _) = random(rows, 5);
        band.factor().expect("positive definite");
        let (from, until) = (4, 2);
        let mut lanes = vec![[[0.0; LANES]; 4]; rows];
        let mut single = vec![vec![Cell::zeros(); rows]; LANES];
        for lane in 0..LANES {
            single[lane][from + lane % 3][lane % 4] = 1.0 + lane as f64;
            lanes[from + lane % 3][lane % 4][lane] = 1.0 + lane as f64;
        }
        band.solve_lanes(&mut lanes, from, until);
        for (lane, x) in single.iter_mut().enumerate() {
            band.solve(x);
            for i in until..rows {
                for k in 0..4 {
                    assert!((lanes[i][k][lane] - x[i][k]).abs() < 1e-14);
                }
            }
        }
    }

    #[test]
    fn a_matrix_that_is_not_positive_definite_is_named() {
        let (mut band, _) = random(6, 1);
        band.diagonal[3][(2, 2)] = -1.0;
        assert_eq!(band.factor(), Err(3));
        let (mut band, _) = random(6, 1);
        band.diagonal[4][(0, 0)] = f64::NAN;
        assert_eq!(band.factor(), Err(4));
    }
}

//! Symmetric block matrix: a 3×3 block wherever two nodes share an element, with its lower triangle in compressed
//! columns, as a Cholesky factorisation reads it.

use nalgebra::{Matrix3, Vector3};

/// Sparsity pattern of the lower triangle's blocks.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct BlockPattern {
    /// Block column `c` is `rows[starts[c]..starts[c + 1]]`, the diagonal first.
    starts: Vec<usize>,
    rows: Vec<u32>,
    /// The scalar columns of the lower triangle.
    col_ptr: Vec<usize>,
    row_idx: Vec<usize>,
}

impl BlockPattern {
    /// The pattern for `nodes` block rows with these pairs of neighbours, in any order, with repetitions.
    #[must_use]
    pub fn new(nodes: usize, pairs: impl Iterator<Item = (u32, u32)>) -> Self {
        let mut entries: Vec<(u32, u32)> = (0..nodes as u32).map(|node| (node, node)).collect();
        entries.extend(pairs.map(|(a, b)| (a.min(b), a.max(b))));
        entries.sort_unstable();
        entries.dedup();
        let mut starts = vec![0; nodes + 1];
        for &(column, _) in &entries {
            starts[column as usize + 1] += 1;
        }
        for column in 0..nodes {
            starts[column + 1] += starts[column];
        }
        let rows: Vec<u32> = entries.into_iter().map(|(_, row)| row).collect();
        let mut col_ptr = Vec::with_capacity(3 * nodes + 1);
        let mut row_idx = Vec::with_capacity(9 * rows.len());
        col_ptr.push(0);
        for column in 0..nodes {
            for axis in 0..3 {
                for &row in &rows[starts[column]..starts[column + 1]] {
                    let from = if row as usize == column { axis } else { 0 };
                    row_idx.extend((from..3).map(|r| 3 * row as usize + r));
                }
                col_ptr.push(row_idx.len());
            }
        }
        Self { starts, rows, col_ptr, row_idx }
    }

    /// Block rows.
    #[must_use]
    pub fn nodes(&self) -> usize {
        self.starts.len().saturating_sub(1)
    }

    /// Rows of a block column, itself first, ascending.
    #[must_use]
    pub fn column(&self, column: usize) -> &[u32] {
        &self.rows[self.starts[column]..self.starts[column + 1]]
    }

    /// Starts of the scalar columns of the lower triangle.
    #[must_use]
    pub fn col_ptr(&self) -> &[usize] {
        &self.col_ptr
    }

    /// Rows of the scalar entries of the lower triangle, ascending within a column.
    #[must_use]
    pub fn row_idx(&self) -> &[usize] {
        &self.row_idx
    }

    /// Positions of block (row, column), row ≥ column, in each of its three scalar columns: its entry of row r and
    /// column c is at `slot[c] + r`, on the diagonal for r ≥ c only. `None` where there is no such block.
    #[must_use]
    pub fn slot(&self, row: u32, column: u32) -> Option<[usize; 3]> {
        let at = self.column(column as usize).binary_search(&row).ok()?;
        // Nothing is stored above the diagonal: later entries are one and two positions nearer to the beginning.
        Some([0, 1, 2].map(|axis| self.col_ptr[3 * column as usize + axis] + 3 * at - axis))
    }
}

/// A symmetric matrix with such a pattern: the values of its lower triangle.
#[derive(Clone, Debug, PartialEq)]
pub struct BlockMatrix {
    pattern: BlockPattern,
    values: Vec<f64>,
}

impl BlockMatrix {
    /// All zero.
    #[must_use]
    pub fn zeros(pattern: BlockPattern) -> Self {
        let values = vec![0.0; pattern.row_idx.len()];
        Self { pattern, values }
    }

    /// Its pattern.
    #[must_use]
    pub fn pattern(&self) -> &BlockPattern {
        &self.pattern
    }

    /// Values of the lower triangle, by columns.
    #[must_use]
    pub fn values(&self) -> &[f64] {
        &self.values
    }

    /// The same, mutable.
    pub fn values_mut(&mut self) -> &mut [f64] {
        &mut self.values
    }

    /// Adds a block where `row` ≥ `column`; of a diagonal block only its lower triangle is read. A block outside the
    /// pattern is ignored.
    pub fn add(&mut self, row: u32, column: u32, block: &Matrix3<f64>) {
        let Some(slot) = self.pattern.slot(row, column) else { return };
        for c in 0..3 {
            for r in if row == column { c } else { 0 }..3 {
                self.values[slot[c] + r] += block[(r, c)];
            }
        }
    }

    /// y = A x.
    ///
    /// # Panics
    /// When a slice does not have one vector per block row.
    pub fn multiply(&self, x: &[Vector3<f64>], y: &mut [Vector3<f64>]) {
        assert!(x.len() == self.pattern.nodes() && y.len() == x.len(), "one vector per block row");
        y.fill(Vector3::zeros());
        for column in 0..x.len() {
            let rows = self.pattern.column(column);
            let base = [0, 1, 2].map(|axis| self.pattern.col_ptr[3 * column + axis]);
            let v = &self.values;
            let [a, b, c] = base;
            let own = x[column];
            // The diagonal: three, two, one entries.
            let mut sum = Vector3::new(
                v[a] * own.x + v[a + 1] * own.y + v[a + 2] * own.z,
                v[a + 1] * own.x + v[b] * own.y + v[b + 1] * own.z,
                v[a + 2] * own.x + v[b + 1] * own.y + v[c] * own.z,
            );
            let count = 3 * (rows.len() - 1);
            let (first, second, third) =
                (&v[a + 3..a + 3 + count], &v[b + 2..b + 2 + count], &v[c + 1..c + 1 + count]);
            for (k, &row) in rows[1..].iter().enumerate() {
                let at = 3 * k;
                let [p, q, r] = [&first[at..at + 3], &second[at..at + 3], &third[at..at + 3]];
                let other = x[row as usize];
                sum.x += p[0] * other.x + p[1] * other.y + p[2] * other.z;
                sum.y += q[0] * other.x + q[1] * other.y + q[2] * other.z;
                sum.z += r[0] * other.x + r[1] * other.y + r[2] * other.z;
                let out = &mut y[row as usize];
                out.x += p[0] * own.x + q[0] * own.y + r[0] * own.z;
                out.y += p[1] * own.x + q[1] * own.y + r[1] * own.z;
                out.z += p[2] * own.x + q[2] * own.y + r[2] * own.z;
            }
            y[column] += sum;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blocks_land_where_the_dense_matrix_has_them() {
        let pairs = [(0, 2), (3, 1), (2, 3), (2, 0)];
        let mut matrix = BlockMatrix::zeros(BlockPattern::new(4, pairs.into_iter()));
        let mut dense = nalgebra::DMatrix::<f64>::zeros(12, 12);
        let places = [(0, 0), (1, 1), (2, 2), (3, 3), (2, 0), (3, 1), (3, 2)];
        for (i, (row, column)) in places.into_iter().enumerate() {
            let full = Matrix3::from_fn(|r, c| (1 + i) as f64 + 0.1 * r as f64 + 0.37 * c as f64);
            let block = if row == column { full + full.transpose() } else { full };
            matrix.add(row as u32, column as u32, &block);
            dense.view_mut((3 * row, 3 * column), (3, 3)).copy_from(&block);
            dense.view_mut((3 * column, 3 * row), (3, 3)).copy_from(&block.transpose());
        }
        let x: Vec<_> = (0..4).map(|i| Vector3::new(1.0 + i as f64, -0.5 * i as f64, 0.25)).collect();
        let mut y = vec![Vector3::zeros(); 4];
        matrix.multiply(&x, &mut y);
        let flat = nalgebra::DVector::from_iterator(12, x.iter().flat_map(|v| v.iter().copied()));
        let expected = dense * flat;
        for (node, v) in y.iter().enumerate() {
            assert!((v - expected.fixed_rows::<3>(3 * node)).norm() < 1e-13, "{node}: {v}");
        }
        // A block outside the pattern is ignored.
        let before = matrix.clone();
        matrix.add(1, 0, &Matrix3::identity());
        assert_eq!(matrix, before);
    }
}

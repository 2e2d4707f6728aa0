//! Supernodal Cholesky factorisation (faer's) of a matrix whose rows are already in elimination order: symbolic once,
//! numeric whenever the values change. Entries of the inverse are read from its supernodes.

use faer::dyn_stack::{MemBuffer, MemStack};
use faer::sparse::linalg::SupernodalThreshold;
use faer::sparse::linalg::cholesky::{
    CholeskySymbolicParams, LltRef, SymbolicCholesky, SymbolicCholeskyRaw, SymmetricOrdering,
    factorize_symbolic_cholesky, supernodal::SupernodalLltRef,
};
use faer::sparse::{SparseColMatRef, SymbolicSparseColMatRef};
use faer::{Conj, MatMut, Par, Side, Spec};
use thiserror::Error;

use super::BlockPattern;
use super::selected_inverse::inverse_between;

/// Why a factorisation failed.
#[derive(Clone, Copy, Debug, Error, PartialEq, Eq)]
pub enum FactorError {
    /// The matrix is not positive definite: a part of the body is not supported, or a value is not finite.
    #[error(
        "the matrix is not positive definite at row {row} of {rows}: a part of the body may be held by nothing"
    )]
    Indefinite {
        /// Row of the first non-positive pivot, in elimination order.
        row: usize,
        /// Number of rows.
        rows: usize,
    },
    /// Not enough memory for the factor.
    #[error("there is no room for the factor of a matrix of {rows} rows")]
    OutOfMemory {
        /// Number of rows.
        rows: usize,
    },
}

/// A factor L Lᵀ of a matrix with a [`BlockPattern`].
pub struct SupernodalCholesky {
    symbolic: SymbolicCholesky<usize>,
    values: Vec<f64>,
    scratch: MemBuffer,
    columns: usize,
}

impl SupernodalCholesky {
    /// Symbolic factorisation of a pattern, rows in the given order. Solves take up to `columns` right-hand sides at
    /// once.
    ///
    /// # Errors
    /// Not enough memory.
    pub fn new(pattern: &BlockPattern, columns: usize) -> Result<Self, FactorError> {
        let rows = 3 * pattern.nodes();
        let room = |_| FactorError::OutOfMemory { rows };
        // The symbolic part reads the upper triangle, the numeric part the lower one.
        let (col_ptr, row_idx) = transposed(rows, pattern.col_ptr(), pattern.row_idx());
        let upper = SymbolicSparseColMatRef::new_checked(rows, rows, &col_ptr, None, &row_idx);
        let params = CholeskySymbolicParams {
            supernodal_flop_ratio_threshold: SupernodalThreshold::FORCE_SUPERNODAL,
            ..Default::default()
        };
        let symbolic = factorize_symbolic_cholesky(upper, Side::Upper, SymmetricOrdering::Identity, params)
            .map_err(room)?;
        let factoring = symbolic.factorize_numeric_llt_scratch::<f64>(Par::Seq, Spec::default());
        let solving = symbolic.solve_in_place_scratch::<f64>(columns.max(1), Par::Seq);
        let scratch =
            MemBuffer::try_new(factoring.or(solving)).map_err(|_| FactorError::OutOfMemory { rows })?;
        let mut values = Vec::new();
        values.try_reserve_exact(symbolic.len_val()).map_err(|_| FactorError::OutOfMemory { rows })?;
        values.resize(symbolic.len_val(), 0.0);
        Ok(Self { symbolic, values, scratch, columns: columns.max(1) })
    }

    /// Numeric factorisation: the values of the lower triangle by columns.
    ///
    /// # Errors
    /// The matrix is not positive definite; the factor is invalid then.
    ///
    /// # Panics
    /// When the pattern is another one.
    pub fn factor(&mut self, pattern: &BlockPattern, values: &[f64]) -> Result<(), FactorError> {
        let rows = self.symbolic.nrows();
        assert_eq!(rows, 3 * pattern.nodes(), "the pattern that was analysed");
        let lower =
            SymbolicSparseColMatRef::new_checked(rows, rows, pattern.col_ptr(), None, pattern.row_idx());
        let matrix = SparseColMatRef::new(lower, values);
        let stack = MemStack::new(&mut self.scratch);
        let done = self.symbolic.factorize_numeric_llt(
            &mut self.values,
            matrix,
            Side::Lower,
            Default::default(),
            Par::Seq,
            stack,
            Spec::default(),
        );
        match done {
            Ok(_) => Ok(()),
            Err(faer::linalg::cholesky::llt::factor::LltError::NonPositivePivot { index }) => {
                Err(FactorError::Indefinite { row: index, rows })
            }
        }
    }

    /// Number of rows.
    #[must_use]
    pub fn rows(&self) -> usize {
        self.symbolic.nrows()
    }

    /// Number of stored entries of the factor.
    #[must_use]
    pub fn entries(&self) -> usize {
        self.values.len()
    }

    /// Solves A x = b in place, for consecutive right-hand sides.
    ///
    /// # Panics
    /// With incomplete columns, or more than allocated.
    pub fn solve(&mut self, columns: &mut [f64]) {
        let rows = self.rows();
        if rows == 0 {
            return;
        }
        let count = columns.len() / rows;
        assert!(
            count * rows == columns.len() && count <= self.columns,
            "whole columns, as many as asked for"
        );
        let factor = LltRef::new(&self.symbolic, &self.values);
        let stack = MemStack::new(&mut self.scratch);
        let right = MatMut::from_column_major_slice_mut(columns, rows, count);
        factor.solve_in_place_with_conj(Conj::No, right, Par::Seq, stack);
    }

    /// Visits the entries of the inverse between distinct rows: the indices of row and column among `rows`, and the
    /// entry, each pair in both orders. `progress` receives the completed fraction and may cancel by `false`; then the
    /// result is `false`.
    pub(crate) fn inverse_between(
        &self,
        rows: &[usize],
        visit: impl FnMut(usize, usize, f64),
        progress: &mut dyn FnMut(f64) -> bool,
    ) -> bool {
        let SymbolicCholeskyRaw::Supernodal(symbolic) = self.symbolic.raw() else { return false };
        inverse_between(&SupernodalLltRef::new(symbolic, &self.values), rows, visit, progress)
    }
}

/// The same entries by rows.
fn transposed(rows: usize, col_ptr: &[usize], row_idx: &[usize]) -> (Vec<usize>, Vec<usize>) {
    let mut starts = vec![0; rows + 1];
    for &row in row_idx {
        starts[row + 1] += 1;
    }
    for row in 0..rows {
        starts[row + 1] += starts[row];
    }
    let mut next = starts.clone();
    let mut columns = vec![0; row_idx.len()];
    for column in 0..rows {
        for &row in &row_idx[col_ptr[column]..col_ptr[column + 1]] {
            columns[next[row]] = column;
            next[row] += 1;
        }
    }
    (starts, columns)
}

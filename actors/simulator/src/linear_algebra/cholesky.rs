//! The Cholesky factor of a sparse matrix whose rows already stand in the order of elimination (faer's, supernodal where
//! that pays): the pattern is analysed once, the numbers are factored as often as they change.

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

/// Why there is no factor.
#[derive(Clone, Copy, Debug, Error, PartialEq, Eq)]
pub enum FactorError {
    /// The matrix is not positive definite: a part of the body is held by nothing, or a number is not one.
    #[error(
        "the matrix is not positive definite at row {row} of {rows}: a part of the body may be held by nothing"
    )]
    Indefinite {
        /// Row of the first pivot that is not positive, in the order of elimination.
        row: usize,
        /// Rows of the matrix.
        rows: usize,
    },
    /// No room for the factor.
    #[error("there is no room for the factor of a matrix of {rows} rows")]
    OutOfMemory {
        /// Rows of the matrix.
        rows: usize,
    },
}

/// A factor L Lᵀ of a matrix with a [`BlockPattern`].
pub struct SparseCholesky {
    symbolic: SymbolicCholesky<usize>,
    values: Vec<f64>,
    scratch: MemBuffer,
    columns: usize,
}

impl SparseCholesky {
    /// Analyses a pattern; rows are eliminated as they stand. Solves take up to `columns` right hand sides at once.
    ///
    /// # Errors
    /// No room.
    pub fn new(pattern: &BlockPattern, columns: usize) -> Result<Self, FactorError> {
        let rows = 3 * pattern.nodes();
        let room = |_| FactorError::OutOfMemory { rows };
        // The analysis reads the upper triangle, the factorisation the lower one.
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

    /// Factors a matrix: the values of its lower triangle by columns.
    ///
    /// # Errors
    /// The matrix is not positive definite; the factor is of no use then.
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

    /// Rows of the matrix.
    #[must_use]
    pub fn rows(&self) -> usize {
        self.symbolic.nrows()
    }

    /// Entries of the factor that are stored.
    #[must_use]
    pub fn entries(&self) -> usize {
        self.values.len()
    }

    /// Solves A x = b in place, for right hand sides that stand one after the other.
    ///
    /// # Panics
    /// When there are not whole columns, or more than were asked for.
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

    /// Visits the entries of the inverse between some rows, all distinct: the indices of row and column among `rows`, and
    /// the entry, each pair in both orders. `progress` is told the share that is done, and stops it by `false`; then the
    /// answer is `false`.
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

//! Sparse symmetric matrices of 3×3 blocks, one block row per node, and their Cholesky factors.

mod blocks;
mod cholesky;
mod ordering;

pub use blocks::{BlockMatrix, BlockPattern};
pub use cholesky::{FactorError, SparseCholesky};
pub use ordering::minimum_degree;

//! Sparse symmetric matrices of 3×3 blocks, one block row per node, and their Cholesky factors.

mod between;
mod blocks;
mod cholesky;
mod dissection;
mod ordering;

pub use blocks::{BlockMatrix, BlockPattern};
pub use cholesky::{FactorError, SparseCholesky};
pub use dissection::nested_dissection;
pub use ordering::minimum_degree;

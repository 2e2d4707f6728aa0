//! Sparse symmetric matrices of 3×3 blocks, one block row per node, and their Cholesky factors.

pub(crate) mod block_banded;
pub(crate) mod block_matrix;
pub(crate) mod block_sparse_lu;
pub(crate) mod minimum_degree;
pub(crate) mod nested_dissection;
pub(crate) mod selected_inverse;
pub(crate) mod supernodal_bf16;
mod supernodal_cholesky;

pub use block_matrix::{BlockMatrix, BlockPattern};
pub use minimum_degree::minimum_degree;
pub use nested_dissection::nested_dissection;
pub use supernodal_cholesky::{FactorError, SupernodalCholesky};

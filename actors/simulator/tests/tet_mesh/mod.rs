//! Tetrahedral meshes.

mod mesh;
mod topology;

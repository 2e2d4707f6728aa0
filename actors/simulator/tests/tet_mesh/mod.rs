//! Tetrahedral meshes.

mod cut_through;
mod mesh;
mod topology;

//! Solvers on finer meshes, lattices and steps.
//!
//! What takes minutes: `tests/run --thorough` runs it before a release.

#[path = "tet_mesh/cut_grid.rs"]
mod cut_grid;
#[path = "suture_thread/knot_refinement.rs"]
mod knot_refinement;
#[path = "electrosurgery/refinement.rs"]
mod lattice_refinement;
mod support;

//! Collision detection: each method is a plain algorithm with a thin controller. A surface is two slices, vertices and
//! triangles as indices into them, so that methods read the scene's data without copying.
//!
//! | Method | File |
//! |---|---|
//! | closest points of points, segments and triangles, whether triangles overlap | [`primitive`] |
//! | surface against surface, and against itself: contact, all pairs, distance, tolerance | [`obb_tree`] |
//! | tree of axis-aligned boxes, neighbours, a surface that moves | [`aabb_tree`], [`topology`], [`moving_surface`] |
//! | a shaft as a line: the dynamic point | [`dynamic_point`] |
//! | haptic rendering: the finger proxy, or god-object | [`finger_proxy`] |
//! | penetration of surfaces | [`penetration`] |
//! | continuous: first contact within a step, of pairs and of lines and surfaces | [`continuous`] |
//! | deforming bodies, bands and threads: the local spherical hash | [`spherical_hash`] |
//! | an instrument's volume, also swept between two frames: the Z-buffer | [`z_buffer`] |
//!
//! [`controller`] schedules them.
#![forbid(unsafe_code)]

pub mod aabb_tree;
mod candidates;
pub mod continuous;
pub mod controller;
pub mod dynamic_point;
pub mod finger_proxy;
mod generation;
mod line;
pub mod moving_surface;
pub mod obb_tree;
mod part;
pub mod penetration;
pub mod primitive;
mod pseudonormal;
pub mod spherical_hash;
mod surface;
pub mod topology;
mod uniform_grid;
pub mod z_buffer;

pub use line::{Line, LineError};
pub use part::Part;
pub use pseudonormal::pseudonormal;
pub use surface::{Surface, SurfaceError, check_finite};

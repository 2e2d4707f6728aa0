//! Meshes as plain data: file readers, validation and repair.
//!
//! A surface keeps one vertex per *point*, and hangs normals and texture coordinates on the corners of its triangles,
//! so that a closed body is closed by its indices even where its edges are sharp. [`SurfaceData::split`] converts to a
//! renderer's format (one vertex per distinct combination).
//!
//! Readers take bytes, not paths, apart from [`read_surface`] and [`read_tets`]. Every size declared by a file is
//! checked against its actual length before allocation. Accepted meshes are well formed (finite numbers, indices in
//! range); whether it is also *good* (closed, manifold, not inverted) is reported by [`validate_surface`] and
//! [`validate_tets`], and the caller decides what to refuse ([`SurfacePolicy`], [`TetPolicy`]). Third-party meshes
//! often have bad elements: [`tet_defects`] lists all of them with their indices, [`repaired_tets`] repairs what it can
//! and reports the repairs.

mod cursor;
mod data;
mod error;
mod gltf;
mod gltf_buffer;
mod gmsh;
mod gmsh_v2;
mod gmsh_v4;
mod limits;
mod obj;
mod read;
mod stl;
mod tet_defects;
pub mod tet_faces;
mod tet_repair;
mod validate;
mod validate_tets;
mod vtk;

pub use data::{LineData, SplitSurface, SurfaceData, TetData};
pub use error::{FilePosition, MeshError};
pub use gltf::read_gltf;
pub use gmsh::{read_gmsh, read_gmsh_line};
pub use limits::Limits;
pub use obj::{read_obj, read_obj_line};
pub use read::{LINE_EXTENSIONS, SURFACE_EXTENSIONS, TET_EXTENSIONS, read_line, read_surface, read_tets};
pub use stl::read_stl;
pub use tet_defects::{BadTets, Defect, MeshRules, mean_ratio, tet_defects, tet_shape};
pub use tet_repair::{RepairedTets, Repairs, repaired_tets};
pub use validate::{Finding, SurfacePolicy, SurfaceReport, validate_surface};
pub use validate_tets::{TetPolicy, TetReport, validate_tets};
pub use vtk::{read_vtk, read_vtk_line};

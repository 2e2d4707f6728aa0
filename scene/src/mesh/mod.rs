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

mod base64;
mod cells;
mod cursor;
mod data;
mod error;
mod file;
mod gltf;
mod gmsh;
pub mod inspect;
mod limits;
mod number_kind;
mod obj;
mod ply;
mod polygon_face;
mod read;
mod shells;
mod stl;
mod surface_repair;
mod tet_defects;
pub mod tet_faces;
mod tet_repair;
mod unit;
mod validate;
mod validate_tets;
mod vtk;
pub mod write;

pub use data::{LineData, SplitSurface, SurfaceData, TetData};
pub use error::{FilePosition, MeshError};
pub use file::{MeshFile, SurfaceFile, TetFile};
pub use gltf::read_gltf;
pub use gmsh::{read_gmsh, read_gmsh_line, read_gmsh_surface};
pub use limits::Limits;
pub use obj::{read_obj, read_obj_line};
pub use ply::read_ply;
pub use read::{EXTENSIONS, LINE_EXTENSIONS, read_line, read_mesh, read_surface, read_tets};
pub use shells::{Shell, Shells, shells};
pub use stl::read_stl;
pub use surface_repair::{SurfaceRepairs, WELD_RELATIVE, repaired_surface, weld_tolerance};
pub use tet_defects::{BadTets, Defect, MeshRules, mean_ratio, tet_defects, tet_shape};
pub use tet_repair::{RepairedTets, Repairs, repaired_tets};
pub use unit::{EXTENT_MAX, EXTENT_MIN, TISSUE_EXTENT_MAX, doubt_of_size, length, unit};
pub use validate::{Finding, SurfacePolicy, SurfaceReport, validate_surface};
pub use validate_tets::{TetPolicy, TetReport, validate_tets};
pub use vtk::{read_vtk, read_vtk_line, read_vtk_surface};

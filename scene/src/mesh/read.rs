//! Reading a mesh file by its extension, within limits.

use std::path::Path;

use super::data::{LineData, SurfaceData, TetData};
use super::error::{FilePosition, MeshError};
use super::limits::{Limits, read_bytes};
use super::{
    read_gltf, read_gmsh, read_gmsh_line, read_obj, read_obj_line, read_stl, read_vtk, read_vtk_line,
};

/// Extensions of surface files that [`read_surface`] knows.
pub const SURFACE_EXTENSIONS: &str = "obj, stl, gltf, glb";
/// Extensions of volume files that [`read_tets`] knows.
pub const TET_EXTENSIONS: &str = "msh, vtk";

/// Reads an OBJ, STL, glTF or GLB surface; the extension selects the format.
///
/// # Errors
/// Names the file, the place in it and the reason.
pub fn read_surface(file: &Path, limits: &Limits) -> Result<SurfaceData, MeshError> {
    match extension(file).as_str() {
        "obj" => read_obj(file, &read_bytes(file, limits)?, limits),
        "stl" => read_stl(file, &read_bytes(file, limits)?, limits),
        "gltf" | "glb" => read_gltf(file, &read_bytes(file, limits)?, limits),
        other => Err(unknown_extension(file, other, SURFACE_EXTENSIONS)),
    }
}

/// Extensions of files of lines that [`read_line`] knows.
pub const LINE_EXTENSIONS: &str = "obj, msh, vtk";

/// Reads the polylines of an OBJ file, the lines of two nodes of a Gmsh one (2.2, 4.1), or the lines and polylines of a
/// legacy VTK one; the extension selects the format. Vertices that no piece uses stay ([`LineData::compact`] drops
/// them).
///
/// # Errors
/// Names the file, the place in it and the reason.
pub fn read_line(file: &Path, limits: &Limits) -> Result<LineData, MeshError> {
    match extension(file).as_str() {
        "obj" => read_obj_line(file, &read_bytes(file, limits)?, limits),
        "msh" => read_gmsh_line(file, &read_bytes(file, limits)?, limits),
        "vtk" => read_vtk_line(file, &read_bytes(file, limits)?, limits),
        other => Err(unknown_extension(file, other, LINE_EXTENSIONS)),
    }
}

/// Reads a Gmsh (2.2, 4.1) or legacy VTK volume of tetrahedra; the extension selects the format.
///
/// # Errors
/// Names the file, the place in it and the reason.
pub fn read_tets(file: &Path, limits: &Limits) -> Result<TetData, MeshError> {
    match extension(file).as_str() {
        "msh" => read_gmsh(file, &read_bytes(file, limits)?, limits),
        "vtk" => read_vtk(file, &read_bytes(file, limits)?, limits),
        other => Err(unknown_extension(file, other, TET_EXTENSIONS)),
    }
}

fn extension(file: &Path) -> String {
    file.extension().map(|text| text.to_string_lossy().to_ascii_lowercase()).unwrap_or_default()
}

fn unknown_extension(file: &Path, extension: &str, supported: &'static str) -> MeshError {
    let what = if extension.is_empty() {
        "a file without extension".into()
    } else {
        format!("extension '{extension}'")
    };
    MeshError::Unsupported { file: file.into(), place: FilePosition::Whole, what, supported }
}

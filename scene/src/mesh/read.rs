//! Reading a mesh file by its extension, within limits.

use std::path::Path;

use super::data::{LineData, SurfaceData, TetData};
use super::error::{FilePosition, MeshError};
use super::file::{MeshFile, SurfaceFile};
use super::gmsh::read_gmsh_file;
use super::limits::{Limits, read_bytes};
use super::obj::read_obj_file;
use super::ply::read_ply_file;
use super::stl::read_stl_file;
use super::vtk::read_vtk_file;
use super::{read_gltf, read_gmsh_line, read_obj_line, read_vtk_line};

/// Extensions of files that [`read_mesh`] knows: first those of surfaces, then those of surfaces or volumes.
pub const EXTENSIONS: &str = "obj, stl, ply, gltf, glb, vtp, msh, vtk, vtu";

/// Reads a surface or a volume; the extension selects the format, except that the content tells VTK's formats apart.
///
/// # Errors
/// Names the file, the place in it and the reason.
pub fn read_mesh(file: &Path, limits: &Limits) -> Result<MeshFile, MeshError> {
    let extension = extension(file);
    if !EXTENSIONS.split(", ").any(|known| known == extension) {
        return Err(unknown_extension(file, &extension, EXTENSIONS));
    }
    let bytes = read_bytes(file, limits)?;
    match extension.as_str() {
        "obj" => read_obj_file(file, &bytes, limits).map(MeshFile::Surface),
        "stl" => read_stl_file(file, &bytes, limits).map(MeshFile::Surface),
        "ply" => read_ply_file(file, &bytes, limits).map(MeshFile::Surface),
        "msh" => read_gmsh_file(file, &bytes, limits),
        "vtk" | "vtu" | "vtp" => read_vtk_file(file, &bytes, limits),
        _ => {
            let surface = read_gltf(file, &bytes, limits)?;
            Ok(MeshFile::Surface(SurfaceFile { surface, ..SurfaceFile::default() }))
        }
    }
}

/// Reads a surface; see [`read_mesh`].
///
/// # Errors
/// Names the file, the place in it and the reason; also when the file holds a volume.
pub fn read_surface(file: &Path, limits: &Limits) -> Result<SurfaceData, MeshError> {
    match read_mesh(file, limits)? {
        MeshFile::Surface(read) => Ok(read.surface),
        MeshFile::Volume(_) => Err(refused(file, "it holds a volume where a surface is expected")),
    }
}

/// Reads a volume of tetrahedra; see [`read_mesh`].
///
/// # Errors
/// Names the file, the place in it and the reason; also when the file holds a surface.
pub fn read_tets(file: &Path, limits: &Limits) -> Result<TetData, MeshError> {
    match read_mesh(file, limits)? {
        MeshFile::Volume(read) => Ok(read.volume),
        MeshFile::Surface(_) => Err(refused(file, "it holds a surface where a volume is expected")),
    }
}

fn refused(file: &Path, reason: &str) -> MeshError {
    MeshError::Refused { file: file.into(), reason: reason.into() }
}

/// Extensions of files of lines that [`read_line`] knows.
pub const LINE_EXTENSIONS: &str = "obj, msh, vtk, vtu, vtp";

/// Reads the polylines of an OBJ file, the lines of a Gmsh one, or the lines and polylines of a VTK one; the extension
/// selects the format. Vertices that no piece uses stay ([`LineData::compact`] drops them).
///
/// # Errors
/// Names the file, the place in it and the reason.
pub fn read_line(file: &Path, limits: &Limits) -> Result<LineData, MeshError> {
    match extension(file).as_str() {
        "obj" => read_obj_line(file, &read_bytes(file, limits)?, limits),
        "msh" => read_gmsh_line(file, &read_bytes(file, limits)?, limits),
        "vtk" | "vtu" | "vtp" => read_vtk_line(file, &read_bytes(file, limits)?, limits),
        other => Err(unknown_extension(file, other, LINE_EXTENSIONS)),
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

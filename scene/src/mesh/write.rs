//! Writing meshes: OBJ, STL (binary) and PLY for surfaces, Gmsh 2.2 and legacy VTK for volumes. Coordinates are metres, in
//! the fewest digits that read back as the same numbers.

use std::fmt::Write;

use super::data::{SurfaceData, TetData};
use super::inspect::MendedMesh;

/// Extensions of files of surfaces that [`written`] knows.
pub const SURFACE_OUTPUTS: &str = "obj, stl, ply";
/// Extensions of files of volumes that [`written`] knows.
pub const VOLUME_OUTPUTS: &str = "msh, vtk";

/// The bytes of a file with this extension.
///
/// # Errors
/// The extensions that are possible, when this one is not.
pub fn written(mesh: &MendedMesh, extension: &str) -> Result<Vec<u8>, String> {
    let valid =
        |what: &str, list: &str| format!("a {what} is written as one of: {list}; not as '{extension}'");
    match (mesh, extension.to_ascii_lowercase().as_str()) {
        (MendedMesh::Surface(surface), "obj") => Ok(obj(surface).into_bytes()),
        (MendedMesh::Surface(surface), "stl") => Ok(stl(surface)),
        (MendedMesh::Surface(surface), "ply") => Ok(ply(surface).into_bytes()),
        (MendedMesh::Surface(_), _) => Err(valid("surface", SURFACE_OUTPUTS)),
        (MendedMesh::Volume(volume), "msh") => Ok(msh(volume).into_bytes()),
        (MendedMesh::Volume(volume), "vtk") => Ok(vtk(volume).into_bytes()),
        (MendedMesh::Volume(_), _) => Err(valid("volume", VOLUME_OUTPUTS)),
    }
}

// Writing to a string cannot fail.
fn obj(surface: &SurfaceData) -> String {
    let mut text = String::new();
    for p in &surface.positions {
        let _ = writeln!(text, "v {} {} {}", p.x, p.y, p.z);
    }
    for [u, v] in surface.uvs.iter().flatten().flatten() {
        let _ = writeln!(text, "vt {u} {v}");
    }
    for (t, triangle) in surface.triangles.iter().enumerate() {
        text.push('f');
        for (k, vertex) in triangle.iter().enumerate() {
            let _ = write!(text, " {}", vertex + 1);
            if surface.uvs.is_some() {
                let _ = write!(text, "/{}", 3 * t + k + 1);
            }
        }
        text.push('\n');
    }
    text
}

fn stl(surface: &SurfaceData) -> Vec<u8> {
    let mut bytes = vec![0; 80];
    bytes.extend((surface.triangles.len() as u32).to_le_bytes());
    for t in 0..surface.triangles.len() {
        let normal = surface.area_vector(t).try_normalize(0.0).unwrap_or_default();
        let corners = surface.corners(t).map(|corner| corner.coords);
        for number in [normal].iter().chain(&corners).flat_map(|of| of.iter()) {
            bytes.extend((*number as f32).to_le_bytes());
        }
        bytes.extend([0, 0]);
    }
    bytes
}

fn ply(surface: &SurfaceData) -> String {
    let mut text = format!(
        "ply\nformat ascii 1.0\nelement vertex {}\nproperty double x\nproperty double y\nproperty double z\n\
         element face {}\nproperty list uchar int vertex_indices\nend_header\n",
        surface.positions.len(),
        surface.triangles.len()
    );
    for p in &surface.positions {
        let _ = writeln!(text, "{} {} {}", p.x, p.y, p.z);
    }
    for [a, b, c] in &surface.triangles {
        let _ = writeln!(text, "3 {a} {b} {c}");
    }
    text
}

fn msh(volume: &TetData) -> String {
    let mut text = format!("$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n{}\n", volume.positions.len());
    for (node, p) in volume.positions.iter().enumerate() {
        let _ = writeln!(text, "{} {} {} {}", node + 1, p.x, p.y, p.z);
    }
    let _ = writeln!(text, "$EndNodes\n$Elements\n{}", volume.tets.len());
    for (tet, [a, b, c, d]) in volume.tets.iter().enumerate() {
        let tag = volume.tags.get(tet).copied().unwrap_or_default();
        let _ = writeln!(text, "{} 4 2 {tag} {tag} {} {} {} {}", tet + 1, a + 1, b + 1, c + 1, d + 1);
    }
    text + "$EndElements\n"
}

fn vtk(volume: &TetData) -> String {
    let count = volume.tets.len();
    let mut text = format!(
        "# vtk DataFile Version 3.0\nmetres\nASCII\nDATASET UNSTRUCTURED_GRID\nPOINTS {} double\n",
        volume.positions.len()
    );
    for p in &volume.positions {
        let _ = writeln!(text, "{} {} {}", p.x, p.y, p.z);
    }
    let _ = writeln!(text, "CELLS {count} {}", 5 * count);
    for [a, b, c, d] in &volume.tets {
        let _ = writeln!(text, "4 {a} {b} {c} {d}");
    }
    let _ = writeln!(text, "CELL_TYPES {count}");
    text.push_str(&"10\n".repeat(count));
    if volume.tags.iter().any(|&tag| tag != 0) {
        let _ = writeln!(text, "CELL_DATA {count}\nSCALARS region int 1\nLOOKUP_TABLE default");
        for tag in &volume.tags {
            let _ = writeln!(text, "{tag}");
        }
    }
    text
}

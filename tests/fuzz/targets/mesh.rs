//! Every mesh reader with the same bytes: OBJ, STL, PLY, glTF, Gmsh, VTK (legacy and XML); what is read is mended and inspected.
#![no_main]

use std::path::Path;

use libfuzzer_sys::fuzz_target;
use trocar_fuzz::Bound;
use trocar_scene::mesh::{
    Limits, LineData, MeshError, MeshRules, SurfaceData, TetData, read_gltf, read_gmsh, read_gmsh_line,
    read_gmsh_surface, read_obj, read_obj_line, read_ply, read_stl, read_vtk, read_vtk_line,
    read_vtk_surface, repaired_surface, repaired_tets, validate_surface, validate_tets, weld_tolerance,
};

/// An OBJ corner of two bytes ("1 ") becomes a triangle of 12 bytes plus the 36 of its corners, and vectors double.
const MESH: Bound = Bound { per_byte: 256, always: 64 << 10 };
/// Compressed arrays of XML files may become a hundred times as long as the file, and a byte of them a number of eight.
const XML: Bound = Bound { per_byte: 2048, always: 2 << 20 };

fn bound(bytes: &[u8]) -> &'static Bound {
    if bytes.trim_ascii_start().starts_with(b"<") { &XML } else { &MESH }
}

type Reader<T> = fn(&Path, &[u8], &Limits) -> Result<T, MeshError>;
const SURFACES: [Reader<SurfaceData>; 6] =
    [read_obj, read_stl, read_ply, read_gltf, read_gmsh_surface, read_vtk_surface];
const VOLUMES: [Reader<TetData>; 2] = [read_gmsh, read_vtk];
const LINES: [Reader<LineData>; 3] = [read_obj_line, read_gmsh_line, read_vtk_line];

fuzz_target!(|bytes: &[u8]| {
    let limits = Limits::default();
    for reader in SURFACES {
        if let Ok(surface) = bound(bytes).holds(bytes.len(), || reader(Path::new("x"), bytes, &limits)) {
            let vertices = surface.positions.len();
            assert!(surface.triangles.iter().flatten().all(|v| (*v as usize) < vertices));
            assert!(surface.positions.iter().all(|p| p.coords.iter().all(|x| x.is_finite())));
            validate_surface(&surface);
            surface.split();
            let (mended, _) = repaired_surface(&surface, weld_tolerance(&surface.positions));
            assert_eq!(validate_surface(&mended).inside_out.count, 0);
        }
    }
    for reader in VOLUMES {
        if let Ok(mut volume) = bound(bytes).holds(bytes.len(), || reader(Path::new("x"), bytes, &limits)) {
            let vertices = volume.positions.len();
            assert!(volume.tets.iter().flatten().all(|v| (*v as usize) < vertices));
            assert!(volume.positions.iter().all(|p| p.coords.iter().all(|x| x.is_finite())));
            assert_eq!(volume.tets.len(), volume.tags.len());
            validate_tets(&volume);
            // What cannot be mended is listed.
            let _ = repaired_tets(&volume.positions, &volume.tets, &MeshRules::default());
            volume.flip_inverted();
            volume.compact();
            volume.boundary();
        }
    }
    for reader in LINES {
        if let Ok(mut line) = bound(bytes).holds(bytes.len(), || reader(Path::new("x"), bytes, &limits)) {
            let vertices = line.positions.len();
            assert!(line.segments.iter().flatten().all(|v| (*v as usize) < vertices));
            line.compact();
        }
    }
});

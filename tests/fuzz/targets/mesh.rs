//! Every mesh reader with the same bytes: OBJ, STL, glTF, Gmsh 2.2 and 4.1, legacy VTK.
#![no_main]

use std::path::Path;

use libfuzzer_sys::fuzz_target;
use trocar_fuzz::Bound;
use trocar_scene::mesh::{
    Limits, LineData, MeshError, SurfaceData, TetData, read_gltf, read_gmsh, read_gmsh_line, read_obj,
    read_obj_line, read_stl, read_vtk, read_vtk_line, validate_surface, validate_tets,
};

/// An OBJ corner of two bytes ("1 ") becomes a triangle of 12 bytes plus the 36 of its corners, and vectors double.
const MESH: Bound = Bound { per_byte: 256, always: 64 << 10 };

type Reader<T> = fn(&Path, &[u8], &Limits) -> Result<T, MeshError>;
const SURFACES: [Reader<SurfaceData>; 3] = [read_obj, read_stl, read_gltf];
const VOLUMES: [Reader<TetData>; 2] = [read_gmsh, read_vtk];
const LINES: [Reader<LineData>; 3] = [read_obj_line, read_gmsh_line, read_vtk_line];

fuzz_target!(|bytes: &[u8]| {
    let limits = Limits::default();
    for reader in SURFACES {
        if let Ok(surface) = MESH.holds(bytes.len(), || reader(Path::new("x"), bytes, &limits)) {
            let vertices = surface.positions.len();
            assert!(surface.triangles.iter().flatten().all(|v| (*v as usize) < vertices));
            assert!(surface.positions.iter().all(|p| p.coords.iter().all(|x| x.is_finite())));
            validate_surface(&surface);
            surface.split();
        }
    }
    for reader in VOLUMES {
        if let Ok(mut volume) = MESH.holds(bytes.len(), || reader(Path::new("x"), bytes, &limits)) {
            let vertices = volume.positions.len();
            assert!(volume.tets.iter().flatten().all(|v| (*v as usize) < vertices));
            assert!(volume.positions.iter().all(|p| p.coords.iter().all(|x| x.is_finite())));
            assert_eq!(volume.tets.len(), volume.tags.len());
            validate_tets(&volume);
            volume.flip_inverted();
            volume.compact();
            volume.boundary();
        }
    }
    for reader in LINES {
        if let Ok(mut line) = MESH.holds(bytes.len(), || reader(Path::new("x"), bytes, &limits)) {
            let vertices = line.positions.len();
            assert!(line.segments.iter().flatten().all(|v| (*v as usize) < vertices));
            line.compact();
        }
    }
});

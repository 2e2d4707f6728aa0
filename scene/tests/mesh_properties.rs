//! No input makes a reader panic, hang, or allocate more than a fixed multiple of its size.

use crate::support as common;
use std::path::Path;

use crate::support::ply::write_ply;
use crate::support::vtk_xml::{styles, write_vtu};
use crate::support::{Order, tet_box};
use proptest::prelude::*;
use trocar_scene::mesh::{
    Limits, LineData, MeshError, MeshRules, SurfaceData, TetData, read_gltf, read_gmsh, read_gmsh_line,
    read_gmsh_surface, read_obj, read_obj_line, read_ply, read_stl, read_vtk, read_vtk_line,
    read_vtk_surface, repaired_surface, repaired_tets, validate_surface, validate_tets, weld_tolerance,
};
use trocar_scene::shapes;
use trocar_test_support::allocations::peak_of;
use trocar_test_support::hostile::mutated;

type SurfaceReader = fn(&Path, &[u8], &Limits) -> Result<SurfaceData, MeshError>;
type TetReader = fn(&Path, &[u8], &Limits) -> Result<TetData, MeshError>;
const SURFACES: [SurfaceReader; 6] =
    [read_obj, read_stl, read_ply, read_gltf, read_gmsh_surface, read_vtk_surface];
const VOLUMES: [TetReader; 2] = [read_gmsh, read_vtk];
type LineReader = fn(&Path, &[u8], &Limits) -> Result<LineData, MeshError>;
const LINES: [LineReader; 3] = [read_obj_line, read_gmsh_line, read_vtk_line];

/// What a reader may hold per byte of input. An OBJ corner of two bytes ("1 ") becomes a triangle of 12 bytes plus
/// the 36 of its corners, and vectors double as they grow.
const BYTES_PER_BYTE: usize = 256;
const BYTES_ALWAYS: usize = 64 << 10;
/// The same of XML files: compressed arrays may become a hundred times as long as the file, and a byte of them a number of
/// eight.
const XML_BYTES: [usize; 2] = [2048, 2 << 20];

fn every_reader(bytes: &[u8]) -> Result<(), TestCaseError> {
    let limits = Limits::default();
    let is_xml = bytes.trim_ascii_start().starts_with(b"<");
    let [per_byte, always] = if is_xml { XML_BYTES } else { [BYTES_PER_BYTE, BYTES_ALWAYS] };
    let allowed = per_byte * bytes.len() + always;
    for reader in SURFACES {
        let (read, peak) = peak_of(|| reader(Path::new("x"), bytes, &limits));
        prop_assert!(peak <= allowed, "{peak} bytes for an input of {}", bytes.len());
        if let Ok(surface) = read {
            let vertices = surface.positions.len();
            prop_assert!(surface.triangles.iter().flatten().all(|v| (*v as usize) < vertices));
            prop_assert!(surface.positions.iter().all(|p| p.coords.iter().all(|x| x.is_finite())));
            validate_surface(&surface);
            surface.split();
            let (mended, _) = repaired_surface(&surface, weld_tolerance(&surface.positions));
            prop_assert_eq!(validate_surface(&mended).inside_out.count, 0);
        }
    }
    for reader in VOLUMES {
        let (read, peak) = peak_of(|| reader(Path::new("x"), bytes, &limits));
        prop_assert!(peak <= allowed, "{peak} bytes for an input of {}", bytes.len());
        if let Ok(mut volume) = read {
            let vertices = volume.positions.len();
            prop_assert!(volume.tets.iter().flatten().all(|v| (*v as usize) < vertices));
            prop_assert!(volume.positions.iter().all(|p| p.coords.iter().all(|x| x.is_finite())));
            prop_assert_eq!(volume.tets.len(), volume.tags.len());
            validate_tets(&volume);
            // What cannot be mended is listed.
            let _ = repaired_tets(&volume.positions, &volume.tets, &MeshRules::default());
            volume.flip_inverted();
            volume.compact();
            volume.boundary();
        }
    }
    for reader in LINES {
        let (read, peak) = peak_of(|| reader(Path::new("x"), bytes, &limits));
        prop_assert!(peak <= allowed, "{peak} bytes for an input of {}", bytes.len());
        if let Ok(mut line) = read {
            let vertices = line.positions.len();
            prop_assert!(line.segments.iter().flatten().all(|v| (*v as usize) < vertices));
            prop_assert!(line.segments.iter().all(|[a, b]| a != b));
            prop_assert!(line.positions.iter().all(|p| p.coords.iter().all(|x| x.is_finite())));
            line.compact();
            prop_assert!(line.segments.iter().flatten().all(|v| (*v as usize) < line.positions.len()));
        }
    }
    Ok(())
}

fn valid_files() -> Vec<Vec<u8>> {
    let surface = shapes::torus(0.75, 0.25, 3, 3).expect("a torus");
    let volume = tet_box(1);
    let mut files: Vec<Vec<u8>> = styles().into_iter().map(|style| write_vtu(&volume, style)).collect();
    files.extend([None, Some(Order::Little), Some(Order::Big)].map(|order| write_ply(&surface, order)));
    files.extend([common::POLY_DATA, common::POLY_DATA_XML].map(|text| text.as_bytes().to_vec()));
    files.extend(vec![
        common::write_obj(&surface),
        common::write_stl(&surface, false),
        common::write_stl(&surface, true),
        common::write_gltf_embedded(&surface),
        common::write_glb(&surface),
        common::write_gmsh_2(&volume, None),
        common::write_gmsh_2(&volume, Some(Order::Little)),
        common::write_gmsh_2(&volume, Some(Order::Big)),
        common::write_gmsh_4(&volume, None),
        common::write_gmsh_4(&volume, Some(Order::Little)),
        common::write_gmsh_4(&volume, Some(Order::Big)),
        common::write_vtk(&volume, false, 3),
        common::write_vtk(&volume, true, 3),
        common::write_vtk(&volume, false, 5),
        common::write_vtk(&volume, true, 5),
        b"v 0 0 0\nv 1 0 0\nv 0 1 0\nl 1 2 3\n".to_vec(),
        b"# vtk DataFile Version 3.0\nt\nASCII\nDATASET POLYDATA\nPOINTS 3 float\n0 0 0 1 0 0 0 1 0\n\
          LINES 2 6\n2 0 1\n2 1 2\n"
            .to_vec(),
        b"$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n2\n1 0 0 0\n2 1 0 0\n$EndNodes\n$Elements\n1\n\
          1 1 0 1 2\n$EndElements\n"
            .to_vec(),
    ]);
    files
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2000))]

    #[test]
    fn mutated_files_never_harm(file in mutated(valid_files())) {
        every_reader(&file)?;
    }

    #[test]
    fn random_bytes_never_harm(bytes in prop::collection::vec(any::<u8>(), 0..400)) {
        every_reader(&bytes)?;
    }

    #[test]
    fn random_text_never_harms(
        head in prop::sample::select(vec![
            "", "v 0 0 0\n", "solid x\n", "glTF", "{\"asset\":{\"version\":\"2.0\"},", "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n",
            "$MeshFormat\n4.1 0 8\n$EndMeshFormat\n$Nodes\n", "# vtk DataFile Version 3.0\nt\nASCII\nDATASET UNSTRUCTURED_GRID\n",
            "# vtk DataFile Version 5.1\nt\nASCII\nDATASET POLYDATA\n", "ply\nformat ascii 1.0\n", "<VTKFile type=\"PolyData\"><Piece>",
        ]),
        words in prop::collection::vec("(v|f|vn|facet|normal|[$]Nodes|[$]Elements|POINTS|CELLS|POLYGONS|element vertex|property|end_header|<DataArray|float|-?[0-9]{1,12}|\n|[ -~]{1,6})", 0..60),
    ) {
        every_reader(format!("{head}{}", words.join(" ")).as_bytes())?;
    }

    #[test]
    fn any_finite_surface_survives_a_round_trip(
        points in prop::collection::vec(prop::array::uniform3(-1e6..1e6f64), 3..30),
        corners in prop::collection::vec(prop::array::uniform3(any::<prop::sample::Index>()), 1..40),
    ) {
        let surface = SurfaceData {
            triangles: corners.iter().map(|t| t.map(|c| c.index(points.len()) as u32)).collect(),
            positions: points.into_iter().map(Into::into).collect(),
            ..SurfaceData::default()
        };
        let read = read_obj(Path::new("x"), &common::write_obj(&surface), &Limits::default());
        prop_assert_eq!(read.expect("a valid file"), surface.clone());
        let read = read_stl(Path::new("x"), &common::write_stl(&surface, false), &Limits::default()).expect("valid");
        for t in 0..surface.triangles.len() {
            prop_assert_eq!(read.corners(t), surface.corners(t));
        }
    }
}

/// Headers that promise more than there is, for each place where a count stands.
#[test]
fn huge_declarations_are_refused_before_allocating() {
    let limits = Limits { bytes: u64::MAX, vertices: u64::MAX, elements: u64::MAX };
    let huge = u64::MAX.to_string();
    let large = "4000000000";
    let mut binary_stl = vec![0u8; 84];
    binary_stl[80..84].copy_from_slice(&u32::MAX.to_le_bytes());
    let msh = |rest: &str| format!("$MeshFormat\n{rest}").into_bytes();
    let vtk = |rest: &str| {
        format!("# vtk DataFile Version 5.0\nt\nBINARY\nDATASET UNSTRUCTURED_GRID\n{rest}").into_bytes()
    };
    let mut files = vec![binary_stl];
    for count in [huge.as_str(), large] {
        files.push(msh(&format!("2.2 0 8\n$EndMeshFormat\n$Nodes\n{count}\n")));
        files.push(msh(&format!("2.2 0 8\n$EndMeshFormat\n$Nodes\n0\n$EndNodes\n$Elements\n{count}\n")));
        files.push(msh(&format!("4.1 0 8\n$EndMeshFormat\n$Nodes\n1 {count} 1 1\n3 1 0 {count}\n")));
        files.push(msh(&format!("4.1 0 8\n$EndMeshFormat\n$Entities\n0 0 0 {count}\n")));
        files.push(vtk(&format!("POINTS {count} float\n")));
        files.push(vtk(&format!("CELLS {count} {count}\n")));
        files.push(vtk(&format!("CELLS {count} {count}\nOFFSETS vtktypeint64\n")));
        files.push(vtk(&format!("CELL_TYPES {count}\n")));
        files.push(vtk(&format!("FIELD f 1\na {count} {count} double\n")));
    }
    for file in files {
        let ((stl, gmsh, vtk), peak) = peak_of(|| {
            let p = Path::new("x");
            (
                read_stl(p, &file, &limits).is_err(),
                read_gmsh(p, &file, &limits).is_err(),
                read_vtk(p, &file, &limits).is_err(),
            )
        });
        assert!(stl && gmsh && vtk);
        assert!(peak < 4096, "{peak} bytes for\n{}", String::from_utf8_lossy(&file));
    }
}

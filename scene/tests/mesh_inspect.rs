//! The facts that an inspection tells, against closed forms, and files of mended meshes that are read back.

use crate::support as common;
use trocar_scene::mesh::inspect::{MendedMesh, inspect, mend};
use trocar_scene::mesh::write::written;
use trocar_scene::mesh::{Limits, MeshFile, TetData, read_mesh};

fn read(name: &str, bytes: &[u8]) -> MeshFile {
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join(name);
    std::fs::write(&file, bytes).expect("a file");
    read_mesh(&file, &Limits::default()).unwrap_or_else(|error| panic!("{error}"))
}

/// A cube of 40 units whose box begins at (-20, -20, 0).
const CUBE: &str = "v -20 -20 0\nv 20 -20 0\nv 20 20 0\nv -20 20 0\nv -20 -20 40\nv 20 -20 40\nv 20 20 40\nv -20 20 40\n\
    f 1 4 3 2\nf 5 6 7 8\nf 1 2 6 5\nf 2 3 7 6\nf 3 4 8 7\nf 4 1 5 8\n";

#[test]
fn a_cube_is_told_with_its_size_volume_area_and_likely_unit() {
    let file = read("a.obj", CUBE.as_bytes());
    let facts = inspect(&file, 1.0, None);
    assert_eq!((facts.kind, facts.vertices, facts.triangles, facts.pieces), ("surface", 8, 12, 1));
    assert_eq!((facts.min_m, facts.size_m), ([-20.0, -20.0, 0.0], [40.0; 3]));
    assert!(facts.closed && facts.oriented && facts.defects.is_empty() && facts.repair.is_none());
    assert!(
        (facts.volume_m3.expect("closed") - 64_000.0).abs() < 1e-9 && (facts.area_m2 - 9_600.0).abs() < 1e-9
    );
    assert!(facts.unit_doubt.as_ref().is_some_and(|doubt| doubt.contains("the millimetre")), "{facts:?}");
    let facts = inspect(&file, 0.001, None);
    assert!((facts.volume_m3.expect("closed") / 64e-6 - 1.0).abs() < 1e-12 && facts.unit_doubt.is_none());
    // Open, and told what repair would leave.
    let open = CUBE.replace("f 4 1 5 8\n", "");
    let facts = inspect(&read("a.obj", open.as_bytes()), 0.001, None);
    assert!(!facts.closed && facts.volume_m3.is_none());
    assert!(facts.defects[0].starts_with("4 open edges"), "{:?}", facts.defects);
    assert!(facts.repair.as_ref().is_some_and(|told| told.contains("would leave")), "{facts:?}");
    // Inside out, which repair mends.
    let turned = inspect(
        &read(
            "a.obj",
            CUBE.replace("-20", "x")
                .replace("20", "-20")
                .replace('x', "20")
                .replace(" 40", " -40")
                .as_bytes(),
        ),
        0.001,
        None,
    );
    assert_eq!((turned.inside_out, turned.shells.len()), (1, 1));
    assert!(turned.shells[0].volume_m3.is_some_and(|volume| (volume + 64e-6).abs() < 1e-15));
    assert!(
        turned.repair.as_ref().is_some_and(|told| told.starts_with("mends it: 12 triangles were turned"))
    );
}

#[test]
fn a_volume_is_told_with_the_shapes_of_its_elements_and_its_regions() {
    let volume = common::tet_box(2);
    let facts = inspect(&read("a.msh", &common::write_gmsh_2(&volume, None)), 1.0, None);
    assert_eq!((facts.kind, facts.tetrahedra, facts.triangles, facts.pieces), ("volume", 48, 48, 1));
    assert!((facts.volume_m3.expect("a volume") - 0.125).abs() < 1e-12);
    // A box of 1 × 0.5 × 0.25 m.
    assert!((facts.area_m2 - 2.0 * (0.5 + 0.25 + 0.125)).abs() < 1e-12, "{}", facts.area_m2);
    let regions: Vec<(&str, usize)> = facts.regions.iter().map(|r| (r.name.as_str(), r.tetrahedra)).collect();
    assert_eq!(regions, [("liver", 24), ("9", 24)]);
    assert!(facts.regions.iter().all(|region| (region.volume_m3 - 0.0625).abs() < 1e-12));
    let quality = facts.quality.expect("tetrahedra");
    assert!((quality.edge_min_m - 0.125).abs() < 1e-12 && quality.worst.len() == 5);
    // A regular tetrahedron has the mean ratio 1 and angles of arccos(1/3).
    let regular = "# vtk DataFile Version 3.0\nt\nASCII\nDATASET UNSTRUCTURED_GRID\nPOINTS 4 double\n\
        .1 .1 .1 -.1 -.1 .1 -.1 .1 -.1 .1 -.1 -.1\nCELLS 1 5\n4 0 1 2 3\nCELL_TYPES 1\n10\n";
    let facts = inspect(&read("a.vtk", regular.as_bytes()), 1.0, None);
    let quality = facts.quality.expect("a tetrahedron");
    let angle = (1.0f64 / 3.0).acos().to_degrees();
    assert!(
        (quality.dihedral_min_deg - angle).abs() < 1e-9 && (quality.dihedral_max_deg - angle).abs() < 1e-9
    );
    assert!((quality.mean_ratio_min.abs() - 1.0).abs() < 1e-12);
    assert!((facts.volume_m3.expect("one").abs() - 0.008 / 3.0).abs() < 1e-15);
}

#[test]
fn defects_of_volumes_are_told_in_the_numbers_of_the_file_with_what_repair_would_do() {
    let mut volume = common::tet_box(2);
    volume.tets[4].swap(0, 1);
    volume.tets.push(volume.tets[9]);
    volume.tags.push(7);
    let facts = inspect(&read("a.vtk", &common::write_vtk(&volume, false, 3)), 1.0, None);
    assert!(
        facts.defects.iter().any(|defect| defect.contains("tetrahedron 5 is inverted")),
        "{:?}",
        facts.defects
    );
    assert!(
        facts.defects.iter().any(|defect| defect.contains("10 and 49 have the same corners")),
        "{:?}",
        facts.defects
    );
    assert!(facts.repair.as_ref().is_some_and(|told| told.starts_with("mends it")), "{facts:?}");
}

#[test]
fn what_is_written_is_read_back_as_the_same_mesh() {
    let (cube, told) = mend(&read("a.obj", CUBE.as_bytes()), 0.001, None).expect("a cube");
    assert_eq!(told, "nothing had to be mended");
    let MendedMesh::Surface(surface) = &cube else { panic!("a surface") };
    for extension in ["obj", "stl", "PLY"] {
        let bytes = written(&cube, extension).expect(extension);
        let MeshFile::Surface(again) = read(&format!("b.{extension}"), &bytes) else { panic!("a surface") };
        assert_eq!(again.surface.triangles.len(), 12);
        for t in 0..12 {
            for (a, b) in again.surface.corners(t).iter().zip(surface.corners(t)) {
                let tolerance = if extension == "stl" { 1e-8 } else { 0.0 };
                assert!((a - b).norm() <= tolerance, "{extension}: {a} is not {b}");
            }
        }
    }
    assert!(written(&cube, "msh").expect_err("no volume").contains("obj, stl, ply"));
    let volume = common::tet_box(2);
    let mut bad = volume.clone();
    bad.tets[4].swap(2, 3);
    let (mended, told) = mend(&read("a.vtk", &common::write_vtk(&bad, false, 3)), 1.0, None).expect("mended");
    assert!(told.contains("1 inverted element turned (5)"), "{told}");
    for extension in ["msh", "vtk"] {
        let bytes = written(&mended, extension).expect(extension);
        let MeshFile::Volume(again) = read(&format!("b.{extension}"), &bytes) else { panic!("a volume") };
        let TetData { positions, tets, tags } = again.volume;
        assert_eq!(
            (positions, tets, tags),
            (volume.positions.clone(), volume.tets.clone(), volume.tags.clone())
        );
    }
    assert!(written(&mended, "obj").expect_err("no surface").contains("msh, vtk"));
    let mut overlapping = volume.clone();
    let [a, b, c, d] = volume.tets[0];
    let sum: nalgebra::Vector3<f64> = [a, b, c, d].iter().map(|&v| volume.positions[v as usize].coords).sum();
    overlapping.positions.push(nalgebra::Point3::from(sum / 4.0));
    overlapping.tets.push([a, b, c, 27]);
    overlapping.tags.push(0);
    let left =
        mend(&read("a.vtk", &common::write_vtk(&overlapping, false, 3)), 1.0, None).expect_err("overlap");
    assert!(left.contains("overlap"), "{left}");
}

//! Mesh files: what is written comes back, and what is wrong is named with its place.

use crate::support as common;
use std::path::Path;

use crate::support::{Order, tet_box};
use trocar_scene::mesh::{
    Limits, MeshError, SurfaceData, SurfacePolicy, TetData, TetPolicy, read_gltf, read_gmsh, read_gmsh_line,
    read_line, read_obj, read_obj_line, read_stl, read_surface, read_tets, read_vtk, read_vtk_line,
    validate_surface, validate_tets,
};
use trocar_scene::shapes;

fn limits() -> Limits {
    Limits::default()
}
fn solid() -> SurfaceData {
    shapes::torus(0.75, 0.25, 12, 8).expect("a torus")
}

fn same_surface(read: &SurfaceData, written: &SurfaceData, tolerance: f64) {
    assert_eq!(read.triangles.len(), written.triangles.len());
    for t in 0..read.triangles.len() {
        for (a, b) in read.corners(t).iter().zip(written.corners(t)) {
            assert!((a - b).norm() <= tolerance, "triangle {t}: {a} is not {b}");
        }
    }
    assert!(validate_surface(read).is_closed(), "{}", validate_surface(read));
}

fn same_volume(read: &TetData, written: &TetData, tolerance: f64) {
    assert_eq!(read.positions.len(), written.positions.len());
    for (a, b) in read.positions.iter().zip(&written.positions) {
        assert!((a - b).norm() <= tolerance);
    }
    assert_eq!(read.tets, written.tets);
}

#[test]
fn obj_comes_back_exactly_with_normals_and_texture_coordinates() {
    let written = solid();
    let read = read_obj(Path::new("a.obj"), &common::write_obj(&written), &limits()).expect("a valid file");
    assert_eq!(read.positions, written.positions);
    assert_eq!(read.triangles, written.triangles);
    assert_eq!(read.uvs, written.uvs);
    for (a, b) in read.normals.iter().flatten().flatten().zip(written.normals.iter().flatten().flatten()) {
        assert!((a - b).norm() < 1e-15);
    }
}

#[test]
fn obj_agrees_with_tobj() {
    let bytes = common::write_obj(&solid());
    let ours = read_obj(Path::new("a.obj"), &bytes, &limits()).expect("a valid file");
    let options = tobj::LoadOptions { triangulate: true, ..Default::default() };
    let (models, _) = tobj::load_obj_buf(&mut bytes.as_slice(), &options, |_| Ok(Default::default()))
        .expect("tobj reads it");
    let mesh = &models[0].mesh;
    assert_eq!(mesh.indices.len(), 3 * ours.triangles.len());
    for (theirs, ours) in mesh.indices.iter().zip(ours.triangles.iter().flatten()) {
        for axis in 0..3 {
            let theirs = f64::from(mesh.positions[3 * *theirs as usize + axis]);
            assert!((theirs - ours_position(&bytes, *ours, axis)).abs() < 1e-6);
        }
    }
}

fn ours_position(bytes: &[u8], vertex: u32, axis: usize) -> f64 {
    let surface = read_obj(Path::new("a.obj"), bytes, &limits()).expect("a valid file");
    surface.positions[vertex as usize][axis]
}

#[test]
fn obj_groups_share_vertices_and_polygons_become_fans() {
    let text = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 0.5 0.5 1\ng base\nf 4 3 2 1\ng sides\n\
                f 1 2 -1\nf 2 3 -1\nf 3 4 -1\nf 4 1 -1\n";
    let read = read_obj(Path::new("pyramid.obj"), text.as_bytes(), &limits()).expect("a valid file");
    assert_eq!((read.positions.len(), read.triangles.len()), (5, 6));
    assert!(SurfacePolicy::SOLID.require(Path::new("pyramid.obj"), &validate_surface(&read)).is_ok());
    assert!((read.volume() - 1.0 / 3.0).abs() < 1e-15);
}

#[test]
fn stl_comes_back_in_both_forms_and_agrees_with_stl_io() {
    let written = solid();
    for binary in [false, true] {
        let bytes = common::write_stl(&written, binary);
        let read = read_stl(Path::new("a.stl"), &bytes, &limits()).expect("a valid file");
        same_surface(&read, &written, 1e-7);
        if !binary {
            let theirs = stl_io::read_stl(&mut std::io::Cursor::new(&bytes)).expect("stl_io reads it");
            assert_eq!(theirs.vertices.len(), read.positions.len());
            assert_eq!(theirs.faces.len(), read.triangles.len());
        }
    }
}

#[test]
fn gltf_comes_back_from_every_kind_of_buffer_with_its_nodes_applied() {
    let written = solid();
    let mut expected = written.clone().scaled(2.0);
    expected.positions.iter_mut().for_each(|p| p.x += 1.0);
    let folder = tempfile::tempdir().expect("a folder");
    let (document, buffer) = common::write_gltf_external(&written, "sub/mesh%20data.bin");
    std::fs::create_dir(folder.path().join("sub")).expect("a folder");
    std::fs::write(folder.path().join("sub/mesh data.bin"), buffer).expect("a file");
    for (name, bytes) in [
        ("embedded.gltf", common::write_gltf_embedded(&written)),
        ("binary.glb", common::write_glb(&written)),
        ("external.gltf", document),
    ] {
        let file = folder.path().join(name);
        std::fs::write(&file, bytes).expect("a file");
        let read = read_surface(&file, &limits()).unwrap_or_else(|error| panic!("{error}"));
        same_surface(&read, &expected, 1e-6);
    }
}

#[test]
fn gltf_buffers_outside_of_the_folder_are_refused() {
    for uri in
        ["../secret.bin", "/etc/hostname", "%2e%2e/secret.bin", "http://example.org/a.bin", "c:\\a.bin"]
    {
        let (document, _) = common::write_gltf_external(&solid(), uri);
        let error = read_gltf(Path::new("folder/a.gltf"), &document, &limits()).expect_err("refused");
        assert!(matches!(error, MeshError::Malformed { .. }), "{error}");
    }
}

#[test]
fn gltf_nodes_in_a_cycle_are_refused() {
    let text = String::from_utf8(common::write_gltf_embedded(&solid())).expect("text");
    let mut json: serde_json::Value = serde_json::from_str(&text).expect("JSON");
    json["nodes"][1]["children"] = serde_json::json!([0]);
    let error = read_gltf(Path::new("a.gltf"), json.to_string().as_bytes(), &limits()).expect_err("refused");
    assert!(error.to_string().contains("cycle"), "{error}");
}

#[test]
fn a_mirroring_node_keeps_the_outside_outside() {
    let text = String::from_utf8(common::write_gltf_embedded(&solid())).expect("text");
    let mut json: serde_json::Value = serde_json::from_str(&text).expect("JSON");
    json["nodes"][1]["scale"] = serde_json::json!([-2.0, 2.0, 2.0]);
    let read = read_gltf(Path::new("a.gltf"), json.to_string().as_bytes(), &limits()).expect("a valid file");
    assert!((read.volume() / (8.0 * solid().volume()) - 1.0).abs() < 1e-5);
}

#[test]
fn gmsh_comes_back_in_both_versions_and_every_encoding() {
    let written = tet_box(2);
    for binary in [None, Some(Order::Little), Some(Order::Big)] {
        let read = read_gmsh(Path::new("a.msh"), &common::write_gmsh_2(&written, binary), &limits());
        let read = read.unwrap_or_else(|error| panic!("2.2 {binary:?}: {error}"));
        same_volume(&read, &written, 0.0);
        assert_eq!(read.tags, written.tags);

        let read = read_gmsh(Path::new("a.msh"), &common::write_gmsh_4(&written, binary), &limits());
        let read = read.unwrap_or_else(|error| panic!("4.1 {binary:?}: {error}"));
        // Grouped by tag in the file.
        let order: Vec<usize> =
            [7, 9].iter().flat_map(|tag| (0..48).filter(|t| written.tags[*t] == *tag)).collect();
        let tets = order.iter().map(|t| written.tets[*t]).collect();
        let tags: Vec<i32> = order.iter().map(|t| written.tags[*t]).collect();
        same_volume(&read, &TetData { tets, ..written.clone() }, 0.0);
        assert_eq!(read.tags, tags);
    }
}

#[test]
fn vtk_comes_back_in_both_versions_and_encodings() {
    let written = tet_box(2);
    for version in [3, 5] {
        for binary in [false, true] {
            let read = read_vtk(Path::new("a.vtk"), &common::write_vtk(&written, binary, version), &limits());
            let read = read.unwrap_or_else(|error| panic!("version {version}, binary {binary}: {error}"));
            same_volume(&read, &written, if binary { 1e-7 } else { 0.0 });
            assert_eq!(read.tags, written.tags);
        }
    }
}

const OBJ_LINE: &str = "vt 0 0\nv 9 9 9\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 2 3 4\nl 2 3 4\nl -2/1 -1\n";
const MSH_2_LINE: &str = "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n\
    $Nodes\n5\n1 9 9 9\n2 0 0 0\n3 1 0 0\n4 1 1 0\n7 0 1 0\n$EndNodes\n\
    $Elements\n4\n1 1 2 0 1 2 3\n2 1 2 0 1 3 4\n3 1 2 0 1 4 7\n4 2 2 0 1 2 3 4\n$EndElements\n";
const MSH_4_LINE: &str = "$MeshFormat\n4.1 0 8\n$EndMeshFormat\n\
    $Nodes\n1 5 1 7\n1 1 0 5\n1\n2\n3\n4\n7\n9 9 9\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n$EndNodes\n\
    $Elements\n2 4 1 4\n1 1 1 3\n1 2 3\n2 3 4\n3 4 7\n2 1 2 1\n4 2 3 4\n$EndElements\n";
const VTK_POLY_LINE: &str = "# vtk DataFile Version 3.0\nt\nASCII\nDATASET POLYDATA\n\
    POINTS 5 float\n9 9 9 0 0 0 1 0 0 1 1 0 0 1 0\n\
    POLYGONS 1 4\n3 1 2 3\nLINES 2 7\n3 1 2 3\n2 3 4\n";
const VTK_GRID_LINE: &str = "# vtk DataFile Version 3.0\nt\nASCII\nDATASET UNSTRUCTURED_GRID\n\
    POINTS 5 double\n9 9 9 0 0 0 1 0 0 1 1 0 0 1 0\n\
    CELLS 3 11\n3 1 2 3\n2 3 4\n3 1 2 3\nCELL_TYPES 3\n4\n3\n5\n";

/// Three pieces through four of five vertices, whichever file they stand in.
#[test]
fn lines_of_files_are_read_and_what_else_there_is_is_not() {
    let folder = tempfile::tempdir().expect("a folder");
    let files = [
        ("a.obj", OBJ_LINE),
        ("b.msh", MSH_2_LINE),
        ("c.MSH", MSH_4_LINE),
        ("d.vtk", VTK_POLY_LINE),
        ("e.vtk", VTK_GRID_LINE),
    ];
    for (name, text) in files {
        let file = folder.path().join(name);
        std::fs::write(&file, text).expect("a file");
        let mut line = read_line(&file, &limits()).unwrap_or_else(|error| panic!("{error}")).scaled(0.01);
        assert_eq!(line.segments, [[1, 2], [2, 3], [3, 4]], "{name}");
        assert_eq!(line.positions.len(), 5);
        line.compact();
        assert_eq!(line.segments, [[0, 1], [1, 2], [2, 3]], "{name}");
        let places: Vec<[f64; 3]> = line.positions.iter().map(|point| point.coords.into()).collect();
        assert_eq!(places, [[0.0, 0.0, 0.0], [0.01, 0.0, 0.0], [0.01, 0.01, 0.0], [0.0, 0.01, 0.0]]);
    }
    let error = read_line(Path::new("x.stl"), &limits()).expect_err("no lines");
    assert!(error.to_string().contains("'stl'") && error.to_string().contains("obj, msh, vtk"), "{error}");
}

#[test]
fn errors_in_lines_name_place_and_reason() {
    let obj = |text: &str| read_obj_line(Path::new("x.obj"), text.as_bytes(), &limits());
    let msh = |text: &str| read_gmsh_line(Path::new("x.msh"), text.as_bytes(), &limits());
    let vtk = |text: &str| read_vtk_line(Path::new("x.vtk"), text.as_bytes(), &limits());
    for (read, names) in [
        (obj("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"), &["no polyline"][..]),
        (obj("v 0 0 0\nv 1 0 0\nl 1 3\n"), &["line 3", "vertex"]),
        (obj("v 0 0 0\nv 1 0 0\nl 1 1\n"), &["line 3", "itself"]),
        (msh(&MSH_2_LINE.replace("1 2 3\n2 1", "1 2 8\n2 1")), &["line 14", "element 1", "vertex 8"]),
        (msh(&MSH_2_LINE.replace(" 1 2 0 1", " 2 2 0 1 2")), &["no line"]),
        (vtk(&VTK_POLY_LINE.replace("2 3 4", "2 3 5")), &["cell 2", "vertex 5"]),
        (vtk(&VTK_POLY_LINE.replace("2 3 4", "2 3 3")), &["cell 2", "itself"]),
        (vtk(&VTK_POLY_LINE.replace("LINES", "CELLS")), &["TRIANGLE_STRIPS", "CELLS"]),
        (vtk(&VTK_GRID_LINE.replace("\n4\n3\n5", "\n7\n1\n5")), &["no line"]),
    ] {
        let error = read.expect_err("refused").to_string();
        names.iter().for_each(|name| assert!(error.contains(name), "{error}: no {name}"));
    }
    // Poly data has no volume.
    assert!(read_vtk(Path::new("x.vtk"), VTK_POLY_LINE.as_bytes(), &limits()).is_err());
}

#[test]
fn the_extension_selects_the_reader_and_an_unknown_one_is_named() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("liver.MSH");
    std::fs::write(&file, common::write_gmsh_4(&tet_box(1), None)).expect("a file");
    assert_eq!(read_tets(&file, &limits()).expect("a valid file").tets.len(), 6);
    let error = read_surface(&file, &limits()).expect_err("no surface");
    assert!(error.to_string().contains("holds a volume"), "{error}");
    let error = read_surface(&folder.path().join("liver.off"), &limits()).expect_err("not known");
    assert!(
        error.to_string().contains("'off'") && error.to_string().contains("obj, stl, ply, gltf, glb"),
        "{error}"
    );
    let error = read_tets(&folder.path().join("missing.vtk"), &limits()).expect_err("missing");
    assert!(matches!(error, MeshError::Io { .. }) && error.to_string().contains("missing.vtk"), "{error}");
    assert!(matches!(read_tets(&folder.path().join("."), &limits()), Err(MeshError::Unsupported { .. })));
}

/// Every error names the file, and the place and reason given here.
#[test]
fn errors_name_place_and_reason() {
    type Reader = fn(&[u8]) -> Result<(), MeshError>;
    let obj: Reader = |bytes| read_obj(Path::new("dir/x.mesh"), bytes, &limits()).map(|_| ());
    let stl: Reader = |bytes| read_stl(Path::new("dir/x.mesh"), bytes, &limits()).map(|_| ());
    let gltf: Reader = |bytes| read_gltf(Path::new("dir/x.mesh"), bytes, &limits()).map(|_| ());
    let gmsh: Reader = |bytes| read_gmsh(Path::new("dir/x.mesh"), bytes, &limits()).map(|_| ());
    let vtk: Reader = |bytes| read_vtk(Path::new("dir/x.mesh"), bytes, &limits()).map(|_| ());
    let msh = "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n";
    let nodes = "$Nodes\n4\n1 0 0 0\n2 1 0 0\n3 0 1 0\n4 0 0 1\n$EndNodes\n";
    let head = "# vtk DataFile Version 3.0\nt\nASCII\nDATASET UNSTRUCTURED_GRID\n";
    let points = "POINTS 4 float\n0 0 0 1 0 0 0 1 0 0 0 1\n";
    let cases: Vec<(Reader, String, &[&str])> = vec![
        (obj, String::new(), &["no face"]),
        (obj, "v 0 0 0\nv 1 0 x\n".into(), &["line 2", "'x' is not a number"]),
        (obj, "v 0 0\n".into(), &["line 1", "too few numbers"]),
        (obj, "v 0 0 0\nv 0 nan 0\n".into(), &["line 2", "vertex 1", "not finite"]),
        (obj, "v 0 0 0\nf 1 1 2\n".into(), &["line 2", "vertex 2", "1 vertices"]),
        (obj, "v 0 0 0\nf 0 1 1\n".into(), &["line 2", "vertex 0"]),
        (obj, "v 0 0 0\nf -2 1 1\n".into(), &["line 2", "vertex -2"]),
        (obj, "v 0 0 0\nf 1 1\n".into(), &["line 2", "at least 3 corners"]),
        (obj, "v 0 0 0\nf 1/ 1/x 1\n".into(), &["line 2", "'1/x'"]),
        (obj, "curv 1 2\n".into(), &["line 1", "'curv'", "not supported"]),
        (stl, "solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 oops\n".into(), &["line 4", "'oops'"]),
        (stl, "solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 inf\n".into(), &["line 4", "not finite"]),
        (stl, "solid a\nfacet normal 0 0 1\nouter\n".into(), &["'loop' is expected", "end of the file"]),
        (stl, "solid a\nendsolid a\n".into(), &["no facet"]),
        (stl, "nothing".into(), &["byte 0", "header"]),
        (gltf, "{".into(), &["line 1", "not a glTF document"]),
        (gltf, r#"{"asset":{"version":"1.0"}}"#.into(), &["version '1.0'", "2.0"]),
        (gltf, "glTF".into(), &["byte 4", "version"]),
        (gmsh, String::new(), &["without $MeshFormat"]),
        (gmsh, "$MeshFormat\n3 0 8\n".into(), &["line 2", "'3'", "2.2 and 4.1"]),
        (gmsh, "$MeshFormat\n2.2 0 4\n".into(), &["line 2", "data size"]),
        (gmsh, format!("{msh}$Nodes\n2\n1 0 0 0\n"), &["a node number is expected", "end of the file"]),
        (gmsh, format!("{msh}$Nodes\n1\n1 0 0 nan\n$EndNodes\n"), &["node 0", "not finite"]),
        (gmsh, format!("{msh}$Nodes\n99999\n1 0 0 0\n"), &["declares 99999 nodes"]),
        (gmsh, format!("{msh}$Nodes\n999999999999\n"), &["999999999999 nodes", "limit"]),
        (gmsh, format!("{msh}$Nodes\n2\n1 0 0 0\n1 0 0 0\n$EndNodes\n"), &["node number 1 appears twice"]),
        (gmsh, format!("{msh}{nodes}$Elements\n1\n1 4 0 1 2 3 5\n$EndElements\n"), &["line 13", "vertex 5"]),
        (
            gmsh,
            format!("{msh}{nodes}$Elements\n1\n1 99 0 1 2 3 4 1 2 3 4\n$EndElements\n"),
            &["line 13", "type 99", "hexahedra"],
        ),
        (gmsh, format!("{msh}{nodes}$Elements\n1\n1 15 0 1\n$EndElements\n"), &["no tetrahedron"]),
        (gmsh, format!("{msh}{nodes}"), &["without $Elements"]),
        (gmsh, format!("{msh}$Nodes\n0\n$EndElements\n"), &["$EndNodes is expected"]),
        (gmsh, format!("{msh}$Junk\n1 2 3\n"), &["line 4", "'Junk'", "not ended"]),
        (vtk, "# vtk DataFile Version 9.0\n".into(), &["line 1", "versions 1 to 5"]),
        (
            vtk,
            "# vtk DataFile Version 3.0\nt\nASCII\nDATASET RECTILINEAR_GRID\n".into(),
            &["line 4", "POLYDATA"],
        ),
        (vtk, head.into(), &["no POINTS"]),
        (vtk, format!("{head}POINTS 9000 float\n0 0 0\n"), &["line 5", "declares 9000 points"]),
        (vtk, format!("{head}{points}CELLS 1 5\n4 0 1 2 9\nCELL_TYPES 1\n10\n"), &["vertex 9", "4 vertices"]),
        (vtk, format!("{head}{points}CELLS 1 5\n4 0 1 2 -1\nCELL_TYPES 1\n10\n"), &["vertex -1"]),
        (
            vtk,
            format!("{head}{points}CELLS 1 5\n4 0 1 2 3\nCELL_TYPES 1\n12\n"),
            &["cell 0 of type 12 has 4 corners"],
        ),
        (vtk, format!("{head}{points}CELLS 1 5\n9 0 1 2 3\nCELL_TYPES 1\n10\n"), &["9 corners does not fit"]),
        (
            vtk,
            format!("{head}{points}CELLS 1 5\n4 0 1 2 3\nCELL_TYPES 2\n10 10\n"),
            &["1 cells", "2 cell types"],
        ),
        (vtk, format!("{head}{points}BOGUS 3\n"), &["line 7", "'BOGUS 3'", "CELL_TYPES"]),
    ];
    for (reader, text, expected) in cases {
        let error = reader(text.as_bytes()).expect_err(&text).to_string();
        for part in expected.iter().chain(&["dir/x.mesh"]) {
            assert!(error.contains(part), "'{part}' is missing in '{error}' for\n{text}");
        }
    }
}

#[test]
fn limits_are_kept() {
    let tight = Limits { vertices: 10, ..limits() };
    let is_limit =
        |result: Result<(), MeshError>| matches!(result, Err(MeshError::TooLarge { limit: 10, .. }));
    let (surface, volume) = (solid(), tet_box(2));
    let p = Path::new("x");
    assert!(is_limit(read_obj(p, &common::write_obj(&surface), &tight).map(|_| ())));
    assert!(is_limit(read_stl(p, &common::write_stl(&surface, true), &tight).map(|_| ())));
    assert!(is_limit(read_gltf(p, &common::write_glb(&surface), &tight).map(|_| ())));
    assert!(is_limit(read_gmsh(p, &common::write_gmsh_2(&volume, None), &tight).map(|_| ())));
    assert!(is_limit(read_gmsh(p, &common::write_gmsh_4(&volume, Some(Order::Little)), &tight).map(|_| ())));
    assert!(is_limit(read_vtk(p, &common::write_vtk(&volume, true, 3), &tight).map(|_| ())));
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("a.obj");
    std::fs::write(&file, common::write_obj(&surface)).expect("a file");
    let small = Limits { bytes: 10, ..limits() };
    assert!(is_limit(read_surface(&file, &small).map(|_| ())));
}

#[test]
fn what_is_wrong_with_a_surface_is_found_and_refused_on_demand() {
    let name = Path::new("cube");
    let cube = shapes::cuboid([1.0; 3]).expect("a cube");
    let refusal = |surface: &SurfaceData| {
        SurfacePolicy::SOLID.require(name, &validate_surface(surface)).expect_err("refused").to_string()
    };
    assert!(SurfacePolicy::SOLID.require(name, &validate_surface(&cube)).is_ok());

    let mut open = cube.clone();
    open.triangles.truncate(11);
    let report = validate_surface(&open);
    assert_eq!((report.boundary_edges.count, report.is_manifold()), (3, true));
    assert!(refusal(&open).contains("3 open edges"));
    assert!(SurfacePolicy { closed: false, ..SurfacePolicy::SOLID }.require(name, &report).is_ok());

    let mut turned = cube.clone();
    turned.triangles[4].swap(0, 1);
    assert_eq!(validate_surface(&turned).misoriented_edges.count, 3);
    assert!(refusal(&turned).contains("opposite orientation"));

    let mut fin = cube.clone();
    fin.positions.push([0.0, 0.0, 9.0].into());
    let [a, b, _] = fin.triangles[0];
    fin.triangles.push([a, b, 8]);
    let report = validate_surface(&fin);
    assert_eq!(report.non_manifold_edges.count, 1);
    assert_eq!(report.non_manifold_edges.first, Some([a.min(b), a.max(b)]));
    assert!(refusal(&fin).contains("more than two triangles"));

    let mut touching = cube.clone();
    let mut other = cube.clone();
    other.positions.iter_mut().for_each(|p| p.coords.add_scalar_mut(2.0));
    touching.append(&other);
    touching.weld_identical();
    let report = validate_surface(&touching);
    assert_eq!((report.non_manifold_vertices.count, report.components, report.is_closed()), (1, 2, true));
    assert!(refusal(&touching).contains("separate fans"));

    let mut degenerate = cube.clone();
    degenerate.triangles[3][1] = degenerate.triangles[3][0];
    assert_eq!(validate_surface(&degenerate).degenerate.first, Some(3));
    assert!(refusal(&degenerate).contains("1 degenerate triangle (triangle 3)"));

    let mut doubled = cube;
    doubled.triangles.push(doubled.triangles[5]);
    assert_eq!(validate_surface(&doubled).duplicates.first, Some(12));
    assert!(refusal(&doubled).contains("duplicate"));
    assert!(SurfacePolicy::ANY.require(name, &validate_surface(&doubled)).is_ok());
}

#[test]
fn what_is_wrong_with_a_volume_is_found_and_refused_on_demand() {
    let name = Path::new("box");
    let good = tet_box(2);
    let report = validate_tets(&good);
    assert!(TetPolicy::SOLID.require(name, &report).is_ok());
    assert_eq!((report.components, report.boundary_faces), (1, 48));
    assert!((report.volume - 0.125).abs() < 1e-15);
    let (surface, _) = good.boundary();
    assert!(SurfacePolicy::SOLID.require(name, &validate_surface(&surface)).is_ok());
    assert!((surface.volume() - 0.125).abs() < 1e-15);

    let mut inverted = good.clone();
    inverted.tets[5].swap(0, 1);
    inverted.tets[9].swap(0, 1);
    let report = validate_tets(&inverted);
    assert_eq!((report.inverted.count, report.inverted.first), (2, Some(5)));
    let refusal = TetPolicy::SOLID.require(name, &report).expect_err("refused").to_string();
    assert!(refusal.contains("2 inverted") && refusal.contains("first 5"), "{refusal}");
    assert_eq!(inverted.flip_inverted(), 2);
    assert_eq!(validate_tets(&inverted).inverted.count, 0);

    let mut flat = good.clone();
    flat.tets[7][3] = flat.tets[7][0];
    assert_eq!(validate_tets(&flat).degenerate.first, Some(7));

    let mut doubled = good;
    doubled.tets.push(doubled.tets[1]);
    let report = validate_tets(&doubled);
    assert_eq!(report.duplicates.first, Some(48));
    assert!(report.non_manifold_faces.count > 0);
}

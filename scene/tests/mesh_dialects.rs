//! The same mesh in the dialects that programs write: byte order marks, line ends, capitals, kinds of numbers, encodings.

use std::path::Path;

use crate::support::ply::write_ply;
use crate::support::vtk_xml::{Form, Style, styles, write_vtu};
use crate::support::{self as common, Order, tet_box};
use trocar_scene::mesh::{
    Limits, MeshError, MeshFile, SurfaceData, TetData, read_gmsh, read_gmsh_surface, read_mesh, read_obj,
    read_ply, read_stl, read_vtk, read_vtk_line, read_vtk_surface, validate_surface,
};
use trocar_scene::shapes;

const CORNERS: &str = "v -2 -2 0\nv 2 -2 0\nv 2 2 0\nv -2 2 0\nv -2 -2 4\nv 2 -2 4\nv 2 2 4\nv -2 2 4\n";
const QUADS: &str = "f 1 4 3 2\nf 5 6 7 8\nf 1 2 6 5\nf 2 3 7 6\nf 3 4 8 7\nf 4 1 5 8\n";

fn limits() -> Limits {
    Limits::default()
}
fn obj(text: &[u8]) -> Result<SurfaceData, MeshError> {
    read_obj(Path::new("x.obj"), text, &limits())
}
fn stl(bytes: &[u8]) -> Result<SurfaceData, MeshError> {
    read_stl(Path::new("x.stl"), bytes, &limits())
}
fn ply(bytes: &[u8]) -> Result<SurfaceData, MeshError> {
    read_ply(Path::new("x.ply"), bytes, &limits())
}
fn vtk(bytes: &[u8]) -> Result<TetData, MeshError> {
    read_vtk(Path::new("x.vtk"), bytes, &limits())
}
fn poly(bytes: &[u8]) -> Result<SurfaceData, MeshError> {
    read_vtk_surface(Path::new("x.vtk"), bytes, &limits())
}
fn msh(bytes: &[u8]) -> Result<TetData, MeshError> {
    read_gmsh(Path::new("x.msh"), bytes, &limits())
}

/// A text with each of the marks, line ends and blanks that do not matter; capitals where `any_case`.
fn dialects(text: &str, any_case: bool) -> Vec<(&'static str, Vec<u8>)> {
    let marked = |text: &str| [b"\xef\xbb\xbf", text.as_bytes()].concat();
    let mut all = vec![
        ("as it is", text.as_bytes().to_vec()),
        ("byte order mark", marked(text)),
        ("carriage returns and line feeds", text.replace('\n', "\r\n").into_bytes()),
        ("mark, carriage returns and line feeds", marked(&text.replace('\n', "\r\n"))),
        ("carriage returns", text.replace('\n', "\r").into_bytes()),
        ("trailing blanks and tabs", text.replace('\n', " \t\n").into_bytes()),
        ("tabs", text.replace(' ', "\t").replace("\tDataFile\tVersion\t", " DataFile Version ").into_bytes()),
        ("no line end at the end", text.trim_end().as_bytes().to_vec()),
    ];
    if any_case {
        all.push(("capitals", text.to_uppercase().into_bytes()));
        all.push(("small letters", text.to_lowercase().into_bytes()));
    }
    all
}

fn is_box(surface: &SurfaceData, dialect: &str) {
    assert_eq!((surface.positions.len(), surface.triangles.len()), (8, 12), "{dialect}");
    assert!((surface.volume() - 64.0).abs() < 1e-9, "{dialect}: {}", surface.volume());
    assert!(validate_surface(surface).is_closed(), "{dialect}");
}

#[test]
fn obj_is_read_in_every_dialect() {
    let plain = format!("# a comment\n{CORNERS}g sides\ns off\n{QUADS}");
    for (dialect, text) in dialects(&plain, true) {
        is_box(&obj(&text).unwrap_or_else(|error| panic!("{dialect}: {error}")), dialect);
    }
    let forms = [
        ("continued lines", format!("{CORNERS}{}", QUADS.replace(' ', " \\\n "))),
        ("continued lines with carriage returns", format!("{CORNERS}{}", QUADS.replace(' ', " \\\r\n "))),
        ("faces before their vertices", format!("{QUADS}{CORNERS}")),
        ("vertices between faces", QUADS.replacen("f 2 3", &format!("{CORNERS}f 2 3"), 1)),
        ("weights", CORNERS.replace(" 0\n", " 0 1.0\n").replace(" 4\n", " 4 1.0\n") + QUADS),
        ("colours", CORNERS.replace(" 0\n", " 0 0.1 0.2 0.3\n").replace(" 4\n", " 4 1 1 1\n") + QUADS),
        ("a library whose path ends in a backslash", format!("mtllib C:\\meshes\\\n{CORNERS}{QUADS}")),
        ("comments behind elements", format!("{CORNERS}{}", QUADS.replace('\n', " # a face\n"))),
        ("repeated corners", CORNERS.to_owned() + &QUADS.replace("f 1 4 3 2", "f 1 1 4 4 3 2 1")),
        ("other elements", format!("o box\nusemtl skin\nmg 0\n{CORNERS}p 1\nl 1 2\n{QUADS}")),
    ];
    for (dialect, text) in forms {
        is_box(&obj(text.as_bytes()).unwrap_or_else(|error| panic!("{dialect}: {error}")), dialect);
    }
    let relative =
        "f -8 -5 -6 -7\nf -4 -3 -2 -1\nf -8 -7 -3 -4\nf -7 -6 -2 -3\nf -6 -5 -1 -2\nf -5 -8 -4 -1\n";
    is_box(&obj(format!("{CORNERS}{relative}").as_bytes()).expect("relative"), "negative numbers");
    let attributes = "vt 0 0\nvt 1 0 0\nvn 0 0 1\n";
    for form in ["K/1", "K//1", "K/1/1", "K/-1/-1", "K/"] {
        let corner = |word: &str| if word == "f" { word.into() } else { form.replace('K', word) };
        let faces: Vec<String> =
            QUADS.lines().map(|l| l.split(' ').map(corner).collect::<Vec<String>>().join(" ")).collect();
        let text = format!("{CORNERS}{attributes}{}\n", faces.join("\n"));
        is_box(&obj(text.as_bytes()).unwrap_or_else(|error| panic!("{form}: {error}")), form);
    }
    let late = obj(format!("{QUADS}f 1 2 9\n{CORNERS}").as_bytes()).expect_err("no vertex 9").to_string();
    assert!(late.contains("line 7") && late.contains("vertex 9") && late.contains("8 vertices"), "{late}");
}

#[test]
fn text_of_two_or_four_bytes_a_letter_is_told_from_damage_in_every_format() {
    let wide: [fn(&str) -> Vec<u8>; 6] = [
        |text| text.encode_utf16().flat_map(u16::to_le_bytes).collect(),
        |text| text.encode_utf16().flat_map(u16::to_be_bytes).collect(),
        |text| format!("\u{feff}{text}").encode_utf16().flat_map(u16::to_le_bytes).collect(),
        |text| format!("\u{feff}{text}").encode_utf16().flat_map(u16::to_be_bytes).collect(),
        |text| format!("\u{feff}{text}").chars().flat_map(|c| u32::from(c).to_le_bytes()).collect(),
        |text| format!("\u{feff}{text}").chars().flat_map(|c| u32::from(c).to_be_bytes()).collect(),
    ];
    let box_ = obj(format!("{CORNERS}{QUADS}").as_bytes()).expect("a box");
    let volume = tet_box(1);
    let text = |bytes: Vec<u8>| String::from_utf8(bytes).expect("text");
    let style = Style { form: Form::Ascii, order: Order::Little, compressed: false, wide: false };
    let files = [
        ("a.obj", format!("{CORNERS}{QUADS}")),
        ("a.stl", text(common::write_stl(&box_, false))),
        ("a.ply", text(write_ply(&box_, None))),
        ("a.msh", text(common::write_gmsh_2(&volume, None))),
        ("a.vtk", text(common::write_vtk(&volume, false, 3))),
        ("a.vtu", text(write_vtu(&volume, style))),
        ("a.gltf", text(common::write_gltf_embedded(&box_))),
    ];
    let folder = tempfile::tempdir().expect("a folder");
    for (name, text) in files {
        let file = folder.path().join(name);
        std::fs::write(&file, format!("\u{feff}{text}")).expect("a file");
        assert!(read_mesh(&file, &limits()).is_ok(), "{name} with a byte order mark");
        for (k, encode) in wide.iter().enumerate() {
            std::fs::write(&file, encode(&text)).expect("a file");
            let error = read_mesh(&file, &limits()).expect_err(name).to_string();
            let encoding = if k < 4 { "UTF-16" } else { "UTF-32" };
            assert!(error.contains(&format!("{encoding}: save the file as UTF-8")), "{name}, {k}: {error}");
        }
    }
}

#[test]
fn stl_text_is_read_in_every_dialect() {
    let box_ = obj(format!("{CORNERS}{QUADS}").as_bytes()).expect("a box");
    let text = String::from_utf8(common::write_stl(&box_, false)).expect("text");
    let name =
        text.lines().next().and_then(|line| line.split_once(' ')).map_or("", |(_, name)| name).to_owned();
    for (dialect, text) in dialects(&text, true) {
        is_box(&stl(&text).unwrap_or_else(|error| panic!("{dialect}: {error}")), dialect);
    }
    let end = format!("endsolid {name}");
    let forms = [
        ("end solid", text.replace(&end, "end solid")),
        ("end solid with a name", text.replace(&end, "end solid part 1")),
        ("END SOLID", text.replace(&end, "END SOLID X")),
        ("endsolid without a name", text.replace(&end, "endsolid")),
        ("no name", text.replacen(&format!("solid {name}"), "solid", 1)),
        ("end loop and end facet", text.replace("endloop", "end loop").replace("endfacet", "end facet")),
        ("a name of keywords", text.replacen(&format!("solid {name}"), "solid facet vertex 1 binary", 1)),
        ("odd normals", text.replace("facet normal ", "facet normal -nan(ind) ")),
        ("a byte that is no UTF-8", text.clone()),
    ];
    for (form, text) in forms {
        let mut bytes = text.into_bytes();
        if form.starts_with("a byte") {
            bytes.splice(6..6, [0xe9]);
        }
        is_box(&stl(&bytes).unwrap_or_else(|error| panic!("{form}: {error}")), form);
    }
    let half = box_.triangles.len() / 2;
    let lines: Vec<&str> = text.lines().collect();
    let first = lines[..1 + 7 * half].join("\n");
    let second = lines[1 + 7 * half..].join("\n");
    is_box(
        &stl(format!("{first}\nendsolid\nsolid b\n{second}\n").as_bytes()).expect("two"),
        "several solids",
    );
}

#[test]
fn binary_stl_is_told_by_its_size_and_not_by_its_header_and_may_have_bytes_behind_it() {
    let box_ = obj(format!("{CORNERS}{QUADS}").as_bytes()).expect("a box");
    let plain = common::write_stl(&box_, true);
    for header in ["solid bracket", "SOLID facet normal", "", "solid \u{e9}", "facet"] {
        for behind in [0, 1, 37, 50, 4096] {
            let mut bytes = plain.clone();
            for fill in [b' ', 0] {
                bytes[..80].fill(fill);
                bytes[..header.len()].copy_from_slice(header.as_bytes());
                let mut bytes = bytes.clone();
                bytes.extend(std::iter::repeat_n(b'x', behind));
                let read = stl(&bytes).unwrap_or_else(|error| panic!("'{header}', {behind}: {error}"));
                is_box(&read, header);
            }
        }
    }
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("a.stl");
    std::fs::write(&file, [&plain[..], &[7; 37]].concat()).expect("a file");
    let Ok(MeshFile::Surface(read)) = read_mesh(&file, &limits()) else { panic!("a surface") };
    assert_eq!(read.notes, ["37 bytes behind the last of its 12 facets were skipped"]);
    let cut = stl(&plain[..plain.len() - 60]).expect_err("cut short").to_string();
    assert!(cut.contains("declares 12 facets"), "{cut}");
    let no_solid =
        stl(b"# made by hand\nfacet normal 0 0 1\nouter loop\n").expect_err("no 'solid'").to_string();
    assert!(no_solid.contains("line 1") && no_solid.contains("'solid' is expected"), "{no_solid}");
}

#[test]
fn legacy_vtk_is_read_in_every_dialect() {
    let written = tet_box(1);
    for version in [3, 5] {
        let text = String::from_utf8(common::write_vtk(&written, false, version)).expect("text");
        for (dialect, bytes) in dialects(&text, true) {
            let read = vtk(&bytes).unwrap_or_else(|error| panic!("{version}, {dialect}: {error}"));
            assert_eq!((&read.tets, &read.tags), (&written.tets, &written.tags), "{dialect}");
            assert_eq!(read.positions, written.positions, "{dialect}");
        }
        for number in ["1.0", "2.0", "3.0", "4.1", "4.2", "5.0", "5.1"] {
            let text = text.replacen(&format!("Version {version}.1"), &format!("Version {number}"), 1);
            assert_eq!(vtk(text.as_bytes()).expect(number).tets, written.tets);
        }
    }
    let text = String::from_utf8(common::write_vtk(&written, false, 5)).expect("text");
    let kinds = [
        "vtktypeint32",
        "vtktypeint64",
        "vtktypeuint32",
        "vtktypeuint64",
        "vtktypeint16",
        "vtkIdType",
        "int",
        "long",
        "unsigned_int",
        "short",
        "unsigned_char",
    ];
    for kind in kinds {
        let text = text.replace("vtktypeint64", kind);
        assert_eq!(vtk(text.as_bytes()).expect(kind).tets, written.tets);
    }
}

#[test]
fn a_line_of_vertical_tabs_in_legacy_vtk_is_an_empty_line() {
    let written = tet_box(1);
    let text = String::from_utf8(common::write_vtk(&written, false, 5)).expect("text");
    let tabs = text.replacen("\nCELLS", "\n\u{b}\u{b}\n\u{85}\nCELLS", 1);
    assert_ne!(tabs, text);
    assert_eq!(vtk(tabs.as_bytes()).expect("it is read").tets, written.tets);
}

/// Bytes of a number in the order of VTK's binary files.
fn big(number: i64, kind: &str) -> Vec<u8> {
    let bytes = number.to_be_bytes();
    let width = match kind {
        "vtktypeint8" | "unsigned_char" => 1,
        "vtktypeint16" | "short" => 2,
        "vtktypeint32" | "unsigned_int" => 4,
        _ => 8,
    };
    bytes[8 - width..].to_vec()
}

#[test]
fn binary_vtk_may_have_any_kind_of_number_and_data_before_the_cells() {
    let written = tet_box(1);
    for kind in [
        "vtktypeint8",
        "unsigned_char",
        "short",
        "vtktypeint32",
        "unsigned_int",
        "vtktypeint64",
        "vtktypeuint64",
    ] {
        let mut file = b"# vtk DataFile Version 5.1\nt\nBINARY\nDATASET UNSTRUCTURED_GRID\n".to_vec();
        // A string, whose length has a byte of its own: 3 << 6 | 3.
        file.extend_from_slice(b"FIELD FieldData 2\nSPACE 1 1 string\n\xc3LPS\nBits 1 9 bit\n\xff\x80\n");
        file.extend_from_slice(format!("POINTS {} double\n", written.positions.len()).as_bytes());
        written.positions.iter().flat_map(|p| [p.x, p.y, p.z]).for_each(|x| file.extend(x.to_be_bytes()));
        let (cells, corners) = (written.tets.len(), 4 * written.tets.len());
        file.extend_from_slice(format!("\nMETADATA\nINFORMATION 1\nNAME L2_NORM_RANGE LOCATION vtkDataArray\nDATA 2 0 1 \n\nCELLS {} {corners}\nOFFSETS {kind}\n", cells + 1).as_bytes());
        (0..=cells).for_each(|k| file.extend(big(4 * k as i64, kind)));
        file.extend_from_slice(format!("\nCONNECTIVITY {kind}\n").as_bytes());
        written.tets.iter().flatten().for_each(|&v| file.extend(big(v.into(), kind)));
        file.extend_from_slice(format!("\nCELL_TYPES {cells}\n").as_bytes());
        (0..cells).for_each(|_| file.extend(10i32.to_be_bytes()));
        file.extend_from_slice(
            format!("\nPOINT_DATA {}\nVECTORS v float\n", written.positions.len()).as_bytes(),
        );
        file.extend(std::iter::repeat_n(b'\n', 12 * written.positions.len()));
        file.extend_from_slice(
            format!("\nCELL_DATA {cells}\nFIELD FieldData 2\nquality 1 {cells} float\n").as_bytes(),
        );
        file.extend(std::iter::repeat_n(0x20, 4 * cells));
        file.extend_from_slice(format!("\nmaterial 1 {cells} {kind}\n").as_bytes());
        written.tags.iter().for_each(|&tag| file.extend(big(tag.into(), kind)));
        let read = vtk(&file).unwrap_or_else(|error| panic!("{kind}: {error}"));
        assert_eq!(
            (&read.tets, &read.tags, &read.positions),
            (&written.tets, &written.tags, &written.positions)
        );
    }
}

#[test]
fn poly_data_is_a_surface_of_polygons_and_strips_and_its_lines_and_vertices_are_skipped() {
    let head = "# vtk DataFile Version 3.0\nt\nASCII\nDATASET POLYDATA\nPOINTS 8 float\n\
        -2 -2 0 2 -2 0 2 2 0 -2 2 0 -2 -2 4 2 -2 4 2 2 4 -2 2 4\n";
    let polygons = "POLYGONS 4 20\n4 0 3 2 1\n4 4 5 6 7\n4 0 1 5 4\n4 2 3 7 6\n";
    // Both remaining sides as strips of two triangles each.
    let strips = "TRIANGLE_STRIPS 2 10\n4 1 2 5 6\n4 3 0 7 4\n";
    let text = format!(
        "{head}VERTICES 1 2\n1 0\nLINES 1 3\n2 0 1\n{polygons}{strips}POINT_DATA 8\nSCALARS a float\n"
    );
    for (dialect, bytes) in dialects(&text, true) {
        is_box(&poly(&bytes).unwrap_or_else(|error| panic!("{dialect}: {error}")), dialect);
    }
    assert_eq!(read_vtk_line(Path::new("x"), text.as_bytes(), &limits()).expect("a line").segments, [[0, 1]]);
    // Version 5 has offsets; a field of strings stands before the points.
    let text = text
        .replace("3.0", "5.1")
        .replace("POINTS 8", "FIELD FieldData 1\nSPACE 1 1 string\nLPS\nPOINTS 8")
        .replace(polygons, "POLYGONS 5 16\nOFFSETS vtktypeint64\n0 4 8 12 16\nCONNECTIVITY vtktypeint32\n0 3 2 1 4 5 6 7 0 1 5 4 2 3 7 6\n")
        .replace(strips, "TRIANGLE_STRIPS 3 8\nOFFSETS vtktypeint64\n0 4 8\nCONNECTIVITY vtktypeint64\n1 2 5 6 3 0 7 4\n")
        .replace("VERTICES 1 2\n1 0\nLINES 1 3\n2 0 1\n", "");
    is_box(&poly(text.as_bytes()).expect("version 5"), "version 5");
    let points = "<Points><DataArray type=\"Float32\" NumberOfComponents=\"3\" format=\"ascii\">\
        -2 -2 0 2 -2 0 2 2 0 -2 2 0 -2 -2 4 2 -2 4 2 2 4 -2 2 4</DataArray></Points>";
    let array = |name: &str, text: &str| {
        format!("<DataArray type=\"Int64\" Name=\"{name}\" format=\"ascii\">{text}</DataArray>")
    };
    let xml = format!(
        "<?xml version=\"1.0\"?>\n<VTKFile type=\"PolyData\" version=\"0.1\" byte_order=\"LittleEndian\">\n<PolyData>\
         <Piece NumberOfPoints=\"8\" NumberOfPolys=\"4\">{points}<Verts>{}{}</Verts>\n<Strips>{}{}</Strips>\
         <Polys>{}{}</Polys></Piece></PolyData></VTKFile>\n",
        array("connectivity", "0"),
        array("offsets", "1"),
        array("connectivity", "1 2 5 6 3 0 7 4"),
        array("offsets", "4 8"),
        array("connectivity", "0 3 2 1 4 5 6 7 0 1 5 4 2 3 7 6"),
        array("offsets", "4 8 12 16"),
    );
    for (dialect, bytes) in dialects(&xml, false) {
        is_box(&poly(&bytes).unwrap_or_else(|error| panic!("{dialect}: {error}")), dialect);
    }
}

#[test]
fn vtk_xml_is_read_in_every_form_of_its_arrays() {
    let written = tet_box(2);
    for style in styles() {
        let bytes = write_vtu(&written, style);
        let read = vtk(&bytes).unwrap_or_else(|error| panic!("{style:?}: {error}"));
        assert_eq!((&read.tets, &read.tags), (&written.tets, &written.tags), "{style:?}");
        assert_eq!(read.positions, written.positions, "{style:?}");
        // Cut short anywhere, it is refused.
        for part in [3, 5, 8, 9] {
            assert!(vtk(&bytes[..bytes.len() * part / 10]).is_err(), "{style:?}, {part}/10");
        }
    }
    // The content tells the format, not the name.
    let style = Style { form: Form::Ascii, order: Order::Little, compressed: false, wide: false };
    let folder = tempfile::tempdir().expect("a folder");
    for name in ["a.vtu", "a.vtk", "a.VTU"] {
        let file = folder.path().join(name);
        std::fs::write(&file, write_vtu(&written, style)).expect("a file");
        assert!(matches!(read_mesh(&file, &limits()), Ok(MeshFile::Volume(_))), "{name}");
    }
    let text = String::from_utf8(write_vtu(&written, style)).expect("text");
    for (dialect, bytes) in dialects(&text, false) {
        assert_eq!(vtk(&bytes).unwrap_or_else(|error| panic!("{dialect}: {error}")).tets, written.tets);
    }
}

#[test]
fn what_is_wrong_with_vtk_xml_is_told() {
    let style = Style { form: Form::Ascii, order: Order::Little, compressed: false, wide: false };
    let text = String::from_utf8(write_vtu(&tet_box(1), style)).expect("text");
    let cases = [
        (text.replace("UnstructuredGrid\"", "ImageData\""), "'ImageData'"),
        (text.replace("\"UnstructuredGrid\"", "\"PUnstructuredGrid\""), "parallel"),
        (
            text.replace("header_type", "compressor=\"vtkLZ4DataCompressor\" header_type"),
            "vtkZLibDataCompressor",
        ),
        (text.replace("Name=\"types\"", "Name=\"kinds\""), "no types"),
        (text.replace("\n10 10", "\n42 10"), "cell 0 of type 42"),
        (text.replace("\n4 8 ", "\n4 3 "), "offsets begin at 0, grow"),
        (text.replace("<Cells>", "<Cellz>"), "not an XML file"),
        (text.replace("format=\"ascii\"", "format=\"appended\""), "no AppendedData"),
        (text.replace("type=\"Float64\"", "type=\"Float63\""), "'Float63'"),
        ("<?xml version=\"1.0\"?>\n<svg></svg>\n".into(), "no VTKFile"),
    ];
    for (text, part) in cases {
        let error = vtk(text.as_bytes()).expect_err(part).to_string();
        assert!(error.contains(part), "'{part}' is missing in '{error}'");
    }
    // An array that becomes a thousand times as long as the file.
    let zeros = miniz_oxide::deflate::compress_to_vec_zlib(&vec![0; 20_000_000], 9);
    let header: Vec<u8> =
        [1, 20_000_000, 0, zeros.len() as u32].into_iter().flat_map(u32::to_le_bytes).collect();
    let array = crate::support::vtk_xml::base64(&header) + &crate::support::vtk_xml::base64(&zeros);
    let bomb = format!(
        "<VTKFile type=\"UnstructuredGrid\" compressor=\"vtkZLibDataCompressor\"><Piece><Points>\
         <DataArray type=\"Float64\" NumberOfComponents=\"3\" format=\"binary\">{array}</DataArray></Points></Piece></VTKFile>"
    );
    let error = vtk(bomb.as_bytes()).expect_err("a bomb");
    assert!(matches!(error, MeshError::TooLarge { .. }), "{error}");
}

#[test]
fn ply_is_read_in_every_form_and_dialect() {
    let torus = shapes::torus(0.75, 0.25, 12, 8).expect("a torus");
    for binary in [None, Some(Order::Little), Some(Order::Big)] {
        let read = ply(&write_ply(&torus, binary)).unwrap_or_else(|error| panic!("{binary:?}: {error}"));
        assert_eq!((&read.positions, &read.triangles), (&torus.positions, &torus.triangles), "{binary:?}");
    }
    let text = String::from_utf8(write_ply(&torus, None)).expect("text");
    for (dialect, bytes) in dialects(&text, true) {
        let read = ply(&bytes).unwrap_or_else(|error| panic!("{dialect}: {error}"));
        assert_eq!(read.triangles, torus.triangles, "{dialect}");
    }
    let head = "ply\nformat ascii 1.0\nelement vertex 8\nproperty float32 x\nproperty float32 y\nproperty float32 z\n";
    let points = "-2 -2 0\n2 -2 0\n2 2 0\n-2 2 0\n-2 -2 4\n2 -2 4\n2 2 4\n-2 2 4\n";
    let quads = "4 0 3 2 1\n4 4 5 6 7\n4 0 1 5 4\n4 1 2 6 5\n4 2 3 7 6\n4 3 0 4 7\n";
    let faces = "element face 6\nproperty list uint8 int32 vertex_index\nend_header\n";
    is_box(&ply(format!("{head}{faces}{points}{quads}").as_bytes()).expect("quads"), "quads");
    let strips = "element tristrips 1\nproperty list int int vertex_indices\nend_header\n";
    let strip = "29 0 3 1 2 -1 4 5 7 6 -1 0 1 4 5 -1 1 2 5 6 -1 2 3 6 7 -1 3 0 7 4\n";
    is_box(&ply(format!("{head}{strips}{points}{strip}").as_bytes()).expect("strips"), "strips");
    for (text, part) in [
        (
            format!("{head}{faces}{points}{}", quads.replace("4 0 3 2 1", "4 0 3 2 8")),
            "face 0 refers to vertex 8",
        ),
        (format!("{head}{faces}{points}{}", quads.replace("4 0 3 2 1", "2 0 3")), "face 0"),
        (format!("{head}{faces}{points}{}", quads.replace("4 3 0 4 7\n", "")), "the end of the file"),
        (format!("{head}end_header\n{points}"), "points alone"),
        (format!("{head}{faces}{points}{quads}").replace("float32 z", "float32 w"), "x, y and z"),
        (format!("{head}{faces}{points}{quads}").replace("uint8 int32", "uint8 int31"), "'int31'"),
        (
            format!("{head}{faces}{points}{quads}").replace("vertex 8", "vertex 99999"),
            "declares 99999 vertices",
        ),
        (format!("{head}{faces}{points}{quads}").replace("ascii", "text"), "binary_little_endian"),
        (format!("{head}{faces}{points}{quads}").replace("-2 2 4", "-2 nan 4"), "vertex 7"),
    ] {
        let error = ply(text.as_bytes()).expect_err(part).to_string();
        assert!(error.contains(part), "'{part}' is missing in '{error}'");
    }
}

#[test]
fn gmsh_text_is_read_in_every_dialect_and_version() {
    let written = tet_box(1);
    for text in [common::write_gmsh_2(&written, None), common::write_gmsh_4(&written, None)] {
        let text = String::from_utf8(text).expect("text");
        for (dialect, bytes) in dialects(&text, true) {
            let read = msh(&bytes).unwrap_or_else(|error| panic!("{dialect}: {error}"));
            assert!((read.volume() - written.volume()).abs() < 1e-12, "{dialect}");
        }
    }
    let version_2 = String::from_utf8(common::write_gmsh_2(&written, None)).expect("text");
    for number in ["2", "2.0", "2.1"] {
        assert_eq!(msh(version_2.replacen("2.2", number, 1).as_bytes()).expect(number).tets, written.tets);
    }
    // Version 4.0 has the number of a node before its coordinates, and no smallest and largest number.
    let version_4 = "$MeshFormat\n4.0 0 8\n$EndMeshFormat\n$PhysicalNames\n1\n3 7 \"hard nodule\"\n$EndPhysicalNames\n\
        $Entities\n1 0 0 1\n1 0 0 0 0 0 0 0\n5 0 0 0 1 1 1 1 7 0\n$EndEntities\n\
        $Nodes\n1 4\n5 3 0 4\n1 0 0 0\n2 1 0 0\n3 0 1 0\n4 0 0 1\n$EndNodes\n\
        $Elements\n1 1\n5 3 4 1\n9 1 2 3 4\n$EndElements\n";
    let read = msh(version_4.as_bytes()).expect("version 4.0");
    assert_eq!((read.tets.as_slice(), read.tags.as_slice()), (&[[0, 1, 2, 3]][..], &[7][..]));
    let error = msh(b"$NOD\n1\n").expect_err("version 1").to_string();
    assert!(error.contains("version 1") && error.contains("4.1"), "{error}");
}

#[test]
fn second_order_and_split_elements_of_gmsh_are_read_by_their_corners() {
    let head = "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n10\n1 0 0 0\n2 1 0 0\n3 0 1 0\n4 0 0 1\n5 .5 0 0\n6 .5 .5 0\n\
        7 0 .5 0\n8 0 0 .5\n9 0 .5 .5\n10 .5 0 .5\n$EndNodes\n";
    let text = format!("{head}$Elements\n1\n1 11 2 0 1 1 2 3 4 5 6 7 8 9 10\n$EndElements\n");
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("a.msh");
    std::fs::write(&file, text).expect("a file");
    let Ok(MeshFile::Volume(read)) = read_mesh(&file, &limits()) else { panic!("a volume") };
    assert_eq!(read.volume.tets, [[0, 1, 2, 3]]);
    assert!(read.notes[0].contains("1 elements of higher order"), "{:?}", read.notes);
    // A surface of triangles and quadrilaterals.
    let text = "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n5\n1 0 0 0\n2 1 0 0\n3 1 1 0\n4 0 1 0\n5 .5 .5 1\n$EndNodes\n\
        $Elements\n5\n1 3 0 4 3 2 1\n2 2 0 1 2 5\n3 2 0 2 3 5\n4 2 0 3 4 5\n5 2 0 4 1 5\n$EndElements\n";
    let surface = read_gmsh_surface(Path::new("x"), text.as_bytes(), &limits()).expect("a pyramid");
    assert!((surface.volume() - 1.0 / 3.0).abs() < 1e-12 && validate_surface(&surface).is_closed());
}

/// An L of six corners with a notch at the third one, extruded from z = 0 to 2.
const NOTCH: [[f64; 2]; 6] = [[4., 0.], [4., 2.], [2., 2.], [2., 4.], [0., 4.], [0., 0.]];

#[test]
fn concave_polygons_keep_their_notch_in_every_format() {
    let mut points = String::new();
    for z in [0.0, 2.0] {
        NOTCH.iter().for_each(|[x, y]| points += &format!("{x} {y} {z}\n"));
    }
    let mut polygons: Vec<Vec<u32>> = vec![vec![5, 4, 3, 2, 1, 0], vec![6, 7, 8, 9, 10, 11]];
    polygons.extend((0..6).map(|k| vec![k, (k + 1) % 6, 6 + (k + 1) % 6, 6 + k]));
    // The notch's corner first, second … : a fan from the first corner covers the notch for most of them.
    for turn in 0..6 {
        let mut polygons = polygons.clone();
        polygons[0].rotate_left(turn);
        polygons[1].rotate_left(turn);
        let list = |base: u32, count: bool| {
            let line = |polygon: &Vec<u32>| {
                let numbers = polygon.iter().map(|v| (v + base).to_string()).collect::<Vec<_>>().join(" ");
                if count { format!("{} {numbers}\n", polygon.len()) } else { format!("f {numbers}\n") }
            };
            polygons.iter().map(line).collect::<String>()
        };
        let numbers: usize = polygons.iter().map(|polygon| polygon.len() + 1).sum();
        let as_obj: String =
            points.lines().map(|line| format!("v {line}\n")).collect::<String>() + &list(1, false);
        let as_ply = format!(
            "ply\nformat ascii 1.0\nelement vertex 12\nproperty float x\nproperty float y\nproperty float z\n\
             element face 8\nproperty list uchar int vertex_indices\nend_header\n{points}{}",
            list(0, true)
        );
        let as_vtk = format!(
            "# vtk DataFile Version 3.0\nt\nASCII\nDATASET POLYDATA\nPOINTS 12 float\n{points}POLYGONS 8 {numbers}\n{}",
            list(0, true)
        );
        let as_grid = format!(
            "# vtk DataFile Version 3.0\nt\nASCII\nDATASET UNSTRUCTURED_GRID\nPOINTS 12 float\n{points}CELLS 8 {numbers}\n{}\
             CELL_TYPES 8\n7 7 9 9 9 9 9 9\n",
            list(0, true)
        );
        for (name, read) in [
            ("obj", obj(as_obj.as_bytes())),
            ("ply", ply(as_ply.as_bytes())),
            ("vtk", poly(as_vtk.as_bytes())),
            ("grid", poly(as_grid.as_bytes())),
        ] {
            let surface = read.unwrap_or_else(|error| panic!("{name}, {turn}: {error}"));
            let report = validate_surface(&surface);
            assert!(
                report.is_closed() && report.is_oriented() && report.is_manifold(),
                "{name}, {turn}: {report}"
            );
            assert!((surface.volume() - 24.0).abs() < 1e-9, "{name}, {turn}: {}", surface.volume());
            // A fan's lid would be larger than the L, though its signed volume is the same.
            assert!(
                (surface.area() - (2.0 * 12.0 + 2.0 * 16.0)).abs() < 1e-9,
                "{name}, {turn}: {}",
                surface.area()
            );
        }
    }
    let crossed = obj(b"v 0 0 0\nv 1 1 0\nv 1 0 0\nv 0 1 0\nf 1 2 3 4\n").expect_err("a bow tie").to_string();
    assert!(crossed.contains("line 5") && crossed.contains("crosses itself"), "{crossed}");
}

//! Small valid meshes, and files of every format written from them.
#![allow(dead_code)]

pub mod ply;
pub mod vtk_xml;

use nalgebra::Point3;
use trocar_scene::mesh::{SurfaceData, TetData};
use trocar_scene::{Entity, Registry, Scenario, Store};

/// Two polygons, a strip, a line and a vertex as legacy poly data.
pub const POLY_DATA: &str = "# vtk DataFile Version 5.1\nt\nASCII\nDATASET POLYDATA\nFIELD FieldData 1\n\
    SPACE 1 1 string\nLPS\nPOINTS 6 float\n0 0 0 1 0 0 1 1 0 0 1 0 2 0 0 2 1 0\nVERTICES 2 1\n\
    OFFSETS vtktypeint64\n0 1\nCONNECTIVITY vtktypeint64\n0\nLINES 2 2\nOFFSETS vtktypeint64\n0 2\n\
    CONNECTIVITY vtktypeint64\n0 1\nPOLYGONS 3 7\nOFFSETS vtktypeint32\n0 4 7\nCONNECTIVITY vtktypeint32\n\
    0 1 2 3 1 4 2\nTRIANGLE_STRIPS 2 3\nOFFSETS vtktypeint64\n0 3\nCONNECTIVITY vtktypeint64\n4 5 2\n\
    POINT_DATA 6\nSCALARS a float 1\nLOOKUP_TABLE default\n0 0 0 0 0 0\n";
/// A polygon as poly data in XML.
pub const POLY_DATA_XML: &str = "<?xml version=\"1.0\"?>\n<VTKFile type=\"PolyData\" version=\"0.1\" \
    byte_order=\"LittleEndian\"><PolyData><Piece NumberOfPoints=\"4\" NumberOfPolys=\"1\"><Points>\
    <DataArray type=\"Float32\" NumberOfComponents=\"3\" format=\"ascii\">0 0 0 1 0 0 1 1 0 0 1 0</DataArray></Points>\
    <Polys><DataArray type=\"Int32\" Name=\"connectivity\" format=\"ascii\">0 1 2 3</DataArray>\
    <DataArray type=\"Int32\" Name=\"offsets\" format=\"ascii\">4</DataArray></Polys></Piece></PolyData></VTKFile>\n";

/// Loads a scenario whose one entity has the mesh of a file, from its bytes; `options` follow the file's name. The refusal,
/// if it is refused.
pub fn load_organ(name: &str, bytes: &[u8], options: &str) -> Result<(Store, Entity), String> {
    let registry = Registry::standard();
    let folder = tempfile::tempdir().expect("a folder");
    std::fs::write(folder.path().join(name), bytes).expect("a file");
    let file = folder.path().join("s.toml");
    let text = format!(
        "schema = 1\nname = \"s\"\n[[entity]]\nname = \"organ\"\nmesh = {{ file = \"{name}\"{options} }}\n"
    );
    std::fs::write(&file, text).expect("a file");
    let scenario = Scenario::load(&file, &registry).map_err(|error| error.to_string())?;
    let store = scenario.spawn(&registry).expect("a valid scene");
    let organ = store.view().find("organ").expect("it is there");
    Ok((store, organ))
}

/// A box of `n` cells along each axis, six tetrahedra per cell, all of positive volume.
pub fn tet_box(n: u32) -> TetData {
    let vertex = |i: u32, j: u32, k: u32| (i * (n + 1) + j) * (n + 1) + k;
    let mut volume = TetData::default();
    for i in 0..=n {
        for j in 0..=n {
            for k in 0..=n {
                let at = |x: u32| f64::from(x) / f64::from(n);
                volume.positions.push(Point3::new(at(i), 0.5 * at(j), 0.25 * at(k)));
            }
        }
    }
    let cell = [[0, 4, 6, 7], [0, 6, 2, 7], [0, 2, 3, 7], [0, 3, 1, 7], [0, 1, 5, 7], [0, 5, 4, 7]];
    for i in 0..n {
        for j in 0..n {
            for k in 0..n {
                for tet in cell {
                    volume.tets.push(tet.map(|c| vertex(i + (c >> 2 & 1), j + (c >> 1 & 1), k + (c & 1))));
                    volume.tags.push(if i % 2 == 0 { 7 } else { 9 });
                }
            }
        }
    }
    volume.flip_inverted();
    volume
}

/// Bytes of numbers in either order.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Order {
    Little,
    Big,
}

#[derive(Default)]
struct Bytes(Vec<u8>);

impl Bytes {
    fn text(&mut self, text: &str) -> &mut Self {
        self.0.extend_from_slice(text.as_bytes());
        self
    }
    fn raw<const N: usize>(&mut self, mut little: [u8; N], order: Order) -> &mut Self {
        if order == Order::Big {
            little.reverse();
        }
        self.0.extend_from_slice(&little);
        self
    }
    fn i32(&mut self, x: i32, order: Order) -> &mut Self {
        self.raw(x.to_le_bytes(), order)
    }
    fn i64(&mut self, x: i64, order: Order) -> &mut Self {
        self.raw(x.to_le_bytes(), order)
    }
    fn f64(&mut self, x: f64, order: Order) -> &mut Self {
        self.raw(x.to_le_bytes(), order)
    }
    fn f32(&mut self, x: f32, order: Order) -> &mut Self {
        self.raw(x.to_le_bytes(), order)
    }
}

pub fn write_obj(surface: &SurfaceData) -> Vec<u8> {
    let mut out = String::from("# a comment\no body\n");
    for p in &surface.positions {
        out += &format!("v {} {} {}\n", p.x, p.y, p.z);
    }
    for n in surface.normals.iter().flatten().flatten() {
        out += &format!("vn {} {} {}\n", n.x, n.y, n.z);
    }
    for uv in surface.uvs.iter().flatten().flatten() {
        out += &format!("vt {} {}\n", uv[0], uv[1]);
    }
    for (t, triangle) in surface.triangles.iter().enumerate() {
        out += "f";
        for (k, v) in triangle.iter().enumerate() {
            let attribute = 3 * t + k + 1;
            out += &match (&surface.uvs, &surface.normals) {
                (Some(_), Some(_)) => format!(" {}/{attribute}/{attribute}", v + 1),
                (None, Some(_)) => format!(" {}//{attribute}", v + 1),
                (Some(_), None) => format!(" {}/{attribute}", v + 1),
                (None, None) => format!(" {}", v + 1),
            };
        }
        out += "\n";
    }
    out.into_bytes()
}

pub fn write_stl(surface: &SurfaceData, binary: bool) -> Vec<u8> {
    let mut out = Bytes::default();
    if binary {
        let mut header = [b' '; 80];
        // Exporters do this, and readers that trust it fail.
        header[..12].copy_from_slice(b"solid binary");
        out.0.extend_from_slice(&header);
        out.i32(surface.triangles.len() as i32, Order::Little);
    } else {
        out.text("solid body with a name\n");
    }
    for t in 0..surface.triangles.len() {
        let n = surface.area_vector(t).normalize();
        if binary {
            for x in n.iter() {
                out.f32(*x as f32, Order::Little);
            }
            for x in surface.corners(t).iter().flat_map(|p| p.coords.iter().copied().collect::<Vec<_>>()) {
                out.f32(x as f32, Order::Little);
            }
            out.0.extend_from_slice(&[0, 0]);
        } else {
            out.text(&format!("facet normal {} {} {}\n outer loop\n", n.x, n.y, n.z));
            for p in surface.corners(t) {
                out.text(&format!("  vertex {} {} {}\n", p.x, p.y, p.z));
            }
            out.text(" endloop\nendfacet\n");
        }
    }
    if !binary {
        out.text("endsolid body with a name\n");
    }
    out.0
}

/// JSON and binary buffer of a glTF document: positions, then 32-bit indices.
fn gltf_parts(surface: &SurfaceData, uri: Option<&str>) -> (serde_json::Value, Vec<u8>) {
    let mut buffer = Bytes::default();
    for x in surface.positions.iter().flat_map(|p| [p.x, p.y, p.z]) {
        buffer.f32(x as f32, Order::Little);
    }
    let indices_at = buffer.0.len();
    for v in surface.triangles.iter().flatten() {
        buffer.i32(*v as i32, Order::Little);
    }
    let total = buffer.0.len();
    let mut json = serde_json::json!({
        "asset": { "version": "2.0" },
        "scene": 0,
        "scenes": [{ "nodes": [0] }],
        "nodes": [{ "children": [1], "translation": [1.0, 0.0, 0.0] }, { "mesh": 0, "scale": [2.0, 2.0, 2.0] }],
        "meshes": [{ "primitives": [{ "attributes": { "POSITION": 0 }, "indices": 1 }] }],
        "buffers": [{ "byteLength": total }],
        "bufferViews": [
            { "buffer": 0, "byteOffset": 0, "byteLength": indices_at },
            { "buffer": 0, "byteOffset": indices_at, "byteLength": total - indices_at },
        ],
        "accessors": [
            { "bufferView": 0, "componentType": 5126, "count": surface.positions.len(), "type": "VEC3",
              "min": [0, 0, 0], "max": [0, 0, 0] },
            { "bufferView": 1, "componentType": 5125, "count": 3 * surface.triangles.len(), "type": "SCALAR" },
        ],
    });
    if let Some(uri) = uri {
        json["buffers"][0]["uri"] = uri.into();
    }
    (json, buffer.0)
}

/// A document whose buffer is a data URI. Its nodes scale by 2 and move by 1 along x.
pub fn write_gltf_embedded(surface: &SurfaceData) -> Vec<u8> {
    let (_, buffer) = gltf_parts(surface, None);
    let uri = format!("data:application/octet-stream;base64,{}", base64(&buffer));
    gltf_parts(surface, Some(&uri)).0.to_string().into_bytes()
}

/// A document and its buffer, to be stored under `uri`.
pub fn write_gltf_external(surface: &SurfaceData, uri: &str) -> (Vec<u8>, Vec<u8>) {
    let (json, buffer) = gltf_parts(surface, Some(uri));
    (json.to_string().into_bytes(), buffer)
}

pub fn write_glb(surface: &SurfaceData) -> Vec<u8> {
    let (json, buffer) = gltf_parts(surface, None);
    let mut json = json.to_string().into_bytes();
    json.resize(json.len().next_multiple_of(4), b' ');
    let mut out = Bytes::default();
    out.text("glTF").i32(2, Order::Little).i32((28 + json.len() + buffer.len()) as i32, Order::Little);
    out.i32(json.len() as i32, Order::Little).text("JSON");
    out.0.extend_from_slice(&json);
    out.i32(buffer.len() as i32, Order::Little).text("BIN\0");
    out.0.extend_from_slice(&buffer);
    out.0
}

fn base64(bytes: &[u8]) -> String {
    const ALPHABET: &[u8] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut out = String::new();
    for chunk in bytes.chunks(3) {
        let bits = chunk.iter().fold(0u32, |bits, b| bits << 8 | u32::from(*b)) << (8 * (3 - chunk.len()));
        for k in 0..4 {
            let symbol = ALPHABET[(bits >> (18 - 6 * k) & 63) as usize] as char;
            out.push(if k <= chunk.len() { symbol } else { '=' });
        }
    }
    out
}

/// Gmsh 2.2; node numbers have gaps, a triangle and a point stand between the tetrahedra.
pub fn write_gmsh_2(volume: &TetData, binary: Option<Order>) -> Vec<u8> {
    let number = |v: u32| 10 + 3 * v as i32;
    let mut out = Bytes::default();
    let extra = 2;
    let total = volume.tets.len() + extra;
    let Some(order) = binary else {
        out.text(
            "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$PhysicalNames\n1\n3 7 \"liver\"\n$EndPhysicalNames\n",
        );
        out.text(&format!("$Nodes\n{}\n", volume.positions.len()));
        for (v, p) in volume.positions.iter().enumerate() {
            out.text(&format!("{} {} {} {}\n", number(v as u32), p.x, p.y, p.z));
        }
        out.text(&format!("$EndNodes\n$Elements\n{total}\n1 15 2 0 1 {}\n", number(0)));
        out.text(&format!("2 2 2 3 1 {} {} {}\n", number(0), number(1), number(2)));
        for (t, tet) in volume.tets.iter().enumerate() {
            let [a, b, c, d] = tet.map(number);
            out.text(&format!("{} 4 2 {} 1 {a} {b} {c} {d}\n", t + 3, volume.tags[t]));
        }
        out.text("$EndElements\n");
        return out.0;
    };
    out.text("$MeshFormat\n2.2 1 8\n").i32(1, order).text("\n$EndMeshFormat\n");
    out.text(&format!("$Nodes\n{}\n", volume.positions.len()));
    for (v, p) in volume.positions.iter().enumerate() {
        out.i32(number(v as u32), order).f64(p.x, order).f64(p.y, order).f64(p.z, order);
    }
    out.text(&format!("\n$EndNodes\n$Elements\n{total}\n"));
    out.i32(15, order)
        .i32(1, order)
        .i32(2, order)
        .i32(1, order)
        .i32(0, order)
        .i32(1, order)
        .i32(number(0), order);
    out.i32(2, order).i32(1, order).i32(2, order).i32(2, order).i32(3, order).i32(1, order);
    out.i32(number(0), order).i32(number(1), order).i32(number(2), order);
    out.i32(4, order).i32(volume.tets.len() as i32, order).i32(2, order);
    for (t, tet) in volume.tets.iter().enumerate() {
        out.i32(t as i32 + 3, order).i32(volume.tags[t], order).i32(1, order);
        for v in tet {
            out.i32(number(*v), order);
        }
    }
    out.text("\n$EndElements\n");
    out.0
}

/// One number of a Gmsh 4.1 section, or the end of a line.
#[derive(Clone, Copy)]
enum Word {
    Int(i32),
    Size(i64),
    Double(f64),
    End,
}
use Word::{Double, End, Int, Size};

fn section(out: &mut Bytes, name: &str, binary: Option<Order>, words: &[Word]) {
    out.text(&format!("${name}\n"));
    for word in words {
        match (binary, *word) {
            (Some(order), Int(x)) => out.i32(x, order),
            (Some(order), Size(x)) => out.i64(x, order),
            (Some(order), Double(x)) => out.f64(x, order),
            (Some(_), End) => out,
            (None, Int(x)) => out.text(&format!("{x} ")),
            (None, Size(x)) => out.text(&format!("{x} ")),
            (None, Double(x)) => out.text(&format!("{x} ")),
            (None, End) => out.text("\n"),
        };
    }
    out.text(&format!("\n$End{name}\n"));
}

/// Gmsh 4.1 with one volume entity per tag, whose physical group is the tag; one block of nodes is parametric.
/// Tetrahedra come out grouped by tag.
pub fn write_gmsh_4(volume: &TetData, binary: Option<Order>) -> Vec<u8> {
    let number = |v: u32| 10 + 3 * i64::from(v);
    let mut tags = volume.tags.clone();
    tags.sort_unstable();
    tags.dedup();
    let mut out = Bytes::default();
    match binary {
        None => out.text("$MeshFormat\n4.1 0 8\n$EndMeshFormat\n"),
        Some(order) => out.text("$MeshFormat\n4.1 1 8\n").i32(1, order).text("\n$EndMeshFormat\n"),
    };
    out.text("$Comments\nnothing that matters\n$EndComments\n");

    let mut words = vec![Size(1), Size(0), Size(0), Size(tags.len() as i64), End];
    words.extend([Int(1), Double(0.0), Double(0.0), Double(0.0), Size(0), End]);
    for (k, tag) in tags.iter().enumerate() {
        words.extend([Int(k as i32 + 1), Double(0.0), Double(0.0), Double(0.0), Double(1.0), Double(1.0)]);
        words.extend([Double(1.0), Size(1), Int(*tag), Size(0), End]);
    }
    section(&mut out, "Entities", binary, &words);

    let count = volume.positions.len();
    let mut words = vec![Size(2), Size(count as i64), Size(10), Size(number(count as u32 - 1)), End];
    for (dimension, parametric, range) in [(1, 1, 0..1), (3, 0, 1..count)] {
        words.extend([Int(dimension), Int(1), Int(parametric), Size(range.len() as i64), End]);
        words.extend(range.clone().flat_map(|v| [Size(number(v as u32)), End]));
        for p in &volume.positions[range] {
            words.extend([Double(p.x), Double(p.y), Double(p.z)]);
            words.extend((parametric == 1).then_some(Double(0.5)));
            words.push(End);
        }
    }
    section(&mut out, "Nodes", binary, &words);

    let total = volume.tets.len() as i64 + 1;
    let mut words = vec![Size(1 + tags.len() as i64), Size(total), Size(1), Size(total), End];
    words.extend([Int(2), Int(1), Int(2), Size(1), End, Size(1)]);
    words.extend([0, 1, 2].map(|v| Size(number(v))));
    words.push(End);
    for (k, tag) in tags.iter().enumerate() {
        let of_tag: Vec<usize> = (0..volume.tets.len()).filter(|t| volume.tags[*t] == *tag).collect();
        words.extend([Int(3), Int(k as i32 + 1), Int(4), Size(of_tag.len() as i64), End]);
        for t in of_tag {
            words.push(Size(t as i64 + 2));
            words.extend(volume.tets[t].map(|v| Size(number(v))));
            words.push(End);
        }
    }
    section(&mut out, "Elements", binary, &words);
    out.0
}

/// Legacy VTK: version 3 (cells with counts) or 5 (offsets and connectivity), with a triangle among the cells and
/// a field, metadata and cell data around the geometry.
pub fn write_vtk(volume: &TetData, binary: bool, version: u32) -> Vec<u8> {
    let big = Order::Big;
    let mut out = Bytes::default();
    let kind = if binary { "BINARY" } else { "ASCII" };
    out.text(&format!("# vtk DataFile Version {version}.1\na title\n{kind}\nDATASET UNSTRUCTURED_GRID\n"));
    out.text("FIELD FieldData 1\nTime 1 2 double\n");
    let point_type = if binary { "float" } else { "double" };
    if binary {
        out.f64(1.5, big).f64(2.5, big).text("\n");
    } else {
        out.text("1.5 2.5\n");
    }
    out.text(&format!("POINTS {} {point_type}\n", volume.positions.len()));
    for x in volume.positions.iter().flat_map(|p| [p.x, p.y, p.z]) {
        if binary {
            out.f32(x as f32, big);
        } else {
            out.text(&format!("{x} "));
        }
    }
    out.text("\nMETADATA\nINFORMATION 0\n\n");
    let mut cells: Vec<Vec<u32>> = vec![vec![0, 1, 2]];
    cells.extend(volume.tets.iter().map(|tet| tet.to_vec()));
    let corners: usize = cells.iter().map(Vec::len).sum();
    let integer = |out: &mut Bytes, x: usize, wide: bool| {
        match (binary, wide) {
            (false, _) => out.text(&format!("{x} ")),
            (true, false) => out.i32(x as i32, big),
            (true, true) => out.i64(x as i64, big),
        };
    };
    if version < 5 {
        out.text(&format!("CELLS {} {}\n", cells.len(), corners + cells.len()));
        for cell in &cells {
            integer(&mut out, cell.len(), false);
            cell.iter().for_each(|v| integer(&mut out, *v as usize, false));
        }
    } else {
        out.text(&format!("CELLS {} {corners}\nOFFSETS vtktypeint64\n", cells.len() + 1));
        let mut offset = 0;
        integer(&mut out, 0, true);
        for cell in &cells {
            offset += cell.len();
            integer(&mut out, offset, true);
        }
        out.text("\nCONNECTIVITY vtktypeint64\n");
        cells.iter().flatten().for_each(|v| integer(&mut out, *v as usize, true));
    }
    out.text(&format!("\nCELL_TYPES {}\n", cells.len()));
    cells.iter().for_each(|cell| integer(&mut out, if cell.len() == 3 { 5 } else { 10 }, false));
    out.text(&format!("\nCELL_DATA {}\nSCALARS region int 1\nLOOKUP_TABLE default\n", cells.len()));
    integer(&mut out, 0, false);
    volume.tags.iter().for_each(|&tag| integer(&mut out, tag as usize, false));
    out.text("\n");
    out.0
}

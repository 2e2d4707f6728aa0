//! glTF 2.0 surfaces, as text with buffers beside it or as one binary file (Khronos Group, "glTF 2.0
//! Specification").
//!
//! The JSON is decoded by the `gltf` crate; indices, buffers and accessors are followed here with every access
//! checked, because that crate trusts files that have not been validated, and its validation indexes out of
//! bounds on some invalid ones. All triangle meshes of the default scene become one surface in the scene's
//! frame (glTF: y up, metres). External buffers must lie below the file's folder. Morph targets, skins and
//! materials are skipped; required extensions are refused.

mod buffer;

use std::path::Path;

use ::gltf::json;
use json::mesh::{Mode, Semantic};
use json::validation::Checked;
use nalgebra::{Matrix3, Matrix4, Point3, Quaternion, UnitQuaternion, Vector3};

use crate::mesh::cursor::{Cursor, LazyPosition};
use crate::mesh::data::SurfaceData;
use crate::mesh::error::{FilePosition, MeshError};
use crate::mesh::limits::Limits;
use buffer::Buffers;

/// Deepest tree of nodes.
const DEPTH_MAX: usize = 64;
/// Largest number of visits to nodes: a node reached twice is an error in glTF, and must not cause an endless loop.
const NODES_MAX: usize = 65_536;

/// Reads a glTF or GLB surface. External buffers are searched below the folder of `file`.
///
/// # Errors
/// Names the part of the document and the reason.
pub fn read_gltf(file: &Path, bytes: &[u8], limits: &Limits) -> Result<SurfaceData, MeshError> {
    let cursor = Cursor::new(file, bytes, limits);
    let (document, blob) = split_glb(&cursor, bytes)?;
    let root: json::Root = json::deserialize::from_slice(document).map_err(|error| {
        let place = if blob.is_none() { FilePosition::Line(error.line()) } else { FilePosition::Whole };
        cursor.malformed(LazyPosition::Known(place), format!("not a glTF document: {error}"))
    })?;
    let fail = |reason: String| cursor.malformed(LazyPosition::Known(FilePosition::Whole), reason);
    if root.asset.version.split('.').next() != Some("2") {
        let what = format!("glTF version '{}'", root.asset.version.escape_default());
        return Err(cursor.unsupported(LazyPosition::Known(FilePosition::Whole), what, "2.0"));
    }
    if let Some(extension) = root.extensions_required.first() {
        let what = format!("required extension '{}'", extension.escape_default());
        return Err(cursor.unsupported(
            LazyPosition::Known(FilePosition::Whole),
            what,
            "documents without required extensions",
        ));
    }
    let mut walk = Walk {
        root: &root,
        buffers: Buffers::open(&cursor, &root, blob)?,
        cursor: &cursor,
        surface: SurfaceData::default(),
        visits: 0,
        decoded: 0,
    };
    if root.scenes.is_empty() {
        for mesh in 0..root.meshes.len() {
            walk.mesh(mesh, &Matrix4::identity())?;
        }
    } else {
        let scene = root.scene.map_or(0, |index| index.value());
        let scene = root.scenes.get(scene).ok_or_else(|| fail(format!("there is no scene {scene}")))?;
        for node in &scene.nodes {
            walk.node(node.value(), &Matrix4::identity(), 0)?;
        }
    }
    let mut surface = walk.surface;
    if surface.triangles.is_empty() {
        return Err(fail("there is no triangle in the document's scene".into()));
    }
    surface.weld_identical();
    Ok(surface)
}

/// The JSON and the binary chunk of a GLB file; the whole file when it is not one.
fn split_glb<'a>(cursor: &Cursor<'a>, bytes: &'a [u8]) -> Result<(&'a [u8], Option<&'a [u8]>), MeshError> {
    use crate::mesh::cursor::Order::Little;
    if !bytes.starts_with(b"glTF") {
        let text = Cursor::of_text(cursor.file, bytes, cursor.limits)?;
        return Ok((text.remaining(), None));
    }
    let mut cursor = cursor.clone();
    cursor.take(4, "the magic number")?;
    let place = cursor.byte();
    let version = cursor.u32(Little, "the version")?;
    if version != 2 {
        return Err(cursor.unsupported(place, format!("GLB version {version}"), "2"));
    }
    let place = cursor.byte();
    let length = cursor.u32(Little, "the length")?;
    if length as usize != bytes.len() {
        let reason = format!("the header declares {length} bytes, but the file has {}", bytes.len());
        return Err(cursor.malformed(place, reason));
    }
    let mut chunk = |expected: &[u8; 4]| -> Result<&'a [u8], MeshError> {
        let place = cursor.byte();
        let length = cursor.u32(Little, "the length of a chunk")?;
        let kind = cursor.take(4, "the type of a chunk")?;
        if kind != expected {
            let reason = format!("chunk {} is expected", String::from_utf8_lossy(expected).escape_default());
            return Err(cursor.malformed(place, reason));
        }
        cursor.take(length as usize, "a chunk")
    };
    let document = chunk(b"JSON")?;
    // 12 bytes of header and 8 of the chunk's own.
    let blob = if 20 + document.len() < bytes.len() { chunk(b"BIN\0")? } else { &[] };
    Ok((document, Some(blob)))
}

struct Walk<'a> {
    root: &'a json::Root,
    buffers: Buffers<'a>,
    cursor: &'a Cursor<'a>,
    surface: SurfaceData,
    visits: usize,
    /// Vertices decoded so far, kept or not: many nodes may refer to one mesh.
    decoded: u64,
}

impl Walk<'_> {
    fn fail(&self, reason: String) -> MeshError {
        self.cursor.malformed(LazyPosition::Known(FilePosition::Whole), reason)
    }

    fn node(
        &mut self,
        index: usize,
        world_from_parent: &Matrix4<f64>,
        depth: usize,
    ) -> Result<(), MeshError> {
        let root = self.root;
        let node = root.nodes.get(index).ok_or_else(|| self.fail(format!("there is no node {index}")))?;
        self.visits += 1;
        if depth > DEPTH_MAX || self.visits > NODES_MAX {
            let reason =
                format!("the nodes form a cycle, are deeper than {DEPTH_MAX} or more than {NODES_MAX}");
            return Err(self.fail(reason));
        }
        let world_from_node = world_from_parent * local_transform(node);
        if !world_from_node.iter().all(|x| x.is_finite()) {
            return Err(self.fail(format!("node {index} has a transform that is not finite")));
        }
        if let Some(mesh) = node.mesh {
            self.mesh(mesh.value(), &world_from_node)?;
        }
        node.children
            .iter()
            .flatten()
            .try_for_each(|child| self.node(child.value(), &world_from_node, depth + 1))
    }

    fn mesh(&mut self, index: usize, transform: &Matrix4<f64>) -> Result<(), MeshError> {
        let root = self.root;
        let mesh = root.meshes.get(index).ok_or_else(|| self.fail(format!("there is no mesh {index}")))?;
        for (k, primitive) in mesh.primitives.iter().enumerate() {
            let part = self.primitive(primitive, &format!("mesh {index}, primitive {k}"), transform)?;
            let limits = self.cursor.limits;
            let whole = LazyPosition::Known(FilePosition::Whole);
            self.decoded += part.positions.len() as u64;
            if self.decoded > limits.vertices {
                return Err(self.cursor.too_large(whole, "vertices", self.decoded, limits.vertices));
            }
            let triangles = (self.surface.triangles.len() + part.triangles.len()) as u64;
            if triangles > limits.elements {
                return Err(self.cursor.too_large(whole, "triangles", triangles, limits.elements));
            }
            if !part.triangles.is_empty() {
                self.surface.append(&part);
            }
        }
        Ok(())
    }

    fn primitive(
        &self,
        primitive: &json::mesh::Primitive,
        name: &str,
        transform: &Matrix4<f64>,
    ) -> Result<SurfaceData, MeshError> {
        let Checked::Valid(mode) = primitive.mode else {
            return Err(self.fail(format!("{name} has an invalid mode")));
        };
        if matches!(mode, Mode::Points | Mode::Lines | Mode::LineLoop | Mode::LineStrip) {
            return Ok(SurfaceData::default());
        }
        let attribute = |semantic| primitive.attributes.get(&Checked::Valid(semantic)).map(|a| a.value());
        let position =
            attribute(Semantic::Positions).ok_or_else(|| self.fail(format!("{name} has no POSITION")))?;
        let positions: Vec<[f64; 3]> = self.buffers.vectors(self.cursor, self.root, position, "vertex")?;
        let indices = match primitive.indices {
            Some(accessor) => self.buffers.indices(self.cursor, self.root, accessor.value())?,
            None => (0..positions.len() as u32).collect(),
        };
        if let Some(k) = indices.iter().position(|&v| v as usize >= positions.len()) {
            let (vertex, count) = (i64::from(indices[k]), positions.len());
            return Err(self.cursor.out_of_range(
                LazyPosition::Known(FilePosition::Whole),
                "triangle",
                k / 3,
                vertex,
                count,
            ));
        }
        let mirrored = transform.fixed_view::<3, 3>(0, 0).determinant() < 0.0;
        let triangles = triangles(mode, &indices, mirrored);
        let normals = match attribute(Semantic::Normals) {
            Some(accessor) => {
                let normals: Vec<[f64; 3]> =
                    self.buffers.vectors(self.cursor, self.root, accessor, "normal")?;
                corner_normals(&triangles, &normals, positions.len(), transform)
            }
            None => None,
        };
        let uvs = match attribute(Semantic::TexCoords(0)) {
            Some(accessor) => {
                let uvs: Vec<[f64; 2]> =
                    self.buffers.vectors(self.cursor, self.root, accessor, "texture coordinate")?;
                (uvs.len() == positions.len())
                    .then(|| triangles.iter().map(|t| t.map(|v| uvs[v as usize])).collect())
            }
            None => None,
        };
        let positions: Vec<Point3<f64>> =
            positions.iter().map(|p| transform.transform_point(&Point3::from(*p))).collect();
        if let Some(index) = positions.iter().position(|p| !p.coords.iter().all(|x| x.is_finite())) {
            let (at, coords) = (LazyPosition::Known(FilePosition::Whole), positions[index].coords);
            self.cursor.finite(at, "vertex", index, coords.as_slice())?;
        }
        Ok(SurfaceData { positions, triangles, normals, uvs })
    }
}

fn local_transform(node: &json::Node) -> Matrix4<f64> {
    if let Some(matrix) = node.matrix {
        return Matrix4::from_column_slice(&matrix.map(f64::from));
    }
    let translation = Vector3::from(node.translation.unwrap_or([0.0; 3]).map(f64::from));
    let scale = Vector3::from(node.scale.unwrap_or([1.0; 3]).map(f64::from));
    let [x, y, z, w] = node.rotation.unwrap_or_default().0.map(f64::from);
    let rotation = UnitQuaternion::try_new(Quaternion::new(w, x, y, z), 0.0).unwrap_or_default();
    Matrix4::new_translation(&translation)
        * rotation.to_homogeneous()
        * Matrix4::new_nonuniform_scaling(&scale)
}

/// Triangles of a list, a strip or a fan; reversed when the transform mirrors.
fn triangles(mode: Mode, indices: &[u32], mirrored: bool) -> Vec<[u32; 3]> {
    let turn = |[a, b, c]: [u32; 3], odd: bool| if odd != mirrored { [b, a, c] } else { [a, b, c] };
    match mode {
        Mode::TriangleStrip => {
            let windows = indices.windows(3).enumerate();
            windows.map(|(k, w)| turn([w[0], w[1], w[2]], k % 2 == 1)).collect()
        }
        Mode::TriangleFan => {
            let first = indices.first().copied().unwrap_or(0);
            indices.get(1..).unwrap_or(&[]).windows(2).map(|w| turn([first, w[0], w[1]], false)).collect()
        }
        _ => indices.chunks_exact(3).map(|t| turn([t[0], t[1], t[2]], false)).collect(),
    }
}

/// Normals turn with the inverse transpose; none are kept if any of them is missing or has no direction.
fn corner_normals(
    triangles: &[[u32; 3]],
    normals: &[[f64; 3]],
    vertices: usize,
    transform: &Matrix4<f64>,
) -> Option<Vec<[Vector3<f64>; 3]>> {
    if normals.len() != vertices {
        return None;
    }
    let linear: Matrix3<f64> = transform.fixed_view::<3, 3>(0, 0).into_owned();
    let inverse_transpose = linear.try_inverse()?.transpose();
    let corner = |v: u32| (inverse_transpose * Vector3::from(normals[v as usize])).try_normalize(0.0);
    triangles.iter().map(|&[a, b, c]| Some([corner(a)?, corner(b)?, corner(c)?])).collect()
}

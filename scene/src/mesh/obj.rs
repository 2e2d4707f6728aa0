//! Wavefront OBJ surfaces and lines (B. Martin, "Object Files (.obj)", Wavefront Technologies 1995: the polygonal part).
//!
//! Physics needs properties that graphics loaders discard, hence our own parser: vertices in the order of the file and
//! shared across groups (duplicated vertices would tear the surface), double precision, and line numbers in errors.
//! Polygons become fans. Points, groups, materials and smoothing groups are skipped, and so are polylines (`l`) when
//! reading surfaces; free-form curves and surfaces are refused.

use std::path::Path;

use nalgebra::{Point3, Vector3};

use super::cursor::{Cursor, LazyPosition, quoted};
use super::data::{LineData, SurfaceData};
use super::error::{FilePosition, MeshError};
use super::limits::Limits;

/// Largest number of corners of one polygon.
const CORNERS_MAX: usize = 4096;

const SUPPORTED: &str = "polygonal elements (v, vt, vn, f; p, l, g, o, s, mtllib and usemtl are skipped)";

#[derive(Clone, Copy)]
struct Corner {
    vertex: u32,
    uv: Option<u32>,
    normal: Option<u32>,
}

#[derive(Default)]
struct Parsed {
    positions: Vec<Point3<f64>>,
    uvs: Vec<[f64; 2]>,
    normals: Vec<Vector3<f64>>,
    triangles: Vec<[Corner; 3]>,
    /// Pieces of polylines.
    segments: Vec<[u32; 2]>,
}

/// Reads an OBJ surface. `file` is for messages only.
///
/// Normals (and texture coordinates) survive when every corner of every face has one.
///
/// # Errors
/// Names the line and the reason.
pub fn read_obj(file: &Path, bytes: &[u8], limits: &Limits) -> Result<SurfaceData, MeshError> {
    let mut cursor = Cursor::new(file, bytes, limits);
    let parsed = parse(&mut cursor, limits, false)?;
    if parsed.triangles.is_empty() {
        return Err(
            cursor.malformed(LazyPosition::Known(FilePosition::Whole), "there is no face in the file")
        );
    }
    Ok(parsed.into_surface())
}

/// Reads the polylines (`l`) of an OBJ file; its faces are skipped. `file` is for messages only.
///
/// # Errors
/// Names the line and the reason.
pub fn read_obj_line(file: &Path, bytes: &[u8], limits: &Limits) -> Result<LineData, MeshError> {
    let mut cursor = Cursor::new(file, bytes, limits);
    let parsed = parse(&mut cursor, limits, true)?;
    if parsed.segments.is_empty() {
        return Err(cursor
            .malformed(LazyPosition::Known(FilePosition::Whole), "there is no polyline ('l') in the file"));
    }
    Ok(LineData { positions: parsed.positions, segments: parsed.segments })
}

fn parse(cursor: &mut Cursor, limits: &Limits, lines: bool) -> Result<Parsed, MeshError> {
    let mut parsed = Parsed::default();
    let mut number = 0;
    let mut polygon = Vec::new();
    while let Some(line) = cursor.next_line() {
        number += 1;
        let place = LazyPosition::Known(FilePosition::Line(number));
        let line = &line[..line.iter().position(|&b| b == b'#').unwrap_or(line.len())];
        if line.ends_with(b"\\") {
            return Err(cursor.unsupported(place, "a line continued by a backslash", "one element per line"));
        }
        let mut words = line.split(u8::is_ascii_whitespace).filter(|word| !word.is_empty());
        match words.next() {
            None => {}
            Some(b"v") => {
                limit(cursor, place, "vertices", parsed.positions.len(), limits.vertices)?;
                let [x, y, z] = numbers(cursor, place, "vertex", parsed.positions.len(), &mut words)?;
                parsed.positions.push(Point3::new(x, y, z));
            }
            Some(b"vt") => {
                limit(
                    cursor,
                    place,
                    "texture coordinates",
                    parsed.uvs.len(),
                    limits.elements.saturating_mul(3),
                )?;
                let [u, v] = texture_coordinate(cursor, place, parsed.uvs.len(), words)?;
                parsed.uvs.push([u, v]);
            }
            Some(b"vn") => {
                limit(cursor, place, "normals", parsed.normals.len(), limits.elements.saturating_mul(3))?;
                let [x, y, z] = numbers(cursor, place, "normal", parsed.normals.len(), &mut words)?;
                parsed.normals.push(Vector3::new(x, y, z));
            }
            Some(b"l") if lines => {
                let mut last = None;
                for word in words {
                    let next = corner(cursor, place, word, &parsed)?.vertex;
                    if let Some(last) = last.replace(next) {
                        limit(cursor, place, "segments", parsed.segments.len(), limits.elements)?;
                        if last == next {
                            let reason = format!("a polyline goes from vertex {} to itself", last + 1);
                            return Err(cursor.malformed(place, reason));
                        }
                        parsed.segments.push([last, next]);
                    }
                }
            }
            Some(b"f") if lines => {}
            Some(b"f") => {
                polygon.clear();
                for word in words {
                    if polygon.len() == CORNERS_MAX {
                        let reason = format!("a face has more than {CORNERS_MAX} corners");
                        return Err(cursor.malformed(place, reason));
                    }
                    polygon.push(corner(cursor, place, word, &parsed)?);
                }
                if polygon.len() < 3 {
                    let reason = format!("a face needs at least 3 corners, this one has {}", polygon.len());
                    return Err(cursor.malformed(place, reason));
                }
                limit(cursor, place, "triangles", parsed.triangles.len() + polygon.len(), limits.elements)?;
                let fan = (2..polygon.len()).map(|k| [polygon[0], polygon[k - 1], polygon[k]]);
                parsed.triangles.extend(fan);
            }
            Some(
                b"p" | b"l" | b"g" | b"o" | b"s" | b"mtllib" | b"usemtl" | b"usemap" | b"maplib" | b"mg"
                | b"lod" | b"bevel" | b"c_interp" | b"d_interp" | b"shadow_obj" | b"trace_obj",
            ) => {}
            Some(other) => {
                return Err(cursor.unsupported(place, format!("element {}", quoted(other)), SUPPORTED));
            }
        }
    }
    Ok(parsed)
}

fn limit(
    cursor: &Cursor,
    place: LazyPosition,
    what: &'static str,
    count: usize,
    limit: u64,
) -> Result<(), MeshError> {
    if (count as u64) < limit {
        return Ok(());
    }
    Err(cursor.too_large(place, what, count as u64 + 1, limit))
}

fn number(cursor: &Cursor, place: LazyPosition, what: &str, word: Option<&[u8]>) -> Result<f64, MeshError> {
    let word = word.ok_or_else(|| cursor.malformed(place, format!("{what} has too few numbers")))?;
    std::str::from_utf8(word)
        .ok()
        .and_then(|text| text.parse().ok())
        .ok_or_else(|| cursor.malformed(place, format!("{what}: {} is not a number", quoted(word))))
}

fn numbers<'a, const N: usize>(
    cursor: &Cursor,
    place: LazyPosition,
    what: &'static str,
    index: usize,
    words: &mut impl Iterator<Item = &'a [u8]>,
) -> Result<[f64; N], MeshError> {
    let mut values = [0.0; N];
    for value in &mut values {
        *value = number(cursor, place, what, words.next())?;
    }
    cursor.finite(place, what, index, &values)?;
    Ok(values)
}

/// One to three numbers; a missing v is 0 and the third is for volume textures.
fn texture_coordinate<'a>(
    cursor: &Cursor,
    place: LazyPosition,
    index: usize,
    mut words: impl Iterator<Item = &'a [u8]>,
) -> Result<[f64; 2], MeshError> {
    let what = "texture coordinate";
    let u = number(cursor, place, what, words.next())?;
    let v = words.next().map_or(Ok(0.0), |word| number(cursor, place, what, Some(word)))?;
    cursor.finite(place, what, index, &[u, v])?;
    Ok([u, v])
}

/// `v`, `v/vt`, `v//vn` or `v/vt/vn`; negative numbers count back from the latest element.
fn corner(cursor: &Cursor, place: LazyPosition, word: &[u8], parsed: &Parsed) -> Result<Corner, MeshError> {
    let bad = || {
        let reason = format!("corner {} is not v, v/vt, v//vn or v/vt/vn", quoted(word));
        cursor.malformed(place, reason)
    };
    let index = |text: &[u8], have: usize| -> Result<u32, MeshError> {
        let written: i64 =
            std::str::from_utf8(text).ok().and_then(|text| text.parse().ok()).ok_or_else(bad)?;
        let resolved = if written > 0 { written - 1 } else { written.saturating_add(have as i64) };
        // 0 is not a valid index: it would resolve to one past the end.
        if resolved < 0 || resolved >= have as i64 {
            let triangle = parsed.triangles.len();
            return Err(cursor.out_of_range(place, "face with triangle", triangle, written, have));
        }
        Ok(resolved as u32)
    };
    let mut parts = word.split(|&b| b == b'/');
    let vertex = index(parts.next().unwrap_or_default(), parsed.positions.len())?;
    let uv = match parts.next() {
        None | Some(b"") => None,
        Some(text) => Some(index(text, parsed.uvs.len())?),
    };
    let normal = parts.next().map(|text| index(text, parsed.normals.len())).transpose()?;
    if parts.next().is_some() {
        return Err(bad());
    }
    Ok(Corner { vertex, uv, normal })
}

impl Parsed {
    fn into_surface(self) -> SurfaceData {
        let triangles = self.triangles.iter().map(|t| t.map(|corner| corner.vertex)).collect();
        let normals = self.corners(|corner| {
            let normal = self.normals[corner.normal? as usize];
            normal.try_normalize(0.0)
        });
        let uvs = self.corners(|corner| Some(self.uvs[corner.uv? as usize]));
        SurfaceData { positions: self.positions, triangles, normals, uvs }
    }

    fn corners<T>(&self, attribute: impl Fn(&Corner) -> Option<T>) -> Option<Vec<[T; 3]>> {
        self.triangles.iter().map(|[a, b, c]| Some([attribute(a)?, attribute(b)?, attribute(c)?])).collect()
    }
}

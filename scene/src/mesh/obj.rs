//! Wavefront OBJ surfaces and lines (B. Martin, "Object Files (.obj)", Wavefront Technologies 1995: the polygonal part).
//!
//! Physics needs properties that graphics loaders discard, hence our own parser: vertices in the order of the file and
//! shared across groups (duplicated vertices would tear the surface), double precision, and line numbers in errors.
//! Polygons are triangulated as polygons, so that concave ones keep their notches. A line may be continued by a
//! backslash, keywords may have any capitals, faces may stand before their vertices. What follows a vertex's coordinates
//! (a weight, a colour) is skipped, and so are points, groups, materials and smoothing groups, and polylines (`l`) when
//! reading surfaces; free-form curves and surfaces are refused.

use std::borrow::Cow;
use std::path::Path;

use nalgebra::{Point3, Vector3};

use super::cursor::{Cursor, LazyPosition, quoted};
use super::data::{LineData, SurfaceData};
use super::error::{FilePosition, MeshError};
use super::file::SurfaceFile;
use super::limits::Limits;
use super::polygon_face::{CORNERS_MAX, triangles_of};

const SUPPORTED: &str = "polygonal elements (v, vt, vn, f; p, l, g, o, s, mtllib and usemtl are skipped)";

/// A corner of a face or polyline; its numbers may refer to what stands further down.
#[derive(Clone, Copy)]
struct Corner {
    vertex: u32,
    uv: Option<u32>,
    normal: Option<u32>,
}

/// A face or polyline: the line that it stands in, and its corners in the list of all.
struct Element {
    line: usize,
    corners: std::ops::Range<usize>,
}

#[derive(Default)]
struct Parsed {
    positions: Vec<Point3<f64>>,
    uvs: Vec<[f64; 2]>,
    normals: Vec<Vector3<f64>>,
    corners: Vec<Corner>,
    elements: Vec<Element>,
}

/// Reads an OBJ surface. `file` is for messages only.
///
/// Normals (and texture coordinates) survive when every corner of every face has one.
///
/// # Errors
/// Names the line and the reason.
pub fn read_obj(file: &Path, bytes: &[u8], limits: &Limits) -> Result<SurfaceData, MeshError> {
    read_obj_file(file, bytes, limits).map(|read| read.surface)
}

/// Like [`read_obj`], with the line of each triangle.
pub(super) fn read_obj_file(file: &Path, bytes: &[u8], limits: &Limits) -> Result<SurfaceFile, MeshError> {
    let mut cursor = Cursor::of_text(file, bytes, limits)?;
    let parsed = parse(&mut cursor, limits, false)?;
    if parsed.elements.is_empty() {
        return Err(
            cursor.malformed(LazyPosition::Known(FilePosition::Whole), "there is no face in the file")
        );
    }
    parsed.into_surface(&cursor)
}

/// Reads the polylines (`l`) of an OBJ file; its faces are skipped. `file` is for messages only.
///
/// # Errors
/// Names the line and the reason.
pub fn read_obj_line(file: &Path, bytes: &[u8], limits: &Limits) -> Result<LineData, MeshError> {
    let mut cursor = Cursor::of_text(file, bytes, limits)?;
    let parsed = parse(&mut cursor, limits, true)?;
    let mut segments = Vec::new();
    for element in &parsed.elements {
        let place = LazyPosition::Known(FilePosition::Line(element.line));
        for pair in parsed.corners[element.corners.clone()].windows(2) {
            let [last, next] = [pair[0].vertex, pair[1].vertex];
            limit(&cursor, place, "segments", segments.len(), limits.elements)?;
            if last == next {
                let reason = format!("a polyline goes from vertex {} to itself", last + 1);
                return Err(cursor.malformed(place, reason));
            }
            segments.push([last, next]);
        }
    }
    if segments.is_empty() {
        return Err(cursor
            .malformed(LazyPosition::Known(FilePosition::Whole), "there is no polyline ('l') in the file"));
    }
    Ok(LineData { positions: parsed.positions, segments })
}

/// The next line without its comment, joined with those that continue it, and how many there are.
fn logical_line<'a>(cursor: &mut Cursor<'a>) -> Option<(Cow<'a, [u8]>, usize)> {
    let mut joined: Cow<'a, [u8]> = Cow::Borrowed(b"");
    let mut count = 0;
    while let Some(line) = cursor.next_line() {
        count += 1;
        let line = &line[..line.iter().position(|&b| b == b'#').unwrap_or(line.len())];
        let line = line.trim_ascii();
        // The path of a library may end in a backslash.
        let names_file = |line: &[u8]| line.get(..6).is_some_and(|word| word.eq_ignore_ascii_case(b"mtllib"));
        let continued =
            line.strip_suffix(b"\\").filter(|_| !names_file(if count == 1 { line } else { &joined }));
        let part = continued.unwrap_or(line);
        if count == 1 {
            joined = Cow::Borrowed(part);
        } else {
            let all = joined.to_mut();
            all.push(b' ');
            all.extend_from_slice(part);
        }
        if continued.is_none() {
            return Some((joined, count));
        }
    }
    (count > 0).then_some((joined, count))
}

/// Reads the polylines or the faces.
fn parse(cursor: &mut Cursor, limits: &Limits, lines: bool) -> Result<Parsed, MeshError> {
    let mut parsed = Parsed::default();
    let mut next = 1;
    while let Some((line, count)) = logical_line(cursor) {
        let number = next;
        next += count;
        let place = LazyPosition::Known(FilePosition::Line(number));
        let mut words = line.split(u8::is_ascii_whitespace).filter(|word| !word.is_empty());
        let Some(keyword) = words.next() else { continue };
        match keyword.to_ascii_lowercase().as_slice() {
            b"v" => {
                limit(cursor, place, "vertices", parsed.positions.len(), limits.vertices)?;
                let [x, y, z] = numbers(cursor, place, "vertex", parsed.positions.len(), &mut words)?;
                parsed.positions.push(Point3::new(x, y, z));
            }
            b"vt" => {
                let most = limits.elements.saturating_mul(3);
                limit(cursor, place, "texture coordinates", parsed.uvs.len(), most)?;
                let [u, v] = texture_coordinate(cursor, place, parsed.uvs.len(), words)?;
                parsed.uvs.push([u, v]);
            }
            b"vn" => {
                limit(cursor, place, "normals", parsed.normals.len(), limits.elements.saturating_mul(3))?;
                let [x, y, z] = numbers(cursor, place, "normal", parsed.normals.len(), &mut words)?;
                parsed.normals.push(Vector3::new(x, y, z));
            }
            b"l" if lines => {
                limit(cursor, place, "segments", parsed.corners.len(), limits.elements)?;
                parsed.element(cursor, number, words, usize::MAX)?;
            }
            b"f" | b"fo" if !lines => {
                let corners = parsed.element(cursor, number, words, CORNERS_MAX)?;
                if corners < 3 {
                    let reason = format!("a face needs at least 3 corners, this one has {corners}");
                    return Err(cursor.malformed(place, reason));
                }
                limit(cursor, place, "corners of faces", parsed.corners.len(), limits.elements)?;
            }
            b"f" | b"fo" | b"p" | b"l" | b"g" | b"o" | b"s" | b"mtllib" | b"usemtl" | b"usemap"
            | b"maplib" | b"mg" | b"lod" | b"bevel" | b"c_interp" | b"d_interp" | b"shadow_obj"
            | b"trace_obj" => {}
            _ => {
                return Err(cursor.unsupported(place, format!("element {}", quoted(keyword)), SUPPORTED));
            }
        }
    }
    parsed.check_numbers(cursor)?;
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

impl Parsed {
    /// Adds the corners of a face or polyline; returns how many there are.
    fn element<'a>(
        &mut self,
        cursor: &Cursor,
        line: usize,
        words: impl Iterator<Item = &'a [u8]>,
        most: usize,
    ) -> Result<usize, MeshError> {
        let place = LazyPosition::Known(FilePosition::Line(line));
        let first = self.corners.len();
        for word in words {
            if self.corners.len() - first == most {
                return Err(cursor.malformed(place, format!("a face has more than {most} corners")));
            }
            let corner = self.corner(cursor, place, word)?;
            self.corners.push(corner);
        }
        self.elements.push(Element { line, corners: first..self.corners.len() });
        Ok(self.corners.len() - first)
    }

    /// `v`, `v/vt`, `v//vn` or `v/vt/vn`; negative numbers count back from the latest element above, positive ones are
    /// compared with what there is when the file has ended.
    fn corner(&self, cursor: &Cursor, place: LazyPosition, word: &[u8]) -> Result<Corner, MeshError> {
        let bad = || {
            let reason = format!("corner {} is not v, v/vt, v//vn or v/vt/vn", quoted(word));
            cursor.malformed(place, reason)
        };
        let index = |text: &[u8], have: usize, most: u64| -> Result<u32, MeshError> {
            let written: i64 =
                std::str::from_utf8(text).ok().and_then(|text| text.parse().ok()).ok_or_else(bad)?;
            let resolved = if written > 0 { written - 1 } else { written.saturating_add(have as i64) };
            // 0 is not a valid index: it would resolve to one past the end.
            let valid = if written > 0 { resolved < most as i64 } else { written < 0 && resolved >= 0 };
            let resolved = u32::try_from(resolved).ok().filter(|_| valid);
            resolved.ok_or_else(|| cursor.out_of_range(place, "element", self.elements.len(), written, have))
        };
        let limits = cursor.limits;
        let attributes = limits.elements.saturating_mul(3);
        let mut parts = word.split(|&b| b == b'/');
        let vertex = index(parts.next().unwrap_or_default(), self.positions.len(), limits.vertices)?;
        let optional = |part: Option<&[u8]>, have: usize| match part {
            None | Some(b"") => Ok(None),
            Some(text) => index(text, have, attributes).map(Some),
        };
        let uv = optional(parts.next(), self.uvs.len())?;
        let normal = optional(parts.next(), self.normals.len())?;
        if parts.next().is_some() {
            return Err(bad());
        }
        Ok(Corner { vertex, uv, normal })
    }

    /// Whether every number is of something in the file.
    fn check_numbers(&self, cursor: &Cursor) -> Result<(), MeshError> {
        for (index, element) in self.elements.iter().enumerate() {
            for corner in &self.corners[element.corners.clone()] {
                let used = [
                    (Some(corner.vertex), self.positions.len()),
                    (corner.uv, self.uvs.len()),
                    (corner.normal, self.normals.len()),
                ];
                for (number, have) in used {
                    if let Some(number) = number.filter(|&number| number as usize >= have) {
                        let place = LazyPosition::Known(FilePosition::Line(element.line));
                        let written = i64::from(number) + 1;
                        return Err(cursor.out_of_range(place, "element", index, written, have));
                    }
                }
            }
        }
        Ok(())
    }

    fn into_surface(self, cursor: &Cursor) -> Result<SurfaceFile, MeshError> {
        let mut triangles: Vec<[Corner; 3]> = Vec::with_capacity(self.elements.len());
        let mut places = Vec::with_capacity(self.elements.len());
        let (mut polygon, mut points) = (Vec::new(), Vec::new());
        for element in &self.elements {
            polygon.clear();
            polygon.extend_from_slice(&self.corners[element.corners.clone()]);
            polygon = joined_repeats(polygon, |corner| corner.vertex);
            points.clear();
            points.extend(polygon.iter().map(|corner| self.positions[corner.vertex as usize]));
            let place = LazyPosition::Known(FilePosition::Line(element.line));
            let cut = triangles_of(&points).map_err(|why| cursor.malformed(place, why))?;
            limit(cursor, place, "triangles", triangles.len() + cut.len(), cursor.limits.elements)?;
            places.resize(places.len() + cut.len(), element.line as u64);
            triangles.extend(cut.into_iter().map(|corners| corners.map(|k| polygon[k as usize])));
        }
        let normals = corners_of(&triangles, |corner| {
            let normal = self.normals[corner.normal? as usize];
            normal.try_normalize(0.0)
        });
        let uvs = corners_of(&triangles, |corner| Some(self.uvs[corner.uv? as usize]));
        let triangles = triangles.iter().map(|t| t.map(|corner| corner.vertex)).collect();
        let surface = SurfaceData { positions: self.positions, triangles, normals, uvs };
        Ok(SurfaceFile { surface, place: "line", places, first_vertex: 1, notes: Vec::new() })
    }
}

/// A polygon without the corners that repeat the one before them, unless fewer than three would be left.
pub(super) fn joined_repeats<T: Copy>(mut polygon: Vec<T>, vertex: impl Fn(&T) -> u32) -> Vec<T> {
    if polygon.len() <= 3 {
        return polygon;
    }
    let whole = polygon.clone();
    polygon.dedup_by_key(|corner| vertex(corner));
    while polygon.len() > 1 && vertex(&polygon[0]) == vertex(&polygon[polygon.len() - 1]) {
        polygon.pop();
    }
    if polygon.len() < 3 { whole } else { polygon }
}

fn corners_of<T>(triangles: &[[Corner; 3]], attribute: impl Fn(&Corner) -> Option<T>) -> Option<Vec<[T; 3]>> {
    triangles.iter().map(|[a, b, c]| Some([attribute(a)?, attribute(b)?, attribute(c)?])).collect()
}

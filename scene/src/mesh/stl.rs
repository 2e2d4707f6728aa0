//! STL surfaces, ASCII and binary (3D Systems, "StereoLithography Interface Specification", 1989).
//!
//! A binary file is told by the zero in its number of facets, not by its header: many exporters begin binary files with
//! the word "solid" too, and some append bytes of their own, which are skipped. In text, words may have any capitals, and
//! `end solid` may be two words. Corners with equal coordinates become one vertex. The facets' normals are redundant (the
//! order of the corners defines the outside) and often wrong, so they are dropped.

use std::path::Path;

use nalgebra::Point3;

use super::cursor::{Cursor, LazyPosition, Order, is_word, quoted, wide_text};
use super::data::SurfaceData;
use super::error::{FilePosition, MeshError};
use super::file::SurfaceFile;
use super::limits::Limits;

const HEADER: usize = 80;
const FACET: usize = 50;

/// Reads an STL surface. `file` is for messages only. The caller must know the unit of the file.
///
/// # Errors
/// Names the line or byte and the reason.
pub fn read_stl(file: &Path, bytes: &[u8], limits: &Limits) -> Result<SurfaceData, MeshError> {
    read_stl_file(file, bytes, limits).map(|read| read.surface)
}

/// Like [`read_stl`], with what the reader skipped.
pub(super) fn read_stl_file(file: &Path, bytes: &[u8], limits: &Limits) -> Result<SurfaceFile, MeshError> {
    let mut notes = Vec::new();
    let mut surface = if is_binary(bytes) {
        binary(Cursor::new(file, bytes, limits), &mut notes)?
    } else {
        ascii(Cursor::of_text(file, bytes, limits)?)?
    };
    let cursor = Cursor::new(file, bytes, limits);
    let whole = LazyPosition::Known(FilePosition::Whole);
    if surface.triangles.is_empty() {
        return Err(cursor.malformed(whole, "there is no facet in the file"));
    }
    surface.weld_identical();
    if surface.positions.len() as u64 > limits.vertices {
        let count = surface.positions.len() as u64;
        return Err(cursor.too_large(whole, "vertices", count, limits.vertices));
    }
    Ok(SurfaceFile { surface, place: "facet", places: Vec::new(), first_vertex: 0, notes })
}

/// Whether the number of facets behind the header is one: its highest byte is zero in every file of fewer than 2²⁴ facets,
/// and text holds no zeros, unless its characters have two bytes. A file that begins with neither is binary as well.
fn is_binary(bytes: &[u8]) -> bool {
    let text = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes).trim_ascii_start();
    let solid = text.get(..5).is_some_and(|word| is_word(word, "solid"));
    let declared = bytes
        .get(HEADER..HEADER + 4)
        .map(|count| u32::from_le_bytes([count[0], count[1], count[2], count[3]]) as usize);
    let exact = declared.is_some_and(|n| n.checked_mul(FACET).is_some_and(|n| n + HEADER + 4 == bytes.len()));
    if exact || wide_text(bytes).is_some() {
        return exact;
    }
    let start = &bytes[..bytes.len().min(512)];
    let facets = !start.contains(&0) && start.windows(5).any(|word| is_word(word, "facet"));
    if solid { bytes.get(HEADER + 3) == Some(&0) } else { !facets }
}

fn push(surface: &mut SurfaceData, corners: [[f64; 3]; 3]) {
    let first = surface.positions.len() as u32;
    surface.positions.extend(corners.map(Point3::from));
    surface.triangles.push([first, first + 1, first + 2]);
}

fn binary(mut cursor: Cursor, notes: &mut Vec<String>) -> Result<SurfaceData, MeshError> {
    cursor.take(HEADER, "the header of a binary STL file")?;
    let place = cursor.byte();
    let declared = cursor.u32(Order::Little, "the number of facets")?;
    // Corners are numbered by 32 bits before they are welded.
    let limit = cursor.limits.elements.min(u64::from(u32::MAX / 3));
    let count = cursor.count(place, "facets", declared.into(), FACET as u64, limit)?;
    let mut surface = SurfaceData::default();
    surface.positions.reserve(3 * count);
    surface.triangles.reserve(count);
    for facet in 0..count {
        let mut corners = [[0.0; 3]; 3];
        cursor.take(12, "the normal of a facet")?;
        for corner in &mut corners {
            let place = cursor.byte();
            for coordinate in corner.iter_mut() {
                *coordinate = cursor.f32(Order::Little, "a corner of a facet")?.into();
            }
            cursor.finite(place, "facet", facet, corner)?;
        }
        cursor.take(2, "the attribute of a facet")?;
        push(&mut surface, corners);
    }
    let behind = cursor.remaining().len();
    if behind > 0 {
        notes.push(format!("{behind} bytes behind the last of its {count} facets were skipped"));
    }
    Ok(surface)
}

/// `solid` name, facets, `endsolid` name; several solids may follow each other.
fn ascii(mut cursor: Cursor) -> Result<SurfaceData, MeshError> {
    let limit = cursor.limits.elements.min(u64::from(u32::MAX / 3));
    let mut surface = SurfaceData::default();
    let mut solids = 0;
    loop {
        match cursor.token() {
            b"" if solids > 0 => return Ok(surface),
            word if is_word(word, "solid") => {
                // The rest of the line is a name and may hold any words.
                cursor.next_line();
            }
            other => return Err(unexpected(&cursor, "'solid'", other)),
        }
        solids += 1;
        loop {
            match cursor.token() {
                word if is_word(word, "facet") => {}
                word if is_word(word, "endsolid") => {
                    cursor.next_line();
                    break;
                }
                word if is_word(word, "end") => {
                    expect(&mut cursor, "solid")?;
                    cursor.next_line();
                    break;
                }
                other => return Err(unexpected(&cursor, "'facet' or 'endsolid'", other)),
            }
            let facet = surface.triangles.len();
            if facet as u64 >= limit {
                return Err(cursor.too_large(cursor.line(), "facets", facet as u64 + 1, limit));
            }
            expect(&mut cursor, "normal")?;
            // Numbers that are not used, and not always written: NaN is common here in files with degenerate facets.
            let mut ahead = cursor.clone();
            while !matches!(ahead.token(), word if word.is_empty() || is_word(word, "outer")) {
                cursor.token();
            }
            expect(&mut cursor, "outer")?;
            expect(&mut cursor, "loop")?;
            let mut corners = [[0.0; 3]; 3];
            for corner in &mut corners {
                expect(&mut cursor, "vertex")?;
                *corner = cursor.parse_point("facet", facet)?;
            }
            expect_end(&mut cursor, "loop")?;
            expect_end(&mut cursor, "facet")?;
            push(&mut surface, corners);
        }
    }
}

fn expect(cursor: &mut Cursor, word: &'static str) -> Result<(), MeshError> {
    match cursor.token() {
        found if is_word(found, word) => Ok(()),
        other => Err(unexpected(cursor, &format!("'{word}'"), other)),
    }
}

/// `endloop` or `end loop`.
fn expect_end(cursor: &mut Cursor, of: &'static str) -> Result<(), MeshError> {
    match cursor.token() {
        found if is_word(found, "end") => expect(cursor, of),
        found if found.len() == 3 + of.len() && is_word(&found[..3], "end") && is_word(&found[3..], of) => {
            Ok(())
        }
        other => Err(unexpected(cursor, &format!("'end{of}'"), other)),
    }
}

fn unexpected(cursor: &Cursor, expected: &str, found: &[u8]) -> MeshError {
    let found = if found.is_empty() { "the end of the file".into() } else { quoted(found) };
    cursor.malformed(cursor.line(), format!("{expected} is expected, found {found}"))
}

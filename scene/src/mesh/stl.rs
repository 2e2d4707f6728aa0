//! STL surfaces, ASCII and binary (3D Systems, "StereoLithography Interface Specification", 1989).
//!
//! A binary file is recognised by its length, not by its header: many exporters begin binary files with the word
//! "solid" too. Corners with equal coordinates become one vertex. The facets' normals are redundant (the order of the
//! corners defines the outside) and often wrong, so they are dropped.

use std::path::Path;

use nalgebra::Point3;

use super::cursor::{Cursor, LazyPosition, Order, quoted};
use super::data::SurfaceData;
use super::error::{FilePosition, MeshError};
use super::limits::Limits;

const HEADER: usize = 80;
const FACET: usize = 50;

/// Reads an STL surface. `file` is for messages only. The caller must know the unit of the file.
///
/// # Errors
/// Names the line or byte and the reason.
pub fn read_stl(file: &Path, bytes: &[u8], limits: &Limits) -> Result<SurfaceData, MeshError> {
    let cursor = Cursor::new(file, bytes, limits);
    let declared = bytes
        .get(HEADER..HEADER + 4)
        .map(|count| u32::from_le_bytes([count[0], count[1], count[2], count[3]]) as usize);
    let exact = declared.is_some_and(|n| n.checked_mul(FACET).is_some_and(|n| n + HEADER + 4 == bytes.len()));
    let text = bytes.trim_ascii_start().starts_with(b"solid");
    let mut surface = if text && !exact { ascii(cursor)? } else { binary(cursor)? };
    if surface.triangles.is_empty() {
        let cursor = Cursor::new(file, bytes, limits);
        return Err(
            cursor.malformed(LazyPosition::Known(FilePosition::Whole), "there is no facet in the file")
        );
    }
    surface.weld_identical();
    if surface.positions.len() as u64 > limits.vertices {
        let (cursor, count) = (Cursor::new(file, bytes, limits), surface.positions.len() as u64);
        return Err(cursor.too_large(
            LazyPosition::Known(FilePosition::Whole),
            "vertices",
            count,
            limits.vertices,
        ));
    }
    Ok(surface)
}

fn push(surface: &mut SurfaceData, corners: [[f64; 3]; 3]) {
    let first = surface.positions.len() as u32;
    surface.positions.extend(corners.map(Point3::from));
    surface.triangles.push([first, first + 1, first + 2]);
}

fn binary(mut cursor: Cursor) -> Result<SurfaceData, MeshError> {
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
            b"solid" => {
                // The rest of the line is a name and may hold any words.
                cursor.next_line();
            }
            other => return Err(unexpected(&cursor, "'solid'", other)),
        }
        solids += 1;
        loop {
            match cursor.token() {
                b"facet" => {}
                b"endsolid" => {
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
            for name in ["nx", "ny", "nz"] {
                // Parsed to advance the cursor, not used: NaN is common here in files with degenerate facets.
                cursor.parse::<f64>(name)?;
            }
            expect(&mut cursor, "outer")?;
            expect(&mut cursor, "loop")?;
            let mut corners = [[0.0; 3]; 3];
            for corner in &mut corners {
                expect(&mut cursor, "vertex")?;
                *corner = cursor.parse_point("facet", facet)?;
            }
            expect(&mut cursor, "endloop")?;
            expect(&mut cursor, "endfacet")?;
            push(&mut surface, corners);
        }
    }
}

fn expect(cursor: &mut Cursor, word: &'static str) -> Result<(), MeshError> {
    match cursor.token() {
        found if found == word.as_bytes() => Ok(()),
        other => Err(unexpected(cursor, &format!("'{word}'"), other)),
    }
}

fn unexpected(cursor: &Cursor, expected: &str, found: &[u8]) -> MeshError {
    let found = if found.is_empty() { "the end of the file".into() } else { quoted(found) };
    cursor.malformed(cursor.line(), format!("{expected} is expected, found {found}"))
}

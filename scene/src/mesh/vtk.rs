//! Legacy VTK files with an unstructured grid of tetrahedra, or with lines in such a grid or in poly data, ASCII and binary, versions 1 to 5
//! ("VTK File Formats", Kitware: the simple legacy formats; binary numbers are big-endian).
//!
//! Vertices, surface cells and (when reading volumes) lines are skipped; other volume cells are refused. Data on points
//! and cells is not read, so all tags are 0.

use std::path::Path;

use nalgebra::Point3;

use super::cursor::{Cursor, LazyPosition, Order, quoted};
use super::data::{LineData, TetData};
use super::error::{FilePosition, MeshError};
use super::limits::Limits;

const TETRA: i64 = 10;
/// Types of dimension 0 to 2: vertex, poly-vertex, line, poly-line, triangle, strip, polygon, pixel, quad, and the
/// quadratic edge, triangle and quad.
const LOWER: [i64; 12] = [1, 2, 3, 4, 5, 6, 7, 8, 9, 21, 22, 23];
const SUPPORTED_CELLS: &str = "tetrahedra (type 10); cells of lower dimension are skipped";
const KEYWORDS: &str = "POINTS, CELLS, CELL_TYPES, FIELD, METADATA, POINT_DATA, CELL_DATA";
const POLY_KEYWORDS: &str =
    "POINTS, VERTICES, LINES, POLYGONS, TRIANGLE_STRIPS, FIELD, METADATA, POINT_DATA, CELL_DATA";
/// Lines of two corners and of more.
const LINES: [i64; 2] = [3, 4];

/// Type of a number in an array.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    I64,
    U64,
    F32,
    F64,
}

impl Kind {
    fn parse(cursor: &Cursor, place: LazyPosition, name: &str) -> Result<Self, MeshError> {
        Ok(match name.to_ascii_lowercase().as_str() {
            "char" => Kind::I8,
            "unsigned_char" => Kind::U8,
            "short" => Kind::I16,
            "unsigned_short" => Kind::U16,
            "int" => Kind::I32,
            "unsigned_int" => Kind::U32,
            // VTK writes `long` with 8 bytes on all current platforms.
            "long" | "vtktypeint64" | "vtkidtype" => Kind::I64,
            "unsigned_long" => Kind::U64,
            "float" => Kind::F32,
            "double" => Kind::F64,
            _ => {
                let what = format!("data type {}", quoted(name.as_bytes()));
                let supported = "char, short, int, long, their unsigned kinds, vtktypeint64, float, double";
                return Err(cursor.unsupported(place, what, supported));
            }
        })
    }
    fn bytes(self) -> u64 {
        match self {
            Kind::I8 | Kind::U8 => 1,
            Kind::I16 | Kind::U16 => 2,
            Kind::I32 | Kind::U32 | Kind::F32 => 4,
            Kind::I64 | Kind::U64 | Kind::F64 => 8,
        }
    }
}

struct Reader<'a> {
    cursor: Cursor<'a>,
    binary: bool,
}

/// Reads a legacy VTK volume. `file` is for messages only.
///
/// # Errors
/// Names the line or byte and the reason.
pub fn read_vtk(file: &Path, bytes: &[u8], limits: &Limits) -> Result<TetData, MeshError> {
    let sections = read(file, bytes, limits, false)?;
    sections.tets()
}

/// Reads the lines and polylines of a legacy VTK file, of an unstructured grid or of poly data; all else is skipped. `file` is
/// for messages only.
///
/// # Errors
/// Names the line or byte and the reason.
pub fn read_vtk_line(file: &Path, bytes: &[u8], limits: &Limits) -> Result<LineData, MeshError> {
    let sections = read(file, bytes, limits, true)?;
    sections.lines()
}

/// Sections of a file.
struct Sections<'a> {
    cursor: Cursor<'a>,
    is_poly: bool,
    points: Option<Vec<Point3<f64>>>,
    /// The cells of a grid, or the lines of poly data.
    cells: Option<Cells>,
    types: Option<Vec<i64>>,
}

fn read<'a>(
    file: &'a Path,
    bytes: &'a [u8],
    limits: &'a Limits,
    takes_poly: bool,
) -> Result<Sections<'a>, MeshError> {
    let mut cursor = Cursor::new(file, bytes, limits);
    let (binary, is_poly) = header(&mut cursor, takes_poly)?;
    let mut reader = Reader { cursor, binary };
    let mut points: Option<Vec<Point3<f64>>> = None;
    let mut cells: Option<Cells> = None;
    let mut types: Option<Vec<i64>> = None;
    loop {
        reader.cursor.skip_space();
        let place = reader.cursor.line();
        if reader.cursor.remaining().is_empty() {
            break;
        }
        let line = reader.cursor.next_text_line("a keyword")?;
        let words: Vec<&str> = line.split_whitespace().collect();
        match (words.first().map(|word| word.to_ascii_uppercase()).as_deref(), &words[1..]) {
            (Some("POINTS"), [count, kind]) if points.is_none() => {
                points = Some(reader.points(place, count, kind)?);
            }
            (Some("LINES"), [count, size]) if is_poly && cells.is_none() => {
                cells = Some(reader.cells(place, count, size)?);
            }
            (Some("VERTICES" | "POLYGONS" | "TRIANGLE_STRIPS"), [count, size]) if is_poly => {
                reader.cells(place, count, size)?;
            }
            (Some("CELLS"), [count, size]) if !is_poly && cells.is_none() => {
                cells = Some(reader.cells(place, count, size)?);
            }
            (Some("CELL_TYPES"), [count]) if !is_poly && types.is_none() => {
                let count = reader.count(place, "cell types", count, 2, 4, limits.elements)?;
                types = Some(reader.integers(count, Kind::I32, "a cell type")?);
            }
            (Some("POINTS"), _) => return Err(reader.twice(place, line)),
            (Some("LINES"), _) if is_poly => return Err(reader.twice(place, line)),
            (Some("CELLS" | "CELL_TYPES"), _) if !is_poly => return Err(reader.twice(place, line)),
            (Some("FIELD"), [_, count]) => reader.skip_field(place, count)?,
            (Some("METADATA"), _) => reader.skip_paragraph(),
            // The rest of the file after the geometry is not needed.
            (Some("POINT_DATA" | "CELL_DATA"), _) => break,
            _ => {
                let keywords = if is_poly { POLY_KEYWORDS } else { KEYWORDS };
                let reason = format!("one of {keywords} is expected, found {}", quoted(line.as_bytes()));
                return Err(reader.cursor.malformed(place, reason));
            }
        }
    }
    Ok(Sections { cursor: reader.cursor, is_poly, points, cells, types })
}

/// Whether it is binary, and whether it holds poly data.
fn header(cursor: &mut Cursor, takes_poly: bool) -> Result<(bool, bool), MeshError> {
    let place = cursor.line();
    let first = cursor.next_text_line("'# vtk DataFile Version'")?;
    let version = first.strip_prefix("# vtk DataFile Version ").and_then(|v| v.trim().split('.').next());
    match version.and_then(|major| major.parse::<u32>().ok()) {
        Some(1..=5) => {}
        Some(_) => {
            return Err(cursor.unsupported(place, quoted(first.as_bytes()), "legacy versions 1 to 5"));
        }
        None => {
            let reason =
                format!("'# vtk DataFile Version x.y' is expected, found {}", quoted(first.as_bytes()));
            return Err(cursor.malformed(place, reason));
        }
    }
    let place = cursor.line();
    if cursor.next_line().is_none() {
        return Err(cursor.malformed(place, "the file ends where its title is expected"));
    }
    let place = cursor.line();
    let binary = match cursor.next_text_line("ASCII or BINARY")?.to_ascii_uppercase().as_str() {
        "ASCII" => false,
        "BINARY" => true,
        other => {
            let reason = format!("ASCII or BINARY is expected, found {}", quoted(other.as_bytes()));
            return Err(cursor.malformed(place, reason));
        }
    };
    cursor.skip_space();
    let place = cursor.line();
    let dataset = cursor.next_text_line("DATASET UNSTRUCTURED_GRID")?;
    let words: Vec<String> = dataset.split_whitespace().map(str::to_ascii_uppercase).collect();
    match words.iter().map(String::as_str).collect::<Vec<_>>().as_slice() {
        ["DATASET", "UNSTRUCTURED_GRID"] => Ok((binary, false)),
        ["DATASET", "POLYDATA"] if takes_poly => Ok((binary, true)),
        ["DATASET", _] => {
            let supported = match takes_poly {
                true => "DATASET UNSTRUCTURED_GRID, DATASET POLYDATA",
                false => "DATASET UNSTRUCTURED_GRID",
            };
            Err(cursor.unsupported(place, quoted(dataset.as_bytes()), supported))
        }
        _ => {
            let reason =
                format!("DATASET UNSTRUCTURED_GRID is expected, found {}", quoted(dataset.as_bytes()));
            Err(cursor.malformed(place, reason))
        }
    }
}

/// Cells as ranges of one list of vertices.
struct Cells {
    /// Start of each cell, and end of the last one.
    offsets: Vec<usize>,
    vertices: Vec<i64>,
}

impl Cells {
    fn of(&self, cell: usize) -> &[i64] {
        &self.vertices[self.offsets[cell]..self.offsets[cell + 1]]
    }
}

impl Reader<'_> {
    fn twice(&self, place: LazyPosition, line: &str) -> MeshError {
        let reason = format!("{} stands twice, or without its counts", quoted(line.as_bytes()));
        self.cursor.malformed(place, reason)
    }

    fn here(&self) -> LazyPosition {
        if self.binary { self.cursor.byte() } else { self.cursor.line() }
    }

    fn count(
        &self,
        place: LazyPosition,
        what: &'static str,
        word: &str,
        ascii: u64,
        binary: u64,
        limit: u64,
    ) -> Result<usize, MeshError> {
        let declared = word.parse().map_err(|_| {
            let reason = format!("the number of {what} is expected, found {}", quoted(word.as_bytes()));
            self.cursor.malformed(place, reason)
        })?;
        self.cursor.count(place, what, declared, if self.binary { binary } else { ascii }, limit)
    }

    fn integer(&mut self, kind: Kind, what: &str) -> Result<i64, MeshError> {
        if !self.binary {
            return self.cursor.parse(what);
        }
        let (cursor, order) = (&mut self.cursor, Order::Big);
        match kind {
            Kind::I32 => cursor.i32(order, what).map(i64::from),
            Kind::U32 => cursor.u32(order, what).map(i64::from),
            Kind::I64 => cursor.i64(order, what),
            Kind::U64 => {
                let place = cursor.byte();
                let number = cursor.u64(order, what)?;
                i64::try_from(number).map_err(|_| cursor.malformed(place, format!("{what} is {number}")))
            }
            _ => Err(cursor.unsupported(
                cursor.byte(),
                format!("{what} of type {kind:?}"),
                "int, vtktypeint64",
            )),
        }
    }

    fn integers(&mut self, count: usize, kind: Kind, what: &str) -> Result<Vec<i64>, MeshError> {
        (0..count).map(|_| self.integer(kind, what)).collect()
    }

    fn points(
        &mut self,
        place: LazyPosition,
        count: &str,
        kind: &str,
    ) -> Result<Vec<Point3<f64>>, MeshError> {
        let kind = Kind::parse(&self.cursor, place, kind)?;
        let limit = self.cursor.limits.vertices;
        let count = self.count(place, "points", count, 6, 3 * kind.bytes(), limit)?;
        let mut points = Vec::with_capacity(count);
        for index in 0..count {
            let point = match (self.binary, kind) {
                (false, _) => self.cursor.parse_point("point", index)?,
                (true, Kind::F64) => self.cursor.point(Order::Big, "point", index)?,
                (true, Kind::F32) => {
                    let place = self.cursor.byte();
                    let mut point = [0.0; 3];
                    for coordinate in &mut point {
                        *coordinate = self.cursor.f32(Order::Big, "a point")?.into();
                    }
                    self.cursor.finite(place, "point", index, &point)?;
                    point
                }
                (true, kind) => {
                    return Err(self.cursor.unsupported(
                        place,
                        format!("points of type {kind:?}"),
                        "float, double",
                    ));
                }
            };
            points.push(Point3::from(point));
        }
        Ok(points)
    }

    fn cells(&mut self, place: LazyPosition, count: &str, size: &str) -> Result<Cells, MeshError> {
        let limit = self.cursor.limits.elements;
        // Version 5 has a list of offsets here, marked by the next word, possibly on a line of its own.
        let mut ahead = self.cursor.clone();
        if ahead.token().eq_ignore_ascii_case(b"OFFSETS") {
            let offsets = self.count(place, "offsets of cells", count, 2, 4, limit.saturating_add(1))?;
            let connectivity = self.count(place, "corners of cells", size, 2, 4, limit.saturating_mul(8))?;
            return self.cells_with_offsets(offsets, connectivity);
        }
        let count = self.count(place, "cells", count, 4, 8, limit)?;
        let size = self.count(place, "numbers of cells", size, 2, 4, limit.saturating_mul(9))?;
        let mut cells = Cells { offsets: Vec::with_capacity(count + 1), vertices: Vec::with_capacity(size) };
        cells.offsets.push(0);
        let mut left = size;
        for _ in 0..count {
            let place = self.here();
            let corners = self.integer(Kind::I32, "the number of corners of a cell")?;
            let fits = usize::try_from(corners).ok().filter(|&n| n < left);
            let Some(corners) = fits else {
                let reason =
                    format!("a cell of {corners} corners does not fit into the declared {size} numbers");
                return Err(self.cursor.malformed(place, reason));
            };
            left -= corners + 1;
            for _ in 0..corners {
                let vertex = self.integer(Kind::I32, "a corner of a cell")?;
                cells.vertices.push(vertex);
            }
            cells.offsets.push(cells.vertices.len());
        }
        Ok(cells)
    }

    fn cells_with_offsets(&mut self, offsets: usize, connectivity: usize) -> Result<Cells, MeshError> {
        let place = self.here();
        let begins = self.named_array("OFFSETS", offsets)?;
        let vertices = self.named_array("CONNECTIVITY", connectivity)?;
        let mut previous = 0;
        let mut checked = Vec::with_capacity(begins.len());
        for (k, &begin) in begins.iter().enumerate() {
            let valid = usize::try_from(begin)
                .ok()
                .filter(|&b| b >= previous && b <= vertices.len() && (k > 0 || b == 0));
            let Some(valid) = valid else {
                let reason =
                    format!("offset {k} is {begin}: offsets begin at 0, grow, and end within CONNECTIVITY");
                return Err(self.cursor.malformed(place, reason));
            };
            previous = valid;
            checked.push(valid);
        }
        Ok(Cells { offsets: checked, vertices })
    }

    fn named_array(&mut self, name: &'static str, count: usize) -> Result<Vec<i64>, MeshError> {
        self.cursor.skip_space();
        let place = self.cursor.line();
        let line = self.cursor.next_text_line(name)?;
        match line.split_whitespace().collect::<Vec<_>>().as_slice() {
            [word, kind] if word.eq_ignore_ascii_case(name) => {
                let kind = Kind::parse(&self.cursor, place, kind)?;
                let count = count as u64;
                let least = if self.binary { kind.bytes() } else { 2 };
                let count = self.cursor.count(place, "numbers", count, least, u64::MAX)?;
                self.integers(count, kind, "a number of a cell")
            }
            _ => {
                let reason = format!("{name} and its type are expected, found {}", quoted(line.as_bytes()));
                Err(self.cursor.malformed(place, reason))
            }
        }
    }

    /// Arrays of a FIELD: `name components tuples type`, then the numbers.
    fn skip_field(&mut self, place: LazyPosition, count: &str) -> Result<(), MeshError> {
        let arrays = self.count(place, "arrays", count, 8, 8, self.cursor.limits.elements)?;
        for _ in 0..arrays {
            self.cursor.skip_space();
            let place = self.cursor.line();
            let line = self.cursor.next_text_line("an array of a field")?;
            let words: Vec<&str> = line.split_whitespace().collect();
            let [_, components, tuples, kind] = words.as_slice() else {
                let reason = format!(
                    "name, components, tuples and type are expected, found {}",
                    quoted(line.as_bytes())
                );
                return Err(self.cursor.malformed(place, reason));
            };
            if kind.eq_ignore_ascii_case("string") {
                return Err(self.cursor.unsupported(place, "a field of strings", "fields of numbers"));
            }
            let kind = Kind::parse(&self.cursor, place, kind)?;
            let components = self.count(place, "components", components, 0, 0, u64::MAX)?;
            let tuples = self.count(place, "tuples", tuples, 0, 0, u64::MAX)?;
            let numbers = (components as u64).saturating_mul(tuples as u64);
            let least = if self.binary { kind.bytes() } else { 2 };
            let numbers = self.cursor.count(place, "numbers of a field", numbers, least, u64::MAX)?;
            if self.binary {
                self.cursor.take(numbers * kind.bytes() as usize, "a field")?;
            } else {
                for _ in 0..numbers {
                    self.cursor.token();
                }
            }
        }
        Ok(())
    }

    fn skip_paragraph(&mut self) {
        while self.cursor.next_line().is_some_and(|line| !line.trim_ascii().is_empty()) {}
    }
}

/// Vertices, cells and, of a grid, the type of each cell.
type Parts = (Vec<Point3<f64>>, Cells, Option<Vec<i64>>);

impl Sections<'_> {
    fn missing(&self, what: &str) -> MeshError {
        self.cursor
            .malformed(LazyPosition::Known(FilePosition::Whole), format!("the file has no {what} section"))
    }

    fn parts(&mut self) -> Result<Parts, MeshError> {
        let points = self.points.take().ok_or_else(|| self.missing("POINTS"))?;
        let cells = self.cells.take();
        let cells = cells.ok_or_else(|| self.missing(if self.is_poly { "LINES" } else { "CELLS" }))?;
        if self.is_poly {
            return Ok((points, cells, None));
        }
        let types = self.types.take().ok_or_else(|| self.missing("CELL_TYPES"))?;
        let count = cells.offsets.len().saturating_sub(1);
        if types.len() != count {
            let reason = format!("there are {count} cells, but {} cell types", types.len());
            return Err(self.cursor.malformed(LazyPosition::Known(FilePosition::Whole), reason));
        }
        Ok((points, cells, Some(types)))
    }

    fn vertex(
        &self,
        (element, cell): (&'static str, usize),
        written: i64,
        vertices: usize,
    ) -> Result<u32, MeshError> {
        match usize::try_from(written).is_ok_and(|vertex| vertex < vertices) {
            true => Ok(written as u32),
            false => {
                let whole = LazyPosition::Known(FilePosition::Whole);
                Err(self.cursor.out_of_range(whole, element, cell, written, vertices))
            }
        }
    }

    fn tets(mut self) -> Result<TetData, MeshError> {
        let whole = LazyPosition::Known(FilePosition::Whole);
        let (positions, cells, types) = self.parts()?;
        let mut tets = Vec::new();
        for (cell, kind) in types.unwrap_or_default().into_iter().enumerate() {
            if LOWER.contains(&kind) {
                continue;
            }
            if kind != TETRA {
                let what = format!("cell {cell} of type {kind}");
                return Err(self.cursor.unsupported(whole, what, SUPPORTED_CELLS));
            }
            let corners = cells.of(cell);
            let &[a, b, c, d] = corners else {
                let reason = format!("cell {cell} is a tetrahedron with {} corners", corners.len());
                return Err(self.cursor.malformed(whole, reason));
            };
            let mut tet = [0; 4];
            for (vertex, written) in tet.iter_mut().zip([a, b, c, d]) {
                *vertex = self.vertex(("tetrahedron (cell)", cell), written, positions.len())?;
            }
            tets.push(tet);
        }
        if tets.is_empty() {
            return Err(self.cursor.malformed(whole, "there is no tetrahedron in the file"));
        }
        let tags = vec![0; tets.len()];
        Ok(TetData { positions, tets, tags })
    }

    fn lines(mut self) -> Result<LineData, MeshError> {
        let whole = LazyPosition::Known(FilePosition::Whole);
        let (positions, cells, types) = self.parts()?;
        let mut segments = Vec::new();
        for cell in 0..cells.offsets.len().saturating_sub(1) {
            if types.as_ref().is_some_and(|types| !LINES.contains(&types[cell])) {
                continue;
            }
            let mut last = None;
            for &written in cells.of(cell) {
                let next = self.vertex(("line (cell)", cell), written, positions.len())?;
                if let Some(last) = last.replace(next) {
                    if last == next {
                        let reason = format!("cell {cell} goes from vertex {next} to itself");
                        return Err(self.cursor.malformed(whole, reason));
                    }
                    segments.push([last, next]);
                }
            }
        }
        if segments.is_empty() {
            return Err(self.cursor.malformed(whole, "there is no line in the file"));
        }
        Ok(LineData { positions, segments })
    }
}

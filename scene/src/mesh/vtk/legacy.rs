//! Legacy VTK files with an unstructured grid or poly data, ASCII and binary, versions 1 to 5 ("VTK File Formats", Kitware:
//! the simple legacy formats; binary numbers are big-endian).

use nalgebra::Point3;

use super::{CellList, WHOLE, add_cells, region_rank};
use crate::mesh::cells::Grid;
use crate::mesh::cursor::{Cursor, LazyPosition, Order, quoted};
use crate::mesh::error::MeshError;
use crate::mesh::number_kind::NumberKind;

const KEYWORDS: &str = "POINTS, CELLS, CELL_TYPES, FIELD, METADATA, POINT_DATA, CELL_DATA";
const POLY_KEYWORDS: &str =
    "POINTS, VERTICES, LINES, POLYGONS, TRIANGLE_STRIPS, FIELD, METADATA, POINT_DATA, CELL_DATA";

/// Which of a file's data is being read.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Data {
    OfPoints,
    OfCells,
}

struct Reader<'a> {
    cursor: Cursor<'a>,
    binary: bool,
    /// The best array of regions so far: its rank among the names, and the region of each cell.
    regions: Option<(usize, Vec<i32>)>,
    /// Whether an array of regions is being read: a mistake in it is told, one in other data ends the reading.
    in_regions: bool,
}

/// Sections of a file.
#[derive(Default)]
struct Sections {
    points: Option<Vec<Point3<f64>>>,
    /// The cells of a grid.
    cells: Option<CellList>,
    types: Option<Vec<i64>>,
    /// Vertices, lines, polygons and strips of poly data, with VTK's type of a cell of theirs.
    lists: Vec<(&'static str, i64, CellList)>,
}

/// Reads a file from its first line.
pub(super) fn read(mut cursor: Cursor) -> Result<(Grid, Cursor), MeshError> {
    let (binary, is_poly) = header(&mut cursor)?;
    let mut reader = Reader { cursor, binary, regions: None, in_regions: false };
    let limits = *reader.cursor.limits;
    let mut sections = Sections::default();
    let mut data = None;
    loop {
        reader.cursor.skip_space();
        let place = reader.cursor.line();
        if reader.cursor.remaining().is_empty() {
            break;
        }
        let line = reader.cursor.next_text_line("a keyword")?;
        let words: Vec<&str> = line.split_whitespace().collect();
        // A line of white space that ASCII does not count as such, a vertical tab for one, has no word.
        let Some((keyword, arguments)) = words.split_first() else { continue };
        let keyword = keyword.to_ascii_uppercase();
        match (keyword.as_str(), arguments) {
            ("POINTS", [count, kind]) if sections.points.is_none() => {
                sections.points = Some(reader.points(place, count, kind)?);
            }
            ("VERTICES" | "LINES" | "POLYGONS" | "TRIANGLE_STRIPS", [count, size])
                if is_poly && sections.lists.iter().all(|(name, ..)| *name != keyword) =>
            {
                let (name, kind) = match keyword.as_str() {
                    "VERTICES" => ("VERTICES", 2),
                    "LINES" => ("LINES", 4),
                    "POLYGONS" => ("POLYGONS", 7),
                    _ => ("TRIANGLE_STRIPS", 6),
                };
                sections.lists.push((name, kind, reader.cells(place, count, size)?));
            }
            ("CELLS", [count, size]) if !is_poly && sections.cells.is_none() => {
                sections.cells = Some(reader.cells(place, count, size)?);
            }
            ("CELL_TYPES", [count]) if !is_poly && sections.types.is_none() => {
                let count = reader.count(place, "cell types", count, 2, 4, limits.elements)?;
                sections.types = Some(reader.integers(count, NumberKind::I32, "a cell type")?);
            }
            ("POINTS", _) => return Err(reader.twice(place, line)),
            ("VERTICES" | "LINES" | "POLYGONS" | "TRIANGLE_STRIPS", _) if is_poly => {
                return Err(reader.twice(place, line));
            }
            ("CELLS" | "CELL_TYPES", _) if !is_poly => return Err(reader.twice(place, line)),
            ("FIELD", [_, count]) if data.is_none() => reader.field(place, count, None)?,
            ("METADATA", _) => reader.skip_paragraph(),
            ("POINT_DATA", [count]) => {
                data = Some((Data::OfPoints, reader.count(place, "points", count, 0, 0, u64::MAX)?));
            }
            ("CELL_DATA", [count]) => {
                data = Some((Data::OfCells, reader.count(place, "cells", count, 0, 0, u64::MAX)?));
            }
            _ if data.is_some() => {
                let Some((data, count)) = data else { break };
                // Data that is not known or damaged is of no use here, and where it ends is not known.
                match reader.attribute(place, &keyword, arguments, data, count) {
                    Ok(true) => {}
                    Err(error) if reader.in_regions => return Err(error),
                    Ok(false) | Err(_) => break,
                }
            }
            _ => {
                let keywords = if is_poly { POLY_KEYWORDS } else { KEYWORDS };
                let reason = format!("one of {keywords} is expected, found {}", quoted(line.as_bytes()));
                return Err(reader.cursor.malformed(place, reason));
            }
        }
    }
    let regions = reader.regions.map(|(_, regions)| regions);
    Ok((sections.into_grid(&reader.cursor, is_poly, regions)?, reader.cursor))
}

impl Sections {
    fn into_grid(self, cursor: &Cursor, is_poly: bool, regions: Option<Vec<i32>>) -> Result<Grid, MeshError> {
        let missing = |what: &str| cursor.malformed(WHOLE, format!("the file has no {what} section"));
        let mut grid = Grid { word: "cell", ..Grid::default() };
        grid.positions = self.points.ok_or_else(|| missing("POINTS"))?;
        if is_poly {
            if self.lists.is_empty() {
                return Err(missing("POLYGONS, TRIANGLE_STRIPS or LINES"));
            }
            for (_, kind, list) in &self.lists {
                add_cells(&mut grid, cursor, list, 0, |_| *kind, None)?;
            }
            return Ok(grid);
        }
        let cells = self.cells.ok_or_else(|| missing("CELLS"))?;
        let types = self.types.ok_or_else(|| missing("CELL_TYPES"))?;
        if types.len() != cells.count() {
            let reason = format!("there are {} cells, but {} cell types", cells.count(), types.len());
            return Err(cursor.malformed(WHOLE, reason));
        }
        if let Some(regions) = regions.as_ref().filter(|regions| regions.len() != types.len()) {
            let reason = format!("there are {} cells, but the regions of {}", types.len(), regions.len());
            return Err(cursor.malformed(WHOLE, reason));
        }
        add_cells(&mut grid, cursor, &cells, 0, |k| types[k], regions.as_deref())?;
        grid.has_regions = regions.is_some();
        Ok(grid)
    }
}

/// Whether it is binary, and whether it holds poly data.
fn header(cursor: &mut Cursor) -> Result<(bool, bool), MeshError> {
    let place = cursor.line();
    let first = cursor.next_text_line("'# vtk DataFile Version'")?;
    let words: Vec<String> =
        first.trim_start_matches('#').split_whitespace().map(str::to_lowercase).collect();
    let version = match words.as_slice() {
        [vtk, datafile, version, number, ..]
            if first.starts_with('#') && vtk == "vtk" && datafile == "datafile" && version == "version" =>
        {
            number.split('.').next().and_then(|major| major.parse::<u32>().ok())
        }
        _ => None,
    };
    match version {
        Some(1..=5) => {}
        Some(_) => {
            return Err(cursor.unsupported(place, quoted(first.as_bytes()), "legacy versions 1 to 5"));
        }
        None => {
            let reason = format!(
                "'# vtk DataFile Version x.y' or '<VTKFile' is expected, found {}",
                quoted(first.as_bytes())
            );
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
    let dataset = cursor.next_text_line("DATASET UNSTRUCTURED_GRID or POLYDATA")?;
    let words: Vec<String> = dataset.split_whitespace().map(str::to_ascii_uppercase).collect();
    match words.iter().map(String::as_str).collect::<Vec<_>>().as_slice() {
        ["DATASET", "UNSTRUCTURED_GRID"] => Ok((binary, false)),
        ["DATASET", "POLYDATA"] => Ok((binary, true)),
        ["DATASET", _] => {
            let supported = "DATASET UNSTRUCTURED_GRID, DATASET POLYDATA";
            Err(cursor.unsupported(place, quoted(dataset.as_bytes()), supported))
        }
        _ => {
            let reason =
                format!("DATASET UNSTRUCTURED_GRID is expected, found {}", quoted(dataset.as_bytes()));
            Err(cursor.malformed(place, reason))
        }
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
        let declared: u64 = word.parse().map_err(|_| {
            let reason = format!("the number of {what} is expected, found {}", quoted(word.as_bytes()));
            self.cursor.malformed(place, reason)
        })?;
        let least = if self.binary { binary } else { ascii };
        if least == 0 {
            return Ok(usize::try_from(declared).unwrap_or(usize::MAX));
        }
        self.cursor.count(place, what, declared, least, limit)
    }

    fn integer(&mut self, kind: NumberKind, what: &str) -> Result<i64, MeshError> {
        if self.binary {
            return Ok(kind.whole(self.cursor.take(kind.bytes(), what)?, Order::Big));
        }
        self.cursor.parse(what)
    }

    fn integers(&mut self, count: usize, kind: NumberKind, what: &str) -> Result<Vec<i64>, MeshError> {
        (0..count).map(|_| self.integer(kind, what)).collect()
    }

    fn points(
        &mut self,
        place: LazyPosition,
        count: &str,
        kind: &str,
    ) -> Result<Vec<Point3<f64>>, MeshError> {
        let kind = NumberKind::parse(&self.cursor, place, kind)?;
        let limit = self.cursor.limits.vertices;
        let count = self.count(place, "points", count, 6, 3 * kind.bytes() as u64, limit)?;
        let mut points = Vec::with_capacity(count);
        for index in 0..count {
            let point = if self.binary {
                let place = self.cursor.byte();
                let mut point = [0.0; 3];
                for coordinate in &mut point {
                    *coordinate = kind.number(self.cursor.take(kind.bytes(), "a point")?, Order::Big);
                }
                self.cursor.finite(place, "point", index, &point)?;
                point
            } else {
                self.cursor.parse_point("point", index)?
            };
            points.push(Point3::from(point));
        }
        Ok(points)
    }

    fn cells(&mut self, place: LazyPosition, count: &str, size: &str) -> Result<CellList, MeshError> {
        let limit = self.cursor.limits.elements;
        // Version 5 has a list of offsets here, marked by the next word, possibly on a line of its own.
        let mut ahead = self.cursor.clone();
        if ahead.token().eq_ignore_ascii_case(b"OFFSETS") {
            let offsets = self.count(place, "offsets of cells", count, 2, 1, limit.saturating_add(1))?;
            let connectivity = self.count(place, "corners of cells", size, 2, 1, limit.saturating_mul(8))?;
            let place = self.here();
            let begins = self.named_array("OFFSETS", offsets)?;
            let corners = self.named_array("CONNECTIVITY", connectivity)?;
            return CellList::new(&self.cursor, place, &begins, corners);
        }
        let count = self.count(place, "cells", count, 4, 8, limit)?;
        let size = self.count(place, "numbers of cells", size, 2, 4, limit.saturating_mul(9))?;
        let mut cells =
            CellList { offsets: Vec::with_capacity(count + 1), corners: Vec::with_capacity(size) };
        cells.offsets.push(0);
        let mut left = size;
        for _ in 0..count {
            let place = self.here();
            let corners = self.integer(NumberKind::I32, "the number of corners of a cell")?;
            let fits = usize::try_from(corners).ok().filter(|&n| n < left);
            let Some(corners) = fits else {
                let reason =
                    format!("a cell of {corners} corners does not fit into the declared {size} numbers");
                return Err(self.cursor.malformed(place, reason));
            };
            left -= corners + 1;
            for _ in 0..corners {
                let vertex = self.integer(NumberKind::I32, "a corner of a cell")?;
                cells.corners.push(vertex);
            }
            cells.offsets.push(cells.corners.len());
        }
        Ok(cells)
    }

    fn named_array(&mut self, name: &'static str, count: usize) -> Result<Vec<i64>, MeshError> {
        self.cursor.skip_space();
        let place = self.cursor.line();
        let line = self.cursor.next_text_line(name)?;
        match line.split_whitespace().collect::<Vec<_>>().as_slice() {
            [word, kind] if word.eq_ignore_ascii_case(name) => {
                let kind = NumberKind::parse(&self.cursor, place, kind)?;
                let least = if self.binary { kind.bytes() as u64 } else { 2 };
                let count = self.cursor.count(place, "numbers", count as u64, least, u64::MAX)?;
                self.integers(count, kind, "a number of a cell")
            }
            _ => {
                let reason = format!("{name} and its type are expected, found {}", quoted(line.as_bytes()));
                Err(self.cursor.malformed(place, reason))
            }
        }
    }

    /// Arrays of a FIELD: `name components tuples type`, then the numbers.
    fn field(
        &mut self,
        place: LazyPosition,
        count: &str,
        data: Option<(Data, usize)>,
    ) -> Result<(), MeshError> {
        let arrays = self.count(place, "arrays", count, 8, 8, self.cursor.limits.elements)?;
        for _ in 0..arrays {
            self.cursor.skip_space();
            let mut place = self.cursor.line();
            let mut line = self.cursor.next_text_line("an array of a field")?;
            // VTK writes METADATA behind each array that has some.
            while line.eq_ignore_ascii_case("METADATA") {
                self.skip_paragraph();
                self.cursor.skip_space();
                place = self.cursor.line();
                line = self.cursor.next_text_line("an array of a field")?;
            }
            let words: Vec<&str> = line.split_whitespace().collect();
            let [name, components, tuples, kind] = words.as_slice() else {
                let reason = format!(
                    "name, components, tuples and type are expected, found {}",
                    quoted(line.as_bytes())
                );
                return Err(self.cursor.malformed(place, reason));
            };
            let components = self.count(place, "components", components, 0, 0, u64::MAX)?;
            let tuples = self.count(place, "tuples", tuples, 0, 0, u64::MAX)?;
            let numbers = components.saturating_mul(tuples);
            let is_region = matches!(data, Some((Data::OfCells, _))) && components == 1;
            self.array(place, name, numbers, kind, is_region)?;
        }
        Ok(())
    }

    /// Numbers of an array; those of a cell array with the name of regions are kept.
    fn array(
        &mut self,
        place: LazyPosition,
        name: &str,
        numbers: usize,
        kind: &str,
        is_region: bool,
    ) -> Result<(), MeshError> {
        if kind.eq_ignore_ascii_case("string") || kind.eq_ignore_ascii_case("utf8_string") {
            return (0..numbers).try_for_each(|_| self.skip_string());
        }
        let declared = numbers as u64;
        if kind.eq_ignore_ascii_case("bit") {
            if self.binary {
                return self.cursor.take(numbers.div_ceil(8), "bits").map(|_| ());
            }
            return self.skip_words(place, declared);
        }
        let kind = NumberKind::parse(&self.cursor, place, kind)?;
        let least = if self.binary { kind.bytes() as u64 } else { 2 };
        let numbers = self.cursor.count(place, "numbers of a field", declared, least, u64::MAX)?;
        let rank = region_rank(name).filter(|_| is_region && kind.is_whole());
        if let Some(rank) = rank.filter(|rank| self.regions.as_ref().is_none_or(|(best, _)| rank < best)) {
            self.in_regions = true;
            let regions: Result<Vec<i32>, MeshError> = (0..numbers)
                .map(|_| {
                    let place = self.here();
                    let region = self.integer(kind, "a region")?;
                    let out =
                        || self.cursor.malformed(place, format!("region {region} needs more than 32 bits"));
                    i32::try_from(region).map_err(|_| out())
                })
                .collect();
            self.regions = Some((rank, regions?));
            self.in_regions = false;
            return Ok(());
        }
        if self.binary {
            return self.cursor.take(numbers.saturating_mul(kind.bytes()), "an array").map(|_| ());
        }
        self.skip_words(place, declared)
    }

    fn skip_words(&mut self, place: LazyPosition, count: u64) -> Result<(), MeshError> {
        let count = self.cursor.count(place, "numbers of an array", count, 2, u64::MAX)?;
        for _ in 0..count {
            self.cursor.token();
        }
        Ok(())
    }

    /// A line of text, or in binary files a length and that many bytes.
    fn skip_string(&mut self) -> Result<(), MeshError> {
        let place = self.here();
        if !self.binary {
            let end = || self.cursor.malformed(place, "the file ends where a string is expected");
            return self.cursor.clone().next_line().ok_or_else(end).map(|_| {
                self.cursor.next_line();
            });
        }
        // The two highest bits of the length tell how many bytes it has.
        let first = self.cursor.remaining().first().copied().unwrap_or_default();
        let width = 1 << (3 - (first >> 6));
        let mut length = 0u64;
        for (k, &byte) in self.cursor.take(width, "the length of a string")?.iter().enumerate() {
            length = length << 8 | u64::from(if k == 0 { byte & 0x3f } else { byte });
        }
        let length = usize::try_from(length).unwrap_or(usize::MAX);
        self.cursor.take(length, "a string").map(|_| ())
    }

    /// An array of point or cell data; whether its keyword is known.
    fn attribute(
        &mut self,
        place: LazyPosition,
        keyword: &str,
        words: &[&str],
        data: Data,
        count: usize,
    ) -> Result<bool, MeshError> {
        match (keyword, words) {
            ("FIELD", [_, arrays]) => self.field(place, arrays, Some((data, count)))?,
            ("SCALARS", [name, kind, rest @ ..]) => {
                let components: usize = rest.first().and_then(|n| n.parse().ok()).unwrap_or(1);
                let mut ahead = self.cursor.clone();
                if ahead.token().eq_ignore_ascii_case(b"LOOKUP_TABLE") {
                    self.cursor.skip_space();
                    self.cursor.next_line();
                }
                let is_region = data == Data::OfCells && components == 1;
                self.array(place, name, count.saturating_mul(components), kind, is_region)?;
            }
            ("COLOR_SCALARS", [name, components]) => {
                let components: usize = components.parse().unwrap_or(1);
                let kind = if self.binary { "unsigned_char" } else { "float" };
                self.array(place, name, count.saturating_mul(components), kind, false)?;
            }
            ("LOOKUP_TABLE", [name, size]) => {
                let kind = if self.binary { "unsigned_char" } else { "float" };
                let size: usize = size.parse().unwrap_or(0);
                self.array(place, name, size.saturating_mul(4), kind, false)?;
            }
            ("VECTORS" | "NORMALS", [name, kind]) => {
                self.array(place, name, count.saturating_mul(3), kind, false)?;
            }
            ("TEXTURE_COORDINATES", [name, dimension, kind]) => {
                let dimension: usize = dimension.parse().unwrap_or(2);
                self.array(place, name, count.saturating_mul(dimension), kind, false)?;
            }
            ("TENSORS", [name, kind]) => self.array(place, name, count.saturating_mul(9), kind, false)?,
            ("TENSORS6", [name, kind]) => self.array(place, name, count.saturating_mul(6), kind, false)?,
            ("GLOBAL_IDS" | "PEDIGREE_IDS", [name, kind]) => self.array(place, name, count, kind, false)?,
            _ => return Ok(false),
        }
        Ok(true)
    }

    fn skip_paragraph(&mut self) {
        while self.cursor.next_line().is_some_and(|line| !line.trim_ascii().is_empty()) {}
    }
}

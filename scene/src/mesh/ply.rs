//! PLY surfaces, ASCII and binary of either byte order (G. Turk, "The PLY polygon file format", 1994): the positions of
//! `vertex` and the corners of `face` (or the strips of `tristrips`); other elements and properties are skipped.

use std::path::Path;

use nalgebra::Point3;

use super::cells::{Cell, CellShape, Grid};
use super::cursor::{Cursor, LazyPosition, Order, quoted};
use super::data::SurfaceData;
use super::error::{FilePosition, MeshError};
use super::file::SurfaceFile;
use super::limits::Limits;
use super::number_kind::NumberKind;

/// Largest number of elements and of properties of one.
const DECLARED_MAX: usize = 256;

#[derive(Clone, Copy, PartialEq, Eq)]
enum Format {
    Ascii,
    Binary(Order),
}

/// The type of a property: a number, or a list of them with the type of its length.
#[derive(Clone, Copy)]
enum PropertyKind {
    Number(NumberKind),
    List(NumberKind, NumberKind),
}

struct Property {
    name: String,
    kind: PropertyKind,
}

struct Element {
    name: String,
    count: usize,
    place: LazyPosition,
    properties: Vec<Property>,
}

/// Reads a PLY surface. `file` is for messages only.
///
/// # Errors
/// Names the line or byte and the reason.
pub fn read_ply(file: &Path, bytes: &[u8], limits: &Limits) -> Result<SurfaceData, MeshError> {
    read_ply_file(file, bytes, limits).map(|read| read.surface)
}

/// Like [`read_ply`], with the face of each triangle.
pub(super) fn read_ply_file(file: &Path, bytes: &[u8], limits: &Limits) -> Result<SurfaceFile, MeshError> {
    let mut cursor = Cursor::of_text(file, bytes, limits)?;
    let (format, elements) = header(&mut cursor)?;
    let mut body = Body { cursor, format };
    let mut grid = Grid { word: "face", ..Grid::default() };
    let whole = LazyPosition::Known(FilePosition::Whole);
    let mut has_vertices = false;
    for element in &elements {
        match element.name.as_str() {
            "vertex" | "vertices" if !has_vertices => {
                has_vertices = true;
                body.vertices(element, &mut grid)?;
            }
            "face" | "faces" | "tristrips" => body.faces(element, &mut grid)?,
            _ => body.skip(element)?,
        }
    }
    let cursor = body.cursor;
    let vertices = grid.positions.len();
    if let Some(cell) = grid.cells.iter().find(|cell| {
        let corners = &grid.corners[cell.first..cell.first + cell.corners as usize];
        corners.iter().any(|&corner| corner as usize >= vertices)
    }) {
        let corners = &grid.corners[cell.first..cell.first + cell.corners as usize];
        let corner = corners.iter().find(|&&corner| corner as usize >= vertices).copied().unwrap_or_default();
        return Err(cursor.out_of_range(whole, "face", cell.number as usize, corner.into(), vertices));
    }
    if grid.cells.is_empty() {
        return Err(cursor.malformed(whole, "there is no face in the file: points alone are no surface"));
    }
    grid.into_surface(&cursor)
}

/// Everything up to `end_header`.
fn header(cursor: &mut Cursor) -> Result<(Format, Vec<Element>), MeshError> {
    let place = cursor.line();
    let first = cursor.next_text_line("'ply'")?;
    if !first.eq_ignore_ascii_case("ply") {
        return Err(cursor.malformed(place, format!("'ply' is expected, found {}", quoted(first.as_bytes()))));
    }
    let mut format = None;
    let mut elements: Vec<Element> = Vec::new();
    loop {
        let place = cursor.line();
        let line = cursor.next_text_line("a line of the header, or 'end_header'")?;
        let lower = line.to_ascii_lowercase();
        let words: Vec<&str> = lower.split_whitespace().collect();
        match words.as_slice() {
            [] | ["comment" | "obj_info", ..] => {}
            ["format", kind, ..] => {
                format = Some(match *kind {
                    "ascii" => Format::Ascii,
                    "binary_little_endian" => Format::Binary(Order::Little),
                    "binary_big_endian" => Format::Binary(Order::Big),
                    _ => {
                        let supported = "ascii, binary_little_endian, binary_big_endian";
                        return Err(cursor.unsupported(place, quoted(line.as_bytes()), supported));
                    }
                });
            }
            ["element", name, count] if elements.len() < DECLARED_MAX => {
                let count = count.parse::<u64>().map_err(|_| {
                    cursor.malformed(place, format!("a number of elements is expected, found '{count}'"))
                })?;
                let limit = cursor.limits.elements.max(cursor.limits.vertices);
                if count > limit {
                    return Err(cursor.too_large(place, "elements", count, limit));
                }
                let (name, count, properties) = ((*name).to_owned(), count as usize, Vec::new());
                elements.push(Element { name, count, place, properties });
            }
            ["property", rest @ ..] if elements.last().is_some_and(|e| e.properties.len() < DECLARED_MAX) => {
                let kind = |name: &str| NumberKind::parse(cursor, place, name);
                let property = match rest {
                    ["list", length, item, name] => Property {
                        name: (*name).into(),
                        kind: PropertyKind::List(kind(length)?, kind(item)?),
                    },
                    [number, name] => {
                        Property { name: (*name).into(), kind: PropertyKind::Number(kind(number)?) }
                    }
                    _ => return Err(unexpected(cursor, place, line)),
                };
                if let Some(element) = elements.last_mut() {
                    element.properties.push(property);
                }
            }
            ["end_header"] => break,
            _ => return Err(unexpected(cursor, place, line)),
        }
    }
    let whole = LazyPosition::Known(FilePosition::Whole);
    let format = format.ok_or_else(|| cursor.malformed(whole, "the header has no 'format'"))?;
    Ok((format, elements))
}

fn unexpected(cursor: &Cursor, place: LazyPosition, line: &str) -> MeshError {
    let reason = format!(
        "one of format, comment, obj_info, element NAME COUNT, property TYPE NAME, property list TYPE TYPE NAME, \
         end_header is expected, found {}",
        quoted(line.as_bytes())
    );
    cursor.malformed(place, reason)
}

/// The numbers behind the header.
struct Body<'a> {
    cursor: Cursor<'a>,
    format: Format,
}

impl Body<'_> {
    fn here(&self) -> LazyPosition {
        if self.format == Format::Ascii { self.cursor.line() } else { self.cursor.byte() }
    }

    /// The declared number, when that many can be in the rest of the file.
    fn count(&self, element: &Element, what: &'static str, limit: u64) -> Result<usize, MeshError> {
        let least: u64 = match self.format {
            // A digit and a blank each.
            Format::Ascii => 2 * element.properties.len() as u64,
            Format::Binary(_) => element
                .properties
                .iter()
                .map(|property| match property.kind {
                    PropertyKind::Number(kind) | PropertyKind::List(kind, _) => kind.bytes() as u64,
                })
                .sum(),
        };
        self.cursor.count(element.place, what, element.count as u64, least, limit)
    }

    fn number(&mut self, kind: NumberKind, what: &str) -> Result<f64, MeshError> {
        match self.format {
            Format::Ascii => self.cursor.parse(what),
            Format::Binary(order) => Ok(kind.number(self.cursor.take(kind.bytes(), what)?, order)),
        }
    }

    /// A whole number that is not negative.
    fn index(&mut self, kind: NumberKind, what: &str) -> Result<u32, MeshError> {
        let place = self.here();
        let number = self.number(kind, what)?;
        if (0.0..=f64::from(u32::MAX)).contains(&number) && number.fract() == 0.0 {
            return Ok(number as u32);
        }
        Err(self.cursor.malformed(place, format!("{what} is {number}")))
    }

    fn skip_property(&mut self, property: &Property) -> Result<(), MeshError> {
        match property.kind {
            PropertyKind::Number(kind) => self.number(kind, "a number").map(|_| ()),
            PropertyKind::List(length, item) => {
                let count = self.index(length, "the length of a list")? as usize;
                match self.format {
                    Format::Binary(_) => {
                        let bytes = count.saturating_mul(item.bytes());
                        self.cursor.take(bytes, "a list").map(|_| ())
                    }
                    Format::Ascii => {
                        (0..count).try_for_each(|_| self.cursor.parse::<f64>("a number").map(|_| ()))
                    }
                }
            }
        }
    }

    fn skip(&mut self, element: &Element) -> Result<(), MeshError> {
        if element.properties.is_empty() {
            return Ok(());
        }
        let count = self.count(element, "elements", u64::MAX)?;
        for _ in 0..count {
            element.properties.iter().try_for_each(|property| self.skip_property(property))?;
        }
        Ok(())
    }

    fn vertices(&mut self, element: &Element, grid: &mut Grid) -> Result<(), MeshError> {
        let mut axes = [None; 3];
        for (k, property) in element.properties.iter().enumerate() {
            let axis = ["x", "y", "z"].into_iter().position(|axis| axis == property.name);
            if let (Some(axis), PropertyKind::Number(_)) = (axis, property.kind) {
                axes[axis] = Some(k);
            }
        }
        if axes.contains(&None) {
            return Err(self.cursor.malformed(element.place, "a vertex needs the properties x, y and z"));
        }
        let count = self.count(element, "vertices", self.cursor.limits.vertices)?;
        grid.positions.reserve(count);
        for index in 0..count {
            let mut point = [0.0; 3];
            let place = self.here();
            for (k, property) in element.properties.iter().enumerate() {
                match (axes.iter().position(|axis| *axis == Some(k)), property.kind) {
                    (Some(axis), PropertyKind::Number(kind)) => {
                        point[axis] = self.number(kind, ["x", "y", "z"][axis])?;
                    }
                    _ => self.skip_property(property)?,
                }
            }
            self.cursor.finite(place, "vertex", index, &point)?;
            grid.positions.push(Point3::from(point));
        }
        Ok(())
    }

    fn faces(&mut self, element: &Element, grid: &mut Grid) -> Result<(), MeshError> {
        let names = ["vertex_indices", "vertex_index", "vertex_indexes"];
        let list = |property: &Property| {
            names.contains(&property.name.as_str()) && matches!(property.kind, PropertyKind::List(..))
        };
        let Some(which) = element.properties.iter().position(list) else {
            let reason = format!("'{}' needs a list property vertex_indices", element.name);
            return Err(self.cursor.malformed(element.place, reason));
        };
        let strips = element.name == "tristrips";
        let count = self.count(element, "faces", self.cursor.limits.elements)?;
        for index in 0..count {
            let place = self.here();
            for (k, property) in element.properties.iter().enumerate() {
                match property.kind {
                    PropertyKind::List(length, item) if k == which => {
                        let corners = self.index(length, "the number of corners of a face")?;
                        if strips {
                            self.strips(corners, item, index as u64, grid)?;
                            continue;
                        }
                        let first = grid.corners.len();
                        for _ in 0..corners {
                            let corner = self.index(item, "a corner of a face")?;
                            grid.corners.push(corner);
                        }
                        let (shape, number) = (CellShape::Polygon, index as u64);
                        let cell = Cell { shape, higher_order: false, first, corners, number, region: 0 };
                        grid.add(&self.cursor, place, cell)?;
                    }
                    _ => self.skip_property(property)?,
                }
            }
        }
        Ok(())
    }

    /// A list of corners of strips with −1 between them.
    fn strips(
        &mut self,
        count: u32,
        kind: NumberKind,
        number: u64,
        grid: &mut Grid,
    ) -> Result<(), MeshError> {
        let mut first = grid.corners.len();
        for k in 0..=count {
            let place = self.here();
            let ends = k == count || {
                let corner = self.number(kind, "a corner of a strip")?;
                let valid = (0.0..=f64::from(u32::MAX)).contains(&corner) && corner.fract() == 0.0;
                if valid {
                    grid.corners.push(corner as u32);
                } else if corner != -1.0 {
                    return Err(self.cursor.malformed(place, format!("a corner of a strip is {corner}")));
                }
                !valid
            };
            let corners = (grid.corners.len() - first) as u32;
            if ends && corners > 0 {
                let shape = CellShape::Strip;
                let cell = Cell { shape, higher_order: false, first, corners, number, region: 0 };
                grid.add(&self.cursor, place, cell)?;
                first = grid.corners.len();
            }
        }
        Ok(())
    }
}

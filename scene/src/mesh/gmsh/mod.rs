//! Gmsh meshes, versions 2.0 to 2.2, 4.0 and 4.1, ASCII and (2.2, 4.1) binary of either byte order (C. Geuzaine and J.-F. Remacle,
//! "Gmsh: a 3-D finite element mesh generator", 2009; reference manual, chapter "MSH file format").
//!
//! A file with solid elements is a volume, one with triangles and quadrilaterals alone is a surface. Physical groups of
//! dimension 3 are the regions of a volume. Nodes are numbered in the order of the file.

mod v2;
mod v4;

use std::collections::{BTreeMap, HashMap};
use std::path::Path;

use nalgebra::Point3;

use super::cells::{Cell, CellShape, Grid};
use super::cursor::{Cursor, LazyPosition, Order, is_word, quoted};
use super::data::{LineData, SurfaceData, TetData};
use super::error::{FilePosition, MeshError};
use super::file::MeshFile;
use super::limits::Limits;

const SUPPORTED_VERSIONS: &str = "2.2 and 4.1 (2.0, 2.1 and 4.0 as text)";
const SUPPORTED_ELEMENTS: &str =
    "points, lines, triangles, quadrilaterals, tetrahedra, hexahedra, prisms, pyramids";
/// Longest name of a physical group \[bytes\].
const NAME_MAX: usize = 128;

/// Encoding of numbers in a section.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Encoding {
    Ascii,
    Binary(Order),
}

/// Layout of sections.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Version {
    V2,
    V40,
    V41,
}

/// Data read so far.
struct Reading {
    grid: Grid,
    /// Index of each node by its number in the file. Looked up only, so its order does not matter.
    index_of: HashMap<u64, u32>,
    nodes_read: bool,
    elements_read: bool,
    /// Names of groups by dimension and number.
    names: BTreeMap<(i32, i32), String>,
}

/// Reads a Gmsh volume. `file` is for messages only. Unused nodes stay ([`TetData::compact`] drops them), and so
/// do inverted tetrahedra ([`TetData::flip_inverted`]).
///
/// # Errors
/// Names the line or byte and the reason.
pub fn read_gmsh(file: &Path, bytes: &[u8], limits: &Limits) -> Result<TetData, MeshError> {
    let (grid, cursor) = read(file, bytes, limits)?;
    Ok(grid.into_tets(&cursor)?.volume)
}

/// Reads the triangles and quadrilaterals of a Gmsh file. `file` is for messages only.
///
/// # Errors
/// Names the line or byte and the reason.
pub fn read_gmsh_surface(file: &Path, bytes: &[u8], limits: &Limits) -> Result<SurfaceData, MeshError> {
    let (grid, cursor) = read(file, bytes, limits)?;
    Ok(grid.into_surface(&cursor)?.surface)
}

/// Reads the lines of a Gmsh file; all else is skipped. `file` is for messages only.
///
/// # Errors
/// Names the line or byte and the reason.
pub fn read_gmsh_line(file: &Path, bytes: &[u8], limits: &Limits) -> Result<LineData, MeshError> {
    let (grid, cursor) = read(file, bytes, limits)?;
    grid.into_lines(&cursor)
}

/// Reads a volume, or a surface when there are no solid elements.
pub(super) fn read_gmsh_file(file: &Path, bytes: &[u8], limits: &Limits) -> Result<MeshFile, MeshError> {
    let (grid, cursor) = read(file, bytes, limits)?;
    grid.into_file(&cursor)
}

fn read<'a>(file: &'a Path, bytes: &'a [u8], limits: &'a Limits) -> Result<(Grid, Cursor<'a>), MeshError> {
    let mut cursor = Cursor::of_text(file, bytes, limits)?;
    let mut format: Option<(Version, Encoding)> = None;
    let mut groups = v4::PhysicalGroups::new();
    let mut reading = Reading {
        grid: Grid { word: "element", ..Grid::default() },
        index_of: HashMap::new(),
        nodes_read: false,
        elements_read: false,
        names: BTreeMap::new(),
    };
    loop {
        cursor.skip_space();
        let place = cursor.line();
        let start = cursor.clone();
        let Some(line) = cursor.next_line() else { break };
        let Some(section) = line.strip_prefix(b"$") else {
            return Err(
                cursor.malformed(place, format!("a section ($Name) is expected, found {}", quoted(line)))
            );
        };
        let section = section.trim_ascii();
        match (section.to_ascii_lowercase().as_slice(), format) {
            (b"meshformat", None) => format = Some(mesh_format(&mut cursor)?),
            (b"meshformat", Some(_)) => return Err(cursor.malformed(place, "a second $MeshFormat")),
            (b"nod" | b"noe" | b"elm", None) => {
                return Err(cursor.unsupported(place, "Gmsh version 1", SUPPORTED_VERSIONS));
            }
            (b"comments" | b"comment", None) => {
                skip_section(&mut cursor, section, &start)?;
                continue;
            }
            (_, None) => {
                let reason =
                    format!("$MeshFormat is expected first, found ${}", String::from_utf8_lossy(section));
                return Err(cursor.malformed(place, reason));
            }
            (b"physicalnames", Some(_)) => reading.physical_names(&mut cursor)?,
            (b"entities", Some((version @ (Version::V40 | Version::V41), encoding))) => {
                groups = v4::entities(&mut cursor, version, encoding)?;
            }
            (b"nodes", Some((version, encoding))) => {
                if std::mem::replace(&mut reading.nodes_read, true) {
                    return Err(cursor.malformed(place, "a second $Nodes"));
                }
                match version {
                    Version::V2 => v2::nodes(&mut cursor, encoding, &mut reading)?,
                    _ => v4::nodes(&mut cursor, version, encoding, &mut reading)?,
                }
            }
            (b"elements", Some((version, encoding))) => {
                if !reading.nodes_read {
                    return Err(cursor.malformed(place, "$Elements stands before $Nodes"));
                }
                if std::mem::replace(&mut reading.elements_read, true) {
                    return Err(cursor.malformed(place, "a second $Elements"));
                }
                match version {
                    Version::V2 => v2::elements(&mut cursor, encoding, &mut reading)?,
                    _ => v4::elements(&mut cursor, version, encoding, &mut reading, &groups)?,
                }
            }
            (_, Some(_)) => {
                skip_section(&mut cursor, section, &start)?;
                continue;
            }
        }
        end_of_section(&mut cursor, section)?;
    }
    let missing = match format {
        None => Some("$MeshFormat"),
        Some(_) if !reading.nodes_read => Some("$Nodes"),
        Some(_) if !reading.elements_read => Some("$Elements"),
        Some(_) => None,
    };
    if let Some(missing) = missing {
        return Err(cursor.malformed(
            LazyPosition::Known(FilePosition::Whole),
            format!("the file ends without {missing}"),
        ));
    }
    Ok((reading.into_grid(), cursor))
}

fn mesh_format(cursor: &mut Cursor) -> Result<(Version, Encoding), MeshError> {
    let place = cursor.line();
    let line = cursor.next_text_line("version, file type and data size")?;
    let mut words = line.split_whitespace();
    let version = match words.next() {
        Some("2" | "2.0" | "2.1" | "2.2") => Version::V2,
        Some("4" | "4.0") => Version::V40,
        Some("4.1") => Version::V41,
        other => {
            let what = format!("Gmsh version {}", quoted(other.unwrap_or("").as_bytes()));
            return Err(cursor.unsupported(place, what, SUPPORTED_VERSIONS));
        }
    };
    let binary = match words.next() {
        Some("0") => false,
        Some("1") => true,
        _ => return Err(cursor.malformed(place, "the file type must be 0 (ASCII) or 1 (binary)")),
    };
    if words.next() != Some("8") {
        return Err(cursor.unsupported(place, "a data size other than 8", "8 bytes"));
    }
    if !binary {
        return Ok((version, Encoding::Ascii));
    }
    if version == Version::V40 {
        return Err(cursor.unsupported(place, "a binary file of version 4.0", SUPPORTED_VERSIONS));
    }
    let place = cursor.byte();
    let order = match cursor.u32(Order::Little, "the byte order mark")? {
        1 => Order::Little,
        0x0100_0000 => Order::Big,
        other => return Err(cursor.malformed(place, format!("the byte order mark is {other:#x}, not 1"))),
    };
    Ok((version, Encoding::Binary(order)))
}

fn end_of_section(cursor: &mut Cursor, section: &[u8]) -> Result<(), MeshError> {
    let token = cursor.token();
    if is_end_of(token, section) {
        return Ok(());
    }
    let name = String::from_utf8_lossy(section).into_owned();
    let found = if token.is_empty() { "the end of the file".into() } else { quoted(token) };
    Err(cursor.malformed(cursor.line(), format!("$End{name} is expected, found {found}")))
}

/// Whether a word is the end mark of a section, in any capitals.
fn is_end_of(word: &[u8], section: &[u8]) -> bool {
    word.get(..4).is_some_and(|begin| is_word(begin, "$End")) && word[4..].eq_ignore_ascii_case(section)
}

/// Skips a section that is not needed, by looking for its end mark.
fn skip_section(cursor: &mut Cursor, section: &[u8], start: &Cursor) -> Result<(), MeshError> {
    while let Some(line) = cursor.next_line() {
        if is_end_of(line.trim_ascii(), section) {
            return Ok(());
        }
    }
    let name = quoted(section);
    Err(start.malformed(start.line(), format!("section {name} is not ended before the file is")))
}

impl Reading {
    fn reserve_nodes(&mut self, count: usize) {
        self.grid.positions.reserve(count);
        self.grid.nodes.reserve(count);
        self.index_of.reserve(count);
    }

    fn add_node(
        &mut self,
        cursor: &Cursor,
        place: LazyPosition,
        number: u64,
        point: [f64; 3],
    ) -> Result<(), MeshError> {
        let index = self.grid.positions.len() as u32;
        if self.index_of.insert(number, index).is_some() {
            return Err(cursor.malformed(place, format!("node number {number} appears twice")));
        }
        self.grid.positions.push(Point3::from(point));
        self.grid.nodes.push(number);
        Ok(())
    }

    /// Adds an element; `node` gives the numbers of its nodes in turn.
    fn add_element(
        &mut self,
        cursor: &mut Cursor,
        place: LazyPosition,
        (number, kind, region): (u64, ElementKind, i32),
        mut node: impl FnMut(&mut Cursor) -> Result<u64, MeshError>,
    ) -> Result<(), MeshError> {
        let first = self.grid.corners.len();
        for k in 0..kind.nodes {
            let written = node(cursor)?;
            if k >= kind.corners || kind.shape == CellShape::Point {
                continue;
            }
            let Some(&index) = self.index_of.get(&written) else {
                let vertices = self.grid.positions.len();
                return Err(cursor.out_of_range(place, "element", number as usize, written as i64, vertices));
            };
            self.grid.corners.push(index);
        }
        if kind.shape == CellShape::Point {
            return Ok(());
        }
        if kind.shape == CellShape::Line && self.grid.corners[first] == self.grid.corners[first + 1] {
            return Err(cursor.malformed(place, format!("element {number} goes from a node to itself")));
        }
        let (shape, higher_order) = (kind.shape, kind.nodes > kind.corners);
        let corners = kind.corners as u32;
        self.grid.add(cursor, place, Cell { shape, higher_order, first, corners, number, region })
    }

    /// `dimension number "name"`, one a line.
    fn physical_names(&mut self, cursor: &mut Cursor) -> Result<(), MeshError> {
        let place = cursor.line();
        let declared: u64 = cursor.parse("the number of physical names")?;
        let count = cursor.count(place, "physical names", declared, 6, cursor.limits.elements)?;
        cursor.next_line();
        for _ in 0..count {
            let place = cursor.line();
            let line = cursor.next_text_line("a physical name")?;
            let mut words = line.splitn(3, char::is_whitespace);
            let dimension = words.next().and_then(|word| word.parse().ok());
            let rest = words.next().zip(words.next());
            let parsed = dimension.zip(rest.and_then(|(number, name)| {
                let name: String = name.trim().trim_matches('"').chars().take(NAME_MAX).collect();
                Some((number.parse().ok()?, name))
            }));
            let Some((dimension, (number, name))) = parsed else {
                let reason =
                    format!("dimension, number and name are expected, found {}", quoted(line.as_bytes()));
                return Err(cursor.malformed(place, reason));
            };
            self.names.insert((dimension, number), name);
        }
        Ok(())
    }

    fn into_grid(mut self) -> Grid {
        let solid = |cell: &&Cell| cell.shape.corners().is_some();
        self.grid.has_regions = self.grid.cells.iter().filter(solid).any(|cell| cell.region != 0);
        let names = self.names.into_iter().filter(|((dimension, _), _)| *dimension == 3);
        self.grid.region_names = names.map(|((_, number), name)| (number, name)).collect();
        self.grid
    }
}

/// An element type: its corners come first among its nodes.
#[derive(Clone, Copy)]
struct ElementKind {
    shape: CellShape,
    corners: usize,
    nodes: usize,
}

/// Gmsh's element types.
fn element_kind(cursor: &Cursor, place: LazyPosition, kind: i64) -> Result<ElementKind, MeshError> {
    use CellShape::{Hexahedron, Line, Point, Polygon, Pyramid, Tetrahedron, Wedge};
    let (shape, corners, nodes) = match kind {
        15 => (Point, 1, 1),
        1 => (Line, 2, 2),
        8 => (Line, 2, 3),
        26 => (Line, 2, 4),
        27 => (Line, 2, 5),
        28 => (Line, 2, 6),
        2 => (Polygon, 3, 3),
        9 => (Polygon, 3, 6),
        20 => (Polygon, 3, 9),
        21 => (Polygon, 3, 10),
        22 => (Polygon, 3, 12),
        23 | 24 => (Polygon, 3, 15),
        25 => (Polygon, 3, 21),
        3 => (Polygon, 4, 4),
        10 => (Polygon, 4, 9),
        16 => (Polygon, 4, 8),
        4 => (Tetrahedron, 4, 4),
        11 => (Tetrahedron, 4, 10),
        29 => (Tetrahedron, 4, 20),
        30 => (Tetrahedron, 4, 35),
        31 => (Tetrahedron, 4, 56),
        5 => (Hexahedron, 8, 8),
        12 => (Hexahedron, 8, 27),
        17 => (Hexahedron, 8, 20),
        92 => (Hexahedron, 8, 64),
        93 => (Hexahedron, 8, 125),
        6 => (Wedge, 6, 6),
        13 => (Wedge, 6, 18),
        18 => (Wedge, 6, 15),
        7 => (Pyramid, 5, 5),
        14 => (Pyramid, 5, 14),
        19 => (Pyramid, 5, 13),
        _ => return Err(cursor.unsupported(place, format!("element type {kind}"), SUPPORTED_ELEMENTS)),
    };
    Ok(ElementKind { shape, corners, nodes })
}

//! Gmsh meshes of tetrahedra or of lines, versions 2.2 and 4.1, ASCII and binary of either byte order
//! (C. Geuzaine and J.-F. Remacle, "Gmsh: a 3-D finite element mesh generator", 2009; reference manual, chapter
//! "MSH file format").
//!
//! Points, surface elements and (when reading volumes) lines are skipped. Other volume elements are refused: without
//! its hexahedra a volume would have holes and still look valid. Nodes are numbered in the order of the file.

use std::collections::HashMap;
use std::path::Path;

use nalgebra::Point3;

use super::cursor::{Cursor, LazyPosition, Order, quoted};
use super::data::{LineData, TetData};
use super::error::{FilePosition, MeshError};
use super::limits::Limits;
use super::{gmsh_v2, gmsh_v4};

const SUPPORTED_VERSIONS: &str = "2.2 and 4.1";
const SUPPORTED_VOLUMES: &str = "first-order tetrahedra (type 4)";

/// Encoding of numbers in a section.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Encoding {
    Ascii,
    Binary(Order),
}

/// Data read so far.
#[derive(Default)]
pub(super) struct Volume {
    pub positions: Vec<Point3<f64>>,
    /// Index of each node by its number in the file. Looked up only, so its order does not matter.
    pub index_of: HashMap<u64, u32>,
    pub nodes_read: bool,
    pub elements_read: bool,
    pub tets: Vec<[u32; 4]>,
    pub tags: Vec<i32>,
    /// Lines of two nodes, when lines are read; then nothing else is read.
    pub lines: Option<Vec<[u32; 2]>>,
}

/// Reads a Gmsh volume. `file` is for messages only. Unused nodes stay ([`TetData::compact`] drops them), and so
/// do inverted tetrahedra ([`TetData::flip_inverted`]).
///
/// # Errors
/// Names the line or byte and the reason.
pub fn read_gmsh(file: &Path, bytes: &[u8], limits: &Limits) -> Result<TetData, MeshError> {
    let volume = read(file, bytes, limits, Volume::default())?;
    Ok(TetData { positions: volume.positions, tets: volume.tets, tags: volume.tags })
}

/// Reads the lines of two nodes of a Gmsh file; all else is skipped. `file` is for messages only.
///
/// # Errors
/// Names the line or byte and the reason.
pub fn read_gmsh_line(file: &Path, bytes: &[u8], limits: &Limits) -> Result<LineData, MeshError> {
    let wanted = Volume { lines: Some(Vec::new()), ..Volume::default() };
    let volume = read(file, bytes, limits, wanted)?;
    Ok(LineData { positions: volume.positions, segments: volume.lines.unwrap_or_default() })
}

fn read(file: &Path, bytes: &[u8], limits: &Limits, mut volume: Volume) -> Result<Volume, MeshError> {
    let mut cursor = Cursor::new(file, bytes, limits);
    let mut format: Option<(u8, Encoding)> = None;
    let mut physical = gmsh_v4::PhysicalGroups::new();
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
        match (section, format) {
            (b"MeshFormat", None) => format = Some(mesh_format(&mut cursor)?),
            (b"MeshFormat", Some(_)) => return Err(cursor.malformed(place, "a second $MeshFormat")),
            (_, None) => {
                let reason =
                    format!("$MeshFormat is expected first, found ${}", String::from_utf8_lossy(section));
                return Err(cursor.malformed(place, reason));
            }
            (b"Entities", Some((4, encoding))) => physical = gmsh_v4::entities(&mut cursor, encoding)?,
            (b"Nodes", Some((version, encoding))) => {
                if std::mem::replace(&mut volume.nodes_read, true) {
                    return Err(cursor.malformed(place, "a second $Nodes"));
                }
                match version {
                    2 => gmsh_v2::nodes(&mut cursor, encoding, &mut volume)?,
                    _ => gmsh_v4::nodes(&mut cursor, encoding, &mut volume)?,
                }
            }
            (b"Elements", Some((version, encoding))) => {
                if !volume.nodes_read {
                    return Err(cursor.malformed(place, "$Elements stands before $Nodes"));
                }
                if std::mem::replace(&mut volume.elements_read, true) {
                    return Err(cursor.malformed(place, "a second $Elements"));
                }
                match version {
                    2 => gmsh_v2::elements(&mut cursor, encoding, &mut volume)?,
                    _ => gmsh_v4::elements(&mut cursor, encoding, &mut volume, &physical)?,
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
        Some(_) if !volume.nodes_read => Some("$Nodes"),
        Some(_) if !volume.elements_read => Some("$Elements"),
        Some(_) if volume.lines.as_ref().is_some_and(Vec::is_empty) => Some("a line of two nodes"),
        Some(_) if volume.lines.is_none() && volume.tets.is_empty() => Some("a tetrahedron"),
        Some(_) => None,
    };
    if let Some(missing) = missing {
        return Err(cursor.malformed(
            LazyPosition::Known(FilePosition::Whole),
            format!("the file ends without {missing}"),
        ));
    }
    Ok(volume)
}

fn mesh_format(cursor: &mut Cursor) -> Result<(u8, Encoding), MeshError> {
    let place = cursor.line();
    let line = cursor.next_text_line("version, file type and data size")?;
    let mut words = line.split_whitespace();
    let version = match words.next() {
        Some("2.2") => 2,
        Some("4.1") => 4,
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
    if token.strip_prefix(b"$End") == Some(section) {
        return Ok(());
    }
    let name = String::from_utf8_lossy(section).into_owned();
    let found = if token.is_empty() { "the end of the file".into() } else { quoted(token) };
    Err(cursor.malformed(cursor.line(), format!("$End{name} is expected, found {found}")))
}

/// Skips a section that is not needed, by looking for its end mark.
fn skip_section(cursor: &mut Cursor, section: &[u8], start: &Cursor) -> Result<(), MeshError> {
    let mark = [b"\n$End", section].concat();
    // One byte back: the end mark of an empty section follows the line break of its own header.
    cursor.seek(cursor.position().saturating_sub(1));
    match cursor.remaining().windows(mark.len()).position(|window| window == mark) {
        Some(offset) => {
            cursor.seek(cursor.position() + offset + mark.len());
            cursor.next_line();
            Ok(())
        }
        None => {
            let name = quoted(section);
            Err(start.malformed(start.line(), format!("section {name} is not ended before the file is")))
        }
    }
}

impl Volume {
    pub fn reserve_nodes(&mut self, count: usize) {
        self.positions.reserve(count);
        self.index_of.reserve(count);
    }

    pub fn add_node(
        &mut self,
        cursor: &Cursor,
        place: LazyPosition,
        tag: u64,
        point: [f64; 3],
    ) -> Result<(), MeshError> {
        let index = self.positions.len() as u32;
        if self.index_of.insert(tag, index).is_some() {
            return Err(cursor.malformed(place, format!("node number {tag} appears twice")));
        }
        self.positions.push(Point3::from(point));
        Ok(())
    }

    pub fn add_tet(
        &mut self,
        cursor: &Cursor,
        place: LazyPosition,
        nodes: [u64; 4],
        tag: i32,
    ) -> Result<(), MeshError> {
        if self.lines.is_some() {
            return Ok(());
        }
        let tet = self.vertices(cursor, place, ("tetrahedron", self.tets.len()), nodes)?;
        self.tets.push(tet);
        self.tags.push(tag);
        Ok(())
    }

    /// Adds a line of two nodes, when lines are read.
    pub fn add_line(
        &mut self,
        cursor: &Cursor,
        place: LazyPosition,
        nodes: [u64; 2],
    ) -> Result<(), MeshError> {
        let Some(lines) = &self.lines else { return Ok(()) };
        let ends = self.vertices(cursor, place, ("line", lines.len()), nodes)?;
        if ends[0] == ends[1] {
            return Err(cursor.malformed(place, format!("a line goes from node {} to itself", nodes[0])));
        }
        self.lines.get_or_insert_default().push(ends);
        Ok(())
    }

    fn vertices<const N: usize>(
        &self,
        cursor: &Cursor,
        place: LazyPosition,
        (element, index): (&'static str, usize),
        nodes: [u64; N],
    ) -> Result<[u32; N], MeshError> {
        let mut vertices = [0; N];
        for (vertex, node) in vertices.iter_mut().zip(nodes) {
            *vertex = *self.index_of.get(&node).ok_or_else(|| {
                cursor.out_of_range(place, element, index, node as i64, self.positions.len())
            })?;
        }
        Ok(vertices)
    }
}

/// Handling of an element type.
pub(super) enum ElementKind {
    Tetrahedron,
    Line,
    /// Skipped; with this number of nodes.
    Lower(usize),
}

/// Gmsh's element types of dimension 0 to 2, with their number of nodes, and the tetrahedron.
pub(super) fn element_kind(
    cursor: &Cursor,
    place: LazyPosition,
    kind: i64,
) -> Result<ElementKind, MeshError> {
    Ok(match kind {
        4 => ElementKind::Tetrahedron,
        1 => ElementKind::Line,
        2 => ElementKind::Lower(3),
        3 => ElementKind::Lower(4),
        8 => ElementKind::Lower(3),
        9 => ElementKind::Lower(6),
        10 => ElementKind::Lower(9),
        15 => ElementKind::Lower(1),
        16 => ElementKind::Lower(8),
        20 => ElementKind::Lower(9),
        21 => ElementKind::Lower(10),
        22 => ElementKind::Lower(12),
        23 => ElementKind::Lower(15),
        24 => ElementKind::Lower(15),
        25 => ElementKind::Lower(21),
        26 => ElementKind::Lower(4),
        27 => ElementKind::Lower(5),
        28 => ElementKind::Lower(6),
        _ => {
            let name = match kind {
                5 => " (hexahedron)",
                6 => " (prism)",
                7 => " (pyramid)",
                11 => " (second-order tetrahedron)",
                _ => "",
            };
            return Err(cursor.unsupported(place, format!("element type {kind}{name}"), SUPPORTED_VOLUMES));
        }
    })
}

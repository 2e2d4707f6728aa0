//! VTK files: the legacy format ([`legacy`]) and the XML formats `.vtu` and `.vtp` ([`xml`]). The content tells which one a
//! file is, not its name ("VTK File Formats", Kitware).
//!
//! A file with solid cells is a volume, one with triangles, polygons and strips alone is a surface. A cell array of whole
//! numbers with one of the [usual names](REGION_ARRAYS) gives the regions of a volume; other data is skipped.

mod legacy;
mod xml;

use std::path::Path;

use super::cells::{Cell, CellShape, Grid};
use super::cursor::{Cursor, LazyPosition};
use super::data::{LineData, SurfaceData, TetData};
use super::error::{FilePosition, MeshError};
use super::file::MeshFile;
use super::limits::Limits;

const WHOLE: LazyPosition = LazyPosition::Known(FilePosition::Whole);

/// Names of cell arrays that tell regions, without capitals, blanks, '_', '-' and ':'; the first that a file has counts.
const REGION_ARRAYS: [&str; 16] = [
    "region",
    "regions",
    "regionid",
    "material",
    "materials",
    "materialid",
    "materialids",
    "gmshphysical",
    "physical",
    "physicalgroup",
    "celltags",
    "label",
    "labels",
    "domain",
    "attribute",
    "cellentityids",
];

/// The place of a name in the list of [`REGION_ARRAYS`].
fn region_rank(name: &str) -> Option<usize> {
    let plain: String = name
        .chars()
        .filter(|c| !matches!(c, ' ' | '_' | '-' | ':'))
        .map(|c| c.to_ascii_lowercase())
        .collect();
    REGION_ARRAYS.into_iter().position(|known| known == plain)
}

/// Reads a VTK volume. `file` is for messages only.
///
/// # Errors
/// Names the line or byte and the reason.
pub fn read_vtk(file: &Path, bytes: &[u8], limits: &Limits) -> Result<TetData, MeshError> {
    let (grid, cursor) = read(file, bytes, limits)?;
    Ok(grid.into_tets(&cursor)?.volume)
}

/// Reads the triangles, polygons and strips of a VTK file. `file` is for messages only.
///
/// # Errors
/// Names the line or byte and the reason.
pub fn read_vtk_surface(file: &Path, bytes: &[u8], limits: &Limits) -> Result<SurfaceData, MeshError> {
    let (grid, cursor) = read(file, bytes, limits)?;
    Ok(grid.into_surface(&cursor)?.surface)
}

/// Reads the lines and polylines of a VTK file, of an unstructured grid or of poly data; all else is skipped. `file` is for
/// messages only.
///
/// # Errors
/// Names the line or byte and the reason.
pub fn read_vtk_line(file: &Path, bytes: &[u8], limits: &Limits) -> Result<LineData, MeshError> {
    let (grid, cursor) = read(file, bytes, limits)?;
    grid.into_lines(&cursor)
}

/// Reads a volume, or a surface when there are no solid cells.
pub(super) fn read_vtk_file(file: &Path, bytes: &[u8], limits: &Limits) -> Result<MeshFile, MeshError> {
    let (grid, cursor) = read(file, bytes, limits)?;
    grid.into_file(&cursor)
}

fn read<'a>(file: &'a Path, bytes: &'a [u8], limits: &'a Limits) -> Result<(Grid, Cursor<'a>), MeshError> {
    let cursor = Cursor::of_text(file, bytes, limits)?;
    if cursor.remaining().trim_ascii_start().starts_with(b"<") {
        xml::read(cursor)
    } else {
        legacy::read(cursor)
    }
}

/// Cells as ranges of one list of corners.
#[derive(Default)]
struct CellList {
    /// Start of each cell, and end of the last one.
    offsets: Vec<usize>,
    corners: Vec<i64>,
}

impl CellList {
    fn count(&self) -> usize {
        self.offsets.len().saturating_sub(1)
    }

    /// Offsets as a file gives them: they grow, and end within the corners.
    fn new(
        cursor: &Cursor,
        place: LazyPosition,
        begins: &[i64],
        corners: Vec<i64>,
    ) -> Result<Self, MeshError> {
        let mut offsets: Vec<usize> = Vec::with_capacity(begins.len());
        for (k, &begin) in begins.iter().enumerate() {
            let least = offsets.last().copied().unwrap_or(0);
            let valid = usize::try_from(begin)
                .ok()
                .filter(|&b| b >= least && b <= corners.len() && (k > 0 || b == 0));
            let Some(valid) = valid else {
                let reason =
                    format!("offset {k} is {begin}: offsets begin at 0, grow, and end within CONNECTIVITY");
                return Err(cursor.malformed(place, reason));
            };
            offsets.push(valid);
        }
        Ok(Self { offsets, corners })
    }
}

/// Adds cells whose corners count from `base`, with VTK's type of each. `regions` are of each cell, if there are any.
fn add_cells(
    grid: &mut Grid,
    cursor: &Cursor,
    list: &CellList,
    base: usize,
    kind_of: impl Fn(usize) -> i64,
    regions: Option<&[i32]>,
) -> Result<(), MeshError> {
    let vertices = grid.positions.len() - base;
    for k in 0..list.count() {
        let number = grid.cells.len() as u64;
        let corners = &list.corners[list.offsets[k]..list.offsets[k + 1]];
        let Some(kind) = cell_kind(kind_of(k)) else {
            let what = format!("cell {number} of type {}", kind_of(k));
            return Err(cursor.unsupported(WHOLE, what, SUPPORTED_CELLS));
        };
        let first = grid.corners.len();
        let used = kind.corners.unwrap_or(corners.len());
        if used > corners.len() {
            let reason = format!("cell {number} of type {} has {} corners", kind_of(k), corners.len());
            return Err(cursor.malformed(WHOLE, reason));
        }
        for at in 0..used {
            let written = corners[kind.order.get(at).copied().unwrap_or(at)];
            let corner = usize::try_from(written).ok().filter(|&vertex| vertex < vertices);
            let Some(corner) = corner else {
                return Err(cursor.out_of_range(WHOLE, "cell", number as usize, written, vertices));
            };
            grid.corners.push((base + corner) as u32);
        }
        let higher_order = kind.corners.is_some_and(|used| used < corners.len());
        let region = regions.and_then(|regions| regions.get(k)).copied().unwrap_or(0);
        let (shape, corners) = (kind.shape, used as u32);
        grid.add(cursor, WHOLE, Cell { shape, higher_order, first, corners, number, region })?;
    }
    Ok(())
}

/// A type of cell.
struct CellKind {
    shape: CellShape,
    /// How many of its nodes are corners, which come first; all when `None`.
    corners: Option<usize>,
    /// Positions of the corners in the common order, where VTK's differs.
    order: &'static [usize],
}

const SUPPORTED_CELLS: &str = "vertices, lines, triangles, quadrilaterals, polygons and strips, tetrahedra, hexahedra, voxels, \
                               wedges and pyramids, also of higher order (not polyhedra: save them as tetrahedra)";

/// VTK's types of cells.
fn cell_kind(kind: i64) -> Option<CellKind> {
    use CellShape::{Hexahedron, Line, Point, Polygon, Pyramid, Strip, Tetrahedron, Wedge};
    let (shape, corners) = match kind {
        0..=2 => (Point, None),
        4 => (Line, None),
        3 | 21 | 35 | 68 | 75 => (Line, Some(2)),
        5 | 22 | 34 | 69 | 76 => (Polygon, Some(3)),
        6 => (Strip, None),
        7 => (Polygon, None),
        8 | 9 | 23 | 28 | 30 | 70 | 77 => (Polygon, Some(4)),
        10 | 24 | 71 | 78 => (Tetrahedron, Some(4)),
        11 | 12 | 25 | 29 | 33 | 72 | 79 => (Hexahedron, Some(8)),
        13 | 26 | 31 | 32 | 73 | 80 => (Wedge, Some(6)),
        14 | 27 | 37 | 74 | 81 => (Pyramid, Some(5)),
        _ => return None,
    };
    let order: &[usize] = match kind {
        // Pixels and voxels count along their axes.
        8 => &[0, 1, 3, 2],
        11 => &[0, 1, 3, 2, 4, 5, 7, 6],
        _ => &[],
    };
    Some(CellKind { shape, corners, order })
}

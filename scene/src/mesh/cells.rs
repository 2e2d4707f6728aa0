//! Grids of cells as Gmsh and VTK know them, and what becomes of them: a volume of tetrahedra, a surface, or lines.
//!
//! Hexahedra, wedges and pyramids are split into tetrahedra about their corner of the smallest number, and each of their
//! quadrilaterals along the diagonal through its smallest corner, so that neighbours agree on it (J. Dompierre et al.,
//! "How to subdivide pyramids, prisms and hexaedra into tetrahedra", 1999). Cells of higher order count by their corners.

use std::collections::BTreeMap;

use nalgebra::Point3;

use super::cursor::{Cursor, LazyPosition};
use super::data::{LineData, SurfaceData, TetData};
use super::error::{FilePosition, MeshError};
use super::file::{MeshFile, SurfaceFile, TetFile};
use super::obj::joined_repeats;
use super::polygon_face::{CORNERS_MAX, triangles_of};

/// The shape of a cell, with its corners in VTK's and Gmsh's common order.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum CellShape {
    /// Skipped.
    Point,
    Line,
    /// Triangles over each three corners in turn, every other one turned.
    Strip,
    Polygon,
    Tetrahedron,
    Hexahedron,
    Wedge,
    Pyramid,
}

impl CellShape {
    /// Corners of a solid cell.
    pub fn corners(self) -> Option<usize> {
        match self {
            CellShape::Tetrahedron => Some(4),
            CellShape::Hexahedron => Some(8),
            CellShape::Wedge => Some(6),
            CellShape::Pyramid => Some(5),
            _ => None,
        }
    }

    /// Faces of a solid cell, counter-clockwise seen from outside.
    fn faces(self) -> &'static [&'static [usize]] {
        match self {
            CellShape::Tetrahedron => &[&[0, 2, 1], &[0, 1, 3], &[0, 3, 2], &[1, 2, 3]],
            CellShape::Hexahedron => {
                &[&[0, 3, 2, 1], &[4, 5, 6, 7], &[0, 1, 5, 4], &[1, 2, 6, 5], &[2, 3, 7, 6], &[3, 0, 4, 7]]
            }
            CellShape::Wedge => &[&[0, 2, 1], &[3, 4, 5], &[0, 1, 4, 3], &[1, 2, 5, 4], &[2, 0, 3, 5]],
            CellShape::Pyramid => &[&[0, 3, 2, 1], &[0, 1, 4], &[1, 2, 4], &[2, 3, 4], &[3, 0, 4]],
            _ => &[],
        }
    }

    fn name(self) -> &'static str {
        match self {
            CellShape::Hexahedron => "hexahedra",
            CellShape::Wedge => "wedges",
            CellShape::Pyramid => "pyramids",
            _ => "tetrahedra",
        }
    }
}

/// One cell.
#[derive(Clone, Copy, Debug)]
pub(super) struct Cell {
    pub shape: CellShape,
    /// Whether it has nodes besides its corners, which are left out.
    pub higher_order: bool,
    /// Its corners in the list of all.
    pub first: usize,
    pub corners: u32,
    /// Its number in the file.
    pub number: u64,
    /// Its region; 0 when it has none.
    pub region: i32,
}

/// Cells over nodes, with every corner in range.
#[derive(Debug, Default)]
pub(super) struct Grid {
    pub positions: Vec<Point3<f64>>,
    /// The number of each node in the file; empty when they count from 0.
    pub nodes: Vec<u64>,
    pub cells: Vec<Cell>,
    pub corners: Vec<u32>,
    /// Names of the regions of volumes.
    pub region_names: BTreeMap<i32, String>,
    pub has_regions: bool,
    /// What its cells are called: cell, element.
    pub word: &'static str,
}

const WHOLE: LazyPosition = LazyPosition::Known(FilePosition::Whole);

impl Grid {
    pub fn has_volume(&self) -> bool {
        self.cells.iter().any(|cell| cell.shape.corners().is_some())
    }

    /// A volume, or a surface when there is no solid cell.
    pub fn into_file(self, cursor: &Cursor) -> Result<MeshFile, MeshError> {
        if self.has_volume() {
            self.into_tets(cursor).map(MeshFile::Volume)
        } else if self.cells.iter().any(|cell| matches!(cell.shape, CellShape::Strip | CellShape::Polygon)) {
            self.into_surface(cursor).map(MeshFile::Surface)
        } else {
            Err(cursor.malformed(WHOLE, "there is no tetrahedron, triangle or polygon in the file"))
        }
    }

    fn corners_of(&self, cell: &Cell) -> &[u32] {
        &self.corners[cell.first..cell.first + cell.corners as usize]
    }

    /// Sentences about cells that are not taken as they are written.
    fn notes(&self, of: impl Fn(&Cell) -> bool) -> Vec<String> {
        let mut notes = Vec::new();
        let higher = self.cells.iter().filter(|cell| of(cell) && cell.higher_order).count();
        if higher > 0 {
            notes.push(format!("{higher} {}s of higher order were taken by their corners", self.word));
        }
        for shape in [CellShape::Hexahedron, CellShape::Wedge, CellShape::Pyramid] {
            let count = self.cells.iter().filter(|cell| of(cell) && cell.shape == shape).count();
            if count > 0 {
                notes.push(format!("{count} {} were split into tetrahedra", shape.name()));
            }
        }
        notes
    }

    /// The solid cells as tetrahedra.
    pub fn into_tets(self, cursor: &Cursor) -> Result<TetFile, MeshError> {
        let solid = |cell: &Cell| cell.shape.corners().is_some();
        let notes = self.notes(solid);
        let mut volume = TetData::default();
        let mut elements = Vec::new();
        let mut split = Vec::new();
        for cell in self.cells.iter().filter(|cell| solid(cell)) {
            split.clear();
            self.split(cell, &mut split);
            let count = (volume.tets.len() + split.len()) as u64;
            if count > cursor.limits.elements {
                return Err(cursor.too_large(WHOLE, "tetrahedra", count, cursor.limits.elements));
            }
            volume.tets.extend_from_slice(&split);
            volume.tags.resize(volume.tets.len(), cell.region);
            elements.resize(volume.tets.len(), cell.number);
        }
        if volume.tets.is_empty() {
            return Err(cursor.malformed(WHOLE, "there is no tetrahedron in the file"));
        }
        volume.positions = self.positions;
        let (nodes, region_names, has_regions) = (self.nodes, self.region_names, self.has_regions);
        Ok(TetFile { volume, nodes, elements, region_names, has_regions, notes })
    }

    /// Appends the tetrahedra of a solid cell.
    fn split(&self, cell: &Cell, into: &mut Vec<[u32; 4]>) {
        let corners = self.corners_of(cell);
        if let &[a, b, c, d] = corners {
            into.push([a, b, c, d]);
            return;
        }
        let first = into.len();
        let Some(&apex) = corners.iter().min() else { return };
        for face in cell.shape.faces().iter().map(|face| face.iter().map(|&k| corners[k])) {
            let mut polygon = [0; 4];
            let mut count = 0;
            for corner in face {
                polygon[count] = corner;
                count += 1;
            }
            let polygon = &mut polygon[..count];
            if polygon.contains(&apex) {
                continue;
            }
            // The fan about the smallest corner.
            let smallest = (0..count).min_by_key(|&k| polygon[k]).unwrap_or(0);
            polygon.rotate_left(smallest);
            for k in 2..count {
                let [a, b, c] = [polygon[0], polygon[k - 1], polygon[k]];
                // A cell with collapsed edges has fewer tetrahedra.
                if a != b && b != c && c != a {
                    into.push([apex, a, b, c]);
                }
            }
        }
        // VTK's and other programs' wedges run opposite ways round: the sense of its volume decides.
        if cell.shape == CellShape::Wedge {
            let at = |v: u32| self.positions[v as usize];
            let volume =
                |&[a, b, c, d]: &[u32; 4]| (at(b) - at(a)).cross(&(at(c) - at(a))).dot(&(at(d) - at(a)));
            if into[first..].iter().map(volume).sum::<f64>() < 0.0 {
                into[first..].iter_mut().for_each(|tet| tet.swap(2, 3));
            }
        }
    }

    /// The triangles, polygons and strips.
    pub fn into_surface(self, cursor: &Cursor) -> Result<SurfaceFile, MeshError> {
        let flat = |cell: &Cell| matches!(cell.shape, CellShape::Strip | CellShape::Polygon);
        let notes = self.notes(flat);
        let mut triangles: Vec<[u32; 3]> = Vec::new();
        let mut places = Vec::new();
        let mut points = Vec::new();
        for cell in self.cells.iter().filter(|cell| flat(cell)) {
            let corners = self.corners_of(cell);
            if cell.shape == CellShape::Strip {
                for (k, three) in corners.windows(3).enumerate() {
                    let [a, b, c] = [three[0], three[1], three[2]];
                    // Strips are joined by triangles without area.
                    if a != b && b != c && c != a {
                        triangles.push(if k % 2 == 0 { [a, b, c] } else { [b, a, c] });
                    }
                }
            } else {
                let polygon = joined_repeats(corners.to_vec(), |&corner| corner);
                points.clear();
                points.extend(polygon.iter().map(|&v| self.positions[v as usize]));
                let cut = triangles_of(&points).map_err(|why| {
                    cursor.malformed(WHOLE, format!("{} {}: {why}", self.word, cell.number))
                })?;
                triangles.extend(cut.into_iter().map(|t| t.map(|k| polygon[k as usize])));
            }
            places.resize(triangles.len(), cell.number);
            if triangles.len() as u64 > cursor.limits.elements {
                let count = triangles.len() as u64;
                return Err(cursor.too_large(WHOLE, "triangles", count, cursor.limits.elements));
            }
        }
        if triangles.is_empty() {
            return Err(cursor.malformed(WHOLE, "there is no triangle or polygon in the file"));
        }
        let surface = SurfaceData { positions: self.positions, triangles, normals: None, uvs: None };
        Ok(SurfaceFile { surface, place: self.word, places, first_vertex: 0, notes })
    }

    /// The lines and polylines.
    pub fn into_lines(self, cursor: &Cursor) -> Result<LineData, MeshError> {
        let mut segments = Vec::new();
        for cell in self.cells.iter().filter(|cell| cell.shape == CellShape::Line) {
            for pair in self.corners_of(cell).windows(2) {
                if pair[0] == pair[1] {
                    let number = self.nodes.get(pair[0] as usize).copied().unwrap_or(pair[0].into());
                    let reason = format!("{} {} goes from node {number} to itself", self.word, cell.number);
                    return Err(cursor.malformed(WHOLE, reason));
                }
                segments.push([pair[0], pair[1]]);
            }
        }
        if segments.is_empty() {
            return Err(cursor.malformed(WHOLE, "there is no line in the file"));
        }
        Ok(LineData { positions: self.positions, segments })
    }

    /// Adds a cell after checking the number of its corners, which a reader has appended to the list of all.
    pub fn add(&mut self, cursor: &Cursor, place: LazyPosition, cell: Cell) -> Result<(), MeshError> {
        let count = cell.corners as usize;
        let valid = match cell.shape {
            CellShape::Polygon => (3..=CORNERS_MAX).contains(&count),
            CellShape::Strip => count >= 3,
            CellShape::Line => count >= 2,
            CellShape::Point => true,
            solid => solid.corners() == Some(count),
        };
        if !valid {
            let reason = format!("{} {} is a {:?} of {count} corners", self.word, cell.number, cell.shape);
            return Err(cursor.malformed(place, reason));
        }
        self.cells.push(cell);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;
    use crate::mesh::{Limits, validate_surface};

    /// A block of n³ hexahedra with numbers of nodes in a scrambled order.
    fn hexahedra(n: u32) -> Grid {
        let m = n + 1;
        let count = m * m * m;
        let scrambled = |k: u32| (k * 7919 + 13) % count;
        assert_ne!(count % 7919, 0);
        let mut positions = vec![Point3::origin(); count as usize];
        let node = |i: u32, j: u32, k: u32| scrambled((k * m + j) * m + i);
        let mut grid = Grid { word: "cell", ..Grid::default() };
        for (i, j, k) in (0..count).map(|c| (c % m, c / m % m, c / m / m)) {
            positions[node(i, j, k) as usize] = Point3::new(f64::from(i), f64::from(j), f64::from(k));
        }
        for (i, j, k) in (0..n * n * n).map(|c| (c % n, c / n % n, c / n / n)) {
            let base = [(i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1)];
            let first = grid.corners.len();
            grid.corners.extend(base.iter().map(|&(i, j)| node(i, j, k)));
            grid.corners.extend(base.iter().map(|&(i, j)| node(i, j, k + 1)));
            let (shape, number) = (CellShape::Hexahedron, grid.cells.len() as u64);
            grid.cells.push(Cell { shape, higher_order: false, first, corners: 8, number, region: 0 });
        }
        grid.positions = positions;
        grid
    }

    /// Each hexahedron as two wedges, of VTK's sense or of the other.
    fn wedges(n: u32, turned: bool) -> Grid {
        let mut grid = hexahedra(n);
        let hexahedra = std::mem::take(&mut grid.cells);
        let corners = std::mem::take(&mut grid.corners);
        for hexahedron in hexahedra {
            let at = |k: usize| corners[hexahedron.first + k];
            for [a, b, c] in [[0, 1, 2], [0, 2, 3]] {
                let first = grid.corners.len();
                let (low, high) = ([at(a), at(b), at(c)], [at(a + 4), at(b + 4), at(c + 4)]);
                let ordered = if turned { [high, low] } else { [low, high] };
                grid.corners.extend(ordered.iter().flatten());
                grid.cells.push(Cell { shape: CellShape::Wedge, corners: 6, first, ..hexahedron });
            }
        }
        grid
    }

    /// Each hexahedron as six pyramids about its middle.
    fn pyramids(n: u32) -> Grid {
        let mut grid = hexahedra(n);
        let hexahedra = std::mem::take(&mut grid.cells);
        let corners = std::mem::take(&mut grid.corners);
        for hexahedron in hexahedra {
            let of = &corners[hexahedron.first..hexahedron.first + 8];
            let sum: nalgebra::Vector3<f64> = of.iter().map(|&v| grid.positions[v as usize].coords).sum();
            let middle = grid.positions.len() as u32;
            grid.positions.push(Point3::from(sum / 8.0));
            for face in CellShape::Hexahedron.faces() {
                let first = grid.corners.len();
                // The apex is on the inner side of the face.
                grid.corners.extend(face.iter().rev().map(|&k| of[k]));
                grid.corners.push(middle);
                grid.cells.push(Cell { shape: CellShape::Pyramid, corners: 5, first, ..hexahedron });
            }
        }
        grid
    }

    #[test]
    fn cells_of_any_shape_are_split_so_that_neighbours_agree() {
        let limits = Limits::default();
        let cursor = Cursor::new(Path::new("x"), b"", &limits);
        let grids = [
            ("hexahedra", hexahedra(3)),
            ("wedges", wedges(3, false)),
            ("wedges", wedges(3, true)),
            ("pyramids", pyramids(3)),
        ];
        for (name, grid) in grids {
            let read = grid.into_tets(&cursor).expect(name);
            assert!(read.notes[0].contains(name), "{:?}", read.notes);
            let volume = &read.volume;
            assert!((0..volume.tets.len()).all(|t| volume.tet_volume(t) > 0.0), "{name}");
            assert!((volume.volume() - 27.0).abs() < 1e-12, "{name}: {}", volume.volume());
            let report = validate_surface(&volume.boundary().0);
            assert!(report.is_closed() && report.is_manifold() && report.is_oriented(), "{name}: {report}");
            // 9 squares on each of 6 sides, each of two triangles.
            assert_eq!(report.triangles, 108, "{name}: neighbours cut their common faces differently");
        }
    }

    #[test]
    fn strips_alternate_and_polygons_are_cut() {
        let limits = Limits::default();
        let cursor = Cursor::new(Path::new("x"), b"", &limits);
        let positions = (0..6).map(|k| Point3::new(f64::from(k / 2), f64::from(k % 2), 0.0)).collect();
        let strip =
            Cell { shape: CellShape::Strip, higher_order: false, first: 0, corners: 6, number: 0, region: 0 };
        let grid = Grid {
            positions,
            cells: vec![strip],
            corners: (0..6).collect(),
            word: "cell",
            ..Grid::default()
        };
        let surface = grid.into_surface(&cursor).expect("a strip").surface;
        assert_eq!(surface.triangles.len(), 4);
        assert!(surface.triangles.iter().enumerate().all(|(t, _)| surface.area_vector(t).z < 0.0));
    }
}

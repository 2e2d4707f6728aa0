//! Voxelisation of the heated tissue at rest: a volume of tetrahedra, or a membrane of triangles with a thickness,
//! sampled on the lattice.
//!
//! Heat is stored in the tissue's rest frame: deforming tissue carries its heat along. A membrane is extruded into
//! prisms along its vertex normals, three tetrahedra each, so that it has no gaps where it bends.

use nalgebra::{Matrix3, Point3, Vector3};

use super::error::ElectrosurgeryError;

/// Cells along an edge of a block.
pub(super) const EDGE: usize = 8;
/// Samples along a cell's edge: 64 in a cell, the bits of a word.
const SAMPLES: i32 = 4;
/// Maximum number of elements distinguished in a cell: a fifth would have little of it.
const ELEMENTS: usize = 4;
/// Elements with samples in a cell, and their sample counts.
type Samples = [(u32, u32); ELEMENTS];
/// Cells along an edge of a block with its halo.
pub(super) const PADDED: usize = EDGE + 2;
const ELEMENTS_MAX: usize = 10_000_000;
const BIN_ENTRIES_MAX: usize = 100_000_000;
/// Relative thickness below which an element is degenerate.
const FLAT: f64 = 1e-9;

/// Input tissue at rest.
#[derive(Clone, Copy, Debug)]
pub enum Tissue<'a> {
    /// A solid organ. Vertices \[m\] and tetrahedra, of either orientation.
    Volume {
        /// Vertices \[m\].
        positions: &'a [Point3<f64>],
        /// Corners of the tetrahedra.
        tets: &'a [[u32; 4]],
    },
    /// A membrane. Vertices of its middle surface \[m\], triangles, thickness \[m\].
    Membrane {
        /// Vertices \[m\].
        positions: &'a [Point3<f64>],
        /// Corners of the triangles.
        triangles: &'a [[u32; 3]],
        /// Thickness \[m\].
        thickness: f64,
    },
}

impl Tissue<'_> {
    /// Vertices at rest \[m\].
    #[must_use]
    pub fn positions(&self) -> &[Point3<f64>] {
        match self {
            Self::Volume { positions, .. } | Self::Membrane { positions, .. } => positions,
        }
    }

    /// Number of tetrahedra or triangles.
    #[must_use]
    pub fn element_count(&self) -> usize {
        match self {
            Self::Volume { tets, .. } => tets.len(),
            Self::Membrane { triangles, .. } => triangles.len(),
        }
    }

    pub(super) fn corners(&self, element: usize) -> &[u32] {
        match self {
            Self::Volume { tets, .. } => &tets[element],
            Self::Membrane { triangles, .. } => &triangles[element],
        }
    }

    /// Volume of an element \[m³\].
    pub(super) fn volume(&self, element: usize) -> f64 {
        let at = |vertex: u32| self.positions()[vertex as usize];
        match self {
            Self::Volume { tets, .. } => {
                let [a, b, c, d] = tets[element].map(at);
                (b - a).cross(&(c - a)).dot(&(d - a)).abs() / 6.0
            }
            Self::Membrane { triangles, thickness, .. } => {
                let [a, b, c] = triangles[element].map(at);
                (b - a).cross(&(c - a)).norm() / 2.0 * thickness
            }
        }
    }

    /// Validates everything once.
    pub(super) fn check(&self) -> Result<(), ElectrosurgeryError> {
        self.check_places()?;
        let count = self.element_count();
        let flat: Vec<u32> =
            (0..count).filter(|element| self.is_flat(*element)).map(|element| element as u32).collect();
        if flat.is_empty() { Ok(()) } else { Err(ElectrosurgeryError::Degenerate(flat)) }
    }

    /// The same, but allows degenerate elements.
    pub(super) fn check_places(&self) -> Result<(), ElectrosurgeryError> {
        let (positions, count) = (self.positions(), self.element_count());
        if count == 0 || count > ELEMENTS_MAX || u32::try_from(positions.len()).is_err() {
            return Err(ElectrosurgeryError::Count(count));
        }
        if let Self::Membrane { thickness, .. } = self {
            super::error::parameter("thickness", *thickness, 1e-6..=1.0, "1e-6 to 1 m")?;
        }
        let which = |is_bad: &dyn Fn(usize) -> bool, of: usize| -> Vec<u32> {
            (0..of).filter(|index| is_bad(*index)).map(|index| index as u32).collect()
        };
        let is_nowhere = |vertex: usize| !positions[vertex].iter().all(|x| x.abs() <= 1e3);
        let nowhere = which(&is_nowhere, positions.len());
        if !nowhere.is_empty() {
            return Err(ElectrosurgeryError::Positions(nowhere));
        }
        let is_astray =
            |element: usize| self.corners(element).iter().any(|vertex| *vertex as usize >= positions.len());
        let astray = which(&is_astray, count);
        if !astray.is_empty() {
            return Err(ElectrosurgeryError::NoVertex { elements: astray, vertices: positions.len() });
        }
        Ok(())
    }

    /// Whether an element is degenerate.
    pub(super) fn is_flat(&self, element: usize) -> bool {
        let corners = self.corners(element);
        let at = |corner: usize| self.positions()[corners[corner] as usize];
        let longest = (0..corners.len())
            .flat_map(|a| (0..a).map(move |b| (a, b)))
            .map(|(a, b)| (at(a) - at(b)).norm())
            .fold(0.0, f64::max);
        let extent = match self {
            Self::Volume { .. } => longest.powi(3),
            Self::Membrane { thickness, .. } => longest.powi(2) * thickness,
        };
        // Also true for an element collapsed to a point.
        self.volume(element) <= FLAT * extent
    }

    fn pieces(&self) -> Vec<Piece> {
        let positions = self.positions();
        match self {
            Self::Volume { tets, .. } => tets
                .iter()
                .enumerate()
                .filter_map(|(element, nodes)| {
                    Piece::new(nodes.map(|node| positions[node as usize]), *nodes, element as u32)
                })
                .collect(),
            Self::Membrane { triangles, thickness, .. } => prisms(positions, triangles, *thickness),
        }
    }
}

/// Three tetrahedra for each triangle, split in the order of vertex numbers, so that neighbours match.
fn prisms(positions: &[Point3<f64>], triangles: &[[u32; 3]], thickness: f64) -> Vec<Piece> {
    let mut normals = vec![Vector3::zeros(); positions.len()];
    for triangle in triangles {
        let [a, b, c] = triangle.map(|vertex| positions[vertex as usize]);
        let normal = (b - a).cross(&(c - a));
        triangle.iter().for_each(|vertex| normals[*vertex as usize] += normal);
    }
    let offset = |vertex: u32, side: f64| {
        let normal = normals[vertex as usize].try_normalize(0.0).unwrap_or_else(Vector3::zeros);
        positions[vertex as usize] + normal * (side * thickness / 2.0)
    };
    let mut pieces = Vec::with_capacity(3 * triangles.len());
    for (element, triangle) in triangles.iter().enumerate() {
        let mut nodes = *triangle;
        nodes.sort_unstable();
        let [below, above] = [-1.0, 1.0].map(|side| nodes.map(|vertex| offset(vertex, side)));
        let [a, b, c] = nodes;
        let three = [
            ([below[0], below[1], below[2], above[2]], [a, b, c, c]),
            ([below[0], below[1], above[1], above[2]], [a, b, b, c]),
            ([below[0], above[0], above[1], above[2]], [a, a, b, c]),
        ];
        pieces.extend(
            three.into_iter().filter_map(|(corners, nodes)| Piece::new(corners, nodes, element as u32)),
        );
    }
    pieces
}

/// A tetrahedron of tissue with the mesh nodes of its corners.
#[derive(Clone, Debug)]
struct Piece {
    origin: Point3<f64>,
    /// Maps a vector from the origin to the barycentric weights of the other three corners.
    weights: Matrix3<f64>,
    min: Point3<f64>,
    max: Point3<f64>,
    nodes: [u32; 4],
    element: u32,
}

impl Piece {
    fn new(corners: [Point3<f64>; 4], nodes: [u32; 4], element: u32) -> Option<Self> {
        let [a, b, c, d] = corners;
        let weights = Matrix3::from_columns(&[b - a, c - a, d - a]).try_inverse()?;
        let (min, max) = corners.iter().fold((a, a), |(min, max), corner| (min.inf(corner), max.sup(corner)));
        weights.iter().all(|entry| entry.is_finite()).then_some(Self {
            origin: a,
            weights,
            min,
            max,
            nodes,
            element,
        })
    }
}

/// Location of a lattice cell in the mesh.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct CellLocation {
    /// The element with the largest share of it.
    pub element: u32,
    /// The element with the second largest, and its share of the two; 0 where there is none.
    pub other: u32,
    pub others: f32,
    pub nodes: [u32; 4],
    /// Weights of the first three nodes; the fourth has the rest.
    pub weights: [f32; 3],
}

impl CellLocation {
    #[inline]
    pub(super) fn weights(&self) -> [f64; 4] {
        let [a, b, c] = self.weights.map(f64::from);
        [a, b, c, 1.0 - a - b - c]
    }

    /// Sum of the weights of marked vertices.
    pub(super) fn share_of(&self, is_marked: &[bool]) -> f64 {
        let marked = self.nodes.iter().zip(self.weights()).filter(|(node, _)| is_marked[**node as usize]);
        marked.map(|(_, weight)| weight).sum()
    }

    /// Interpolates a nodal quantity at the cell.
    #[inline]
    pub(super) fn interpolate(&self, values: &[f64]) -> f64 {
        let weights = self.weights();
        (0..4).map(|corner| weights[corner] * values[self.nodes[corner] as usize]).sum()
    }
}

/// A rasterised block of the lattice. Cells in the order x, y, z, x fastest.
#[derive(Clone, Debug)]
pub(super) struct Raster {
    /// Tissue fraction of each cell, including the halo.
    pub share: Box<[f32; PADDED * PADDED * PADDED]>,
    pub sites: Box<[CellLocation; EDGE * EDGE * EDGE]>,
    /// Of each cell, including the halo: one bit per axis where a cut separates it from the next cell. Empty without
    /// cuts.
    pub cut: Vec<u8>,
}

/// The tetrahedra of a tissue, in a spatial grid.
#[derive(Clone, Debug)]
pub(super) struct TissueLattice {
    spacing: f64,
    pieces: Vec<Piece>,
    bin: f64,
    /// Bins and the pieces in them, sorted.
    bins: Vec<([i32; 3], u32)>,
    /// Triangles of cuts, which separate tissue.
    cuts: Vec<[Point3<f64>; 3]>,
}

fn cell_of(point: &Point3<f64>, size: f64) -> [i32; 3] {
    // Saturating: positions are within 1 km, and a cell is at least 10 µm.
    [point.x, point.y, point.z].map(|x| (x / size).floor() as i32)
}

/// Whether a segment from a point intersects a triangle, including its border, excluding the segment's end (Möller,
/// Trumbore 1997).
fn passes(from: &Point3<f64>, way: &Vector3<f64>, [a, b, c]: &[Point3<f64>; 3]) -> bool {
    const BORDER: f64 = 1e-9;
    let (u, v) = (b - a, c - a);
    let across = way.cross(&v);
    let determinant = u.dot(&across);
    if determinant.abs() <= 1e-12 * u.norm() * v.norm() * way.norm() {
        return false;
    }
    let off = from - a;
    let first = off.dot(&across) / determinant;
    let turned = off.cross(&u);
    let second = way.dot(&turned) / determinant;
    let share = v.dot(&turned) / determinant;
    (0.0..1.0).contains(&share) && first >= -BORDER && second >= -BORDER && first + second <= 1.0 + BORDER
}

fn boxes(min: [i32; 3], max: [i32; 3]) -> impl Iterator<Item = [i32; 3]> {
    (min[0]..=max[0])
        .flat_map(move |x| (min[1]..=max[1]).flat_map(move |y| (min[2]..=max[2]).map(move |z| [x, y, z])))
}

impl TissueLattice {
    pub(super) fn new(tissue: &Tissue<'_>, spacing: f64) -> Result<Self, ElectrosurgeryError> {
        let pieces = tissue.pieces();
        let mean = pieces.iter().map(|piece| (piece.max - piece.min).amax()).sum::<f64>()
            / pieces.len().max(1) as f64;
        let bin = mean.max(EDGE as f64 * spacing);
        let mut entries = 0_usize;
        for piece in &pieces {
            let (min, max) = (cell_of(&piece.min, bin), cell_of(&piece.max, bin));
            let count: i64 = (0..3).map(|axis| i64::from(max[axis]) - i64::from(min[axis]) + 1).product();
            entries = entries.saturating_add(usize::try_from(count).unwrap_or(usize::MAX));
        }
        if entries > BIN_ENTRIES_MAX {
            return Err(ElectrosurgeryError::TooLarge(entries));
        }
        let mut bins = Vec::with_capacity(entries);
        for (index, piece) in pieces.iter().enumerate() {
            let within = boxes(cell_of(&piece.min, bin), cell_of(&piece.max, bin));
            bins.extend(within.map(|bin| (bin, index as u32)));
        }
        bins.sort_unstable();
        Ok(Self { spacing, pieces, bin, bins, cuts: Vec::new() })
    }

    /// The same for elements that are parts of original ones, whose numbers they keep, and with cuts.
    pub(super) fn parted(mut self, of: &[u32], cuts: &[[Point3<f64>; 3]]) -> Self {
        self.pieces.iter_mut().for_each(|piece| piece.element = of[piece.element as usize]);
        self.cuts = cuts.to_vec();
        self
    }

    /// Cells from `first` on that are separated from the next one along an axis: the segment between their centres
    /// intersects a cut. A centre on a cut belongs to the near side.
    fn cut_links(&self, first: [i32; 3]) -> Vec<u8> {
        let mut links = Vec::new();
        let middle = |cell: [usize; 3]| {
            Point3::from(std::array::from_fn(|axis| {
                (f64::from(first[axis] + cell[axis] as i32) + 0.5) * self.spacing
            }))
        };
        for &[a, b, c] in &self.cuts {
            let (min, max) = (a.inf(&b).inf(&c), a.sup(&b).sup(&c));
            let (low, high) = (cell_of(&min, self.spacing), cell_of(&max, self.spacing));
            let last = PADDED as i32 - 1;
            // The previous cell may reach it.
            let range = |axis: usize| {
                let from = (low[axis] - first[axis] - 1).clamp(0, last + 1) as usize;
                let to = (high[axis] - first[axis] + 1).clamp(0, last + 1) as usize;
                from..to
            };
            for z in range(2) {
                for y in range(1) {
                    for x in range(0) {
                        let at: Point3<f64> = middle([x, y, z]);
                        for axis in 0..3 {
                            let mut way = Vector3::zeros();
                            way[axis] = self.spacing;
                            if passes(&at, &way, &[a, b, c]) {
                                links.resize(PADDED * PADDED * PADDED, 0);
                                links[x + PADDED * (y + PADDED * z)] |= 1 << axis;
                            }
                        }
                    }
                }
            }
        }
        links
    }

    /// Tissue cells of a block and its halo, and their locations in the mesh. `None` where there is no tissue in the
    /// block itself.
    pub(super) fn raster(&self, block: [i32; 3]) -> Option<Raster> {
        let edge = EDGE as i32;
        let first = block.map(|index| index.checked_mul(edge).and_then(|cell| cell.checked_sub(1)));
        let first = [first[0]?, first[1]?, first[2]?];
        let min = Point3::from(first.map(|cell| f64::from(cell) * self.spacing));
        let max = min + Vector3::repeat(PADDED as f64 * self.spacing);
        let mut found: Vec<u32> = Vec::new();
        for bin in boxes(cell_of(&min, self.bin), cell_of(&max, self.bin)) {
            let from = self.bins.partition_point(|entry| entry.0 < bin);
            found.extend(self.bins[from..].iter().take_while(|entry| entry.0 == bin).map(|entry| entry.1));
        }
        found.sort_unstable();
        found.dedup();
        let mut taken = vec![0_u64; PADDED * PADDED * PADDED];
        let mut best = vec![0_u32; EDGE * EDGE * EDGE];
        let mut of_elements: Vec<Samples> = vec![Default::default(); EDGE * EDGE * EDGE];
        let mut sites = Box::new([CellLocation::default(); EDGE * EDGE * EDGE]);
        for piece in found {
            self.fill(
                &self.pieces[piece as usize],
                first,
                &mut taken,
                (&mut best, &mut of_elements),
                &mut sites,
            );
        }
        for (site, counts) in sites.iter_mut().zip(&mut of_elements) {
            counts.sort_by_key(|(_, count)| std::cmp::Reverse(*count));
            let [(element, most), (other, rest), ..] = *counts;
            (site.element, site.other) = (element, other);
            site.others = rest as f32 / (most + rest).max(1) as f32;
        }
        let mut share = Box::new([0.0; PADDED * PADDED * PADDED]);
        for (share, taken) in share.iter_mut().zip(&taken) {
            *share = taken.count_ones() as f32 / 64.0;
        }
        let cut = self.cut_links(first);
        best.iter().any(|count| *count > 0).then_some(Raster { share, sites, cut })
    }

    /// Assigns the samples in a piece to it.
    fn fill(
        &self,
        piece: &Piece,
        first: [i32; 3],
        taken: &mut [u64],
        (best, of_elements): (&mut [u32], &mut [Samples]),
        sites: &mut [CellLocation; EDGE * EDGE * EDGE],
    ) {
        let (low, high) = (cell_of(&piece.min, self.spacing), cell_of(&piece.max, self.spacing));
        let range = |axis: usize| {
            let last = PADDED as i32 - 1;
            ((low[axis] - first[axis]).clamp(0, last + 1), (high[axis] - first[axis]).clamp(-1, last))
        };
        let ((x0, x1), (y0, y1), (z0, z1)) = (range(0), range(1), range(2));
        // Variation of the weights, and of their sum, within the samples of a cell: most cells around a piece lie
        // completely beyond one of its faces, and need not be sampled.
        let half = 0.5 * self.spacing * f64::from(SAMPLES - 1) / f64::from(SAMPLES);
        let spread = piece.weights.abs() * Vector3::repeat(half * (1.0 + 1e-9)) + Vector3::repeat(1e-9);
        let spread_of_sum = piece.weights.row_sum().abs().sum() * half * (1.0 + 1e-9) + 1e-9;
        for (z, y, x) in
            (z0..=z1).flat_map(|z| (y0..=y1).flat_map(move |y| (x0..=x1).map(move |x| (z, y, x))))
        {
            let padded = (x as usize) + PADDED * ((y as usize) + PADDED * (z as usize));
            if taken[padded] == u64::MAX {
                continue;
            }
            let middle = std::array::from_fn(|axis| f64::from(first[axis] + [x, y, z][axis]) + 0.5);
            let weights = piece.weights * (Point3::<f64>::from(middle) * self.spacing - piece.origin);
            if (weights + spread).min() < 0.0 || weights.sum() - spread_of_sum > 1.0 {
                continue;
            }
            let (mut count, mut sum) = (0_u32, Vector3::zeros());
            for sample in 0..SAMPLES.pow(3) {
                let bit = 1_u64 << sample;
                let within = [sample % SAMPLES, sample / SAMPLES % SAMPLES, sample / (SAMPLES * SAMPLES)];
                let at = |axis: usize, cell: i32| {
                    let fine = f64::from(within[axis]) + 0.5;
                    (f64::from(first[axis] + cell) + fine / f64::from(SAMPLES)) * self.spacing
                };
                let weights = piece.weights * (Point3::new(at(0, x), at(1, y), at(2, z)) - piece.origin);
                let is_inside = weights.min() >= -1e-12 && weights.sum() <= 1.0 + 1e-12;
                if is_inside && taken[padded] & bit == 0 {
                    taken[padded] |= bit;
                    count += 1;
                    sum += weights;
                }
            }
            let inner = |cell: i32| usize::try_from(cell - 1).ok().filter(|cell| *cell < EDGE);
            let (Some(x), Some(y), Some(z)) = (inner(x), inner(y), inner(z)) else { continue };
            let cell = x + EDGE * (y + EDGE * z);
            let mut known = of_elements[cell].iter_mut();
            if count > 0
                && let Some(of) = known.find(|of| of.1 == 0 || of.0 == piece.element)
            {
                *of = (piece.element, of.1 + count);
            }
            if count > best[cell] {
                best[cell] = count;
                let mean = sum / f64::from(count);
                let others = [1.0 - mean.sum(), mean.x, mean.y].map(|weight| weight as f32);
                sites[cell] = CellLocation { nodes: piece.nodes, weights: others, ..CellLocation::default() };
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn volume_of(raster: &Raster, spacing: f64) -> f64 {
        let inner = (0..EDGE.pow(3)).map(|cell| {
            let (x, y, z) = (cell % EDGE, cell / EDGE % EDGE, cell / (EDGE * EDGE));
            f64::from(raster.share[x + 1 + PADDED * (y + 1 + PADDED * (z + 1))])
        });
        inner.sum::<f64>() * spacing.powi(3)
    }

    #[test]
    fn a_tetrahedron_in_a_block_has_its_volume_and_its_cells_know_where_they_are() {
        let corners = [[0.2, 0.3, 0.25], [3.7, 0.4, 0.3], [0.4, 3.6, 0.5], [0.5, 0.6, 3.8]];
        let positions = corners.map(|corner| Point3::from(corner.map(|x: f64| x * 1e-3)));
        let tissue = Tissue::Volume { positions: &positions, tets: &[[0, 1, 2, 3]] };
        let lattice = TissueLattice::new(&tissue, 0.5e-3).expect("a lattice");
        let raster = lattice.raster([0, 0, 0]).expect("tissue");
        let (is, should) = (volume_of(&raster, 0.5e-3), tissue.volume(0));
        assert!((is / should - 1.0).abs() < 0.03, "{is} {should}");
        assert!(lattice.raster([5, 0, 0]).is_none());
        // The interpolated position at a full cell is its centre.
        let cell = 2 + EDGE * (2 + EDGE);
        let at: Vec<f64> =
            (0..3).map(|axis| raster.sites[cell].interpolate(&positions.map(|point| point[axis]))).collect();
        let centre = [1.25e-3, 1.25e-3, 0.75e-3];
        assert!((0..3).all(|axis| (at[axis] - centre[axis]).abs() < 1e-9), "{at:?}");
    }

    /// Otherwise a mesh aligned with the lattice would lose more than the lattice.
    #[test]
    fn a_cell_that_two_elements_share_is_told_as_of_both() {
        let positions = [[0.0, 0.0], [1e-3, 0.0], [1e-3, 1e-3], [0.0, 1e-3]];
        let positions = positions.map(|[x, y]| Point3::new(x, y, 0.0));
        let triangles = [[0, 1, 2], [0, 2, 3]];
        let tissue = Tissue::Membrane { positions: &positions, triangles: &triangles, thickness: 1e-3 };
        let raster = TissueLattice::new(&tissue, 0.25e-3).expect("a mesh").raster([0; 3]).expect("tissue");
        let mut parts = [0.0; 2];
        for (x, y) in (0..4).flat_map(|x| (0..4).map(move |y| (x, y))) {
            let site = &raster.sites[x + EDGE * y];
            assert_eq!(site.others > 0.0, x == y, "{x} {y}: {site:?}");
            parts[site.element as usize] += 1.0 - site.others;
            parts[site.other as usize] += site.others;
        }
        // Samples on the line between the two belong to the first one.
        assert!(parts[0] + parts[1] == 16.0 && (parts[0] - 8.0).abs() <= 1.0, "{parts:?}");
    }

    #[test]
    fn a_bent_membrane_has_no_gaps_and_its_volume_is_that_of_its_triangles() {
        // Ends at sample boundaries. A quarter of a tube of radius 2.5 mm, 1 mm thick.
        let (around, along) = (12, 6);
        let positions: Vec<Point3<f64>> = (0..=around)
            .flat_map(|i| (0..=along).map(move |j| (i, j)))
            .map(|(i, j)| {
                let angle = std::f64::consts::FRAC_PI_2 * f64::from(i) / f64::from(around);
                let along = 0.25e-3 + 3.5e-3 * f64::from(j) / f64::from(along);
                Point3::new(0.125e-3 + 2.5e-3 * angle.cos(), 0.125e-3 + 2.5e-3 * angle.sin(), along)
            })
            .collect();
        let at = |i: u32, j: u32| i * 7 + j;
        let triangles: Vec<[u32; 3]> = (0..12)
            .flat_map(|i| (0..6).map(move |j| (i, j)))
            .flat_map(|(i, j)| {
                [[at(i, j), at(i + 1, j), at(i + 1, j + 1)], [at(i, j), at(i + 1, j + 1), at(i, j + 1)]]
            })
            .collect();
        let tissue = Tissue::Membrane { positions: &positions, triangles: &triangles, thickness: 1e-3 };
        let should: f64 = (0..triangles.len()).map(|element| tissue.volume(element)).sum();
        // Some 250 samples in a section are accurate to a few of them; at half the spacing the error is less than half.
        for (spacing, last, tolerance) in [(0.5e-3, 1, 0.02), (0.25e-3, 2, 0.008)] {
            let lattice = TissueLattice::new(&tissue, spacing).expect("a lattice");
            let blocks = boxes([-1, -1, -1], [last, last, last]);
            let is: f64 =
                blocks.filter_map(|block| lattice.raster(block)).map(|r| volume_of(&r, spacing)).sum();
            assert!((is / should - 1.0).abs() < tolerance, "{spacing}: {is} {should}");
        }
    }

    #[test]
    fn everything_that_is_wrong_with_a_mesh_is_named() {
        let positions =
            [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]].map(Point3::from);
        let check = |tets: &[[u32; 4]]| {
            Tissue::Volume { positions: &positions, tets }.check().expect_err("bad").to_string()
        };
        assert_eq!(
            check(&[[0, 1, 2, 3], [0, 1, 2, 2], [0, 1, 1, 3]]),
            "elements 1, 2 have no extent, and would conduct without limit"
        );
        assert!(check(&[[0, 1, 2, 9]]).starts_with("elements 0 name vertices that do not exist"));
        assert!(check(&[]).starts_with("0 elements"));
        let nowhere = [Point3::new(f64::NAN, 0.0, 0.0)];
        let error = Tissue::Volume { positions: &nowhere, tets: &[[0; 4]] }.check().expect_err("nowhere");
        assert_eq!(error, ElectrosurgeryError::Positions(vec![0]));
    }
}

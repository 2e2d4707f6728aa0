//! Impact finder: all impacts of whole lines and surfaces within a step, by a grid of swept boxes, then pair tests.

use nalgebra::Point3;

use super::advancement::{Impact, Sweep};
use super::pairs::{edge_edge, vertex_face};
use super::swept::{Features, SweptLine, SweptSurface, edge, face, vertex};
use crate::part::Part;
use crate::uniform_grid::{Box3, BoxGrid};

/// An impact with its parts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FoundImpact {
    /// Part of the first body: a vertex, an edge of a surface, a segment of a line, a triangle.
    pub first: Part,
    /// Part of the second body; the same body in a search for self-impacts.
    pub second: Part,
    /// Time and geometry; the weights are on the corners of the parts in the order in which the body names them (those
    /// of a [`Part::Edge`]: as it names them).
    pub impact: Impact,
}

/// Lists impacts, and reuses its buffers: searches of similar size do not allocate.
///
/// Two bodies first come within a separation of each other at a vertex of one and a face of the other, or at an edge of
/// either: these pairs are listed, each with its first time, in the order of their times. Parts already through at the
/// beginning of the step (a sewn thread) are not listed; parts within the separation are listed with time 0.
#[derive(Clone, Debug, Default)]
pub struct ImpactFinder {
    features: [Features; 2],
    sides: [Vec<u8>; 2],
    grid: BoxGrid,
    found: Vec<FoundImpact>,
}

/// A body in the search.
struct Body<'a> {
    vertices: Sweep<&'a [Point3<f64>]>,
    triangles: &'a [[u32; 3]],
    /// Segments of a line, in their order, or edges of a surface.
    edges: &'a [[u32; 2]],
    used: &'a [u32],
    is_line: bool,
    bounds: Box3,
}

impl<'a> Body<'a> {
    fn surface(surface: &SweptSurface<'a>, features: &'a Features) -> Self {
        Self {
            vertices: surface.vertices(),
            triangles: surface.triangles(),
            edges: &features.edges,
            used: &features.vertices,
            is_line: false,
            bounds: Box3::EMPTY,
        }
        .bounded()
    }

    fn line(line: &SweptLine<'a>, used: &'a [u32]) -> Self {
        let (vertices, edges) = (line.vertices(), line.segments());
        Self { vertices, triangles: &[], edges, used, is_line: true, bounds: Box3::EMPTY }.bounded()
    }

    fn bounded(mut self) -> Self {
        self.bounds =
            self.used.iter().fold(Box3::EMPTY, |bounds, &index| bounds.joined(&self.swept(&[index])));
        self
    }

    /// Swept box of a part with these corners: around its states at both ends.
    fn swept(&self, corners: &[u32]) -> Box3 {
        corners.iter().fold(Box3::EMPTY, |bounds, &corner| {
            let moving = vertex(&self.vertices, corner);
            bounds.with(&moving.from).with(&moving.to)
        })
    }

    /// For each vertex one bit per side of a box that it stays beyond during the step.
    fn sides(&self, of: &Box3, sides: &mut Vec<u8>) {
        sides.clear();
        sides.resize(self.vertices.from.len(), 0);
        for &index in self.used {
            let bounds = self.swept(&[index]);
            let bits = (0..3).map(|axis| {
                let (below, above) = (bounds.max[axis] < of.min[axis], bounds.min[axis] > of.max[axis]);
                (u8::from(below) | u8::from(above) << 1) << (2 * axis)
            });
            sides[index as usize] = bits.fold(0, |all, bits| all | bits);
        }
    }

    fn edge_part(&self, index: u32) -> Part {
        if self.is_line { Part::Segment(index) } else { Part::Edge(self.edges[index as usize]) }
    }
}

/// Growth of a box beyond the separation, relative to the largest coordinate: covers the rounding of intermediate
/// positions, and the contact tolerance of pair tests.
const BOX_SLACK: f64 = 4e-10;

fn slack(bounds: &Box3, separation: f64) -> f64 {
    let coordinates = bounds.min.coords.amax().max(bounds.max.coords.amax());
    if coordinates.is_finite() { separation + BOX_SLACK * (coordinates + separation) } else { separation }
}

impl ImpactFinder {
    /// A finder with empty buffers.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Impacts of a line (first) and a surface (second) that come within the line's radius and `separation` \[m\] of
    /// each other: vertices of the line with triangles, segments with edges.
    pub fn line_surface(
        &mut self,
        line: &SweptLine<'_>,
        surface: &SweptSurface<'_>,
        separation: f64,
    ) -> &[FoundImpact] {
        let separation = separation + line.radius();
        let Self { features: [of_line, of_surface], sides, grid, found } = self;
        of_surface.update(surface.triangles());
        of_line.update_line(line.segments());
        let (line, surface) = (Body::line(line, &of_line.vertices), Body::surface(surface, of_surface));
        found.clear();
        let search = Search::new([&line, &surface], separation, false, sides);
        search.vertices_faces(grid, |impact| found.push(impact));
        search.edges_edges(grid, found);
        self.sorted()
    }

    /// Impacts of two surfaces that come within `separation` \[m\] of each other: vertices with triangles both ways,
    /// edges with edges.
    pub fn surface_surface(
        &mut self,
        first: &SweptSurface<'_>,
        second: &SweptSurface<'_>,
        separation: f64,
    ) -> &[FoundImpact] {
        let Self { features: [of_first, of_second], sides, grid, found } = self;
        of_first.update(first.triangles());
        of_second.update(second.triangles());
        let (first, second) = (Body::surface(first, of_first), Body::surface(second, of_second));
        found.clear();
        let search = Search::new([&second, &first], separation, false, sides);
        search.vertices_faces(grid, |impact| found.push(impact.swapped()));
        let search = Search::new([&first, &second], separation, false, sides);
        search.vertices_faces(grid, |impact| found.push(impact));
        search.edges_edges(grid, found);
        self.sorted()
    }

    /// Impacts of two lines that come within their radii and `separation` \[m\] of each other.
    pub fn line_line(
        &mut self,
        first: &SweptLine<'_>,
        second: &SweptLine<'_>,
        separation: f64,
    ) -> &[FoundImpact] {
        let separation = separation + first.radius() + second.radius();
        let Self { features: [of_first, of_second], sides, grid, found } = self;
        of_first.update_line(first.segments());
        of_second.update_line(second.segments());
        let (first, second) =
            (Body::line(first, &of_first.vertices), Body::line(second, &of_second.vertices));
        found.clear();
        Search::new([&first, &second], separation, false, sides).edges_edges(grid, found);
        self.sorted()
    }

    /// Impacts of a surface with itself: vertices with triangles of which they are not a corner, edges without a common
    /// vertex. With a `separation` \[m\] above the length of its edges, neighbours count.
    pub fn surface_self(&mut self, surface: &SweptSurface<'_>, separation: f64) -> &[FoundImpact] {
        // The surface uses the same slot as in a search with a line, so that its edges are kept when a step does both.
        let Self { features: [_, features], sides, grid, found } = self;
        features.update(surface.triangles());
        let body = Body::surface(surface, features);
        found.clear();
        let search = Search::new([&body, &body], separation, true, sides);
        search.vertices_faces(grid, |impact| found.push(impact));
        search.edges_edges(grid, found);
        self.sorted()
    }

    /// Impacts of a line with itself: segments without a common vertex that come within two radii and `separation`
    /// \[m\] of each other. With segments shorter than that, second neighbours count.
    pub fn line_self(&mut self, line: &SweptLine<'_>, separation: f64) -> &[FoundImpact] {
        let separation = separation + 2.0 * line.radius();
        let Self { features: [features, _], sides, grid, found } = self;
        features.update_line(line.segments());
        let body = Body::line(line, &features.vertices);
        found.clear();
        Search::new([&body, &body], separation, true, sides).edges_edges(grid, found);
        self.sorted()
    }

    /// Sorts by time, then by parts.
    fn sorted(&mut self) -> &[FoundImpact] {
        self.found.sort_unstable_by(|a, b| {
            let times = a.impact.time.total_cmp(&b.impact.time);
            times.then_with(|| (a.first, a.second).cmp(&(b.first, b.second)))
        });
        &self.found
    }
}

impl FoundImpact {
    /// The same with the bodies swapped.
    #[must_use]
    pub fn swapped(&self) -> Self {
        let Impact { points: [p, q], weights: [u, v], normal, .. } = self.impact;
        let impact = Impact { points: [q, p], weights: [v, u], normal: -normal, ..self.impact };
        Self { first: self.second, second: self.first, impact }
    }
}

/// Two bodies near each other.
struct Search<'a> {
    bodies: [&'a Body<'a>; 2],
    separation: f64,
    is_self: bool,
    reach: f64,
    /// The sides of the other body's bounds beyond which each vertex stays.
    sides: [&'a [u8]; 2],
}

impl<'a> Search<'a> {
    fn new(
        [first, second]: [&'a Body<'a>; 2],
        separation: f64,
        is_self: bool,
        [sides, other_sides]: &'a mut [Vec<u8>; 2],
    ) -> Self {
        let reach = slack(&first.bounds.joined(&second.bounds), separation);
        first.sides(&second.bounds.grown(reach), sides);
        second.sides(&first.bounds.grown(reach), other_sides);
        Self { bodies: [first, second], separation, is_self, reach, sides: [sides, other_sides] }
    }

    /// Tests vertices of the first body with faces of the second.
    fn vertices_faces(&self, grid: &mut BoxGrid, mut found: impl FnMut(FoundImpact)) {
        let [first, second] = self.bodies;
        let vertices = self.swept(0, first.used.iter().map(|&index| ([index], index)));
        let faces = self.swept(1, second.triangles.iter().copied().zip(0..));
        let is_first_fewer = first.used.len() < second.triangles.len();
        overlapping(grid, vertices, faces, is_first_fewer, |index, triangle| {
            let corners = second.triangles[triangle as usize];
            if self.is_self && corners.contains(&index) {
                return;
            }
            let moving = vertex(&first.vertices, index);
            if let Some(impact) = vertex_face(&moving, &face(&second.vertices, corners), self.separation) {
                found(FoundImpact { first: Part::Vertex(index), second: Part::Triangle(triangle), impact });
            }
        });
    }

    /// Tests edges of the first body with edges of the second.
    fn edges_edges(&self, grid: &mut BoxGrid, found: &mut Vec<FoundImpact>) {
        let [first, second] = self.bodies;
        let edges = self.swept(0, first.edges.iter().copied().zip(0..));
        let others = self.swept(1, second.edges.iter().copied().zip(0..));
        overlapping(grid, edges, others, first.edges.len() < second.edges.len(), |index, other| {
            let (ends, other_ends) = (first.edges[index as usize], second.edges[other as usize]);
            if self.is_self && (other <= index || ends.iter().any(|end| other_ends.contains(end))) {
                return;
            }
            let (moving, other_moving) = (edge(&first.vertices, ends), edge(&second.vertices, other_ends));
            if let Some(impact) = edge_edge(&moving, &other_moving, self.separation) {
                found.push(FoundImpact {
                    first: first.edge_part(index),
                    second: second.edge_part(other),
                    impact,
                });
            }
        });
    }

    /// Swept boxes of the parts of one body that may come near the other; parts whose corners all stay beyond one side
    /// are skipped. Only the first body's boxes are grown by the reach.
    fn swept<const K: usize>(
        &self,
        which: usize,
        parts: impl Iterator<Item = ([u32; K], u32)>,
    ) -> impl Iterator<Item = (Box3, u32)> {
        let (body, sides) = (self.bodies[which], self.sides[which]);
        let by = if which == 0 { self.reach } else { 0.0 };
        parts
            .filter(|(corners, _)| {
                corners.iter().fold(u8::MAX, |all, &corner| all & sides[corner as usize]) == 0
            })
            .map(move |(corners, index)| (body.swept(&corners).grown(by), index))
    }
}

/// Visits each pair of overlapping boxes. The smaller set is put into the grid, because a query costs less than an
/// insertion.
fn overlapping(
    grid: &mut BoxGrid,
    boxes: impl Iterator<Item = (Box3, u32)>,
    others: impl Iterator<Item = (Box3, u32)>,
    is_first_fewer: bool,
    mut found: impl FnMut(u32, u32),
) {
    if is_first_fewer {
        grid.rebuild(boxes);
        others.for_each(|(bounds, other)| grid.overlapping(&bounds, |index| found(index, other)));
    } else {
        grid.rebuild(others);
        boxes.for_each(|(bounds, index)| grid.overlapping(&bounds, |other| found(index, other)));
    }
}

//! Validation of surfaces: open and non-manifold edges, wrong orientation, degenerate and duplicate triangles.
//!
//! Works on sorted half-edges (Campagna, Kobbelt, Seidel, "Directed edges", 1998), in the order of the indices,
//! so that the first finding is the same on every run.

use std::fmt;
use std::path::Path;

use super::data::SurfaceData;
use super::error::MeshError;
use super::file::SurfaceFile;
use super::shells::{half_edges, shells};
use crate::disjoint_sets::DisjointSets;

/// Sine of the smallest angle below which a triangle counts as degenerate.
pub(super) const DEGENERATE: f64 = 1e-9;

/// Number of occurrences of a defect, and the first one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Finding<T> {
    /// How often.
    pub count: usize,
    /// The first one in the order of the indices.
    pub first: Option<T>,
}

impl<T> Default for Finding<T> {
    fn default() -> Self {
        Self { count: 0, first: None }
    }
}

impl<T: Copy + fmt::Debug> Finding<T> {
    pub(super) fn add(&mut self, what: T) {
        self.count += 1;
        self.first.get_or_insert(what);
    }
    pub(super) fn refuse(&self, refused: bool, what: &str) -> Option<String> {
        let first = self.first.filter(|_| refused)?;
        Some(format!("{} {what}, first {first:?}", self.count))
    }
}

/// Findings of [`validate_surface`]. Edges are pairs of vertices, the smaller first.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct SurfaceReport {
    /// Number of vertices.
    pub vertices: usize,
    /// Number of triangles.
    pub triangles: usize,
    /// Number of distinct edges.
    pub edges: usize,
    /// Bodies: sets of triangles connected by edges.
    pub components: usize,
    /// Vertices that no triangle uses.
    pub unreferenced: Finding<u32>,
    /// Triangles with a repeated vertex or without area.
    pub degenerate: Finding<usize>,
    /// Triangles with the same three vertices as an earlier one.
    pub duplicates: Finding<usize>,
    /// Edges with one triangle: the rim of a hole.
    pub boundary_edges: Finding<[u32; 2]>,
    /// Edges with more than two triangles.
    pub non_manifold_edges: Finding<[u32; 2]>,
    /// Edges that both of their triangles run through in the same direction.
    pub misoriented_edges: Finding<[u32; 2]>,
    /// Vertices where two fans of triangles touch only at the vertex.
    pub non_manifold_vertices: Finding<u32>,
    /// First triangles of closed shells that are inside out: that face inwards with no other one around them.
    pub inside_out: Finding<usize>,
}

impl SurfaceReport {
    /// Whether every edge has exactly two triangles: watertight.
    pub fn is_closed(&self) -> bool {
        self.triangles > 0 && self.boundary_edges.count == 0 && self.non_manifold_edges.count == 0
    }
    /// Whether the surface is a manifold, with or without a rim.
    pub fn is_manifold(&self) -> bool {
        self.non_manifold_edges.count == 0 && self.non_manifold_vertices.count == 0
    }
    /// Whether neighbouring triangles are consistently oriented.
    pub fn is_oriented(&self) -> bool {
        self.misoriented_edges.count == 0
    }
    /// V − E + F over the vertices in use: 2 for each sphere-like body, 0 for each torus.
    pub fn euler_characteristic(&self) -> i64 {
        (self.vertices - self.unreferenced.count) as i64 - self.edges as i64 + self.triangles as i64
    }
}

impl fmt::Display for SurfaceReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "{} vertices, {} triangles, {} bodies; open edges {}, non-manifold edges {}, misoriented edges {}, \
             non-manifold vertices {}, degenerate {}, duplicate {}, unreferenced vertices {}, inside out {}",
            self.vertices,
            self.triangles,
            self.components,
            self.boundary_edges.count,
            self.non_manifold_edges.count,
            self.misoriented_edges.count,
            self.non_manifold_vertices.count,
            self.degenerate.count,
            self.duplicates.count,
            self.unreferenced.count,
            self.inside_out.count
        )
    }
}

/// Defects that a caller refuses.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SurfacePolicy {
    /// Refuse holes.
    pub closed: bool,
    /// Refuse non-manifold edges and vertices, and duplicate triangles.
    pub manifold: bool,
    /// Refuse inconsistent orientation.
    pub oriented: bool,
    /// Refuse degenerate triangles.
    pub no_degenerate: bool,
    /// Refuse closed shells that are inside out.
    pub outward: bool,
}

/// The place of a finding.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Place {
    Triangle(usize),
    Edge([u32; 2]),
    Vertex(u32),
}

impl SurfacePolicy {
    /// Accepts everything.
    pub const ANY: Self =
        Self { closed: false, manifold: false, oriented: false, no_degenerate: false, outward: false };
    /// A proper body: closed, manifold, oriented outwards, without degenerate triangles.
    pub const SOLID: Self =
        Self { closed: true, manifold: true, oriented: true, no_degenerate: true, outward: true };

    /// Applies the policy to a report.
    ///
    /// # Errors
    /// [`MeshError::Refused`] with every kind of finding that is not allowed, and where the first one of each is.
    pub fn require(&self, name: &Path, report: &SurfaceReport) -> Result<(), MeshError> {
        let place = |place| match place {
            Place::Triangle(triangle) => format!("triangle {triangle}"),
            Place::Edge([a, b]) => format!("between vertices {a} and {b}"),
            Place::Vertex(vertex) => format!("vertex {vertex}"),
        };
        match self.refusal(report, place) {
            None => Ok(()),
            Some(reason) => Err(MeshError::Refused { file: name.into(), reason }),
        }
    }

    /// What the policy refuses of a file, with places as the file has them.
    #[must_use]
    pub fn refusal_of(&self, report: &SurfaceReport, file: &SurfaceFile) -> Option<String> {
        self.refusal(report, |place| match place {
            Place::Triangle(triangle) => file.triangle(triangle),
            Place::Edge([a, b]) => format!("from {} to {}", file.vertex(a), file.vertex(b)),
            Place::Vertex(vertex) => file.vertex(vertex),
        })
    }

    fn refusal(&self, report: &SurfaceReport, place: impl Fn(Place) -> String) -> Option<String> {
        let triangle = |finding: &Finding<usize>| (finding.count, finding.first.map(Place::Triangle));
        let edge = |finding: &Finding<[u32; 2]>| (finding.count, finding.first.map(Place::Edge));
        let vertex = |finding: &Finding<u32>| (finding.count, finding.first.map(Place::Vertex));
        let findings = [
            (self.no_degenerate, triangle(&report.degenerate), "degenerate triangle", "degenerate triangles"),
            (self.manifold, triangle(&report.duplicates), "duplicate triangle", "duplicate triangles"),
            (
                self.manifold || self.closed,
                edge(&report.non_manifold_edges),
                "edge with more than two triangles",
                "edges with more than two triangles",
            ),
            (
                self.manifold,
                vertex(&report.non_manifold_vertices),
                "vertex where separate fans touch",
                "vertices where separate fans touch",
            ),
            (self.closed, edge(&report.boundary_edges), "open edge", "open edges"),
            (
                self.oriented,
                edge(&report.misoriented_edges),
                "edge between triangles of opposite orientation",
                "edges between triangles of opposite orientation",
            ),
            (
                self.outward,
                triangle(&report.inside_out),
                "closed shell is inside out",
                "closed shells are inside out",
            ),
        ];
        let told: Vec<String> = findings
            .into_iter()
            .filter(|(refused, (count, _), ..)| *refused && *count > 0)
            .map(|(_, (count, first), one, more)| {
                let first = first.map(&place).unwrap_or_default();
                let (what, word) = if count == 1 { (one, "") } else { (more, "the first: ") };
                format!("{count} {what} ({word}{first})")
            })
            .collect();
        (!told.is_empty()).then(|| told.join("; "))
    }
}

/// Finds all defects of a surface whose indices are in range.
///
/// # Panics
/// When an index is out of range; no reader of this module returns such a surface.
pub fn validate_surface(surface: &SurfaceData) -> SurfaceReport {
    let mut report = SurfaceReport {
        vertices: surface.positions.len(),
        triangles: surface.triangles.len(),
        ..SurfaceReport::default()
    };
    let mut used = vec![false; surface.positions.len()];
    for (t, triangle) in surface.triangles.iter().enumerate() {
        if is_degenerate(surface, t) {
            report.degenerate.add(t);
        }
        triangle.iter().for_each(|&vertex| used[vertex as usize] = true);
    }
    used.iter().enumerate().filter(|(_, used)| !**used).for_each(|(v, _)| report.unreferenced.add(v as u32));
    find_duplicates(surface, &mut report);

    let half_edges = half_edges(&surface.triangles);
    let mut bodies = DisjointSets::new(surface.triangles.len());
    // Corners (triangle × 3 + k) of one fan around a vertex are joined across the edges of the vertex.
    let mut fans = DisjointSets::new(3 * surface.triangles.len());
    let corner = |t: u32, vertex: u32| {
        let k = surface.triangles[t as usize].iter().position(|&v| v == vertex).unwrap_or(0);
        3 * t as usize + k
    };
    for edge in half_edges.chunk_by(|a, b| a.0 == b.0) {
        let ends = edge[0].0;
        report.edges += 1;
        match edge {
            [_] => report.boundary_edges.add(ends),
            [a, b] if a.1 == b.1 => report.misoriented_edges.add(ends),
            [_, _] => {}
            _ => report.non_manifold_edges.add(ends),
        }
        for pair in edge.windows(2) {
            bodies.join(pair[0].2 as usize, pair[1].2 as usize);
            for vertex in ends {
                fans.join(corner(pair[0].2, vertex), corner(pair[1].2, vertex));
            }
        }
    }
    report.components = bodies.sets();
    let mut fan_of: Vec<Option<usize>> = vec![None; surface.positions.len()];
    let mut split = vec![false; surface.positions.len()];
    for (t, triangle) in surface.triangles.iter().enumerate() {
        for (k, &vertex) in triangle.iter().enumerate() {
            let fan = fans.root(3 * t + k);
            let known = *fan_of[vertex as usize].get_or_insert(fan);
            // A triangle that repeats a vertex has two corners there; that is degenerate, not two fans.
            split[vertex as usize] |= known != fan && !repeats(triangle);
        }
    }
    for (v, _) in split.iter().enumerate().filter(|(_, split)| **split) {
        report.non_manifold_vertices.add(v as u32);
    }
    let found = shells(surface);
    for shell in found.inside_out(surface) {
        report.inside_out.add(found.shells[shell as usize].first);
    }
    report
}

fn repeats(triangle: &[u32; 3]) -> bool {
    triangle[0] == triangle[1] || triangle[1] == triangle[2] || triangle[2] == triangle[0]
}

pub(super) fn is_degenerate(surface: &SurfaceData, t: usize) -> bool {
    let [a, b, c] = surface.corners(t);
    let longest = (b - a).norm_squared().max((c - b).norm_squared()).max((a - c).norm_squared());
    repeats(&surface.triangles[t]) || surface.area_vector(t).norm() <= DEGENERATE * longest
}

fn find_duplicates(surface: &SurfaceData, report: &mut SurfaceReport) {
    let mut keys: Vec<([u32; 3], usize)> = surface
        .triangles
        .iter()
        .enumerate()
        .map(|(t, triangle)| {
            let mut key = *triangle;
            key.sort_unstable();
            (key, t)
        })
        .collect();
    keys.sort_unstable();
    let mut repeated: Vec<usize> =
        keys.windows(2).filter(|pair| pair[0].0 == pair[1].0).map(|pair| pair[1].1).collect();
    repeated.sort_unstable();
    repeated.into_iter().for_each(|t| report.duplicates.add(t));
}

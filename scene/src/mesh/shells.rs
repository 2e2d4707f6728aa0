//! Shells of a surface: sets of triangles that are connected by edges, which of them are closed, and which way they face.
//!
//! A solid with a cavity has an outer shell that faces outwards and an inner one that faces into the cavity. What is wrong
//! is a closed shell that leaves less than nothing inside: one that faces inwards where no other one is around it.

use nalgebra::{Point3, Vector3};

use super::data::SurfaceData;
use crate::disjoint_sets::DisjointSets;

/// Triangles that are visited in all to tell which shells lie in which; beyond it their boxes decide.
const VISITS_MAX: usize = 200_000_000;

/// One shell.
#[derive(Clone, Debug, PartialEq)]
pub struct Shell {
    /// Its first triangle.
    pub first: usize,
    /// Its number of triangles.
    pub triangles: usize,
    /// Area \[m²\].
    pub area: f64,
    /// Volume by the divergence theorem \[m³\]; negative when it faces inwards. Of a closed shell only.
    pub volume: f64,
    /// Whether every edge has two triangles.
    pub closed: bool,
    /// Whether those run through it in opposite directions.
    pub oriented: bool,
    /// Its box \[m\].
    pub min: Point3<f64>,
    /// Its box \[m\].
    pub max: Point3<f64>,
}

/// The shells of a surface, in the order of their first triangles.
#[derive(Clone, Debug, PartialEq)]
pub struct Shells {
    /// The shells.
    pub shells: Vec<Shell>,
    /// The shell of each triangle.
    pub of_triangle: Vec<u32>,
}

/// An edge as a pair of vertices, the smaller first; whether a triangle runs through it from the larger; that triangle.
pub(super) type HalfEdge = ([u32; 2], bool, u32);

/// The edges of all triangles, equal ones next to each other.
pub(super) fn half_edges(triangles: &[[u32; 3]]) -> Vec<HalfEdge> {
    let mut edges = Vec::with_capacity(3 * triangles.len());
    for (t, triangle) in triangles.iter().enumerate() {
        for k in 0..3 {
            let (from, to) = (triangle[k], triangle[(k + 1) % 3]);
            edges.push(([from.min(to), from.max(to)], from > to, t as u32));
        }
    }
    edges.sort_unstable();
    edges
}

/// Finds the shells of a surface whose indices are in range.
#[must_use]
pub fn shells(surface: &SurfaceData) -> Shells {
    let count = surface.triangles.len();
    let edges = half_edges(&surface.triangles);
    let mut sets = DisjointSets::new(count);
    for edge in edges.chunk_by(|a, b| a.0 == b.0) {
        for pair in edge.windows(2) {
            sets.join(pair[0].2 as usize, pair[1].2 as usize);
        }
    }
    let mut of_root = vec![u32::MAX; count];
    let mut found = Shells { shells: Vec::new(), of_triangle: Vec::with_capacity(count) };
    for t in 0..count {
        let root = sets.root(t);
        if of_root[root] == u32::MAX {
            of_root[root] = found.shells.len() as u32;
            let origin = surface.corners(t)[0];
            let (area, volume, triangles) = (0.0, 0.0, 0);
            let (closed, oriented) = (true, true);
            found.shells.push(Shell {
                first: t,
                triangles,
                area,
                volume,
                closed,
                oriented,
                min: origin,
                max: origin,
            });
        }
        found.of_triangle.push(of_root[root]);
        let shell = &mut found.shells[of_root[root] as usize];
        // About one of its own corners, so that a distant shell loses no digits.
        let origin = surface.corners(shell.first)[0];
        let corners = surface.corners(t);
        let [a, b, c] = corners.map(|corner| corner - origin);
        shell.volume += a.dot(&b.cross(&c)) / 6.0;
        shell.area += surface.area_vector(t).norm() / 2.0;
        shell.triangles += 1;
        for corner in corners {
            shell.min = shell.min.inf(&corner);
            shell.max = shell.max.sup(&corner);
        }
    }
    for edge in edges.chunk_by(|a, b| a.0 == b.0) {
        let shell = &mut found.shells[found.of_triangle[edge[0].2 as usize] as usize];
        shell.closed &= edge.len() == 2;
        shell.oriented &= edge.len() != 2 || edge[0].1 != edge[1].1;
    }
    found
}

impl Shells {
    /// The closed shells that each closed shell lies in, in ascending order; of a shell for which `wanted` is false, none.
    #[must_use]
    pub fn around(&self, surface: &SurfaceData, wanted: impl Fn(usize) -> bool) -> Vec<Vec<u32>> {
        let mut triangles_of: Vec<Vec<u32>> = vec![Vec::new(); self.shells.len()];
        if self.shells.len() > 1 {
            for (t, &shell) in self.of_triangle.iter().enumerate() {
                triangles_of[shell as usize].push(t as u32);
            }
        }
        let mut visits = 0;
        let mut around = vec![Vec::new(); self.shells.len()];
        for (inner, shell) in self.shells.iter().enumerate() {
            if !shell.closed || !wanted(inner) {
                continue;
            }
            let [a, b, c] = surface.corners(shell.first);
            let point = Point3::from((a.coords + b.coords + c.coords) / 3.0);
            for (outer, other) in self.shells.iter().enumerate() {
                let encloses = (0..3).all(|k| other.min[k] <= shell.min[k] && other.max[k] >= shell.max[k]);
                if outer == inner || !other.closed || !encloses {
                    continue;
                }
                visits += triangles_of[outer].len();
                let winds = || {
                    let angle: f64 =
                        triangles_of[outer].iter().map(|&t| solid_angle(surface, t as usize, &point)).sum();
                    (angle / (4.0 * std::f64::consts::PI)).abs() > 0.5
                };
                if visits > VISITS_MAX || winds() {
                    around[inner].push(outer as u32);
                }
            }
        }
        around
    }

    /// Closed shells that leave less than nothing inside, by their numbers.
    #[must_use]
    pub fn inside_out(&self, surface: &SurfaceData) -> Vec<u32> {
        let faces_in = |shell: &Shell| shell.closed && shell.oriented && shell.volume < 0.0;
        let around = self.around(surface, |shell| faces_in(&self.shells[shell]));
        let suspects = (0..self.shells.len()).filter(|&shell| faces_in(&self.shells[shell]));
        let winding = |shell: usize| -> i64 {
            let sign = |&other: &u32| if self.shells[other as usize].volume < 0.0 { -1 } else { 1 };
            around[shell].iter().map(sign).sum()
        };
        suspects.filter(|&shell| winding(shell) < 1).map(|shell| shell as u32).collect()
    }
}

/// The solid angle of a triangle seen from a point, with the sign of its side (A. van Oosterom and J. Strackee, "The solid
/// angle of a plane triangle", 1983) \[sr\].
fn solid_angle(surface: &SurfaceData, triangle: usize, from: &Point3<f64>) -> f64 {
    let [a, b, c]: [Vector3<f64>; 3] = surface.corners(triangle).map(|corner| corner - from);
    let (x, y, z) = (a.norm(), b.norm(), c.norm());
    let below = x * y * z + a.dot(&b) * z + b.dot(&c) * x + c.dot(&a) * y;
    2.0 * a.dot(&b.cross(&c)).atan2(below)
}

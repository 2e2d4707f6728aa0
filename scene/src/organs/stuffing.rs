//! Tetrahedral meshing of an implicit body (Labelle, Shewchuk 2007, "Isosurface stuffing: fast tetrahedral meshes with
//! good dihedral angles"): a lattice, whose vertices are moved onto the surface where it passes close by, and whose
//! tetrahedra are clipped where it does not.

use nalgebra::Point3;

use super::OrganError;
use super::implicit::Implicit;
use super::lattice::Lattice;
use crate::mesh::TetData;

/// A vertex is moved onto the surface if it is within this share of an edge, along an axis or a diagonal. The paper's
/// choice for the best angles.
const WARP_LONG: f64 = 0.249_99;
const WARP_SHORT: f64 = 0.411_89;
/// Bisection steps to find the surface on an edge.
const BISECTIONS: usize = 48;

/// The tetrahedra of a body, `edge` \[m\] long where they are at its surface, up to `2^levels` times that inside.
///
/// # Errors
/// When the body is empty, or the edge too short for its size.
pub fn tetrahedra(body: &Implicit, edge: f64, levels: u8) -> Result<TetData, OrganError> {
    let mut lattice = Lattice::around(body, edge, levels)?;
    let crossings = crossings(&lattice, body);
    let left = warp(&mut lattice, crossings);
    let mut cut = Cutter { vertices: lattice.vertices, left, tets: Vec::new() };
    for tet in &lattice.tets {
        cut.clip(*tet, &lattice.depths);
    }
    cut.vertices.extend(cut.left.iter().map(|(_, place)| *place));
    let tags = vec![0; cut.tets.len()];
    let mut data = TetData { positions: cut.vertices, tets: cut.tets, tags };
    data.compact();
    if data.tets.is_empty() {
        return Err(OrganError::Lost { edge });
    }
    Ok(data)
}

/// Where an edge of the lattice meets the surface.
struct Crossing {
    /// Its ends: the inner one, the outer one.
    ends: [u32; 2],
    place: Point3<f64>,
    /// Share of the edge from the inner end.
    share: f64,
    /// Share within which an end vertex is moved onto the surface.
    warp: f64,
}

fn crossings(lattice: &Lattice, body: &Implicit) -> Vec<Crossing> {
    let mut edges: Vec<[u32; 2]> = Vec::new();
    for tet in &lattice.tets {
        for (a, b) in [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)] {
            let (a, b) = (tet[a], tet[b]);
            match (lattice.depths[a as usize] > 0.0, lattice.depths[b as usize] > 0.0) {
                (true, false) => edges.push([a, b]),
                (false, true) => edges.push([b, a]),
                _ => {}
            }
        }
    }
    edges.sort_unstable();
    edges.dedup();
    edges
        .into_iter()
        .map(|ends| {
            let [inner, outer] = ends.map(|end| lattice.vertices[end as usize]);
            let (mut low, mut high) = (0.0, 1.0);
            for _ in 0..BISECTIONS {
                let middle = 0.5 * (low + high);
                if body.depth(&inner.lerp(&outer, middle)) > 0.0 { low = middle } else { high = middle }
            }
            let share = 0.5 * (low + high);
            let [p, q] = ends.map(|end| lattice.places[end as usize]);
            let axes = (0..3).filter(|&k| p[k] != q[k]).count();
            let warp = if axes == 1 { WARP_LONG } else { WARP_SHORT };
            Crossing { ends, place: inner.lerp(&outer, share), share, warp }
        })
        .collect()
}

/// Moves vertices onto the surface where it is close; returns the crossings of edges between unmoved vertices.
fn warp(lattice: &mut Lattice, crossings: Vec<Crossing>) -> Vec<([u32; 2], Point3<f64>)> {
    let mut by_end: Vec<(u32, usize)> = Vec::with_capacity(2 * crossings.len());
    for (k, crossing) in crossings.iter().enumerate() {
        by_end.extend(crossing.ends.map(|end| (end, k)));
    }
    by_end.sort_unstable();
    for of_one in by_end.chunk_by(|a, b| a.0 == b.0) {
        let vertex = of_one[0].0;
        let closest = of_one
            .iter()
            .map(|&(_, k)| &crossings[k])
            // An edge whose other end was moved is no longer crossed.
            .filter(|crossing| crossing.ends.iter().all(|&end| lattice.depths[end as usize] != 0.0))
            .map(|crossing| {
                let share = if crossing.ends[0] == vertex { crossing.share } else { 1.0 - crossing.share };
                (share / crossing.warp, crossing.place)
            })
            .min_by(|a, b| a.0.total_cmp(&b.0));
        if let Some((relative, place)) = closest
            && relative < 1.0
        {
            lattice.vertices[vertex as usize] = place;
            lattice.depths[vertex as usize] = 0.0;
        }
    }
    let stayed = |end: &u32| lattice.depths[*end as usize] != 0.0;
    let mut left: Vec<_> = crossings
        .into_iter()
        .filter(|crossing| crossing.ends.iter().all(stayed))
        .map(|crossing| {
            let [a, b] = crossing.ends;
            ([a.min(b), a.max(b)], crossing.place)
        })
        .collect();
    left.sort_unstable_by_key(|(ends, _)| *ends);
    left
}

/// Clips tetrahedra by the surface.
struct Cutter {
    vertices: Vec<Point3<f64>>,
    /// Crossed edges, sorted, with their crossing points; the new vertices are numbered from `vertices` on, in this
    /// order.
    left: Vec<([u32; 2], Point3<f64>)>,
    tets: Vec<[u32; 4]>,
}

impl Cutter {
    fn clip(&mut self, tet: [u32; 4], depths: &[f64]) {
        let depth = |vertex: u32| depths[vertex as usize];
        // Inner ones first, then those on the surface, then outer ones; by number among themselves, so that both
        // tetrahedra at a face choose the same diagonal.
        let mut sorted = tet;
        sorted.sort_unstable_by_key(|&vertex| {
            let rank = if depth(vertex) > 0.0 { 0 } else { u8::from(depth(vertex) < 0.0) + 1 };
            (rank, vertex)
        });
        let inner = sorted.iter().filter(|&&vertex| depth(vertex) > 0.0).count();
        let outer = sorted.iter().filter(|&&vertex| depth(vertex) < 0.0).count();
        let [a, b, c, d] = sorted;
        match (inner, outer) {
            (0, _) => {}
            (_, 0) => self.push(sorted),
            (1, 1) => {
                let d = self.on(a, d);
                self.push([a, b, c, d]);
            }
            (1, 2) => {
                let (c, d) = (self.on(a, c), self.on(a, d));
                self.push([a, b, c, d]);
            }
            (1, _) => {
                let (b, c, d) = (self.on(a, b), self.on(a, c), self.on(a, d));
                self.push([a, b, c, d]);
            }
            // A pyramid: c is on the surface.
            (2, 1) => {
                let (ad, bd) = (self.on(a, d), self.on(b, d));
                self.push([a, b, c, bd]);
                self.push([a, bd, c, ad]);
            }
            // A wedge along a and b.
            (2, _) => {
                let (ac, ad) = (self.on(a, c), self.on(a, d));
                let (bc, bd) = (self.on(b, c), self.on(b, d));
                self.push([a, b, bc, bd]);
                self.push([a, bc, ac, bd]);
                self.push([a, ac, ad, bd]);
            }
            // A prism: a, b and c over the cut. Diagonals start at the smaller number.
            _ => {
                let (ad, bd, cd) = (self.on(a, d), self.on(b, d), self.on(c, d));
                self.push([a, b, c, cd]);
                self.push([a, b, bd, cd]);
                self.push([a, ad, bd, cd]);
            }
        }
    }

    /// The vertex on a crossed edge.
    fn on(&self, a: u32, b: u32) -> u32 {
        let key = [a.min(b), a.max(b)];
        // Every edge between an inner and an outer vertex that stayed is listed.
        let at = self.left.binary_search_by_key(&key, |(ends, _)| *ends).unwrap_or(0);
        (self.vertices.len() + at) as u32
    }

    fn push(&mut self, mut tet: [u32; 4]) {
        let count = self.vertices.len();
        let place = |vertex: u32| match self.vertices.get(vertex as usize) {
            Some(place) => *place,
            None => self.left[vertex as usize - count].1,
        };
        let [a, b, c, d] = tet.map(place);
        let volume = (b - a).cross(&(c - a)).dot(&(d - a));
        if volume < 0.0 {
            tet.swap(2, 3);
        }
        if volume != 0.0 {
            self.tets.push(tet);
        }
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{Isometry3, Vector3};

    use super::super::implicit::Part;
    use super::*;
    use crate::mesh::{validate_surface, validate_tets};

    fn ball(radius: f64) -> Implicit {
        let part = Part::Ellipsoid { pose: Isometry3::identity(), radii: Vector3::repeat(radius) };
        Implicit { parts: vec![part], ..Default::default() }
    }

    /// Smallest and largest dihedral angle \[deg\].
    fn dihedrals(data: &TetData) -> [f64; 2] {
        let mut range = [180.0_f64, 0.0_f64];
        for tet in &data.tets {
            let p = tet.map(|vertex| data.positions[vertex as usize]);
            for (a, b, c, d) in
                [(0, 1, 2, 3), (0, 2, 1, 3), (0, 3, 1, 2), (1, 2, 0, 3), (1, 3, 0, 2), (2, 3, 0, 1)]
            {
                let axis = (p[b] - p[a]).normalize();
                let [u, v] = [p[c] - p[a], p[d] - p[a]].map(|way| way - axis * axis.dot(&way));
                let angle = u.angle(&v).to_degrees();
                range = [range[0].min(angle), range[1].max(angle)];
            }
        }
        range
    }

    #[test]
    fn a_ball_is_closed_good_and_as_large_as_a_ball() {
        for levels in [0, 1, 2, 3] {
            let data = tetrahedra(&ball(0.05), 0.006, levels).unwrap();
            let report = validate_tets(&data);
            assert_eq!(
                (report.inverted.count, report.degenerate.count, report.duplicates.count),
                (0, 0, 0),
                "{levels}: {report}"
            );
            assert_eq!((report.non_manifold_faces.count, report.components), (0, 1), "{levels}: {report}");
            let (surface, _) = data.boundary();
            let report = validate_surface(&surface);
            assert!(report.is_closed() && report.is_manifold() && report.is_oriented(), "{levels}: {report}");
            assert_eq!(report.euler_characteristic(), 2);
            let volume = 4.0 / 3.0 * std::f64::consts::PI * 0.05_f64.powi(3);
            let error = (data.volume() / volume - 1.0).abs();
            assert!(error < 0.01, "{levels} levels: volume off by {error}");
            assert!((surface.volume() - data.volume()).abs() < 1e-12, "no gaps and no overlaps");
            for vertex in &surface.positions {
                assert!((vertex.coords.norm() - 0.05).abs() < 1e-9, "{vertex} is not on the ball");
            }
            let [least, most] = dihedrals(&data);
            assert!(least > 15.0 && most < 140.0, "{levels} levels: {least}° to {most}°");
        }
    }

    #[test]
    fn levels_make_it_coarser_inside_only() {
        let fine = tetrahedra(&ball(0.05), 0.003, 0).unwrap();
        let graded = tetrahedra(&ball(0.05), 0.003, 3).unwrap();
        assert!(graded.tets.len() * 2 < fine.tets.len(), "{} of {}", graded.tets.len(), fine.tets.len());
        assert_eq!(graded.boundary_triangles().len(), fine.boundary_triangles().len());
    }

    #[test]
    fn volumes_converge_with_the_square_of_the_edge() {
        let exact = 4.0 / 3.0 * std::f64::consts::PI * 0.05_f64.powi(3);
        let error = |edge: f64| (tetrahedra(&ball(0.05), edge, 2).unwrap().volume() - exact).abs();
        assert!(error(0.012) > 3.0 * error(0.006), "{} and {}", error(0.012), error(0.006));
    }

    #[test]
    fn what_cannot_be_made_is_told() {
        assert_eq!(tetrahedra(&Implicit::default(), 0.01, 0), Err(OrganError::Empty));
        assert!(matches!(tetrahedra(&ball(0.5), 1e-4, 0), Err(OrganError::TooFine { .. })));
        // A wall that contains no lattice vertex.
        let leaf = Implicit { wall: Some(1e-7), ..ball(0.05) };
        assert!(matches!(tetrahedra(&leaf, 0.03, 0), Err(OrganError::Lost { .. })));
    }
}

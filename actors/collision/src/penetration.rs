//! Penetration of two surfaces: the vertices of one inside the other, each with depth and exit direction.
//!
//! Triangles in contact lie along the rim of the intersection; its depth follows from the vertices inside (Heidelberger
//! et al., *Consistent penetration depth estimation for deformable collision response*, 2004). From the rim the search
//! floods over the surface's own edges, as long as it stays inside: its cost depends on the number of vertices inside,
//! not on all vertices.

use nalgebra::{Isometry3, Point3, Vector3};

use crate::moving_surface::MovingSurface;
use crate::pseudonormal::pseudonormal;

/// A vertex inside another surface, in that surface's frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VertexInside {
    /// Its index.
    pub vertex: u32,
    /// Its position \[m\].
    pub point: Point3<f64>,
    /// The nearest triangle of the other surface.
    pub triangle: u32,
    /// The nearest point of that triangle \[m\].
    pub on_surface: Point3<f64>,
    /// Unit exit direction.
    pub outwards: Vector3<f64>,
    /// Penetration depth \[m\].
    pub depth: f64,
}

/// Buffers of the search; after warm-up it does not allocate. It caches the nearest triangle of each vertex as a warm
/// start, so use one search per pair of surfaces; the result does not depend on the cache.
#[derive(Clone, Debug, Default)]
pub struct PenetrationSearch {
    /// Search number of each vertex's last visit.
    stamps: Vec<u32>,
    stamp: u32,
    waiting: Vec<u32>,
    /// Nearest triangle of each vertex at its last visit.
    nearest: Vec<u32>,
    found: Vec<VertexInside>,
}

impl PenetrationSearch {
    /// An empty search.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// The vertices of `surface` inside of `other`, `most` at most, that are connected through the inside with a corner
    /// of one of the `seeds` (triangles of `surface`; invalid indices are ignored), in the order in which they are
    /// reached. Vertices farther than `reach` \[m\] from the other surface are skipped.
    pub fn vertices_inside(
        &mut self,
        surface: &MovingSurface,
        other: &MovingSurface,
        surface_in_other: &Isometry3<f64>,
        seeds: impl IntoIterator<Item = u32>,
        reach: f64,
        most: usize,
    ) -> &[VertexInside] {
        let own = surface.surface();
        if self.stamps.len() != own.vertices().len() || self.stamp == u32::MAX {
            self.stamps.clear();
            self.stamps.resize(own.vertices().len(), 0);
            self.nearest.clear();
            self.nearest.resize(own.vertices().len(), u32::MAX);
            self.stamp = 0;
        }
        self.stamp += 1;
        self.waiting.clear();
        self.found.clear();
        for seed in seeds {
            if let Some(corners) = own.triangles().get(seed as usize) {
                corners.iter().for_each(|vertex| self.wait(*vertex));
            }
        }
        // First in, first out: vertices near the rim come first, and a bound cuts off far ones.
        let mut next = 0;
        while let Some(&vertex) = self.waiting.get(next) {
            next += 1;
            if self.found.len() >= most {
                break;
            }
            let point = surface_in_other * own.vertices()[vertex as usize];
            let nearest = &mut self.nearest[vertex as usize];
            let Some(inside) = inside(other, vertex, &point, reach, nearest) else { continue };
            self.found.push(inside);
            for about in surface.topology().about_vertex(vertex) {
                own.triangles()[*about as usize].iter().for_each(|neighbour| self.wait(*neighbour));
            }
        }
        &self.found
    }

    /// The last result.
    #[must_use]
    pub fn found(&self) -> &[VertexInside] {
        &self.found
    }

    fn wait(&mut self, vertex: u32) {
        let stamp = &mut self.stamps[vertex as usize];
        if std::mem::replace(stamp, self.stamp) != self.stamp {
            self.waiting.push(vertex);
        }
    }
}

/// Whether a point is inside, and its exit. `first` is the warm start, and the nearest triangle afterwards.
fn inside(
    other: &MovingSurface,
    vertex: u32,
    point: &Point3<f64>,
    reach: f64,
    first: &mut u32,
) -> Option<VertexInside> {
    let surface = other.surface();
    let nearest = other.tree().nearest_to_point_from(&surface, point, reach, Some(*first)).ok().flatten()?;
    *first = nearest.triangle;
    let normal = pseudonormal(&surface, other.topology(), nearest.triangle, &nearest.nearest.weights)?;
    let way = nearest.nearest.point - point;
    if normal.dot(&way) <= 0.0 {
        return None;
    }
    let depth = nearest.distance;
    let outwards = way.try_normalize(f64::MIN_POSITIVE).unwrap_or_else(|| normal.normalize());
    let (triangle, on_surface) = (nearest.triangle, nearest.nearest.point);
    Some(VertexInside { vertex, point: *point, triangle, on_surface, outwards, depth })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Surface;
    use crate::obb_tree::{ObbTree, TreeQuery};
    use trocar_scene::shapes;

    fn ball(radius: f64) -> (Vec<Point3<f64>>, Vec<[u32; 3]>) {
        let ball = shapes::sphere(radius, 40, 20).expect("a ball");
        (ball.positions, ball.triangles)
    }

    #[test]
    fn every_vertex_inside_a_ball_is_found_from_the_rim_with_its_way_out() {
        let (vertices, triangles) = ball(0.02);
        let surface = Surface::new(&vertices, &triangles).expect("a surface");
        let (tree, moving) = (ObbTree::build(&surface), MovingSurface::new(&surface));
        let mut search = PenetrationSearch::new();
        for (offset, count) in [(0.030, 1), (0.036, 1), (0.010, 1), (0.0401, 0), (0.05, 0)] {
            let there = Isometry3::translation(0.0, offset * 0.6, offset * 0.8);
            let mut query = TreeQuery::new();
            let rim: Vec<u32> =
                query.all_contacts(&tree, &tree, &there).iter().map(|pair| pair.triangles[1]).collect();
            let found = search.vertices_inside(&moving, &moving, &there, rim, 1.0, usize::MAX).to_vec();
            assert_eq!(usize::from(!found.is_empty()), count, "{offset}");
            for inside in &found {
                let from_middle = (there * vertices[inside.vertex as usize]).coords.norm();
                // The polyhedron lies a little within the ball.
                assert!((inside.depth - (0.02 - from_middle)).abs() < 2e-4, "{inside:?}");
                assert!((inside.point + inside.outwards * inside.depth - inside.on_surface).norm() < 1e-12);
            }
            // Against all vertices.
            let all = (0..vertices.len() as u32)
                .filter(|vertex| {
                    let point = there * vertices[*vertex as usize];
                    super::inside(&moving, *vertex, &point, 1.0, &mut u32::MAX.clone()).is_some()
                })
                .count();
            assert_eq!(found.len(), all, "{offset}");
        }
    }

    #[test]
    fn the_search_is_bounded_and_passes_over_seeds_that_do_not_exist() {
        let (vertices, triangles) = ball(0.02);
        let moving = MovingSurface::new(&Surface::new(&vertices, &triangles).expect("a surface"));
        let mut search = PenetrationSearch::new();
        let there = Isometry3::translation(0.0, 0.0, 0.005);
        let all = 0..triangles.len() as u32 + 10;
        assert_eq!(search.vertices_inside(&moving, &moving, &there, all.clone(), 1.0, 7).len(), 7);
        assert!(search.vertices_inside(&moving, &moving, &there, all.clone(), 1e-9, 7).is_empty());
        let nothing = MovingSurface::new(&Surface::new(&[], &[]).expect("a surface"));
        assert!(search.vertices_inside(&moving, &nothing, &there, all.clone(), 1.0, 7).is_empty());
        assert!(search.vertices_inside(&nothing, &moving, &there, all, 1.0, 7).is_empty());
    }
}

//! How deep two surfaces are in each other: the vertices of one that are inside of the other, each with its way out.
//!
//! Triangles that touch lie along the rim of what two bodies have in common; how deep it is is told by the vertices
//! within (Heidelberger et al., *Consistent penetration depth estimation for deformable collision response*, 2004). From
//! those of the rim the search floods over the surface's own edges, as far as it stays inside: its cost follows what is
//! inside, not what there is.

use nalgebra::{Isometry3, Point3, Vector3};

use crate::moving_surface::MovingSurface;
use crate::pseudonormal::pseudonormal;

/// A vertex inside of another surface. All in that surface's frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VertexInside {
    /// Which vertex.
    pub vertex: u32,
    /// Where it is \[m\].
    pub point: Point3<f64>,
    /// The triangle of the other surface that is nearest to it.
    pub triangle: u32,
    /// The nearest point of that \[m\].
    pub on_surface: Point3<f64>,
    /// Unit direction in which it would get out.
    pub outwards: Vector3<f64>,
    /// How far that is \[m\].
    pub depth: f64,
}

/// Room for the search; a warmed one does not allocate. It remembers which triangle was nearest to each vertex and looks
/// there first, so that one search for each pair of surfaces costs the least; what it finds does not depend on that.
#[derive(Clone, Debug, Default)]
pub struct PenetrationSearch {
    /// When each vertex was last looked at.
    stamps: Vec<u32>,
    stamp: u32,
    waiting: Vec<u32>,
    /// The triangle that was nearest to each vertex when it was last looked at.
    nearest: Vec<u32>,
    found: Vec<VertexInside>,
}

impl PenetrationSearch {
    /// Room for nothing yet.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// The vertices of `surface` inside of `other`, `most` at most, that are connected through the inside with a corner of
    /// one of the `seeds` (triangles of `surface`; those that there are none of are passed over), in the order in which
    /// they are reached. What is farther than `reach` \[m\] from the other surface is not looked at.
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
        // First in, first out: what is near the rim comes first, and a bound cuts off what is far.
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

    /// What was found last.
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

/// Whether a point is inside, and where it would get out. `first` is where to look first, and the nearest afterwards.
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

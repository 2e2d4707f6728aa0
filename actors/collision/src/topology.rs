//! Adjacency of a surface: the triangles at each vertex and each edge, in flat arrays.
//!
//! Built in O(n) by counting, in the order of the triangles. An edge may have one triangle (a border), two, or any
//! number; a triangle with a repeated vertex has an edge from that vertex to itself and is listed once there.

use crate::Surface;

/// Lists of triangles end to end: list `i` is `of[start[i]..start[i + 1]]`.
#[derive(Clone, Debug, Default)]
struct Lists {
    start: Vec<u32>,
    of: Vec<u32>,
}

impl Lists {
    fn get(&self, index: u32) -> &[u32] {
        let index = index as usize;
        match (self.start.get(index), self.start.get(index + 1)) {
            (Some(&from), Some(&to)) => &self.of[from as usize..to as usize],
            _ => &[],
        }
    }

    /// Sorts pairs of (list, item) into `lists` lists, each in the order of the pairs.
    fn new(lists: usize, pairs: impl Iterator<Item = (u32, u32)> + Clone) -> Self {
        let mut start = vec![0_u32; lists + 1];
        for (list, _) in pairs.clone() {
            start[list as usize + 1] += 1;
        }
        for list in 0..lists {
            start[list + 1] += start[list];
        }
        let mut next = start.clone();
        let mut of = vec![0; start[lists] as usize];
        for (list, item) in pairs {
            of[next[list as usize] as usize] = item;
            next[list as usize] += 1;
        }
        Self { start, of }
    }
}

/// Triangles at vertices and edges.
#[derive(Clone, Debug, Default)]
pub struct Topology {
    about_vertex: Lists,
    about_edge: Lists,
    edges: Vec<[u32; 2]>,
    edges_of: Vec<[u32; 3]>,
}

impl Topology {
    /// Builds it in one pass over the triangles.
    #[must_use]
    pub fn new(surface: &Surface) -> Self {
        let triangles = surface.triangles();
        let vertices = surface.vertices().len();
        let corners = triangles.iter().enumerate().flat_map(|(triangle, &[a, b, c])| {
            let distinct = [Some(a), (b != a).then_some(b), (c != a && c != b).then_some(c)];
            distinct.into_iter().flatten().map(move |vertex| (vertex, triangle as u32))
        });
        let about_vertex = Lists::new(vertices, corners);

        // The edges of all triangles, by their smaller vertex: an edge is then found among the few of that vertex.
        let ends = |side: u32| {
            let corners = triangles[side as usize / 3];
            let (a, b) = (corners[side as usize % 3], corners[(side as usize + 1) % 3]);
            [a.min(b), a.max(b)]
        };
        let sides = 3 * triangles.len() as u32;
        let by_smaller = Lists::new(vertices, (0..sides).map(|side| (ends(side)[0], side)));
        let mut edges = Vec::with_capacity(sides as usize / 2);
        let mut edges_of = vec![[0_u32; 3]; triangles.len()];
        for vertex in 0..vertices as u32 {
            let first = edges.len();
            for &side in by_smaller.get(vertex) {
                let own = ends(side);
                let known = edges[first..].iter().position(|&edge| edge == own);
                let edge = known.map_or(edges.len(), |known| first + known);
                if known.is_none() {
                    edges.push(own);
                }
                edges_of[side as usize / 3][side as usize % 3] = edge as u32;
            }
        }
        let of_sides = edges_of.iter().enumerate().flat_map(|(triangle, &[a, b, c])| {
            let distinct = [Some(a), (b != a).then_some(b), (c != a && c != b).then_some(c)];
            distinct.into_iter().flatten().map(move |edge| (edge, triangle as u32))
        });
        let about_edge = Lists::new(edges.len(), of_sides);
        Self { about_vertex, about_edge, edges, edges_of }
    }

    /// Triangles with this corner, ascending; none for a vertex that is not used or does not exist.
    #[must_use]
    pub fn about_vertex(&self, vertex: u32) -> &[u32] {
        self.about_vertex.get(vertex)
    }

    /// Triangles with this edge, ascending: one at a border, two on a manifold; none for an edge that does not exist.
    #[must_use]
    pub fn about_edge(&self, edge: u32) -> &[u32] {
        self.about_edge.get(edge)
    }

    /// The edges of a triangle, from each corner to the next; `None` for a triangle that does not exist.
    #[must_use]
    pub fn edges_of(&self, triangle: u32) -> Option<[u32; 3]> {
        self.edges_of.get(triangle as usize).copied()
    }

    /// The two vertices of every edge, the smaller first.
    #[must_use]
    pub fn edges(&self) -> &[[u32; 2]] {
        &self.edges
    }

    /// Triangles that share the part of `triangle` on which a point with these `weights` lies, itself among them: those
    /// at a vertex, at an edge, or only itself for its interior.
    #[must_use]
    pub fn sharing(&self, corners: &[u32; 3], triangle: u32, weights: &[f64; 3]) -> &[u32] {
        let on = weights.map(|weight| weight > 0.0);
        match on {
            [true, false, false] => self.about_vertex(corners[0]),
            [false, true, false] => self.about_vertex(corners[1]),
            [false, false, true] => self.about_vertex(corners[2]),
            [true, true, false] => self.side(triangle, 0),
            [false, true, true] => self.side(triangle, 1),
            [true, false, true] => self.side(triangle, 2),
            _ => &[],
        }
    }

    fn side(&self, triangle: u32, side: usize) -> &[u32] {
        self.edges_of(triangle).map_or(&[], |edges| self.about_edge(edges[side]))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Point3;
    use proptest::prelude::*;

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(500))]
        /// For any triangle soup, degenerate and non-manifold: exactly the triangles that contain the vertices.
        #[test]
        fn neighbours_are_those_who_name_the_same_vertices(
            triangles in prop::collection::vec([0..12_u32, 0..12, 0..12], 0..60)
        ) {
            let vertices = vec![Point3::origin(); 13];
            let surface = Surface::new(&vertices, &triangles).expect("a surface");
            let topology = Topology::new(&surface);
            let naming = |wanted: &[u32]| -> Vec<u32> {
                (0..triangles.len() as u32)
                    .filter(|&index| wanted.iter().all(|vertex| triangles[index as usize].contains(vertex)))
                    .collect()
            };
            for vertex in 0..15 {
                prop_assert_eq!(topology.about_vertex(vertex), &naming(&[vertex])[..]);
            }
            for (index, corners) in triangles.iter().enumerate() {
                let edges = topology.edges_of(index as u32).expect("a triangle");
                for side in 0..3 {
                    let (a, b) = (corners[side], corners[(side + 1) % 3]);
                    prop_assert_eq!(topology.edges()[edges[side] as usize], [a.min(b), a.max(b)]);
                    if a != b {
                        prop_assert_eq!(topology.about_edge(edges[side]), &naming(&[a, b])[..]);
                    }
                    prop_assert!(topology.about_edge(edges[side]).contains(&(index as u32)));
                }
            }
            let mut unique = topology.edges().to_vec();
            unique.sort_unstable();
            unique.dedup();
            prop_assert_eq!(unique.len(), topology.edges().len());
        }
    }

    #[test]
    fn a_point_shares_its_vertex_its_edge_or_nothing() {
        let vertices = vec![Point3::origin(); 5];
        let triangles = [[0, 1, 2], [1, 0, 3], [2, 4, 0]];
        let topology = Topology::new(&Surface::new(&vertices, &triangles).expect("a surface"));
        let sharing = |weights| topology.sharing(&triangles[0], 0, &weights);
        assert_eq!(sharing([1.0, 0.0, 0.0]), [0, 1, 2]);
        assert_eq!(sharing([0.0, 1.0, 0.0]), [0, 1]);
        assert_eq!(sharing([0.5, 0.5, 0.0]), [0, 1]);
        assert_eq!(sharing([0.5, 0.0, 0.5]), [0, 2]);
        assert_eq!(sharing([0.0, 0.5, 0.5]), [0]);
        assert!(sharing([0.2, 0.2, 0.6]).is_empty());
        assert!(topology.about_edge(99).is_empty() && topology.edges_of(3).is_none());
    }
}

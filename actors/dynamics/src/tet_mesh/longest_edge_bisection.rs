//! Local mesh refinement by longest-edge bisection (Rivara 1984): the mesh stays conforming, and the element quality
//! degrades by at most a fixed factor.

use nalgebra::Point3;
use thiserror::Error;

/// Why a mesh was not refined.
#[derive(Clone, Copy, Debug, Error, PartialEq)]
pub enum RefineError {
    /// A corner that is not a node.
    #[error("element {tet} has a corner that is none of the {nodes} nodes")]
    Corner {
        /// The element.
        tet: usize,
        /// Number of nodes.
        nodes: usize,
    },
    /// A non-finite node position.
    #[error("node {0} is not at a finite place")]
    NotFinite(usize),
    /// The refined mesh would be too large.
    #[error("edges as short as that need more than {nodes_max} nodes")]
    TooMany {
        /// Maximum number of nodes.
        nodes_max: usize,
    },
}

/// Nodes \[m\] and the corners of elements.
pub type NodesAndTets = (Vec<Point3<f64>>, Vec<[u32; 4]>);

/// The longest edge of an element; ties are broken by node numbers.
type Edge = (f64, u32, u32);

struct Refinement {
    nodes: Vec<Point3<f64>>,
    tets: Vec<[u32; 4]>,
    /// Elements at each node.
    around: Vec<Vec<u32>>,
}

/// Bisects elements until each one's longest edge is within `edge_max`, evaluated at the element's centroid \[m\].
/// Nodes keep their numbers, new ones follow; elements keep their orientation.
///
/// # Errors
/// Invalid corners or positions, or more than `nodes_max` nodes.
pub fn refined(
    nodes: &[Point3<f64>],
    tets: &[[u32; 4]],
    edge_max: impl Fn(&Point3<f64>) -> f64,
    nodes_max: usize,
) -> Result<NodesAndTets, RefineError> {
    if let Some(node) = nodes.iter().position(|at| !at.iter().all(|x| x.is_finite())) {
        return Err(RefineError::NotFinite(node));
    }
    let mut around = vec![Vec::new(); nodes.len()];
    for (index, tet) in tets.iter().enumerate() {
        for &node in tet {
            around
                .get_mut(node as usize)
                .ok_or(RefineError::Corner { tet: index, nodes: nodes.len() })?
                .push(index as u32);
        }
    }
    let mut mesh = Refinement { nodes: nodes.to_vec(), tets: tets.to_vec(), around };
    // Split elements are checked again; their other halves come at the end.
    let mut index = 0;
    while index < mesh.tets.len() {
        let corners = mesh.tets[index].map(|node| mesh.nodes[node as usize].coords);
        let middle = Point3::from(corners.iter().sum::<nalgebra::Vector3<f64>>() / 4.0);
        let (square, ..) = mesh.longest(index);
        if square.sqrt() <= edge_max(&middle) || square == 0.0 {
            index += 1;
            continue;
        }
        if mesh.nodes.len() >= nodes_max {
            return Err(RefineError::TooMany { nodes_max });
        }
        mesh.bisect(index);
    }
    Ok((mesh.nodes, mesh.tets))
}

impl Refinement {
    fn longest(&self, tet: usize) -> Edge {
        let corners = self.tets[tet];
        let mut longest: Option<Edge> = None;
        for i in 0..4 {
            for j in i + 1..4 {
                let (a, b) = (corners[i].min(corners[j]), corners[i].max(corners[j]));
                let square = (self.nodes[b as usize] - self.nodes[a as usize]).norm_squared();
                // Lengths that differ by rounding only count as equal.
                let longer = longest.is_none_or(|(most, c, d)| {
                    square > most * (1.0 + 1e-9) || (square > most * (1.0 - 1e-9) && (a, b) < (c, d))
                });
                if longer {
                    longest = Some((square, a, b));
                }
            }
        }
        longest.unwrap_or((0.0, 0, 0))
    }

    /// Elements at an edge.
    fn star(&self, a: u32, b: u32) -> Vec<u32> {
        let has = |tet: &&u32| self.tets[**tet as usize].contains(&b);
        self.around[a as usize].iter().filter(has).copied().collect()
    }

    /// One bisection: splits the longest edge of an element, after any neighbour at that edge with a longer one
    /// (recursively).
    fn bisect(&mut self, tet: usize) {
        let mut edge = self.longest(tet);
        loop {
            let star = self.star(edge.1, edge.2);
            let longer = star.iter().map(|&other| self.longest(other as usize)).find(|other| {
                other.0 > edge.0 * (1.0 + 1e-9)
                    || (other.0 > edge.0 * (1.0 - 1e-9) && (other.1, other.2) < (edge.1, edge.2))
            });
            match longer {
                Some(other) => edge = other,
                None => return self.split(edge.1, edge.2, &star),
            }
        }
    }

    fn split(&mut self, a: u32, b: u32, star: &[u32]) {
        let middle = self.nodes.len() as u32;
        self.nodes.push(nalgebra::center(&self.nodes[a as usize], &self.nodes[b as usize]));
        self.around.push(Vec::with_capacity(2 * star.len()));
        for &tet in star {
            let old = self.tets[tet as usize];
            let new = self.tets.len() as u32;
            self.tets[tet as usize] = old.map(|node| if node == b { middle } else { node });
            self.tets.push(old.map(|node| if node == a { middle } else { node }));
            for node in old.into_iter().filter(|&node| node != a && node != b) {
                self.around[node as usize].push(new);
            }
            self.around[b as usize].retain(|&other| other != tet);
            self.around[b as usize].push(new);
            self.around[middle as usize].extend([tet, new]);
        }
    }
}

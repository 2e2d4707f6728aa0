//! Finer elements where they are wanted: bisection of longest edges (Rivara 1984), so that the mesh stays one without
//! hanging nodes, and no element gets worse than a fixed multiple of those it came from.

use nalgebra::Point3;
use thiserror::Error;

/// Why a mesh was not refined.
#[derive(Clone, Copy, Debug, Error, PartialEq)]
pub enum RefineError {
    /// A corner that is none of the nodes.
    #[error("element {tet} has a corner that is none of the {nodes} nodes")]
    Corner {
        /// Which element.
        tet: usize,
        /// Nodes there are.
        nodes: usize,
    },
    /// A node that is nowhere.
    #[error("node {0} is not at a finite place")]
    NotFinite(usize),
    /// It would be too large.
    #[error("edges as short as that need more than {nodes_max} nodes")]
    TooMany {
        /// What is allowed.
        nodes_max: usize,
    },
}

/// Nodes \[m\] and the corners of elements.
pub type NodesAndTets = (Vec<Point3<f64>>, Vec<[u32; 4]>);

/// The longest edge of an element; of equals always the same.
type Edge = (f64, u32, u32);

struct Refinement {
    nodes: Vec<Point3<f64>>,
    tets: Vec<[u32; 4]>,
    /// Elements about each node.
    around: Vec<Vec<u32>>,
}

/// Bisects elements until no edge about their middles is longer than `edge_max` says for it \[m\]. Nodes keep their
/// numbers, new ones follow; elements keep their orientation.
///
/// # Errors
/// Corners or places that are none, more than `nodes_max` nodes.
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
    // Elements that are split are looked at again, and so are their other halves, which come at the end.
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
                // Equal but for rounding is equal.
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

    /// Elements about an edge.
    fn star(&self, a: u32, b: u32) -> Vec<u32> {
        let has = |tet: &&u32| self.tets[**tet as usize].contains(&b);
        self.around[a as usize].iter().filter(has).copied().collect()
    }

    /// Splits the longest edge of an element, or that of a neighbour about it, if that is longer, and so on: one bisection.
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

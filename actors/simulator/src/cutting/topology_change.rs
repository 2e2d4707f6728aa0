//! Record of a topology change of vertices and triangles, in order, so that attributes (positions, masses, texture
//! coordinates, temperatures, burns) can be updated.

use serde::{Deserialize, Serialize};

/// One change of a vertex.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum VertexChange {
    /// A new vertex, appended, on the edge between two.
    Between {
        /// The edge.
        edge: [u32; 2],
        /// Position from the first to the second, 0 to 1.
        share: f64,
    },
    /// A vertex moved along one of its edges.
    Moved {
        /// The vertex.
        vertex: u32,
        /// The vertex it moved towards.
        towards: u32,
        /// The fraction of the edge, 0 to 1.
        share: f64,
    },
    /// A copy of a vertex, appended, for the other lip of a cut.
    Copy {
        /// The original.
        of: u32,
    },
}

/// The record of a change.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct TopologyChange {
    /// Changes of vertices, in order.
    pub vertices: Vec<VertexChange>,
    /// For each new triangle, appended in this order, the one that it is a part of; indices of triangles do not change.
    pub triangles: Vec<u32>,
    /// Vertices around which springs, masses and the like are to be rebuilt, ascending.
    pub stale: Vec<u32>,
    /// Length of the new lips in the rest shape \[m\].
    pub length: f64,
}

impl TopologyChange {
    /// Whether nothing happened.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.vertices.is_empty() && self.triangles.is_empty() && self.length == 0.0
    }

    /// Updates values per vertex; `mix` interpolates from the first to the second value by a fraction.
    pub fn carry<T: Clone>(&self, values: &mut Vec<T>, mix: impl Fn(&T, &T, f64) -> T) {
        for change in &self.vertices {
            match *change {
                VertexChange::Between { edge: [a, b], share } => {
                    values.push(mix(&values[a as usize], &values[b as usize], share));
                }
                VertexChange::Moved { vertex, towards, share } => {
                    let moved = mix(&values[vertex as usize], &values[towards as usize], share);
                    values[vertex as usize] = moved;
                }
                VertexChange::Copy { of } => values.push(values[of as usize].clone()),
            }
        }
    }

    /// Updates values per triangle.
    pub fn carry_triangles<T: Clone>(&self, values: &mut Vec<T>) {
        for &parent in &self.triangles {
            values.push(values[parent as usize].clone());
        }
    }

    /// Updates a set of vertices, such as pinned ones: it is extended by copies of members and by vertices between two
    /// of them.
    pub fn carry_members(&self, members: &mut Vec<u32>, vertices_before: usize) {
        let mut next = vertices_before as u32;
        for change in &self.vertices {
            let (parents, new) = match *change {
                VertexChange::Between { edge, .. } => (edge, true),
                VertexChange::Copy { of } => ([of, of], true),
                VertexChange::Moved { vertex, .. } => ([vertex; 2], false),
            };
            if new {
                if parents.iter().all(|parent| members.contains(parent)) {
                    members.push(next);
                }
                next += 1;
            }
        }
    }

    /// Appends a later change.
    pub fn append(&mut self, mut later: Self) {
        self.vertices.append(&mut later.vertices);
        self.triangles.append(&mut later.triangles);
        self.stale.append(&mut later.stale);
        self.stale.sort_unstable();
        self.stale.dedup();
        self.length += later.length;
    }
}

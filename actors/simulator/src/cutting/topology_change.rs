//! What a change of topology did to vertices and triangles, in the order in which it was done, so that whatever belongs
//! to them (positions, masses, texture coordinates, temperatures, burn) can follow.

use serde::{Deserialize, Serialize};

/// One thing that happened to the vertices.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum VertexChange {
    /// A new vertex, appended, on the edge between two.
    Between {
        /// The edge.
        edge: [u32; 2],
        /// How far from the first to the second, 0 to 1.
        share: f64,
    },
    /// A vertex moved along an edge of its own.
    Moved {
        /// Which.
        vertex: u32,
        /// To which it moved.
        towards: u32,
        /// How far, 0 to 1.
        share: f64,
    },
    /// A new vertex, appended, for the other lip of a cut.
    Copy {
        /// Of which.
        of: u32,
    },
}

/// The record of a change.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct TopologyChange {
    /// What happened to vertices, in order.
    pub vertices: Vec<VertexChange>,
    /// Of each new triangle, appended in this order, the one that it is a part of; indices of triangles stay.
    pub triangles: Vec<u32>,
    /// Vertices about which springs, masses and the like are to be derived anew, ascending.
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

    /// Brings values per vertex up to date; `mix` gives the value a share of the way from the first to the second.
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

    /// Brings values per triangle up to date.
    pub fn carry_triangles<T: Clone>(&self, values: &mut Vec<T>) {
        for &parent in &self.triangles {
            values.push(values[parent as usize].clone());
        }
    }

    /// Brings a list of vertices that share a property (pinned ones) up to date: copies have it, and what lies between
    /// two that have it.
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

    /// Appends what happened after it.
    pub fn append(&mut self, mut later: Self) {
        self.vertices.append(&mut later.vertices);
        self.triangles.append(&mut later.triangles);
        self.stale.append(&mut later.stale);
        self.stale.sort_unstable();
        self.stale.dedup();
        self.length += later.length;
    }
}

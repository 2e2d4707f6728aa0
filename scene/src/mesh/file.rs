//! What a mesh file holds, with the numbers that it gives to its parts, so that findings name them as the file does.

use std::collections::BTreeMap;

use super::data::{SurfaceData, TetData};
use super::tet_defects::{BadTets, Defect};
use super::tet_repair::Repairs;

/// A mesh file of either kind.
#[derive(Clone, Debug, PartialEq)]
pub enum MeshFile {
    /// Triangles.
    Surface(SurfaceFile),
    /// Tetrahedra.
    Volume(TetFile),
}

/// A surface, with the place of each triangle.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SurfaceFile {
    /// The surface.
    pub surface: SurfaceData,
    /// What a place is: the line of an OBJ file, the facet of an STL one, the face, cell or element of others.
    pub place: &'static str,
    /// The place of each triangle; empty when a place is the number of the triangle, from 0.
    pub places: Vec<u64>,
    /// The number of the first vertex: 1 in OBJ files.
    pub first_vertex: u64,
    /// What the reader took otherwise than it is written, one sentence each.
    pub notes: Vec<String>,
}

impl SurfaceFile {
    /// The place of a triangle, such as "line 12".
    #[must_use]
    pub fn triangle(&self, triangle: usize) -> String {
        let what = if self.place.is_empty() { "triangle" } else { self.place };
        format!("{what} {}", self.places.get(triangle).copied().unwrap_or(triangle as u64))
    }

    /// A vertex as the file numbers it, and where it is.
    #[must_use]
    pub fn vertex(&self, vertex: u32) -> String {
        let at = self.surface.positions.get(vertex as usize).copied().unwrap_or_default();
        format!("vertex {} at ({}, {}, {})", u64::from(vertex) + self.first_vertex, at.x, at.y, at.z)
    }
}

/// A volume, with the numbers of its nodes and elements, and its regions.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TetFile {
    /// The volume; its tags are the regions.
    pub volume: TetData,
    /// The number of each node in the file; empty when nodes are counted from 0.
    pub nodes: Vec<u64>,
    /// The number of the element or cell that each tetrahedron is of; empty when tetrahedra are counted from 0.
    pub elements: Vec<u64>,
    /// Names of regions by their tags, where the file names them.
    pub region_names: BTreeMap<i32, String>,
    /// Whether the file tells regions at all.
    pub has_regions: bool,
    /// What the reader took otherwise than it is written, one sentence each.
    pub notes: Vec<String>,
}

impl TetFile {
    /// The same defects with the numbers of the file. Numbers that need more than 32 bits leave the defects as they are,
    /// counted from 0.
    #[must_use]
    pub fn in_its_numbers(&self, bad: BadTets) -> BadTets {
        let fits = |numbers: &[u64]| numbers.iter().all(|&number| number < u64::from(u32::MAX));
        if !fits(&self.nodes) || !fits(&self.elements) {
            return bad;
        }
        let node = |index: u32| self.nodes.get(index as usize).map_or(index, |&number| number as u32);
        let tet = |index: u32| self.elements.get(index as usize).map_or(index, |&number| number as u32);
        BadTets { defects: bad.defects.into_iter().map(|defect| defect.renumbered(node, tet)).collect() }
    }
}

impl TetFile {
    /// Repairs in words, with the numbers of the file.
    #[must_use]
    pub fn told(&self, repairs: &Repairs) -> String {
        let fits = |numbers: &[u64]| numbers.iter().all(|&number| number < u64::from(u32::MAX));
        if !fits(&self.nodes) || !fits(&self.elements) {
            return repairs.to_string();
        }
        let node = |index: &u32| self.nodes.get(*index as usize).map_or(*index, |&number| number as u32);
        let tet = |index: &u32| self.elements.get(*index as usize).map_or(*index, |&number| number as u32);
        let named = Repairs {
            turned_tets: repairs.turned_tets.iter().map(tet).collect(),
            dropped_tets: repairs.dropped_tets.iter().map(tet).collect(),
            merged_nodes: repairs.merged_nodes.iter().map(|(which, to)| (node(which), node(to))).collect(),
            dropped_nodes: repairs.dropped_nodes.iter().map(node).collect(),
            ..Repairs::default()
        };
        named.to_string()
    }
}

impl Defect {
    /// The same defect with other numbers of nodes and elements.
    #[must_use]
    pub fn renumbered(self, to_node: impl Fn(u32) -> u32, to_tet: impl Fn(u32) -> u32) -> Self {
        match self {
            Defect::Empty | Defect::TooMany { .. } => self,
            Defect::NotFinite { node } => Defect::NotFinite { node: to_node(node) },
            Defect::NoNode { tet, node, nodes } => Defect::NoNode { tet: to_tet(tet), node, nodes },
            Defect::RepeatedCorner { tet, node } => {
                Defect::RepeatedCorner { tet: to_tet(tet), node: to_node(node) }
            }
            Defect::Inverted { tet, volume } => Defect::Inverted { tet: to_tet(tet), volume },
            Defect::Flat { tet, volume } => Defect::Flat { tet: to_tet(tet), volume },
            Defect::Sliver { tet, mean_ratio, least } => {
                Defect::Sliver { tet: to_tet(tet), mean_ratio, least }
            }
            Defect::SameCorners { first, second } => {
                Defect::SameCorners { first: to_tet(first), second: to_tet(second) }
            }
            Defect::SharedFace { corners, count, first, second } => Defect::SharedFace {
                corners: corners.map(to_node),
                count,
                first: to_tet(first),
                second: to_tet(second),
            },
            Defect::Overlap { corners, first, second } => Defect::Overlap {
                corners: corners.map(to_node),
                first: to_tet(first),
                second: to_tet(second),
            },
            Defect::Coincident { first, second } => {
                Defect::Coincident { first: to_node(first), second: to_node(second) }
            }
            Defect::Unreferenced { node } => Defect::Unreferenced { node: to_node(node) },
        }
    }
}

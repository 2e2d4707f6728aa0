//! Topology changes of a tetrahedral mesh: elements are removed (burned, vaporised), and faces between elements are
//! opened (cut, torn). Derived data is updated locally: neighbours, boundary, nodal volumes, and nodes. Parts that stay
//! connected only by a node or an edge are separated, with duplicate nodes.

use std::collections::BTreeSet;

use nalgebra::{Point3, Vector3};
use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::{MeshError, MeshRules, TetMesh};
use trocar_scene::mesh::tet_faces::{OPPOSITE, faces};

/// A face of an element: the element, and the corner opposite to the face.
pub type TetFace = (u32, u8);

/// Why a mesh was not changed.
#[derive(Clone, Copy, Debug, Error, PartialEq, Eq)]
pub enum VolumeError {
    /// An element that does not exist or was removed.
    #[error("element {tet} is not there: {left} of {tets} are left")]
    NoElement {
        /// The element.
        tet: u32,
        /// Elements that are left.
        left: usize,
        /// Elements at the beginning.
        tets: usize,
    },
    /// A corner other than 0 to 3.
    #[error("face {corner} of element {tet}: 0 to 3 are valid")]
    NoFace {
        /// Which element.
        tet: u32,
        /// The corner.
        corner: u8,
    },
    /// The mesh has reached its maximum size.
    #[error("the mesh has {0} elements: it is cut no further")]
    Full(usize),
}

/// Origin of a new node: a fraction of the way between two nodes, which are equal for a duplicated node.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct NodeOrigin {
    /// The two nodes.
    pub of: [u32; 2],
    /// The fraction, 0 to 1.
    pub share: f64,
}

impl NodeOrigin {
    /// A duplicate of a node.
    pub(super) fn copy(of: u32) -> Self {
        Self { of: [of; 2], share: 0.0 }
    }

    /// Interpolates a nodal value for the new node; `mix` interpolates between two values by a fraction.
    pub fn mix<T>(&self, values: &[T], mix: impl Fn(&T, &T, f64) -> T) -> T {
        let [from, to] = self.of.map(|node| &values[node as usize]);
        mix(from, to, self.share)
    }
}

/// A split element.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SplitTet {
    /// The element; its second end is the new node now.
    pub tet: u32,
    /// The other half, in which the first end is the new node.
    pub child: u32,
    /// Corners of the element at the ends of the edge.
    pub ends: [u8; 2],
}

impl SplitTet {
    /// Faces that are split too: those of the element, each with its other half.
    pub fn faces(&self) -> impl Iterator<Item = (TetFace, TetFace)> + '_ {
        let corners = (0..4_u8).filter(|corner| !self.ends.contains(corner));
        corners.map(|corner| ((self.tet, corner), (self.child, corner)))
    }

    /// The face that now belongs to the other half: before and after.
    #[must_use]
    pub fn moved_face(&self) -> [TetFace; 2] {
        [(self.tet, self.ends[0]), (self.child, self.ends[0])]
    }
}

/// The effect of a topology change, for all data attached to the mesh.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct VolumeChange {
    /// Removed elements.
    pub removed: Vec<u32>,
    /// New nodes, numbered after all others in this order.
    pub born: Vec<NodeOrigin>,
    /// Split elements, in order.
    pub halved: Vec<SplitTet>,
    /// Elements with renumbered corners, ascending.
    pub renamed: Vec<u32>,
    /// Faces that have become boundary faces.
    pub uncovered: Vec<TetFace>,
    /// Nodes of removed elements.
    pub loosened: BTreeSet<u32>,
}

/// A tetrahedral mesh whose topology changes. Elements and nodes keep their numbers; new ones are numbered after them.
#[derive(Clone, Debug, PartialEq)]
pub struct Volume {
    pub(super) rest: Vec<Point3<f64>>,
    pub(super) tets: Vec<Option<[u32; 4]>>,
    /// The neighbour at the face opposite to each corner.
    pub(super) neighbours: Vec<[Option<u32>; 4]>,
    pub(super) around: Vec<Vec<u32>>,
    pub(super) boundary: BTreeSet<TetFace>,
    pub(super) volumes: Vec<f64>,
    pub(super) shares: Vec<f64>,
    pub(super) left: usize,
}

impl Volume {
    /// From a mesh.
    #[must_use]
    pub fn new(mesh: &TetMesh) -> Self {
        let count = mesh.tets().len();
        let nodes = mesh.rest().len();
        let mut neighbours = vec![[None; 4]; count];
        let mut boundary = BTreeSet::new();
        let all = faces(mesh.tets());
        for same in all.chunk_by(|one, other| one.sorted == other.sorted) {
            let corner = |index: usize| {
                let tet = mesh.tets()[same[index].tet as usize];
                tet.iter().position(|node| !same[index].sorted.contains(node)).unwrap_or(0)
            };
            if let [one, other] = same {
                neighbours[one.tet as usize][corner(0)] = Some(other.tet);
                neighbours[other.tet as usize][corner(1)] = Some(one.tet);
            } else {
                boundary.insert((same[0].tet, corner(0) as u8));
            }
        }
        let mut around = vec![Vec::new(); nodes];
        let mut shares = vec![0.0; nodes];
        for (index, tet) in mesh.tets().iter().enumerate() {
            for &node in tet {
                around[node as usize].push(index as u32);
                shares[node as usize] += 0.25 * mesh.volumes()[index];
            }
        }
        Self {
            rest: mesh.rest().to_vec(),
            tets: mesh.tets().iter().copied().map(Some).collect(),
            neighbours,
            around,
            boundary,
            volumes: mesh.volumes().to_vec(),
            shares,
            left: count,
        }
    }

    /// Rest positions of all nodes \[m\], including those that no element uses any longer.
    #[must_use]
    pub fn rest(&self) -> &[Point3<f64>] {
        &self.rest
    }

    /// Corners of an element; `None` if it was removed.
    #[must_use]
    pub fn tet(&self, tet: u32) -> Option<[u32; 4]> {
        self.tets.get(tet as usize).copied().flatten()
    }

    /// Present elements, with their numbers.
    pub fn tets(&self) -> impl Iterator<Item = (u32, [u32; 4])> {
        self.tets.iter().enumerate().filter_map(|(index, tet)| Some((index as u32, (*tet)?)))
    }

    /// Nodal volume \[m³\]: a quarter of the volume of each of its elements; times the density it is the node's mass.
    #[must_use]
    pub fn shares(&self) -> &[f64] {
        &self.shares
    }

    /// Number of present elements.
    #[must_use]
    pub fn left(&self) -> usize {
        self.left
    }

    /// Faces of the boundary, by element.
    pub fn boundary(&self) -> impl Iterator<Item = TetFace> {
        self.boundary.iter().copied()
    }

    /// Corners of a face, counter-clockwise seen from outside its element; `None` if it does not exist.
    #[must_use]
    pub fn face(&self, (tet, corner): TetFace) -> Option<[u32; 3]> {
        let nodes = self.tet(tet)?;
        Some(OPPOSITE.get(corner as usize)?.map(|at| nodes[at]))
    }

    /// Triangles of the boundary, counter-clockwise seen from outside, by element.
    pub fn surface(&self) -> impl Iterator<Item = [u32; 3]> {
        self.boundary().filter_map(|face| self.face(face))
    }

    /// Nodes that no element uses any longer.
    #[must_use]
    pub fn orphans(&self) -> Vec<u32> {
        (0..self.around.len() as u32).filter(|&node| self.around[node as usize].is_empty()).collect()
    }

    /// The present mesh, without removed elements and unused nodes, and the original number of each of its nodes,
    /// ascending.
    ///
    /// # Errors
    /// Nothing is left.
    pub fn mesh(&self) -> Result<(TetMesh, Vec<u32>), MeshError> {
        let used: Vec<u32> =
            (0..self.around.len() as u32).filter(|&node| !self.around[node as usize].is_empty()).collect();
        let rest: Vec<_> = used.iter().map(|&node| self.rest[node as usize]).collect();
        let mut numbers = vec![0; self.rest.len()];
        used.iter().enumerate().for_each(|(own, &node)| numbers[node as usize] = own as u32);
        let tets: Vec<[u32; 4]> =
            self.tets().map(|(_, tet)| tet.map(|node| numbers[node as usize])).collect();
        let rules = MeshRules { mean_ratio_min: 0.0, coincident_within: None };
        Ok((TetMesh::new(&rest, &tets, &rules)?, used))
    }

    /// Number of parts connected by faces.
    #[must_use]
    pub fn pieces(&self) -> usize {
        self.parts().1
    }

    /// The connected part of each present element, and the number of parts.
    fn parts(&self) -> (Vec<Option<u32>>, usize) {
        let mut part = vec![None; self.tets.len()];
        let mut count = 0;
        for (first, _) in self.tets() {
            if part[first as usize].is_some() {
                continue;
            }
            let mut open = vec![first];
            part[first as usize] = Some(count);
            while let Some(tet) = open.pop() {
                for next in self.neighbours[tet as usize].into_iter().flatten() {
                    if part[next as usize].is_none() {
                        part[next as usize] = Some(count);
                        open.push(next);
                    }
                }
            }
            count += 1;
        }
        (part, count as usize)
    }

    /// Duplicates the nodes that connect parts without a shared face; adds this to `change`.
    pub fn separate(&mut self, change: &mut VolumeChange) {
        let (part, _) = self.parts();
        let between =
            |star: &Vec<u32>| star.windows(2).any(|two| part[two[0] as usize] != part[two[1] as usize]);
        let nodes = (0..self.around.len() as u32).filter(|&node| between(&self.around[node as usize]));
        let nodes = nodes.collect();
        self.split(nodes, change);
    }

    /// Removes elements; parts that are then connected only by a node or an edge get duplicate nodes.
    ///
    /// # Errors
    /// An element is not present; nothing has changed then.
    pub fn remove(&mut self, tets: &[u32]) -> Result<VolumeChange, VolumeError> {
        let mut change = self.take_out(tets)?;
        self.split(change.loosened.clone(), &mut change);
        Ok(change)
    }

    /// Removes elements and keeps all nodes, including unused ones, so that a solver gets no new nodes.
    ///
    /// # Errors
    /// An element is not present; nothing has changed then.
    pub fn take_out(&mut self, tets: &[u32]) -> Result<VolumeChange, VolumeError> {
        let mut going = tets.to_vec();
        going.sort_unstable();
        going.dedup();
        going.iter().try_for_each(|&tet| self.check(tet))?;
        let mut change = VolumeChange::default();
        for &tet in &going {
            for corner in 0..4_u8 {
                self.boundary.remove(&(tet, corner));
                if let Some(next) = self.neighbours[tet as usize][corner as usize].take() {
                    self.part(next, tet, &mut change);
                }
            }
            let Some(nodes) = self.tets[tet as usize].take() else { continue };
            for node in nodes {
                self.around[node as usize].retain(|&other| other != tet);
                self.shares[node as usize] -= 0.25 * self.volumes[tet as usize];
                change.loosened.insert(node);
            }
        }
        self.left -= going.len();
        // Faces between elements that were removed together are no boundary.
        change.uncovered.retain(|(tet, _)| self.tets[*tet as usize].is_some());
        change.removed = going;
        Ok(change)
    }

    /// Opens faces between elements; their nodes are duplicated where the two sides are not otherwise connected.
    ///
    /// # Errors
    /// An element or a corner does not exist; nothing has changed then.
    pub fn open(&mut self, faces: &[TetFace]) -> Result<VolumeChange, VolumeError> {
        for &(tet, corner) in faces {
            self.check(tet)?;
            if corner > 3 {
                return Err(VolumeError::NoFace { tet, corner });
            }
        }
        let mut change = VolumeChange::default();
        let mut touched = BTreeSet::new();
        for &(tet, corner) in faces {
            let Some(next) = self.neighbours[tet as usize][corner as usize].take() else { continue };
            self.boundary.insert((tet, corner));
            change.uncovered.push((tet, corner));
            self.part(next, tet, &mut change);
            if let Some(nodes) = self.tets[tet as usize] {
                touched.extend(OPPOSITE[corner as usize].map(|at| nodes[at]));
            }
        }
        self.split(touched, &mut change);
        Ok(change)
    }

    fn check(&self, tet: u32) -> Result<(), VolumeError> {
        match self.tet(tet) {
            Some(_) => Ok(()),
            None => Err(VolumeError::NoElement { tet, left: self.left, tets: self.tets.len() }),
        }
    }

    /// Removes the neighbour `from` of an element; their face becomes a boundary face.
    fn part(&mut self, tet: u32, from: u32, change: &mut VolumeChange) {
        let sides = &mut self.neighbours[tet as usize];
        if let Some(corner) = sides.iter().position(|next| *next == Some(from)) {
            sides[corner] = None;
            self.boundary.insert((tet, corner as u8));
            change.uncovered.push((tet, corner as u8));
        }
    }

    /// Gives every face-connected part of the elements at a node its own duplicate of the node.
    fn split(&mut self, nodes: BTreeSet<u32>, change: &mut VolumeChange) {
        let mut renamed = BTreeSet::new();
        for node in nodes {
            let mut star = self.around[node as usize].clone();
            star.sort_unstable();
            let mut first = true;
            while let Some(&begin) = star.first() {
                let mut part = BTreeSet::from([begin]);
                let mut open = vec![begin];
                while let Some(tet) = open.pop() {
                    for next in self.neighbours[tet as usize].into_iter().flatten() {
                        if star.binary_search(&next).is_ok() && part.insert(next) {
                            open.push(next);
                        }
                    }
                }
                star.retain(|tet| !part.contains(tet));
                if !std::mem::replace(&mut first, false) {
                    self.give_own(node, &part, change);
                    renamed.extend(part);
                }
            }
        }
        change.renamed = renamed.into_iter().collect();
    }

    fn give_own(&mut self, node: u32, part: &BTreeSet<u32>, change: &mut VolumeChange) {
        let own = self.rest.len() as u32;
        self.rest.push(self.rest[node as usize]);
        let mut share = 0.0;
        for &tet in part {
            if let Some(corners) = &mut self.tets[tet as usize] {
                *corners = corners.map(|corner| if corner == node { own } else { corner });
                share += 0.25 * self.volumes[tet as usize];
            }
        }
        self.shares[node as usize] -= share;
        self.shares.push(share);
        self.around[node as usize].retain(|tet| !part.contains(tet));
        self.around.push(part.iter().copied().collect());
        change.born.push(NodeOrigin::copy(node));
    }

    /// Faces that a straight edge has passed on its way from `before` to `after` \[m\]: those whose two elements'
    /// centroids the swept surface separates. `positions`: current node positions \[m\].
    #[must_use]
    pub fn swept(
        &self,
        positions: &[Point3<f64>],
        before: &[Point3<f64>; 2],
        after: &[Point3<f64>; 2],
    ) -> Vec<TetFace> {
        let middle = |nodes: &[u32; 4]| {
            Point3::from(nodes.iter().map(|&n| positions[n as usize].coords).sum::<Vector3<f64>>() / 4.0)
        };
        let blades = [[before[0], before[1], after[1]], [before[0], after[1], after[0]]];
        let mut found = Vec::new();
        for (tet, nodes) in self.tets() {
            let from = middle(&nodes);
            for (corner, next) in self.neighbours[tet as usize].iter().enumerate() {
                let Some((next, other)) = next.and_then(|next| Some((next, self.tet(next)?))) else {
                    continue;
                };
                if next > tet && blades.iter().any(|blade| crosses(&from, &middle(&other), blade)) {
                    found.push((tet, corner as u8));
                }
            }
        }
        found
    }

    /// The interior face with the largest normal stress, and that stress \[Pa\]; `stress`: Cauchy stress of each
    /// element \[Pa\]. Rankine's criterion: the face tears when the stress exceeds the strength.
    #[must_use]
    pub fn most_pulled(
        &self,
        positions: &[Point3<f64>],
        stress: impl Fn(u32) -> nalgebra::Matrix3<f64>,
    ) -> Option<(TetFace, f64)> {
        let mut most: Option<(TetFace, f64)> = None;
        for (tet, nodes) in self.tets() {
            let own = stress(tet);
            for (corner, next) in self.neighbours[tet as usize].iter().enumerate() {
                let Some(next) = next.filter(|&next| next > tet) else { continue };
                let [a, b, c] = OPPOSITE[corner].map(|at| positions[nodes[at] as usize]);
                let Some(normal) = (b - a).cross(&(c - a)).try_normalize(0.0) else { continue };
                let tension = normal.dot(&((own + stress(next)) * normal)) / 2.0;
                if most.is_none_or(|(_, known)| tension > known) {
                    most = Some(((tet, corner as u8), tension));
                }
            }
        }
        most
    }
}

/// Whether a segment crosses a triangle.
fn crosses(from: &Point3<f64>, to: &Point3<f64>, [a, b, c]: &[Point3<f64>; 3]) -> bool {
    let way = to - from;
    let side = |p: &Point3<f64>, q: &Point3<f64>| way.dot(&(p - from).cross(&(q - from)));
    let sides = [side(a, b), side(b, c), side(c, a)];
    let normal = (b - a).cross(&(c - a));
    let heights = [normal.dot(&(from - a)), normal.dot(&(to - a))];
    // Half open: a point on the surface belongs to one side of it.
    let passes = (heights[0] < 0.0) != (heights[1] < 0.0);
    passes && (sides.iter().all(|s| *s >= 0.0) || sides.iter().all(|s| *s <= 0.0))
}

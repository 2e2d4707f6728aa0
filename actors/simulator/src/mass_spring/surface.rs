//! The network of a surface, whole or brought up to date about the triangles that a cut has changed: the same springs in
//! the same order either way, so that a solver rebuilt from its mesh goes on with the same bits.

use nalgebra::Point3;

use super::error::{Faulty, NetworkError};
use super::network::{Hinge, LEAST, LOOSE, Network, Spring, SurfaceMaterial, check_elements, parameter};
use crate::elasticity::Alteration;

/// One side of a triangle, by its edge: the order in which shares are summed.
type Side = ([u32; 2], u32);

fn sides(triangle: u32, corners: &[u32; 3]) -> [Side; 3] {
    let [a, b, c] = *corners;
    [[a, b], [b, c], [c, a]].map(|[a, b]| ([a.min(b), a.max(b)], triangle))
}

/// Sine of a fold (as a share of its edge) below which it counts as flat.
const FLAT: f64 = 1e-6;

/// Area of a triangle \[m²\].
pub(crate) fn area(corners: &[u32; 3], positions: &[Point3<f64>]) -> f64 {
    let [a, b, c] = corners.map(|node| positions[node as usize]);
    0.5 * (b - a).cross(&(c - a)).norm()
}

impl Network {
    /// A cloth, a membrane or the wall of a tube: springs along the edges of triangles and, where exactly two triangles
    /// meet, a hinge that is at rest in the shape given.
    ///
    /// # Errors
    /// Whatever is wrong with mesh or material, elements by their index.
    pub fn from_surface(
        rest: &[Point3<f64>],
        triangles: &[[u32; 3]],
        material: &SurfaceMaterial,
    ) -> Result<Self, NetworkError> {
        Self::from_altered_surface(rest, triangles, material, &[], &[])
    }

    /// The same of triangles of which each is as `altered` says, or all as they were where that is empty. Nodes in `loose`
    /// may be of no triangle: they are to be pinned, and have a mass for the sake of form.
    ///
    /// # Errors
    /// As [`from_surface`](Self::from_surface).
    pub fn from_altered_surface(
        rest: &[Point3<f64>],
        triangles: &[[u32; 3]],
        material: &SurfaceMaterial,
        altered: &[Alteration],
        loose: &[u32],
    ) -> Result<Self, NetworkError> {
        check(rest, triangles, material)?;
        let mut network = Self { masses: vec![0.0; rest.len()], rest: rest.to_vec(), ..Self::default() };
        let mut all: Vec<Side> = Vec::with_capacity(3 * triangles.len());
        for (index, corners) in triangles.iter().enumerate() {
            let share = material.density * area(corners, rest) / 3.0;
            corners.iter().for_each(|&node| network.masses[node as usize] += share);
            all.extend(sides(index as u32, corners));
        }
        all.sort_unstable();
        for edge in all.chunk_by(|first, second| first.0 == second.0) {
            network.push_edge(rest, triangles, material, edge);
            network.alter_last(edge, triangles, rest, altered);
        }
        for &node in loose {
            let mass = &mut network.masses[node as usize];
            *mass = if *mass > 0.0 { *mass } else { LOOSE };
        }
        network.check(rest.len())?;
        Ok(network)
    }

    /// Makes the edge that was pushed last as stiff and as long as its triangles are, each by its share of the area.
    fn alter_last(
        &mut self,
        edge: &[Side],
        triangles: &[[u32; 3]],
        rest: &[Point3<f64>],
        altered: &[Alteration],
    ) {
        let (mut whole, mut stiffness, mut length) = (0.0, 0.0, 0.0);
        for &(_, triangle) in edge {
            let of = altered.get(triangle as usize).copied().unwrap_or(Alteration::NONE);
            let share = area(&triangles[triangle as usize], rest);
            whole += share;
            stiffness += share * of.stiffness;
            length += share * of.length;
        }
        let (stiffness, length) = (stiffness / whole, length / whole);
        if stiffness == 1.0 && length == 1.0 {
            return;
        }
        if let Some(spring) = self.springs.last_mut() {
            spring.stiffness *= stiffness;
            spring.rest *= length;
        }
        if let Some(hinge) = self.hinges.last_mut().filter(|hinge| hinge.nodes[..2] == edge[0].0) {
            hinge.stiffness *= stiffness;
        }
    }

    fn push_edge(
        &mut self,
        rest: &[Point3<f64>],
        triangles: &[[u32; 3]],
        material: &SurfaceMaterial,
        edge: &[Side],
    ) {
        let nodes = edge[0].0;
        let ends = nodes.map(|node| rest[node as usize]);
        let squared = (ends[1] - ends[0]).norm_squared();
        let about: f64 = edge.iter().map(|side| area(&triangles[side.1 as usize], rest)).sum();
        self.springs.push(Spring {
            nodes,
            rest: squared.sqrt(),
            stiffness: material.membrane_stiffness * about / squared,
        });
        let &[first, second] = edge else { return };
        if material.bending_stiffness == 0.0 {
            return;
        }
        let across = [first, second].map(|side| {
            let corners = triangles[side.1 as usize];
            corners.into_iter().find(|corner| !nodes.contains(corner)).unwrap_or(nodes[0])
        });
        let mut weights = [0.0; 4];
        for (slot, &node) in across.iter().enumerate() {
            let apex = rest[node as usize];
            let cotangent = |at: usize| {
                let (along, up) = (ends[1 - at] - ends[at], apex - ends[at]);
                along.dot(&up) / along.cross(&up).norm()
            };
            let cotangents = [cotangent(0), cotangent(1)];
            weights[0] += cotangents[1];
            weights[1] += cotangents[0];
            weights[2 + slot] = -cotangents[0] - cotangents[1];
        }
        let mut hinge = Hinge {
            nodes: [nodes[0], nodes[1], across[0], across[1]],
            weights,
            rest: 0.0,
            side: 0.0,
            stiffness: material.bending_stiffness / about,
        };
        let bent = hinge.vector(rest).norm();
        if bent > FLAT * squared.sqrt() {
            hinge.rest = bent;
            hinge.side = super::network::volume(&hinge.nodes, rest).signum();
        }
        self.hinges.push(hinge);
    }

    /// Brings springs, hinges and masses up to date after the triangles `changed` (ascending) have got other corners, or
    /// corners of theirs another rest position: what stays is kept, what those triangles have touched is made anew.
    /// `about` lists the triangles about each node of the new mesh, ascending; `stale` the nodes (ascending) whose
    /// edges may have changed, those of the changed triangles before and after.
    ///
    /// # Errors
    /// Whatever is wrong with the new triangles; the network is then as it was.
    pub fn update_surface<'a>(
        &mut self,
        rest: &[Point3<f64>],
        triangles: &[[u32; 3]],
        material: &SurfaceMaterial,
        stale: &[u32],
        about: impl Fn(u32) -> &'a [u32],
    ) -> Result<(), NetworkError> {
        let mut touched: Vec<u32> = stale.iter().flat_map(|&node| about(node)).copied().collect();
        touched.sort_unstable();
        touched.dedup();
        let bad = |&triangle: &u32| area(&triangles[triangle as usize], rest) <= LEAST;
        let first: Vec<u32> = touched.iter().copied().filter(bad).collect();
        let count = first.len();
        Faulty { first, count }.refuse(|faulty| NetworkError::NoExtent { kind: "triangle", faulty })?;

        // All edges of those triangles: those with a stale end may be others than before, and the hinge of the one
        // across from a stale corner reaches over to it.
        let is_stale = |node: u32| stale.binary_search(&node).is_ok();
        let mut fresh = Self::default();
        let all = touched.iter().flat_map(|&triangle| sides(triangle, &triangles[triangle as usize]));
        let mut edges: Vec<[u32; 2]> = all.map(|side| side.0).collect();
        edges.sort_unstable();
        edges.dedup();
        let mut edge: Vec<Side> = Vec::new();
        for &nodes in &edges {
            let with_both = |&&triangle: &&u32| triangles[triangle as usize].contains(&nodes[1]);
            edge.clear();
            edge.extend(about(nodes[0]).iter().filter(with_both).map(|&triangle| (nodes, triangle)));
            fresh.push_edge(rest, triangles, material, &edge);
        }
        let remade =
            |nodes: [u32; 2]| nodes.iter().any(|&node| is_stale(node)) || edges.binary_search(&nodes).is_ok();
        self.springs.retain(|spring| !remade(spring.nodes));
        self.hinges.retain(|hinge| !remade([hinge.nodes[0], hinge.nodes[1]]));
        merge(&mut self.springs, fresh.springs, |spring| spring.nodes);
        merge(&mut self.hinges, fresh.hinges, |hinge| [hinge.nodes[0], hinge.nodes[1]]);
        self.masses.resize(rest.len(), 0.0);
        self.rest.clear();
        self.rest.extend_from_slice(rest);
        let mut corners: Vec<u32> = touched.iter().flat_map(|&index| triangles[index as usize]).collect();
        corners.extend_from_slice(stale);
        corners.sort_unstable();
        corners.dedup();
        for node in corners {
            let shares = about(node)
                .iter()
                .map(|&index| material.density * area(&triangles[index as usize], rest) / 3.0);
            self.masses[node as usize] = shares.fold(0.0, |sum, share| sum + share);
        }
        Ok(())
    }
}

fn check(
    rest: &[Point3<f64>],
    triangles: &[[u32; 3]],
    material: &SurfaceMaterial,
) -> Result<(), NetworkError> {
    parameter("membrane_stiffness", material.membrane_stiffness, LEAST)?;
    parameter("bending_stiffness", material.bending_stiffness, 0.0)?;
    parameter("density", material.density, LEAST)?;
    check_elements("triangle", rest, triangles)?;
    Faulty::among(triangles.len(), |index| area(&triangles[index], rest) <= LEAST)
        .refuse(|faulty| NetworkError::NoExtent { kind: "triangle", faulty })
}

/// Puts sorted `more` into sorted `into`.
fn merge<T>(into: &mut Vec<T>, more: Vec<T>, key: impl Fn(&T) -> [u32; 2]) {
    into.extend(more);
    // Two sorted runs: a merge sort finds them and joins them in linear time.
    into.sort_by_key(key);
}

//! Network of a surface, built as a whole or updated at changed triangles: both give the same springs in the same
//! order, so that a solver rebuilt from its mesh continues bit for bit.

use nalgebra::Point3;
use trocar_dynamics::elasticity::Alteration;
use trocar_dynamics::faulty::Faulty;

use super::error::NetworkError;
use super::network::{Hinge, LEAST, LOOSE, Network, Spring, SurfaceMaterial, check_elements, parameter};
use super::remesh::{ChangedMesh, EdgeElements, NetworkChange};

/// One side of a triangle, by its edge: the order in which shares are summed.
type Side = ([u32; 2], u32);

fn sides(triangle: u32, corners: &[u32; 3]) -> [Side; 3] {
    let [a, b, c] = *corners;
    [[a, b], [b, c], [c, a]].map(|[a, b]| ([a.min(b), a.max(b)], triangle))
}

/// Sine of a fold angle (relative to its edge) below which it counts as flat.
const FLAT: f64 = 1e-6;

/// Area of a triangle \[m²\].
pub(crate) fn area(corners: &[u32; 3], positions: &[Point3<f64>]) -> f64 {
    let [a, b, c] = corners.map(|node| positions[node as usize]);
    0.5 * (b - a).cross(&(c - a)).norm()
}

impl Network {
    /// A cloth, a membrane or the wall of a tube: springs along the edges of triangles and, where exactly two triangles
    /// meet, a hinge with the given shape as rest shape.
    ///
    /// # Errors
    /// Invalid mesh or material, elements by their index.
    pub fn from_surface(
        rest: &[Point3<f64>],
        triangles: &[[u32; 3]],
        material: &SurfaceMaterial,
    ) -> Result<Self, NetworkError> {
        Self::from_altered_surface(rest, triangles, material, &[], &[])
    }

    /// The same with triangles altered as in `altered`, or unaltered where that is empty. Nodes in `loose` may have no
    /// triangles: they are to be pinned and get a nominal mass.
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
        let of = |triangle: u32| altered.get(triangle as usize).copied().unwrap_or(Alteration::NONE);
        let mut about: Vec<u32> = Vec::new();
        for edge in all.chunk_by(|first, second| first.0 == second.0) {
            about.clear();
            about.extend(edge.iter().map(|side| side.1));
            let (spring, hinge) = of_edge(rest, triangles, material, &of, edge[0].0, &about);
            network.springs.push(spring);
            network.hinges.extend(hinge);
        }
        for &node in loose {
            let mass = &mut network.masses[node as usize];
            *mass = if *mass > 0.0 { *mass } else { LOOSE };
        }
        network.check(rest.len())?;
        Ok(network)
    }

    /// Updates the network to changed triangles, with the same result as building it from all of them.
    ///
    /// # Errors
    /// Invalid changed elements; the network is then unchanged.
    pub fn follow_surface(
        &mut self,
        patch: &ChangedMesh<'_, 3>,
        material: &SurfaceMaterial,
    ) -> Result<NetworkChange, NetworkError> {
        let extent = |corners: &[u32; 3]| area(corners, patch.rest);
        let share = |area: f64| material.density * area / 3.0;
        self.follow(
            "triangle",
            patch,
            extent,
            share,
            |_| None,
            |nodes, about| of_edge(patch.rest, patch.elements, material, patch.altered, nodes, about),
        )
    }
}

/// The spring along an edge and, where exactly two triangles meet, the hinge across it: stiffness and rest length from
/// the triangles around it, ascending, each weighted by its share of the area.
fn of_edge(
    rest: &[Point3<f64>],
    triangles: &[[u32; 3]],
    material: &SurfaceMaterial,
    altered: &dyn Fn(u32) -> Alteration,
    nodes: [u32; 2],
    triangles_about: &[u32],
) -> EdgeElements {
    let ends = nodes.map(|node| rest[node as usize]);
    let squared = (ends[1] - ends[0]).norm_squared();
    let (mut about, mut stiffness, mut length) = (0.0, 0.0, 0.0);
    for &triangle in triangles_about {
        let (of, share) = (altered(triangle), area(&triangles[triangle as usize], rest));
        about += share;
        stiffness += share * of.stiffness;
        length += share * of.length;
    }
    let mut spring =
        Spring { nodes, rest: squared.sqrt(), stiffness: material.membrane_stiffness * about / squared };
    let mut hinge = match *triangles_about {
        [first, second] if material.bending_stiffness != 0.0 => {
            Some(hinge_of(rest, [first, second].map(|of| triangles[of as usize]), material, nodes, about))
        }
        _ => None,
    };
    let (stiffness, length) = (stiffness / about, length / about);
    if stiffness != 1.0 || length != 1.0 {
        spring.stiffness *= stiffness;
        spring.rest *= length;
        hinge.iter_mut().for_each(|hinge| hinge.stiffness *= stiffness);
    }
    (spring, hinge)
}

/// The hinge between two triangles of total area `about`.
fn hinge_of(
    rest: &[Point3<f64>],
    triangles: [[u32; 3]; 2],
    material: &SurfaceMaterial,
    nodes: [u32; 2],
    about: f64,
) -> Hinge {
    let ends = nodes.map(|node| rest[node as usize]);
    let across = triangles
        .map(|corners| corners.into_iter().find(|corner| !nodes.contains(corner)).unwrap_or(nodes[0]));
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
    if bent > FLAT * (ends[1] - ends[0]).norm_squared().sqrt() {
        hinge.rest = bent;
        hinge.side = super::network::volume(&hinge.nodes, rest).signum();
    }
    hinge
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

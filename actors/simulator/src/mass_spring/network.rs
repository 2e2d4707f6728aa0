//! Springs and hinges, and the discretisation of lines, surfaces and volumes as networks of them that represent the
//! material: refining the mesh does not change its behaviour.
//!
//! A spring's stiffness is its share of the continuum: `EA / length` along a thread; on triangles and tetrahedra the
//! area or volume about an edge, times the modulus, over its squared length (Van Gelder, *Approximate simulation of elastic
//! membranes by triangulated spring meshes*, 1998), which for edges in all directions alike is the isotropic continuum
//! with Poisson's ratio 1/3 in a plane and 1/4 in space, and no other one.
//!
//! A hinge keeps the length of a weighted sum of positions. Across an edge with cotangent weights, that is the
//! curvature vector, 2 sin(θ/2) times the edge's length (Bergou et al., *A quadratic bending model for inextensible
//! surfaces*, 2006); on three nodes of a line it is the change of direction. On equilateral triangles its energy is
//! that of a plate for curvature in any direction; on right-angled ones up to three times that, depending on direction.

use nalgebra::{Point3, Vector3};
use serde::{Deserialize, Serialize};
use trocar_dynamics::elasticity::Alteration;
use trocar_dynamics::faulty::Faulty;

use super::collapse::Tet;
use super::error::NetworkError;
use super::remesh::{ChangedMesh, NetworkChange};

/// A spring between two nodes.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Spring {
    /// The nodes.
    pub nodes: [u32; 2],
    /// Rest length \[m\].
    pub rest: f64,
    /// Stiffness: force per elongation \[N/m\].
    pub stiffness: f64,
}

/// Keeps the length of the curvature vector `Σ weightᵢ xᵢ` at its rest value.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Hinge {
    /// The edge's two nodes and the two opposite ones; on a line first, middle and last, and the middle once more.
    pub nodes: [u32; 4],
    /// Weights with sum zero; dimensionless on a surface, 1/m on a line.
    pub weights: [f64; 4],
    /// Rest length of the vector.
    pub rest: f64,
    /// Orientation of the rest shape: the sign of the four nodes' volume; 0 where it is flat or a line.
    pub side: f64,
    /// Stiffness: second derivative of the energy by the vector's length.
    pub stiffness: f64,
}

impl Hinge {
    /// Its edge, on a surface.
    pub(crate) fn edge(&self) -> [u32; 2] {
        [self.nodes[0], self.nodes[1]]
    }

    /// The curvature vector at these positions.
    #[inline]
    #[must_use]
    pub fn vector(&self, positions: &[Point3<f64>]) -> Vector3<f64> {
        let [a, b, c, d] = self.nodes.map(|node| positions[node as usize].coords);
        a * self.weights[0] + b * self.weights[1] + c * self.weights[2] + d * self.weights[3]
    }

    /// 1 while the hinge is bent to the same side as at rest, −1 when it is turned inside out.
    #[inline]
    pub(crate) fn sense(&self, positions: &[Point3<f64>]) -> f64 {
        if self.side * self.rest == 0.0 {
            return 1.0;
        }
        let sense = self.side * volume(&self.nodes, positions);
        if sense < 0.0 { -1.0 } else { 1.0 }
    }
}

/// Six times the volume of a tetrahedron.
pub(crate) fn volume(nodes: &[u32; 4], positions: &[Point3<f64>]) -> f64 {
    let [a, b, c, d] = nodes.map(|node| positions[node as usize]);
    (b - a).cross(&(c - a)).dot(&(d - a))
}

/// Masses, springs and hinges.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Network {
    /// One mass per node \[kg\].
    pub masses: Vec<f64>,
    /// Sorted by their nodes if built from a mesh.
    pub springs: Vec<Spring>,
    /// Sorted by their edges if built from a mesh.
    pub hinges: Vec<Hinge>,
    /// Of a volume, sorted by their nodes.
    #[serde(default)]
    pub tets: Vec<Tet>,
    /// Rest positions of the nodes if built from a mesh \[m\]; else empty. Forces do not depend on it.
    #[serde(default)]
    pub rest: Vec<Point3<f64>>,
}

/// Material of a thread.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct LineMaterial {
    /// Axial stiffness EA \[N\].
    pub axial_stiffness: f64,
    /// Bending stiffness EI \[N·m²\]; 0 for none.
    pub bending_stiffness: f64,
    /// Mass per length \[kg/m\].
    pub density: f64,
}

/// Material of a cloth, a membrane or the wall of a tube.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct SurfaceMaterial {
    /// Young's modulus times thickness \[N/m\].
    pub membrane_stiffness: f64,
    /// Flexural rigidity \[N·m\]; 0 for none.
    pub bending_stiffness: f64,
    /// Mass per area \[kg/m²\].
    pub density: f64,
}

/// Material of a volume.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct VolumeMaterial {
    /// Young's modulus \[Pa\].
    pub young_modulus: f64,
    /// Mass per volume \[kg/m³\].
    pub density: f64,
}

/// Rejects a parameter out of range.
pub(crate) fn parameter(what: &'static str, value: f64, least: f64) -> Result<(), NetworkError> {
    let above = if least > 0.0 { value >= least } else { value >= 0.0 };
    let valid = if least > 0.0 { "above 0 and finite" } else { "0 or more and finite" };
    if above && value.is_finite() { Ok(()) } else { Err(NetworkError::Parameter { what, value, valid }) }
}

/// Rejects non-finite nodes, and elements with missing nodes.
pub(crate) fn check_elements<const N: usize>(
    kind: &'static str,
    rest: &[Point3<f64>],
    elements: &[[u32; N]],
) -> Result<(), NetworkError> {
    if rest.is_empty() {
        return Err(NetworkError::Empty);
    }
    let far = |point: &Point3<f64>| !point.iter().all(|coordinate| coordinate.is_finite());
    Faulty::among(rest.len(), |node| far(&rest[node])).refuse(NetworkError::NotFinite)?;
    let nodes = rest.len();
    Faulty::among(elements.len(), |element| {
        let of = &elements[element];
        of.iter().enumerate().any(|(at, node)| *node as usize >= nodes || of[..at].contains(node))
    })
    .refuse(|faulty| NetworkError::Nodes { kind, nodes, faulty })
}

/// Nominal mass of a node without elements \[kg\]: it is pinned.
pub(crate) const LOOSE: f64 = 1e-6;
/// Least positive value that counts as stiffness, density or extent.
pub(crate) const LEAST: f64 = 1e-30;

impl Network {
    /// A thread: springs along its segments and, where exactly two segments meet, a hinge.
    ///
    /// # Errors
    /// Invalid mesh or material, elements by their index.
    pub fn from_line(
        rest: &[Point3<f64>],
        segments: &[[u32; 2]],
        material: &LineMaterial,
    ) -> Result<Self, NetworkError> {
        parameter("axial_stiffness", material.axial_stiffness, LEAST)?;
        parameter("bending_stiffness", material.bending_stiffness, 0.0)?;
        parameter("density", material.density, LEAST)?;
        check_elements("segment", rest, segments)?;
        let length = |[a, b]: [u32; 2]| (rest[b as usize] - rest[a as usize]).norm();
        Faulty::among(segments.len(), |segment| length(segments[segment]) <= LEAST)
            .refuse(|faulty| NetworkError::NoExtent { kind: "segment", faulty })?;
        let mut network = Self { masses: vec![0.0; rest.len()], rest: rest.to_vec(), ..Self::default() };
        let mut neighbours: Vec<(u32, u32)> = Vec::with_capacity(2 * segments.len());
        for &[a, b] in segments {
            let rest = length([a, b]);
            network.springs.push(Spring {
                nodes: [a.min(b), a.max(b)],
                rest,
                stiffness: material.axial_stiffness / rest,
            });
            for node in [a, b] {
                network.masses[node as usize] += 0.5 * material.density * rest;
            }
            neighbours.extend([(a, b), (b, a)]);
        }
        network.springs.sort_by_key(|spring| spring.nodes);
        neighbours.sort_unstable();
        if material.bending_stiffness > 0.0 {
            for about in neighbours.chunk_by(|first, second| first.0 == second.0) {
                if let &[(middle, first), (_, last)] = about {
                    let [before, after] = [length([first, middle]), length([middle, last])];
                    let mut hinge = Hinge {
                        nodes: [first, middle, last, middle],
                        weights: [1.0 / before, -1.0 / before - 1.0 / after, 1.0 / after, 0.0],
                        rest: 0.0,
                        side: 0.0,
                        stiffness: 2.0 * material.bending_stiffness / (before + after),
                    };
                    hinge.rest = hinge.vector(rest).norm();
                    network.hinges.push(hinge);
                }
            }
        }
        network.check(rest.len())?;
        Ok(network)
    }

    /// A volume: springs along the edges of its tetrahedra, of either orientation.
    ///
    /// # Errors
    /// Invalid mesh or material, elements by their index.
    pub fn from_volume(
        rest: &[Point3<f64>],
        tets: &[[u32; 4]],
        material: &VolumeMaterial,
    ) -> Result<Self, NetworkError> {
        Self::from_altered_volume(rest, tets, material, &[], &[])
    }

    /// The same with tetrahedra altered as in `altered`, or unaltered where that is empty. Nodes in `loose` may have no
    /// remaining elements: they are to be pinned and get a nominal mass.
    ///
    /// # Errors
    /// As [`from_volume`](Self::from_volume).
    pub fn from_altered_volume(
        rest: &[Point3<f64>],
        tets: &[[u32; 4]],
        material: &VolumeMaterial,
        altered: &[Alteration],
        loose: &[u32],
    ) -> Result<Self, NetworkError> {
        parameter("young_modulus", material.young_modulus, LEAST)?;
        parameter("density", material.density, LEAST)?;
        check_elements("tetrahedron", rest, tets)?;
        let extent = |tet: &[u32; 4]| volume(tet, rest).abs() / 6.0;
        Faulty::among(tets.len(), |tet| extent(&tets[tet]) <= LEAST)
            .refuse(|faulty| NetworkError::NoExtent { kind: "tetrahedron", faulty })?;
        let mut network = Self { masses: vec![0.0; rest.len()], rest: rest.to_vec(), ..Self::default() };
        let of = |tet: u32| altered.get(tet as usize).copied().unwrap_or(Alteration::NONE);
        let mut all: Vec<([u32; 2], u32)> = Vec::with_capacity(6 * tets.len());
        for (index, tet) in (0..).zip(tets).filter(|(index, _)| of(*index) != Alteration::GONE) {
            let extent = extent(tet);
            for (at, &a) in tet.iter().enumerate() {
                network.masses[a as usize] += 0.25 * material.density * extent;
                all.extend(tet[..at].iter().map(|&b| ([a.min(b), a.max(b)], index)));
            }
        }
        // Sorted by element too, so that each sum has one order.
        all.sort_unstable();
        let mut about: Vec<u32> = Vec::new();
        for edge in all.chunk_by(|first, second| first.0 == second.0) {
            about.clear();
            about.extend(edge.iter().map(|share| share.1));
            network.springs.push(spring_of(rest, tets, material, &of, edge[0].0, &about));
        }
        let there = (0..).zip(tets).map(|(index, tet)| (of(index), tet));
        let there = there.filter(|(of, _)| *of != Alteration::GONE);
        network.tets.extend(there.map(|(of, tet)| tet_of(rest, tet, material, of)));
        network.tets.sort_by_key(|tet| tet.nodes);
        for &node in loose {
            let mass = &mut network.masses[node as usize];
            *mass = if *mass > 0.0 { *mass } else { LOOSE };
        }
        network.check(rest.len())?;
        Ok(network)
    }

    /// Updates the network to changed tetrahedra, with the same result as building it from all of them.
    ///
    /// # Errors
    /// Invalid changed elements; the network is then unchanged.
    pub fn follow_volume(
        &mut self,
        patch: &ChangedMesh<'_, 4>,
        material: &VolumeMaterial,
    ) -> Result<NetworkChange, NetworkError> {
        let extent = |tet: &[u32; 4]| volume(tet, patch.rest).abs() / 6.0;
        let share = |extent: f64| 0.25 * material.density * extent;
        let tet = |tet: u32| {
            Some(tet_of(patch.rest, &patch.elements[tet as usize], material, (patch.altered)(tet)))
        };
        self.follow("tetrahedron", patch, extent, share, tet, |nodes, about| {
            (spring_of(patch.rest, patch.elements, material, patch.altered, nodes, about), None)
        })
    }

    /// Adds springs, hinges and masses of another network over the same nodes, as for a tube with a volume inside.
    ///
    /// # Errors
    /// When the other one has another number of nodes.
    pub fn merge(&mut self, other: &Self) -> Result<(), NetworkError> {
        let (given, expected) = (other.masses.len(), self.masses.len());
        if given != expected {
            return Err(NetworkError::Length { what: "masses", given, expected });
        }
        self.masses.iter_mut().zip(&other.masses).for_each(|(own, more)| *own += more);
        self.springs.extend(&other.springs);
        self.hinges.extend(&other.hinges);
        self.tets.extend(&other.tets);
        Ok(())
    }

    /// The spring along an edge of a network built from a mesh.
    pub(crate) fn spring(&self, edge: &[u32; 2]) -> Option<&Spring> {
        self.springs.binary_search_by_key(edge, |spring| spring.nodes).ok().map(|at| &self.springs[at])
    }

    /// The hinge across an edge.
    pub(crate) fn hinge(&self, edge: &[u32; 2]) -> Option<&Hinge> {
        self.hinges.binary_search_by_key(edge, Hinge::edge).ok().map(|at| &self.hinges[at])
    }

    /// The springs with this first node.
    pub(super) fn springs_from(&self, node: u32) -> &[Spring] {
        let first = self.springs.partition_point(|of| of.nodes[0] < node);
        let count = self.springs[first..].partition_point(|of| of.nodes[0] == node);
        &self.springs[first..first + count]
    }

    /// The hinges with this first node.
    pub(super) fn hinges_from(&self, node: u32) -> &[Hinge] {
        let first = self.hinges.partition_point(|of| of.nodes[0] < node);
        let count = self.hinges[first..].partition_point(|of| of.nodes[0] == node);
        &self.hinges[first..first + count]
    }

    /// Validates a network of any origin.
    ///
    /// # Errors
    /// The first kind of fault, with all elements concerned.
    pub fn check(&self, nodes: usize) -> Result<(), NetworkError> {
        if nodes == 0 {
            return Err(NetworkError::Empty);
        }
        if self.masses.len() != nodes {
            let given = self.masses.len();
            return Err(NetworkError::Length { what: "masses", given, expected: nodes });
        }
        if !self.rest.is_empty() {
            if self.rest.len() != nodes {
                let given = self.rest.len();
                return Err(NetworkError::Length { what: "positions at rest", given, expected: nodes });
            }
            let far = |node: usize| !self.rest[node].iter().all(|value| value.is_finite());
            Faulty::among(nodes, far).refuse(NetworkError::NotFinite)?;
        }
        let positive = |value: f64| value >= LEAST && value.is_finite();
        Faulty::among(nodes, |node| !positive(self.masses[node])).refuse(NetworkError::Masses)?;
        Faulty::among(self.springs.len(), |index| {
            let [a, b] = self.springs[index].nodes;
            a == b || a.max(b) as usize >= nodes
        })
        .refuse(|faulty| NetworkError::Nodes { kind: "spring", nodes, faulty })?;
        Faulty::among(self.hinges.len(), |index| {
            let hinge = &self.hinges[index];
            hinge.nodes.iter().any(|&node| node as usize >= nodes)
        })
        .refuse(|faulty| NetworkError::Nodes { kind: "hinge", nodes, faulty })?;
        Faulty::among(self.tets.len(), |index| {
            let [a, b, c, d] = self.tets[index].nodes;
            !(a < b && b < c && c < d && (d as usize) < nodes)
        })
        .refuse(|faulty| NetworkError::Nodes { kind: "tetrahedron", nodes, faulty })?;
        self.check_numbers()
    }

    /// Validates stiffness, lengths and weights alone.
    pub(super) fn check_numbers(&self) -> Result<(), NetworkError> {
        let number = |value: f64| value >= 0.0 && value.is_finite();
        Faulty::among(self.springs.len(), |index| {
            let spring = &self.springs[index];
            !number(spring.rest) || !number(spring.stiffness)
        })
        .refuse(|faulty| NetworkError::Numbers { kind: "spring", faulty })?;
        Faulty::among(self.hinges.len(), |index| {
            let hinge = &self.hinges[index];
            let finite = hinge.weights.iter().all(|weight| weight.is_finite()) && hinge.side.is_finite();
            !number(hinge.rest) || !number(hinge.stiffness) || !finite
        })
        .refuse(|faulty| NetworkError::Numbers { kind: "hinge", faulty })?;
        Faulty::among(self.tets.len(), |index| {
            let tet = &self.tets[index];
            !number(tet.stiffness) || !number(tet.rest.abs()) || tet.rest == 0.0
        })
        .refuse(|faulty| NetworkError::Numbers { kind: "tetrahedron", faulty })
    }
}

/// The spring along an edge: stiffness and rest length from the tetrahedra around it, ascending, each weighted by its
/// share of the volume.
fn spring_of(
    rest: &[Point3<f64>],
    tets: &[[u32; 4]],
    material: &VolumeMaterial,
    altered: &dyn Fn(u32) -> Alteration,
    nodes: [u32; 2],
    about: &[u32],
) -> Spring {
    let squared = (rest[nodes[1] as usize] - rest[nodes[0] as usize]).norm_squared();
    let (mut stiff, mut whole, mut length) = (0.0, 0.0, 0.0);
    for &tet in about {
        let (of, share) = (altered(tet), volume(&tets[tet as usize], rest).abs() / 6.0);
        stiff += share * of.stiffness;
        whole += share;
        length += share * of.length;
    }
    Spring {
        nodes,
        rest: squared.sqrt() * (length / whole),
        stiffness: material.young_modulus * stiff / squared,
    }
}

/// What keeps a tetrahedron from collapsing.
fn tet_of(rest: &[Point3<f64>], tet: &[u32; 4], material: &VolumeMaterial, of: Alteration) -> Tet {
    let mut nodes = *tet;
    nodes.sort_unstable();
    let six = volume(&nodes, rest);
    Tet {
        nodes,
        rest: six * of.length.powi(3),
        stiffness: material.young_modulus * of.stiffness * six.abs() / 6.0,
    }
}

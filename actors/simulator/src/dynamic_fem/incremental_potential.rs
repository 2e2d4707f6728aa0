//! The incremental potential of a backward Euler step and its gradient.

use nalgebra::{Matrix3, Point3, Vector3};
use trocar_dynamics::soft_body::bearing::rigid_response::{PlaneContact, RigidPresses, RigidResponse};
use trocar_dynamics::tet_mesh::{TetMesh, gradients, shape};

use super::constitutive::Material;
use super::polar::rotation;
use crate::linear_algebra::BlockMatrix;

/// A spring between a point of the body and a point in space, as for a soft grasp or a thread.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Spring {
    /// Nodes and their weights; weight 0 for unused entries.
    pub weights: [(u32, f64); 4],
    /// Target point \[m\].
    pub target: Point3<f64>,
    /// Stiffness: force per distance \[N/m\].
    pub stiffness: f64,
}

/// A penalty contact with a plane: a force proportional to depth.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Contact {
    /// Nodes and their weights; weight 0 for unused entries.
    pub weights: [(u32, f64); 4],
    /// A point of the plane \[m\].
    pub point: Point3<f64>,
    /// Unit normal, towards the free side.
    pub normal: Vector3<f64>,
    /// Stiffness: force per depth \[N/m\].
    pub stiffness: f64,
}

/// Inputs of a step.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Inputs<'a> {
    /// Acceleration of the whole body \[m/s²\], such as gravity.
    pub acceleration: Vector3<f64>,
    /// Forces on nodes \[N\].
    pub forces: &'a [(u32, Vector3<f64>)],
    /// Prescribed node positions at the end of the step \[m\]; each node once.
    pub prescribed: &'a [(u32, Point3<f64>)],
    /// Springs.
    pub springs: &'a [Spring],
    /// Contacts.
    pub contacts: &'a [Contact],
    /// Contacts with rigid bodies that move.
    pub rigid: RigidPresses<'a>,
}

/// Data of an element, contiguous in memory.
#[derive(Clone, Debug)]
pub(super) struct Element {
    pub nodes: [u32; 4],
    pub inverse_shape: Matrix3<f64>,
    /// Rest volume \[m³\] times its stiffness factor; 0 when removed.
    pub volume: f64,
}

impl Element {
    pub fn is_gone(&self) -> bool {
        self.volume == 0.0
    }
}

pub(super) fn elements(mesh: &TetMesh) -> Vec<Element> {
    let parts = mesh.tets().iter().zip(mesh.inverse_shapes()).zip(mesh.volumes());
    parts
        .map(|((nodes, inverse_shape), volume)| Element {
            nodes: *nodes,
            inverse_shape: *inverse_shape,
            volume: *volume,
        })
        .collect()
}

/// Mass matrix: lumped at the nodes, or consistent.
#[derive(Clone, Debug)]
pub(super) struct Mass {
    pub lumped: Vec<f64>,
    pub consistent: Option<BlockMatrix>,
}

impl Mass {
    /// M x.
    pub fn multiply(&self, x: &[Vector3<f64>], y: &mut [Vector3<f64>]) {
        match &self.consistent {
            Some(matrix) => matrix.multiply(x, y),
            None => y.iter_mut().zip(x).zip(&self.lumped).for_each(|((y, x), mass)| *y = x * *mass),
        }
    }
}

/// Rayleigh damping.
#[derive(Clone, Copy, Debug)]
pub(super) struct Damping {
    /// Mass-proportional \[1/s\].
    pub mass: f64,
    /// Stiffness-proportional \[s\].
    pub stiffness: f64,
}

/// Elastic and viscous energy and forces of the elements.
pub(super) struct ElementForces<'a> {
    pub elements: &'a [Element],
    pub material: Material,
    pub lame: [f64; 2],
    pub damping: Damping,
    /// Deformation gradients and rotations at the beginning of the step; empty without stiffness damping.
    pub before: &'a [(Matrix3<f64>, Matrix3<f64>)],
    pub dt: f64,
}

impl ElementForces<'_> {
    /// Returns the energy \[J\] and adds its gradient \[N\].
    pub fn add(&self, positions: &[Point3<f64>], gradient: &mut [Vector3<f64>]) -> f64 {
        let mut energy = 0.0;
        let viscous = self.damping.stiffness / self.dt;
        for (index, element) in self.elements.iter().enumerate().filter(|(_, element)| !element.is_gone()) {
            let f = shape(positions, &element.nodes) * element.inverse_shape;
            let (mut density, mut stress) = self.material.energy_and_stress(&f);
            if let Some((from, turn)) = self.before.get(index) {
                // Viscosity acts as the linear elasticity at rest, in the frame at the beginning of the step.
                let change = turn.tr_mul(&(f - from));
                let rate = (change + change.transpose()) * 0.5;
                let [lambda, mu] = self.lame;
                let trace = rate.trace();
                density += viscous * (mu * rate.norm_squared() + 0.5 * lambda * trace * trace);
                let inner = rate * (2.0 * mu) + Matrix3::from_diagonal_element(lambda * trace);
                stress += turn * inner * viscous;
            }
            energy += density * element.volume;
            let forces = stress * element.inverse_shape.transpose() * element.volume;
            let [a, b, c, d] = element.nodes.map(|node| node as usize);
            let [to_b, to_c, to_d] =
                [0, 1, 2].map(|i| Vector3::new(forces[(0, i)], forces[(1, i)], forces[(2, i)]));
            gradient[b] += to_b;
            gradient[c] += to_c;
            gradient[d] += to_d;
            gradient[a] -= to_b + to_c + to_d;
        }
        energy
    }
}

/// Deformation gradients and rotations of all elements.
pub(super) fn frames(
    elements: &[Element],
    positions: &[Point3<f64>],
    out: &mut Vec<(Matrix3<f64>, Matrix3<f64>)>,
) {
    out.clear();
    out.extend(elements.iter().map(|element| {
        let f = shape(positions, &element.nodes) * element.inverse_shape;
        (f, rotation(&f))
    }));
}

fn mean(weights: &[(u32, f64); 4], positions: &[Point3<f64>]) -> Vector3<f64> {
    weights.iter().filter(|(_, w)| *w != 0.0).map(|&(n, w)| positions[n as usize].coords * w).sum()
}

fn scatter(weights: &[(u32, f64); 4], force: &Vector3<f64>, to: &mut [Vector3<f64>]) {
    for &(node, weight) in weights.iter().filter(|(_, weight)| *weight != 0.0) {
        to[node as usize] += force * weight;
    }
}

/// Energy of springs and contacts \[J\]; adds its gradient.
pub(super) fn add_springs(inputs: &Inputs, positions: &[Point3<f64>], gradient: &mut [Vector3<f64>]) -> f64 {
    let mut energy = 0.0;
    for spring in inputs.springs {
        let apart = mean(&spring.weights, positions) - spring.target.coords;
        energy += 0.5 * spring.stiffness * apart.norm_squared();
        scatter(&spring.weights, &(apart * spring.stiffness), gradient);
    }
    for contact in inputs.contacts {
        let height = (mean(&contact.weights, positions) - contact.point.coords).dot(&contact.normal);
        if height < 0.0 {
            energy += 0.5 * contact.stiffness * height * height;
            scatter(&contact.weights, &(contact.normal * (contact.stiffness * height)), gradient);
        }
    }
    energy
}

/// Energy of contacts with rigid bodies, the bodies' own motion included, in a step of `dt` seconds that began at `from`
/// \[J\]; adds its gradient.
pub(super) fn add_rigid(
    rigid: &RigidPresses<'_>,
    dt: f64,
    from: &[Point3<f64>],
    positions: &[Point3<f64>],
    response: &mut RigidResponse,
    gradient: &mut [Vector3<f64>],
) -> f64 {
    if rigid.contacts.is_empty() {
        return 0.0;
    }
    let moved = |index: usize| {
        let contact: &PlaneContact = &rigid.contacts[index];
        contact.normal.dot(&(contact.place(positions) - contact.place(from)))
    };
    rigid.answer(dt, moved, response);
    for (contact, force) in rigid.contacts.iter().zip(&response.forces).filter(|(_, force)| **force > 0.0) {
        for (node, weight) in contact.joint() {
            gradient[node as usize] -= contact.normal * (force * weight);
        }
    }
    response.energy
}

/// Stiffness of a spring or contact: nodes with weights, and the block \[N/m\] multiplied by the products of the
/// weights.
pub type Coupling = ([(u32, f64); 4], Matrix3<f64>);

/// Those of springs and contacts at these positions \[m\]; of contacts with rigid bodies, those that pressed in the last
/// evaluation, in a step of `dt` seconds.
pub(super) fn couplings(
    inputs: &Inputs,
    positions: &[Point3<f64>],
    (dt, response): (f64, &RigidResponse),
    out: &mut Vec<Coupling>,
) {
    out.clear();
    let presses = |index: usize| response.forces.get(index).is_some_and(|force| *force > 0.0);
    let mut stiffnesses = Vec::new();
    inputs.rigid.stiffnesses(dt, presses, &mut stiffnesses);
    let rigid = inputs.rigid.contacts.iter().zip(stiffnesses).enumerate();
    out.extend(rigid.filter(|(index, _)| presses(*index)).map(|(_, (contact, stiffness))| {
        let [a, b, c] = contact.joint();
        ([a, b, c, (a.0, 0.0)], contact.normal * contact.normal.transpose() * stiffness)
    }));
    let springs = inputs.springs.iter();
    out.extend(springs.map(|spring| (spring.weights, Matrix3::from_diagonal_element(spring.stiffness))));
    for contact in inputs.contacts {
        let height = (mean(&contact.weights, positions) - contact.point.coords).dot(&contact.normal);
        if height < 0.0 {
            let block = contact.normal * contact.normal.transpose() * contact.stiffness;
            out.push((contact.weights, block));
        }
    }
}

/// Adds the elastic, viscous and inertial parts of the Hessian over the numbered nodes.
pub(super) fn add_hessian(
    element_forces: &ElementForces,
    mass: &Mass,
    positions: &[Point3<f64>],
    numbers: &[Option<u32>],
    to: &mut BlockMatrix,
) {
    let dt = element_forces.dt;
    let inertia = 1.0 / (dt * dt) + element_forces.damping.mass / dt;
    for (node, number) in numbers.iter().enumerate() {
        if let Some(number) = number
            && mass.consistent.is_none()
        {
            to.add(*number, *number, &Matrix3::from_diagonal_element(mass.lumped[node] * inertia));
        }
    }
    if let Some(matrix) = &mass.consistent {
        for column in 0..matrix.pattern().nodes() as u32 {
            let Some(own) = numbers[column as usize] else { continue };
            for &row in matrix.pattern().column(column as usize) {
                let (Some(other), Some(slot)) = (numbers[row as usize], matrix.pattern().slot(row, column))
                else {
                    continue;
                };
                let block = Matrix3::from_diagonal_element(matrix.values()[slot[0]] * inertia);
                to.add(own.max(other), own.min(other), &block);
            }
        }
    }
    // Damping adds a multiple of the elastic stiffness, except for its change within a step.
    let factor = 1.0 + element_forces.damping.stiffness / dt;
    for element in element_forces.elements.iter().filter(|element| !element.is_gone()) {
        let f = shape(positions, &element.nodes) * element.inverse_shape;
        let stiffness = element_forces.material.stiffness(&f);
        let turned = gradients(&element.inverse_shape).map(|gradient| stiffness.v.tr_mul(&gradient));
        for (i, node) in element.nodes.iter().enumerate() {
            let Some(row) = numbers[*node as usize] else { continue };
            for (j, other) in element.nodes.iter().enumerate() {
                if let Some(column) = numbers[*other as usize]
                    && row >= column
                {
                    to.add(row, column, &stiffness.block(element.volume * factor, &turned[i], &turned[j]));
                }
            }
        }
    }
}

/// Adds the couplings that fit the sparsity pattern: those of nodes that share an element, such as of points in one.
pub(super) fn add_couplings(couplings: &[Coupling], numbers: &[Option<u32>], to: &mut BlockMatrix) {
    for (weights, block) in couplings {
        for &(node, weight) in weights.iter().filter(|(_, weight)| *weight != 0.0) {
            let Some(row) = numbers[node as usize] else { continue };
            for &(other, share) in weights.iter().filter(|(_, weight)| *weight != 0.0) {
                if let Some(column) = numbers[other as usize]
                    && row >= column
                {
                    to.add(row, column, &(block * (weight * share)));
                }
            }
        }
    }
}

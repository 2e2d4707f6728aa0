//! Penalty contacts: a point of the network, normal, depth, stiffness, damping and friction.

use nalgebra::{Point3, Vector3};
use serde::{Deserialize, Serialize};
use trocar_dynamics::particles::StepError;

/// Slip velocity \[m/s\] at which friction reaches its full magnitude; below, it is a viscous drag.
const CREEP: f64 = 1e-3;

/// One contact of the network with another object, detected at the positions at the beginning of the step.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Contact {
    /// Corners of the touched triangle; one node three times for a vertex, the last one twice for a segment.
    pub nodes: [u32; 3],
    /// Barycentric weights of the contact point: each in \[0, 1\], their sum 1.
    pub weights: [f64; 3],
    /// Unit normal, in the direction that separates the network.
    pub normal: Vector3<f64>,
    /// Penetration depth \[m\]; negative for a gap that may close within the step.
    pub depth: f64,
    /// Velocity of the other object at the contact \[m/s\].
    pub velocity: Vector3<f64>,
    /// Stiffness: force per depth \[N/m\].
    pub stiffness: f64,
    /// Damping: force per approach velocity \[N·s/m\].
    pub damping: f64,
    /// Coulomb's friction coefficient.
    pub friction: f64,
}

impl Contact {
    /// An elastic, frictionless contact of one node.
    #[must_use]
    pub fn at_node(node: u32, normal: Vector3<f64>, depth: f64, stiffness: f64) -> Self {
        let weights = [1.0, 0.0, 0.0];
        let velocity = Vector3::zeros();
        Self { nodes: [node; 3], weights, normal, depth, velocity, stiffness, damping: 0.0, friction: 0.0 }
    }

    /// The contact point \[m\].
    #[inline]
    pub(crate) fn point(&self, positions: &[Point3<f64>]) -> Vector3<f64> {
        let [a, b, c] = self.nodes.map(|node| positions[node as usize].coords);
        a * self.weights[0] + b * self.weights[1] + c * self.weights[2]
    }
    /// Velocity relative to the other object \[m/s\].
    #[inline]
    pub(crate) fn slip(&self, velocities: &[Vector3<f64>]) -> Vector3<f64> {
        let [a, b, c] = self.nodes.map(|node| velocities[node as usize]);
        a * self.weights[0] + b * self.weights[1] + c * self.weights[2] - self.velocity
    }
    /// Inverse effective mass of the contact point \[1/kg\].
    #[inline]
    pub(crate) fn mobility(&self, mobility: &[f64]) -> f64 {
        let shares = self.joint();
        shares.into_iter().map(|(node, weight)| weight * weight * mobility[node as usize]).sum()
    }
    /// Its nodes with their weights, each node once.
    #[inline]
    pub(crate) fn joint(&self) -> [(u32, f64); 3] {
        let ([a, b, c], [u, v, w]) = (self.nodes, self.weights);
        let first = u + if b == a { v } else { 0.0 } + if c == a { w } else { 0.0 };
        let second = if b == a { 0.0 } else { v + if c == b { w } else { 0.0 } };
        let third = if c == a || c == b { 0.0 } else { w };
        [(a, first), (b, second), (c, third)]
    }
    /// Normal force \[N\] at a depth and a separation velocity; never tensile.
    #[inline]
    pub(crate) fn pressing(&self, depth: f64, leaving: f64) -> f64 {
        if depth > 0.0 { (self.stiffness * depth - self.damping * leaving).max(0.0) } else { 0.0 }
    }

    /// Its force at the end of an implicit step of `h` seconds, normal force and friction, and the drag of friction there
    /// \[N·s/m\]. `touched` is the point at the beginning; `ahead` is by how much more the point's velocity implies.
    pub(super) fn force_at_end(
        &self,
        positions: &[Point3<f64>],
        velocities: &[Vector3<f64>],
        touched: &Vector3<f64>,
        h: f64,
        ahead: &Vector3<f64>,
    ) -> (Vector3<f64>, [f64; 2]) {
        let slip = self.slip(velocities);
        let normal = self.normal;
        // Depth at the end of the step, from its beginning: the normal part is linear in the velocity.
        let out = normal.dot(&(self.point(positions) - touched - self.velocity * h));
        let depth = self.depth - out - h * normal.dot(ahead);
        let pressing = self.pressing(depth, normal.dot(&slip));
        let across = slip - normal * normal.dot(&slip);
        let drag = self.friction * pressing / across.norm().max(CREEP);
        (normal * pressing - across * drag, [pressing, drag])
    }

    /// What is invalid in it, if anything.
    fn problem(&self, nodes: usize) -> Option<&'static str> {
        let number = |value: f64| value >= 0.0 && value.is_finite();
        let finite = |vector: &Vector3<f64>| vector.iter().all(|value| value.is_finite());
        if self.nodes.iter().any(|&node| node as usize >= nodes) {
            Some("names a node that does not exist")
        } else if !(self.weights.iter().all(|&weight| number(weight))
            && (self.weights.iter().sum::<f64>() - 1.0).abs() < 1e-6)
        {
            Some("has weights that are negative or do not sum to 1")
        } else if !finite(&self.normal) || (self.normal.norm_squared() - 1.0).abs() > 1e-6 {
            Some("has a normal that is not a unit vector")
        } else if !(self.depth.is_finite() && finite(&self.velocity)) {
            Some("has a depth or velocity that is not finite")
        } else if ![self.stiffness, self.damping, self.friction].into_iter().all(number) {
            Some("has a stiffness, damping or friction that is negative or not finite")
        } else {
            None
        }
    }
}

/// Rejects invalid contacts.
pub(crate) fn check(contacts: &[Contact], nodes: usize) -> Result<(), StepError> {
    let problem = contacts.iter().enumerate().find_map(|(index, contact)| {
        contact.problem(nodes).map(|problem| StepError::Input { what: "contact", index, problem })
    });
    problem.map_or(Ok(()), Err)
}

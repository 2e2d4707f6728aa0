//! Distance and bending constraints of XPBD, and their projections.

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

use super::colouring::MeshConstraint;
use crate::mass_spring::{Hinge, NEARLY_FLAT, Network, Spring};

/// Distance constraint between two nodes: a spring of finite, possibly very high stiffness.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Distance {
    /// The nodes.
    pub nodes: [u32; 2],
    /// Rest length \[m\].
    pub rest: f64,
    /// Inverse stiffness \[m/N\]; 0 for a rigid rod.
    pub compliance: f64,
}

/// Bending constraint of a sheet or a line: keeps the curvature vector of a [`Hinge`] at its rest length (Bergou et
/// al., *A quadratic bending model for inextensible surfaces*, 2006), with the hinge's stiffness.
pub type Bend = Hinge;

/// Elastic material of a volume.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Elasticity {
    /// Young's modulus \[Pa\].
    pub young_modulus: f64,
    /// Poisson's ratio, 0 to below 0.5.
    pub poisson_ratio: f64,
    /// Mass per volume \[kg/m³\].
    pub density: f64,
}

impl From<&Spring> for Distance {
    /// A spring without stiffness becomes one of negligible stiffness.
    fn from(spring: &Spring) -> Self {
        let compliance = 1.0 / spring.stiffness.max(SLACK);
        Self { nodes: spring.nodes, rest: spring.rest, compliance }
    }
}

/// Spring stiffness that counts as none \[N/m\].
const SLACK: f64 = 1e-12;

/// The springs of a network as distance constraints, in their order.
#[must_use]
pub fn distances_of(network: &Network) -> Vec<Distance> {
    network.springs.iter().map(Distance::from).collect()
}

impl MeshConstraint<2> for Distance {
    const KIND: &'static str = "distance";
    fn nodes(&self) -> [u32; 2] {
        self.nodes
    }
}

impl MeshConstraint<4> for Bend {
    const KIND: &'static str = "bend";
    fn nodes(&self) -> [u32; 4] {
        self.nodes
    }
}

/// The nodes during a step: positions \[m\] and inverse masses \[1/kg\], 0 where held; the last one is a held dummy.
pub(super) struct Nodes<'a> {
    pub places: &'a mut [[f64; 4]],
    /// Inverse squared substep \[1/s²\].
    pub rate: f64,
}

impl Nodes<'_> {
    #[inline]
    pub fn place(&self, node: u32) -> (Vector3<f64>, f64) {
        let [x, y, z, mobility] = self.places[node as usize];
        (Vector3::new(x, y, z), mobility)
    }
    #[inline]
    pub fn shift(&mut self, node: u32, by: &Vector3<f64>) {
        let place = &mut self.places[node as usize];
        place[0] += by.x;
        place[1] += by.y;
        place[2] += by.z;
    }
}

/// A constraint of a sweep, whose position corrections can be computed without applying them.
pub(super) trait Constraint: Sync {
    type Multiplier: Copy + Default + Send + Sync;
    type Correction: Send;
    fn project(&self, nodes: &Nodes<'_>, multiplier: Self::Multiplier) -> Self::Correction;
    fn apply(&self, moved: &Self::Correction, nodes: &mut Nodes<'_>, multiplier: &mut Self::Multiplier);
    /// Calls `each` with every node and its impulse for a given multiplier \[N·s²\], at the current positions.
    fn impulses(
        &self,
        nodes: &Nodes<'_>,
        multiplier: &Self::Multiplier,
        each: &mut dyn FnMut(u32, Vector3<f64>),
    );
}

impl Constraint for Distance {
    type Multiplier = f64;
    /// Corrections of the two nodes, and the multiplier.
    type Correction = ([Vector3<f64>; 2], f64);

    #[inline]
    fn project(&self, nodes: &Nodes<'_>, multiplier: f64) -> Self::Correction {
        let [(a, first), (b, second)] = self.nodes.map(|node| nodes.place(node));
        let along = b - a;
        let length = along.norm();
        let soft = self.compliance * nodes.rate;
        if length == 0.0 || first + second + soft == 0.0 {
            return ([Vector3::zeros(); 2], multiplier);
        }
        let change = (self.rest - length - soft * multiplier) / (first + second + soft);
        let push = along * (change / length);
        ([push * -first, push * second], multiplier + change)
    }

    #[inline]
    fn apply(&self, moved: &Self::Correction, nodes: &mut Nodes<'_>, multiplier: &mut f64) {
        *multiplier = moved.1;
        self.nodes.iter().zip(&moved.0).for_each(|(&node, by)| nodes.shift(node, by));
    }

    fn impulses(&self, nodes: &Nodes<'_>, multiplier: &f64, each: &mut dyn FnMut(u32, Vector3<f64>)) {
        let [a, b] = self.nodes.map(|node| nodes.place(node).0);
        let push = (b - a).try_normalize(0.0).unwrap_or_else(Vector3::zeros) * *multiplier;
        each(self.nodes[0], -push);
        each(self.nodes[1], push);
    }
}

impl Constraint for Bend {
    /// One per component of the curvature vector; with a non-zero rest length only the first is used.
    type Multiplier = Vector3<f64>;
    /// Impulse on the curvature vector, and the multiplier.
    type Correction = (Vector3<f64>, Vector3<f64>);

    #[inline]
    fn project(&self, nodes: &Nodes<'_>, multiplier: Vector3<f64>) -> Self::Correction {
        let places = self.nodes.map(|node| nodes.place(node));
        let (mut vector, mut yields) = (Vector3::zeros(), 0.0);
        for ((place, mobility), weight) in places.iter().zip(self.weights) {
            vector += place * weight;
            yields += mobility * weight * weight;
        }
        let soft = nodes.rate / self.stiffness;
        if self.rest == 0.0 {
            let change = (-vector - multiplier * soft) / (yields + soft);
            return (change, multiplier + change);
        }
        let length = vector.norm();
        let [a, b, c, d] = places.map(|of| of.0);
        let turned = self.side * (b - a).cross(&(c - a)).dot(&(d - a)) < 0.0;
        // Turned inside out, it has to pass through the flat state, where the vector has no direction.
        let off = if turned { length + self.rest } else { length - self.rest };
        let slope = vector / length.max(NEARLY_FLAT * self.rest);
        let change = (-off - soft * multiplier.x) / (yields * slope.norm_squared() + soft);
        (slope * change, multiplier + Vector3::x() * change)
    }

    #[inline]
    fn apply(&self, moved: &Self::Correction, nodes: &mut Nodes<'_>, multiplier: &mut Vector3<f64>) {
        *multiplier = moved.1;
        for (node, weight) in self.nodes.into_iter().zip(self.weights) {
            let mobility = nodes.place(node).1;
            nodes.shift(node, &(moved.0 * (weight * mobility)));
        }
    }

    fn impulses(
        &self,
        nodes: &Nodes<'_>,
        multiplier: &Vector3<f64>,
        each: &mut dyn FnMut(u32, Vector3<f64>),
    ) {
        let mut all = *multiplier;
        if self.rest > 0.0 {
            let places = self.nodes.iter().zip(self.weights);
            let vector: Vector3<f64> = places.map(|(&node, weight)| nodes.place(node).0 * weight).sum();
            all = vector / vector.norm().max(NEARLY_FLAT * self.rest) * multiplier.x;
        }
        self.nodes.into_iter().zip(self.weights).for_each(|(node, weight)| each(node, all * weight));
    }
}

//! What keeps the tetrahedra of a volume from collapsing. Springs along edges resist any change of lengths, but the less
//! the flatter a tetrahedron is: their stress has a maximum where it is 0.4 times as high as at rest, and beyond it a
//! volume folds, in one of several ways, and turns inside out.
//!
//! Each tetrahedron therefore has an energy of its volume, the *volumetric* part of a hyperelastic material (as those of
//! Teschner, Heidelberger, Müller and Gross, *A versatile and robust model for geometrically complex deformable solids*,
//! 2004, penalise the volume), of the ratio `q` of its volume to that at rest: `w′(q) = −E (q₀ − q)² / q` below [`BEGIN`],
//! and none above. It and its stiffness vanish there, so that Young's modulus and Poisson's ratio of small strains are
//! those of the springs alone; with it a column of springs bears what a linear-elastic one bears at half its height, and
//! ever more below. Below [`END`] the force grows linearly, so that what is inside out turns back.

use nalgebra::{Point3, Vector3};
use serde::{Deserialize, Serialize};
use trocar_dynamics::particles::State;

use super::network::Network;

/// Share of its volume at rest below which a tetrahedron resists.
const BEGIN: f64 = 0.95;
/// Share below which its force grows linearly.
const END: f64 = 0.2;

/// By how much of the way back a tetrahedron is accelerated in a substep at most.
const TURNED_BACK: f64 = 0.1;

/// A tetrahedron that resists its collapse.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Tet {
    /// Its corners, ascending.
    pub nodes: [u32; 4],
    /// Six times its volume at rest \[m³\]; negative where its corners, ascending, are of the other orientation.
    pub rest: f64,
    /// Young's modulus times its volume at rest \[J\].
    pub stiffness: f64,
}

/// Six times the volume of a tetrahedron, and its derivatives by the corners.
#[inline]
fn volume(nodes: &[u32; 4], positions: &[Point3<f64>]) -> (f64, [Vector3<f64>; 4]) {
    let [a, b, c, d] = nodes.map(|node| positions[node as usize]);
    let (b, c, d) = (b - a, c - a, d - a);
    let (of_b, of_c, of_d) = (c.cross(&d), d.cross(&b), b.cross(&c));
    (d.dot(&of_d), [-(of_b + of_c + of_d), of_b, of_c, of_d])
}

/// Energy per stiffness, its slope and its curvature, at a share `q` of the volume at rest below [`BEGIN`].
#[inline]
fn law(q: f64) -> [f64; 3] {
    let [begin, end] = [BEGIN, END];
    let within = |q: f64| {
        let (by, ratio) = (begin - q, begin / q);
        let energy = begin * (begin * ratio.ln() - 2.0 * by) + 0.5 * (begin + q) * by;
        [energy, -by * by / q, ratio * ratio - 1.0]
    };
    if q >= end {
        return within(q);
    }
    let ([energy, slope, curvature], by) = (within(end), q - end);
    [energy + by * (slope + 0.5 * by * curvature), slope + by * curvature, curvature]
}

impl Tet {
    /// Its share of the volume at rest.
    #[inline]
    fn share(&self, positions: &[Point3<f64>]) -> f64 {
        let [a, b, c, d] = self.nodes.map(|node| positions[node as usize]);
        (b - a).cross(&(c - a)).dot(&(d - a)) / self.rest
    }

    /// Adds its forces on the corners \[N\]; `limited` is what its force on its share of the volume \[J\] is limited to, by
    /// that share and its derivatives by the corners.
    #[inline]
    fn add_force(
        &self,
        positions: &[Point3<f64>],
        forces: &mut [Vector3<f64>],
        limited: impl Fn(f64, f64, &[Vector3<f64>; 4]) -> f64,
    ) {
        let (six, gradient) = volume(&self.nodes, positions);
        let q = six / self.rest;
        if q < BEGIN {
            let gradient = gradient.map(|of| of / self.rest);
            let push = limited(-self.stiffness * law(q)[1], q, &gradient);
            for (node, gradient) in self.nodes.into_iter().zip(gradient) {
                forces[node as usize] += gradient * push;
            }
        }
    }

    /// Its stiffness in one direction of its four corners, `Σ aᵢ · xᵢ` squared: the part along the gradient of the volume,
    /// which is never negative. `None` where it does not resist.
    #[inline]
    fn along(&self, positions: &[Point3<f64>]) -> Option<[Vector3<f64>; 4]> {
        let q = self.share(positions);
        if q >= BEGIN || q.is_nan() {
            return None;
        }
        let (six, gradient) = volume(&self.nodes, positions);
        let root = (self.stiffness * law(six / self.rest)[2]).sqrt() / self.rest;
        Some(gradient.map(|of| of * root))
    }

    /// Bounds of its stiffness: the sums of the norms of its blocks, row by row \[N/m\].
    fn rows(&self, positions: &[Point3<f64>]) -> [f64; 4] {
        let (six, gradient) = volume(&self.nodes, positions);
        // One that resists no longer has no stiffness.
        let [_, slope, curvature] = law((six / self.rest).min(BEGIN));
        let sizes = gradient.map(|of| of.norm());
        let all: f64 = sizes.iter().sum();
        let places = self.nodes.map(|node| positions[node as usize]);
        let length = |a: usize, b: usize| (places[b] - places[a]).norm();
        std::array::from_fn(|at| {
            let [a, b, c] = [1, 2, 3].map(|by| (at + by) % 4);
            let around = length(a, b) + length(b, c) + length(c, a);
            let rest = self.rest.abs();
            self.stiffness * (curvature * sizes[at] * all / (rest * rest) - slope * around / rest)
        })
    }
}

/// Adds the forces of all tetrahedra \[N\].
pub(super) fn add_forces(network: &Network, positions: &[Point3<f64>], forces: &mut [Vector3<f64>]) {
    for tet in &network.tets {
        if tet.share(positions) < BEGIN {
            tet.add_force(positions, forces, |push, _, _| push);
        }
    }
}

/// Energy of all tetrahedra \[J\].
pub(super) fn energy(network: &Network, positions: &[Point3<f64>]) -> f64 {
    let of = |tet: &Tet| {
        let q = tet.share(positions);
        if q < BEGIN { tet.stiffness * law(q)[0] } else { 0.0 }
    };
    network.tets.iter().map(of).sum()
}

/// The stiffness of a tetrahedron that resists: `Σ aᵢ · xᵢ` squared.
#[derive(Clone, Copy, Debug)]
pub(super) struct Squeezed {
    pub nodes: [u32; 4],
    pub along: [Vector3<f64>; 4],
}

impl Squeezed {
    /// Calls `each` with every pair of its nodes once, row and column, a node with itself too, and their block.
    pub fn for_each_pair(&self, mut each: impl FnMut(u32, u32, nalgebra::Matrix3<f64>)) {
        for first in 0..4 {
            for second in 0..=first {
                let block = self.along[first] * self.along[second].transpose();
                each(self.nodes[first], self.nodes[second], block);
            }
        }
    }
}

/// The stiffnesses of the tetrahedra that resist, times the squared step.
pub(super) fn linearise(network: &Network, h: f64, positions: &[Point3<f64>], out: &mut Vec<Squeezed>) {
    out.clear();
    out.reserve(network.tets.len());
    out.extend(network.tets.iter().filter_map(|tet| {
        let along = tet.along(positions)?;
        Some(Squeezed { nodes: tet.nodes, along: along.map(|of| of * h) })
    }));
}

/// The tetrahedra of an explicit step that resist, found now and then: few do, and they begin gently.
#[derive(Clone, Debug, Default)]
pub(super) struct Resisting {
    which: Vec<u32>,
    /// Bound of their stiffness at each node \[N/m\].
    meeting: Vec<f64>,
    /// Share of their forces that the steps can take.
    pub scale: f64,
}

impl Resisting {
    /// Makes room for all of a network's, so that no step allocates.
    pub fn reserve(&mut self, network: &Network) {
        self.which.clear();
        self.which.reserve(network.tets.len());
        self.meeting.clear();
        self.meeting.reserve(if network.tets.is_empty() { 0 } else { network.masses.len() });
    }

    /// Finds those that resist, or may within `ahead` seconds at their velocities.
    pub fn find(&mut self, network: &Network, state: &State, ahead: f64) {
        let State { positions, velocities } = state;
        let fastest = velocities.iter().map(|velocity| velocity.norm_squared()).fold(0.0, f64::max);
        // In a way this much shorter than an edge no tetrahedron loses much of its volume.
        let way = 40.0 * 40.0 * fastest * ahead * ahead;
        let may = |tet: &Tet| {
            let [a, b, c, d] = tet.nodes.map(|node| positions[node as usize]);
            let (b, c, d) = (b - a, c - a, d - a);
            let across = b.cross(&c);
            if d.norm_squared() > way {
                return across.dot(&d) / tet.rest < BEGIN;
            }
            let [u, v, w, x] = tet.nodes.map(|node| velocities[node as usize]);
            let (v, w, x) = (v - u, w - u, x - u);
            let rate = across.dot(&x) + (v.cross(&c) + b.cross(&w)).dot(&d);
            (across.dot(&d) + rate * ahead) / tet.rest < BEGIN || across.dot(&d) / tet.rest < BEGIN
        };
        let all = (0..).zip(&network.tets);
        self.which.clear();
        self.which.extend(all.filter(|(_, tet)| may(tet)).map(|(at, _)| at));
        self.scale = 1.0;
    }

    /// How fast one of them loses its volume, as a share of that at rest \[1/s\].
    pub fn fastest(&self, network: &Network, state: &State) -> f64 {
        let rate = |at: &u32| {
            let tet = &network.tets[*at as usize];
            let (_, gradient) = volume(&tet.nodes, &state.positions);
            let nodes = tet.nodes.iter().zip(&gradient);
            -nodes.map(|(node, of)| of.dot(&state.velocities[*node as usize])).sum::<f64>() / tet.rest
        };
        self.which.iter().map(rate).fold(0.0, f64::max)
    }

    /// Whether none were found.
    pub fn is_empty(&self) -> bool {
        self.which.is_empty()
    }

    /// A bound of the largest eigenvalue of their M⁻¹K \[1/s²\] (Gershgorin, by blocks).
    pub fn largest(&mut self, network: &Network, mobility: &[f64], positions: &[Point3<f64>]) -> f64 {
        if self.which.is_empty() {
            return 0.0;
        }
        self.meeting.clear();
        self.meeting.resize(mobility.len(), 0.0);
        for &at in &self.which {
            let tet = &network.tets[at as usize];
            for (node, row) in tet.nodes.into_iter().zip(tet.rows(positions)) {
                self.meeting[node as usize] += row;
            }
        }
        self.meeting.iter().zip(mobility).map(|(row, mobility)| row * mobility).fold(0.0, f64::max)
    }

    /// Adds their forces in a substep of `h` seconds \[N\]. A substep may carry a tetrahedron far into what it resists:
    /// its force then is one that turns it back over some substeps, instead of throwing it out.
    pub fn add_forces(
        &self,
        network: &Network,
        mobility: &[f64],
        h: f64,
        positions: &[Point3<f64>],
        forces: &mut [Vector3<f64>],
    ) {
        for &at in &self.which {
            let tet = &network.tets[at as usize];
            tet.add_force(positions, forces, |push, q, gradient| {
                let nodes = tet.nodes.iter().zip(gradient);
                let yields: f64 = nodes.map(|(node, of)| mobility[*node as usize] * of.norm_squared()).sum();
                (self.scale * push).min(TURNED_BACK * (BEGIN - q) / (yields * h * h))
            });
        }
    }
}

//! What is constrained, and how one constraint moves its nodes.

use nalgebra::{Matrix3, Point3, Vector3};
use serde::{Deserialize, Serialize};

/// Two nodes at a distance: a spring of finite stiffness, however stiff.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Distance {
    /// Which two.
    pub nodes: [u32; 2],
    /// Length without force \[m\].
    pub rest: f64,
    /// One over the stiffness \[m/N\]; 0 for a rod.
    pub compliance: f64,
}

/// Elasticity of a volume.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Elasticity {
    /// Young's modulus \[Pa\].
    pub young_modulus: f64,
    /// Poisson's ratio, 0 to below 0.5.
    pub poisson_ratio: f64,
    /// Mass per volume \[kg/m³\].
    pub density: f64,
}

/// A tetrahedron at rest.
#[derive(Clone, Copy, Debug)]
pub(super) struct Tet {
    pub nodes: [u32; 4],
    /// Inverse of the matrix of the edges from the first corner at rest.
    inverse: Matrix3<f64>,
    /// Compliances of shape and of volume \[1/J\], and the volume ratio at which the latter has no force.
    shape: f64,
    bulk: f64,
    ratio: f64,
}

/// The state of the nodes during a step.
pub(super) struct Nodes<'a> {
    pub positions: &'a mut [Point3<f64>],
    pub mobility: &'a [f64],
    /// One over the squared step \[1/s²\].
    pub rate: f64,
}

/// How the nodes of one constraint move, and what its multipliers become.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Move {
    pub by: [Vector3<f64>; 4],
    pub multipliers: [f64; 2],
}

impl Tet {
    pub fn new(nodes: [u32; 4], rest: &[Point3<f64>], elasticity: &Elasticity) -> Self {
        let [a, b, c, d] = nodes.map(|node| rest[node as usize]);
        let edges = Matrix3::from_columns(&[b - a, c - a, d - a]);
        let volume = edges.determinant() / 6.0;
        let Elasticity { young_modulus, poisson_ratio, .. } = *elasticity;
        let mu = 0.5 * young_modulus / (1.0 + poisson_ratio);
        let lame = young_modulus * poisson_ratio / ((1.0 + poisson_ratio) * (1.0 - 2.0 * poisson_ratio));
        // So that small strains see the Lamé parameters asked for (Smith, de Goes and Kim 2018).
        let bulk = lame + mu;
        let inverse = edges.try_inverse().unwrap_or_else(Matrix3::zeros);
        Self {
            nodes,
            inverse,
            shape: 1.0 / (mu * volume),
            bulk: 1.0 / (bulk * volume),
            ratio: 1.0 + mu / bulk,
        }
    }

    /// Volume over volume at rest; negative when it is inside out.
    pub fn volume_ratio(&self, positions: &[Point3<f64>]) -> f64 {
        self.gradient(self.nodes.map(|node| positions[node as usize])).determinant()
    }

    fn gradient(&self, [a, b, c, d]: [Point3<f64>; 4]) -> Matrix3<f64> {
        Matrix3::from_columns(&[b - a, c - a, d - a]) * self.inverse
    }

    /// Shape, then volume, each from where the one before has left the nodes.
    #[inline]
    pub fn project(&self, nodes: &Nodes<'_>, mut multipliers: [f64; 2]) -> Move {
        let began = self.nodes.map(|node| nodes.positions[node as usize]);
        let mobility = self.nodes.map(|node| nodes.mobility[node as usize]);
        let mut corners = began;
        for (kind, multiplier) in multipliers.iter_mut().enumerate() {
            let f = self.gradient(corners);
            let (value, slope, compliance) = if kind == 0 {
                let norm = f.norm();
                if norm == 0.0 {
                    continue;
                }
                (norm, f / norm, self.shape)
            } else {
                let [x, y, z] = [f.column(0), f.column(1), f.column(2)];
                let cofactor = Matrix3::from_columns(&[y.cross(&z), z.cross(&x), x.cross(&y)]);
                (f.determinant() - self.ratio, cofactor, self.bulk)
            };
            let slopes = slope * self.inverse.transpose();
            let others: [Vector3<f64>; 3] = std::array::from_fn(|at| slopes.column(at).into_owned());
            let all = [-(others[0] + others[1] + others[2]), others[0], others[1], others[2]];
            let soft = compliance * nodes.rate;
            let yields: f64 =
                all.iter().zip(mobility).map(|(slope, mobility)| slope.norm_squared() * mobility).sum();
            let change = (-value - soft * *multiplier) / (yields + soft);
            *multiplier += change;
            for ((corner, slope), mobility) in corners.iter_mut().zip(&all).zip(mobility) {
                *corner += slope * (mobility * change);
            }
        }
        Move { by: std::array::from_fn(|at| corners[at] - began[at]), multipliers }
    }
}

impl Distance {
    #[inline]
    pub(super) fn project(&self, nodes: &Nodes<'_>, multiplier: f64) -> Move {
        let [a, b] = self.nodes.map(|node| node as usize);
        let along = nodes.positions[b] - nodes.positions[a];
        let length = along.norm();
        let yields = nodes.mobility[a] + nodes.mobility[b];
        let soft = self.compliance * nodes.rate;
        if length == 0.0 || yields + soft == 0.0 {
            return Move { multipliers: [multiplier, 0.0], ..Move::default() };
        }
        let change = (self.rest - length - soft * multiplier) / (yields + soft);
        let push = along * (change / length);
        let by = [push * -nodes.mobility[a], push * nodes.mobility[b], Vector3::zeros(), Vector3::zeros()];
        Move { by, multipliers: [multiplier + change, 0.0] }
    }
}

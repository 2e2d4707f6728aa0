//! Points of bodies as links see them: where they are, how they move, how they answer to impulses, and how they are given
//! them.

use nalgebra::{DMatrix, Matrix3, Point3, Vector3};

use crate::dynamic_fem::DynamicFem;
use crate::rigid::{RigidMass, RigidState};

/// Points of a body.
pub trait End {
    /// Points there are.
    fn count(&self) -> usize;
    /// Where they are \[m\].
    fn places(&self, out: &mut Vec<Point3<f64>>);
    /// How they move \[m/s\].
    fn velocities(&self, out: &mut Vec<Vector3<f64>>);
    /// Velocities of the points per impulse on them \[1/kg\], three rows and columns to a point.
    fn mobility(&self) -> DMatrix<f64>;
}

/// A point as a weighted mean of nodes.
pub type PointWeights = Vec<(u32, f64)>;

/// Points of a body of nodes with masses of their own: of finite elements with lumped masses, of a cloth, of a thread.
#[derive(Clone, Copy, Debug)]
pub struct WeightedNodes<'a> {
    /// Nodes and weights of each point.
    pub points: &'a [PointWeights],
    /// Where the nodes are \[m\].
    pub positions: &'a [Point3<f64>],
    /// How they move \[m/s\].
    pub velocities: &'a [Vector3<f64>],
    /// Inverse of the mass of each node \[1/kg\]; 0 for one that is held.
    pub inverse_masses: &'a [f64],
}

impl End for WeightedNodes<'_> {
    fn count(&self) -> usize {
        self.points.len()
    }

    fn places(&self, out: &mut Vec<Point3<f64>>) {
        out.clear();
        out.extend(self.points.iter().map(|weights| {
            Point3::from(
                weights.iter().map(|&(n, w)| self.positions[n as usize].coords * w).sum::<Vector3<f64>>(),
            )
        }));
    }

    fn velocities(&self, out: &mut Vec<Vector3<f64>>) {
        out.clear();
        out.extend(self.points.iter().map(|weights| {
            weights.iter().map(|&(n, w)| self.velocities[n as usize] * w).sum::<Vector3<f64>>()
        }));
    }

    fn mobility(&self) -> DMatrix<f64> {
        let mut matrix = DMatrix::zeros(3 * self.points.len(), 3 * self.points.len());
        for (row, one) in self.points.iter().enumerate() {
            for (column, other) in self.points.iter().enumerate() {
                let mut sum = 0.0;
                for &(node, weight) in one {
                    let shares = other.iter().filter(|(same, _)| *same == node);
                    let share: f64 = shares.map(|(_, share)| share).sum();
                    sum += weight * share * self.inverse_masses[node as usize];
                }
                (0..3).for_each(|axis| matrix[(3 * row + axis, 3 * column + axis)] = sum);
            }
        }
        matrix
    }
}

impl WeightedNodes<'_> {
    /// Impulses on points as forces on nodes over a step \[N\]; an implicit step takes them as a jump of the velocity
    /// before it moves. Adds to `forces`.
    pub fn forces(
        points: &[PointWeights],
        impulses: &[Vector3<f64>],
        dt: f64,
        forces: &mut Vec<(u32, Vector3<f64>)>,
    ) {
        for (weights, impulse) in points.iter().zip(impulses) {
            forces.extend(weights.iter().map(|&(node, weight)| (node, impulse * (weight / dt))));
        }
    }
}

/// Inverse masses of the nodes of a body of finite elements \[1/kg\]; 0 for fixed ones. Its masses are to be lumped.
#[must_use]
pub fn inverse_masses(body: &DynamicFem, density: f64, fixed: &[u32]) -> Vec<f64> {
    let mut inverse: Vec<f64> = body.mesh().lumped_masses(density).iter().map(|mass| mass.recip()).collect();
    fixed.iter().for_each(|&node| inverse[node as usize] = 0.0);
    inverse
}

/// Points of a rigid body.
#[derive(Clone, Copy, Debug)]
pub struct RigidPoints<'a> {
    /// Its inertia.
    pub mass: &'a RigidMass,
    /// Where it is and how it moves.
    pub state: &'a RigidState,
    /// Its points, in its frame \[m\].
    pub points_in_body: &'a [Point3<f64>],
}

impl RigidPoints<'_> {
    fn lever(&self, point: usize) -> Vector3<f64> {
        self.state.rotation * self.points_in_body[point].coords
    }
}

impl End for RigidPoints<'_> {
    fn count(&self) -> usize {
        self.points_in_body.len()
    }

    fn places(&self, out: &mut Vec<Point3<f64>>) {
        out.clear();
        out.extend((0..self.count()).map(|point| self.state.position + self.lever(point)));
    }

    fn velocities(&self, out: &mut Vec<Vector3<f64>>) {
        let (velocity, spin) = (self.mass.velocity(self.state), self.mass.angular_velocity(self.state));
        out.clear();
        out.extend((0..self.count()).map(|point| velocity + spin.cross(&self.lever(point))));
    }

    fn mobility(&self) -> DMatrix<f64> {
        let turning = self.mass.inverse_inertia_in_world(&self.state.rotation);
        let mut matrix = DMatrix::zeros(3 * self.count(), 3 * self.count());
        for row in 0..self.count() {
            for column in 0..self.count() {
                let block = Matrix3::from_diagonal_element(self.mass.mass.recip())
                    - self.lever(row).cross_matrix() * turning * self.lever(column).cross_matrix();
                matrix.fixed_view_mut::<3, 3>(3 * row, 3 * column).copy_from(&block);
            }
        }
        matrix
    }
}

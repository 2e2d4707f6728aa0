//! Preconditioner: the factor of the rest-state matrix, rotated at each node with its surroundings (stiffness warping:
//! Müller et al., *Stable real-time deformations*, 2002; here it affects the number of iterations, not the result).
//!
//! At rest each node has its own frame, two axes along the surface and one normal to it. In these frames the in-plane
//! stiffness and the bending of a sheet are almost uncoupled, and the small coupling is dropped: the factor splits into
//! two much smaller ones. Contacts and prescribed nodes are left to the iteration.

use nalgebra::{Matrix3, Point3, Vector3};

use super::StepMatrix;
use super::conjugate_gradients::Preconditioner;
use crate::linear_algebra::supernodal_bf16::Triangles;
use crate::mass_spring::Network;
use crate::simd::f64x4::Quad;

/// Couplings below this fraction of both unknowns' own stiffness are dropped.
const NEGLIGIBLE: f64 = 5e-3;

#[derive(Clone, Debug, Default)]
pub(super) struct Warped {
    /// Step \[s\], lag \[s\] and damping \[1/s\] that the factor was made for.
    made_for: Option<[f64; 3]>,
    factor: Option<Triangles>,
    /// Components of each spring's vector along the two tangent axes of its first and of its second node \[m\].
    shares: Vec<[f64; 4]>,
    /// Rest axes of each node, as columns.
    at_rest: Vec<Matrix3<f64>>,
    now: Vec<Matrix3<f64>>,
    /// The current axes, axis by axis, as read by an iteration.
    axes_now: Vec<[[f32; 3]; 3]>,
    axes: Vec<[Vector3<f64>; 2]>,
    vector: Vec<f32>,
}

impl Warped {
    /// For a network with a known rest shape; without one there is no factor.
    pub fn new(network: &Network) -> Self {
        let mut warped = Self::default();
        if network.rest.len() != network.masses.len() {
            return warped;
        }
        let nodes = network.masses.len();
        let mut spread = vec![Matrix3::zeros(); nodes];
        let along = |nodes: [u32; 2]| network.rest[nodes[1] as usize] - network.rest[nodes[0] as usize];
        for spring in &network.springs {
            let along = along(spring.nodes);
            spring.nodes.iter().for_each(|&node| spread[node as usize] += along * along.transpose());
        }
        // The two principal directions of each node's neighbours.
        let main: Vec<[Vector3<f64>; 2]> = spread
            .into_iter()
            .map(|spread| {
                let eigen = spread.symmetric_eigen();
                let mut order = [0, 1, 2];
                order.sort_by(|&a, &b| eigen.eigenvalues[b].total_cmp(&eigen.eigenvalues[a]));
                [0, 1].map(|at| eigen.eigenvectors.column(order[at]).into_owned())
            })
            .collect();
        warped.shares.extend(network.springs.iter().map(|spring| {
            let along = along(spring.nodes);
            let [[a, b], [c, d]] = spring.nodes.map(|node| main[node as usize].map(|axis| axis.dot(&along)));
            [a, b, c, d]
        }));
        warped.turn(network, &network.rest);
        warped.at_rest.clone_from(&warped.now);
        warped.vector = vec![0.0; 3 * nodes];
        warped
    }

    /// Factor of a network with a known rest shape, for this step \[s\] and damping.
    pub fn made(network: &Network, mobility: &[f64], (h, lag, damping): (f64, f64, f64)) -> Self {
        let mut warped = Self::new(network);
        if !warped.at_rest.is_empty() {
            warped.made_for = Some([h, lag, damping]);
            warped.factor = warped.entries(network, mobility, (h, lag, damping));
        }
        warped
    }

    /// Whether its factor has this many nodes and springs, or it can make one.
    pub fn fits(&self, network: &Network) -> bool {
        self.at_rest.len() == network.masses.len() && self.shares.len() == network.springs.len()
    }

    /// Axes of each node at these positions: sums over its springs, which rotate with them.
    fn turn(&mut self, network: &Network, positions: &[Point3<f64>]) {
        self.axes.clear();
        self.axes.resize(network.masses.len(), [Vector3::zeros(); 2]);
        for (spring, [a, b, c, d]) in network.springs.iter().zip(&self.shares) {
            let [first, second] = spring.nodes.map(|node| node as usize);
            let along = positions[second] - positions[first];
            self.axes[first][0] += along * *a;
            self.axes[first][1] += along * *b;
            self.axes[second][0] += along * *c;
            self.axes[second][1] += along * *d;
        }
        self.now.clear();
        self.now.extend(self.axes.iter().map(|[first, second]| {
            let across = first.cross(second);
            let (long, wide) = (first.norm(), across.norm());
            // On a line, or crushed: any axes will do.
            let is_plane = wide > 1e-6 * long * second.norm();
            if !is_plane {
                return Matrix3::identity();
            }
            let (first, across) = (first / long, across / wide);
            Matrix3::from_columns(&[first, across.cross(&first), across])
        }));
    }

    /// Makes the factor unless it exists for this step, and rotates it. Returns whether there is one.
    pub fn update(
        &mut self,
        network: &Network,
        mobility: &[f64],
        (h, lag, damping): (f64, f64, f64),
        positions: &[Point3<f64>],
    ) -> bool {
        if self.at_rest.is_empty() {
            return false;
        }
        if self.made_for != Some([h, lag, damping]) {
            self.made_for = Some([h, lag, damping]);
            self.factor = self.entries(network, mobility, (h, lag, damping));
        }
        self.turn(network, positions);
        self.axes_now.clear();
        self.axes_now.extend(
            self.now
                .iter()
                .map(|axes| std::array::from_fn(|axis| std::array::from_fn(|k| axes[(k, axis)] as f32))),
        );
        self.is_ready()
    }

    /// Number of entries of the factor.
    pub fn factor_entries(&self) -> usize {
        self.factor.as_ref().map_or(0, Triangles::entries)
    }

    /// Whether there is a factor.
    pub fn is_ready(&self) -> bool {
        self.factor.is_some()
    }

    fn entries(
        &self,
        network: &Network,
        mobility: &[f64],
        (h, lag, damping): (f64, f64, f64),
    ) -> Option<Triangles> {
        let nodes = network.masses.len();
        let mut matrix = StepMatrix::default();
        matrix.linearise(network, h, lag, &network.rest);
        let free = |node: u32| mobility[node as usize] > 0.0;
        let own = network.masses.iter().enumerate();
        let mut blocks: Vec<(u32, u32, Matrix3<f64>)> = own
            .map(|(node, mass)| {
                (node as u32, node as u32, Matrix3::from_diagonal_element(mass * (1.0 + h * damping)))
            })
            .collect();
        matrix.for_each_pair(network, &[], |a, b, weight, block| {
            if free(a) && free(b) {
                let (row, column) = (a.max(b), a.min(b));
                let [left, right] = [row, column].map(|node| &self.at_rest[node as usize]);
                blocks.push((row, column, left.transpose() * block.matrix() * right * weight));
            }
        });
        // A stable sort, so that each sum has one order.
        blocks.sort_by_key(|&(row, column, _)| (column, row));
        blocks.dedup_by(|next, first| {
            let same = (next.0, next.1) == (first.0, first.1);
            if same {
                first.2 += next.2;
            }
            same
        });
        let mut diagonal = vec![0.0; 3 * nodes];
        for (row, _, block) in blocks.iter().filter(|(row, column, _)| row == column) {
            (0..3).for_each(|axis| diagonal[3 * *row as usize + axis] = block[(axis, axis)]);
        }
        let mut entries = Vec::with_capacity(4 * blocks.len());
        let sizes = diagonal.clone();
        for (row, column, block) in blocks {
            for c in 0..3 {
                for r in if row == column { c + 1 } else { 0 }..3 {
                    let (at, other, value) = (3 * row + r as u32, 3 * column + c as u32, block[(r, c)]);
                    let of = [at as usize, other as usize];
                    if value * value > NEGLIGIBLE * NEGLIGIBLE * sizes[of[0]] * sizes[of[1]] {
                        entries.push((at, other, value));
                    } else {
                        // Dropped entries are added to the diagonal, which keeps the matrix definite.
                        of.iter().for_each(|&at| diagonal[at] += value.abs());
                    }
                }
            }
        }
        entries.extend(diagonal.into_iter().enumerate().map(|(at, value)| (at as u32, at as u32, value)));
        let places: Vec<_> = network.rest.iter().flat_map(|place| [*place; 3]).collect();
        Triangles::factor(&places, entries)
    }
}

impl Preconditioner for Warped {
    #[inline(always)]
    fn apply(&mut self, masses: &[f64], residual: &[Quad], product: &mut [Quad]) {
        let Some(factor) = &mut self.factor else { return product.copy_from_slice(residual) };
        // Forces on a held node have no effect, and it moves no other node.
        let all = self.vector.chunks_exact_mut(3).zip(&self.axes_now).zip(residual);
        for (((slot, axes), residual), mass) in all.zip(masses) {
            let free = f32::from(u8::from(*mass > 0.0));
            let [x, y, z, _] = residual.0.map(|value| value as f32 * free);
            for (slot, [a, b, c]) in slot.iter_mut().zip(axes) {
                *slot = a * x + b * y + c * z;
            }
        }
        factor.solve(&mut self.vector);
        let solved = self.vector.chunks_exact(3).zip(&self.axes_now);
        for ((product, (slot, [u, v, w])), mass) in product.iter_mut().zip(solved).zip(masses) {
            // A held node does not move.
            let free = f32::from(u8::from(*mass > 0.0));
            let along = |k: usize| f64::from((u[k] * slot[0] + v[k] * slot[1] + w[k] * slot[2]) * free);
            *product = Quad([along(0), along(1), along(2), 0.0]);
        }
    }
}

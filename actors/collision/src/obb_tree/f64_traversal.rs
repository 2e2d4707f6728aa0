//! Traversal in `f64`, for surfaces so far apart, or so different in size, that `f32` cannot distinguish their boxes'
//! gaps from rounding: slower and equally tight.

use nalgebra::{Matrix3, Vector3};

use super::descend::{Relation, Side};
use super::obb::Obb;
use super::{ObbTree, WIDTH};

/// Error of boxes, relative to the extent of their tree.
const BOX_ROUNDING: f64 = 64.0 / 16_777_216.0;
/// Error of `f64`, relative to all lengths involved.
const ROUNDING: f64 = 1e-14;

/// A pair of subtrees, and a lower bound of their distance \[m\].
pub(super) type FarPending = ([u32; 2], f64);

/// A box in metres and in the frame of the first surface.
struct MetricBox {
    center: Vector3<f64>,
    axes: Matrix3<f64>,
    half: Vector3<f64>,
}

fn wide(tree: &ObbTree, obb: &Obb) -> MetricBox {
    let vector = |v: [f32; 3]| Vector3::from(v.map(f64::from));
    // Orthonormal to the last digit: over a large distance the rounding of an axis becomes a large length.
    let x = vector(obb.axes[0]).normalize();
    let y = vector(obb.axes[1]);
    let y = (y - x * x.dot(&y)).normalize();
    MetricBox {
        center: vector(obb.center) * tree.scale + tree.origin.coords,
        axes: Matrix3::from_columns(&[x, y, x.cross(&y)]),
        half: vector(obb.half).map(|half| (half + BOX_ROUNDING) * tree.scale),
    }
}

impl Relation<'_> {
    /// Lower bound of the distance of two boxes \[m\], as in [`super::obb::ObbQuad::distance_squared`].
    fn far_distance(&self, in_a: u32, in_b: u32) -> f64 {
        let a = wide(self.a, &self.a.boxes[in_a as usize]);
        let b = wide(self.b, &self.b.boxes[in_b as usize]);
        let center = self.rotation * b.center + self.translation;
        let axes = self.rotation * b.axes;
        let between = center - a.center;
        let turned = (a.axes.transpose() * axes).abs();
        let apart = |gap: f64| gap.max(0.0);
        let of_a = ((a.axes.transpose() * between).abs() - a.half - turned * b.half).map(apart).norm();
        let of_b =
            ((axes.transpose() * between).abs() - b.half - turned.transpose() * a.half).map(apart).norm();
        let lengths = between.norm() + center.norm() + a.center.norm() + a.half.norm() + b.half.norm();
        let bound = of_a.max(of_b) - ROUNDING * lengths;
        // Overflowing values give no bound.
        if bound.is_nan() { 0.0 } else { bound.max(0.0) }
    }

    /// Visits pairs of leaves whose boxes are at most `limit` \[m\] apart, the nearest first. The visitor returns the
    /// new limit; `None` ends the traversal.
    pub fn descend_far(
        &self,
        pending: &mut Vec<FarPending>,
        mut limit: f64,
        mut visit: impl FnMut(u32, u32) -> Option<f64>,
    ) {
        pending.clear();
        pending.push(([0, 0], 0.0));
        while let Some(([in_a, in_b], bound)) = pending.pop() {
            if bound > limit {
                continue;
            }
            let Some(side) = self.larger(in_a, in_b) else {
                match visit(in_a, in_b) {
                    Some(nearer) => limit = nearer,
                    None => return,
                }
                continue;
            };
            let node = match side {
                Side::A => &self.a.nodes[in_a as usize],
                Side::B => &self.b.nodes[in_b as usize],
            };
            let mut found = [([0, 0], f64::INFINITY); WIDTH];
            let count = node.count as usize;
            for (found, &child) in found.iter_mut().zip(&node.children[..count]) {
                let nodes = match side {
                    Side::A => [child, in_b],
                    Side::B => [in_a, child],
                };
                *found = (nodes, self.far_distance(nodes[0], nodes[1]));
            }
            found[..count].sort_unstable_by(|one, other| other.1.total_cmp(&one.1));
            pending.extend(found[..count].iter().filter(|(_, bound)| *bound <= limit));
        }
    }
}

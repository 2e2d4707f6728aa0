//! Relative placement of two trees, and the traversal to pairs of leaves whose boxes may overlap.

use nalgebra::{Isometry3, Matrix3, Point3, Vector3};

use super::lanes::each;
use super::obb::{Obb, Placement};
use super::{ObbTree, WIDTH};
use crate::primitive::Triangle;

/// Total rounding of boxes and triangles in `f32`, relative to their extent.
const ROUNDING: f64 = 128.0 / 16_777_216.0;
/// Largest ratio of two trees' units, and distance in either, for `f32`.
const RANGE: f64 = 1e9;
/// Distance, relative to both extents, beyond which rounding is no longer small.
const FAR: f64 = 1000.0;

/// Two trees, and the placement of the second relative to the first.
pub(super) struct Relation<'a> {
    pub a: &'a ObbTree,
    pub b: &'a ObbTree,
    pub rotation: Matrix3<f64>,
    pub translation: Vector3<f64>,
    /// From the unit of `b` to that of `a`, and back.
    pub into_a: Placement,
    pub into_b: Placement,
    /// Rounding tolerance of gaps, in the unit of each.
    pub slack: [f32; 2],
    /// Whether `f32` cannot distinguish gaps from rounding, or not represent one tree in the other's unit.
    pub far: bool,
    pub blind: bool,
}

/// The tree in whose unit a bound is.
#[derive(Clone, Copy)]
pub(super) enum Side {
    A,
    B,
}

impl<'a> Relation<'a> {
    pub fn new(a: &'a ObbTree, b: &'a ObbTree, b_in_a: &Isometry3<f64>) -> Self {
        let rotation = b_in_a.rotation.to_rotation_matrix().into_inner();
        let translation = b_in_a.translation.vector;
        let ratio = b.scale / a.scale;
        let shift = rotation * b.origin.coords + translation - a.origin.coords;
        let (in_a, in_b) = (shift / a.scale, -(rotation.transpose() * shift) / b.scale);
        let reaches = [1.0 + ratio + in_a.norm(), 1.0 + ratio.recip() + in_b.norm()];
        let narrow = |m: &Matrix3<f64>| [0, 1, 2].map(|i| [0, 1, 2].map(|j| m[(i, j)] as f32));
        let (into_a, into_b, slack);
        let blind = !reaches.iter().all(|&reach| reach < RANGE);
        let far = blind || in_a.norm() > FAR * (1.0 + ratio);
        if !blind {
            let place = |rotation: &Matrix3<f64>, shift: &Vector3<f64>, scale: f64| Placement {
                rotation: narrow(rotation),
                shift: [0, 1, 2].map(|i| shift[i] as f32),
                scale: scale as f32,
            };
            into_a = place(&rotation, &in_a, ratio);
            into_b = place(&rotation.transpose(), &in_b, ratio.recip());
            slack = reaches.map(|reach| (ROUNDING * reach) as f32);
        } else {
            // Too far, too large or too small: gaps are unreliable.
            let none = Placement { rotation: narrow(&Matrix3::identity()), shift: [0.0; 3], scale: 1.0 };
            (into_a, into_b, slack) = (none, none, [f32::INFINITY; 2]);
        }
        Self { a, b, rotation, translation, into_a, into_b, slack, far, blind }
    }

    /// A triangle of `b`, by its position in the leaf order, in the frame of `a`.
    pub fn triangle_of_b(&self, place: usize) -> Triangle {
        each(self.b.triangle(place), |corner| Point3::from(self.rotation * corner.coords + self.translation))
    }

    pub fn is_inner(tree: &ObbTree, index: u32) -> bool {
        (index as usize) < tree.nodes.len()
    }

    /// The node of a pair to descend into; `None` if both are leaves.
    #[inline]
    pub fn larger(&self, a: u32, b: u32) -> Option<Side> {
        match (Self::is_inner(self.a, a), Self::is_inner(self.b, b)) {
            (false, false) => None,
            (true, false) => Some(Side::A),
            (false, true) => Some(Side::B),
            (true, true) => {
                let sizes =
                    (self.a.boxes[a as usize].size, self.b.boxes[b as usize].size * self.into_a.scale);
                Some(if sizes.0 >= sizes.1 { Side::A } else { Side::B })
            }
        }
    }

    /// Orders a pair by the node to descend into.
    #[inline]
    pub fn ordered(&self, side: Side, [a, b]: [u32; 2]) -> [u32; 2] {
        match side {
            Side::A => [a, b],
            Side::B => [b, a],
        }
    }

    #[inline]
    pub fn placed_b(&self, b: u32) -> Obb {
        self.into_a.place(&self.b.boxes[b as usize])
    }

    #[inline]
    pub fn placed_a(&self, a: u32) -> Obb {
        self.into_b.place(&self.a.boxes[a as usize])
    }
}

/// Sorts up to four items by a measure, the greatest first.
#[inline]
pub(super) fn sorted(bits: u32, measure: [f32; WIDTH]) -> ([usize; WIDTH], usize) {
    let mut order = [0; WIDTH];
    let mut count = 0;
    for lane in 0..WIDTH {
        if bits >> lane & 1 == 1 {
            let mut at = count;
            while at > 0 && measure[order[at - 1]] < measure[lane] {
                order[at] = order[at - 1];
                at -= 1;
            }
            order[at] = lane;
            count += 1;
        }
    }
    (order, count)
}

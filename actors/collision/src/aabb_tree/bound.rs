//! Conservative `f32` boxes, and lower bounds of the distance from a point or a segment to four of them at once.
//!
//! Every bound is rounded towards zero by more than its arithmetic error: 2⁻²⁰ of the largest coordinate.

use nalgebra::Point3;

use super::{LANES, Node};
use crate::primitive::Segment;

/// Largest distance of a bound \[m\]: its square fits an `f32`.
const FAR: f32 = 1e18;
/// Largest error of the `f32` arithmetic, relative to the largest coordinate: sixteen roundings.
const ROUNDING: f32 = 1.0 / (1 << 20) as f32;

/// An axis-aligned box \[m\].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Aabb {
    /// Smallest corner.
    pub min: Point3<f64>,
    /// Largest corner.
    pub max: Point3<f64>,
}

/// Largest `f32` not above `value`.
fn down(value: f64) -> f32 {
    let nearest = value as f32;
    if f64::from(nearest) > value { nearest.next_down() } else { nearest }
}

/// Smallest `f32` not below `value`.
pub(super) fn up(value: f64) -> f32 {
    let nearest = value as f32;
    if f64::from(nearest) < value { nearest.next_up() } else { nearest }
}

/// Upper bound of a number's rounding error.
#[inline]
fn widening(rounded: f32) -> f32 {
    rounded.abs() * f32::EPSILON + f32::MIN_POSITIVE
}

/// A vertex rounded to the nearest.
#[inline]
pub(super) fn rounded(vertex: &Point3<f64>) -> [f32; 4] {
    [vertex.x as f32, vertex.y as f32, vertex.z as f32, 0.0]
}

/// The box of three rounded vertices.
#[inline]
pub(super) fn triangle(corners: &[u32; 3], rounded: &[[f32; 4]]) -> ([f32; 3], [f32; 3]) {
    let [a, b, c] = corners.map(|corner| rounded[corner as usize]);
    let (mut low, mut high) = ([0.0; 4], [0.0; 4]);
    for axis in 0..4 {
        let (least, most) = (smaller(a[axis], b[axis]), larger(a[axis], b[axis]));
        let (least, most) = (smaller(least, c[axis]), larger(most, c[axis]));
        low[axis] = least - widening(least);
        high[axis] = most + widening(most);
    }
    ([low[0], low[1], low[2]], [high[0], high[1], high[2]])
}

/// The larger one, the second if the first is NaN: one instruction for four lanes, unlike `f32::max`.
#[inline]
pub(super) fn larger(first: f32, second: f32) -> f32 {
    if first > second { first } else { second }
}

/// The smaller one, the second if the first is NaN.
#[inline]
pub(super) fn smaller(first: f32, second: f32) -> f32 {
    if first < second { first } else { second }
}

/// A query object with a lower bound of its distance from boxes.
pub(super) trait LowerBound {
    /// Lower bound of its distance from each of the four boxes \[m\]; undefined for a lane without a child.
    fn lower(&self, node: &Node) -> [f32; LANES];
}

/// Distance from `[low, high]` to the boxes, axis by axis.
#[inline]
fn gaps(node: &Node, low: &[f32; 3], high: &[f32; 3]) -> [f32; LANES] {
    let mut squares = [0.0; LANES];
    for axis in 0..3 {
        for (lane, square) in squares.iter_mut().enumerate() {
            let gap = larger(node.min[axis][lane] - high[axis], low[axis] - node.max[axis][lane]);
            let gap = smaller(larger(gap, 0.0), FAR);
            *square += gap * gap;
        }
    }
    squares.map(|square: f32| square.sqrt())
}

/// A box, or a point as a box without extent.
pub(super) struct BoxBound {
    low: [f32; 3],
    high: [f32; 3],
    slack: f32,
}

impl BoxBound {
    pub(super) fn new(bounds: &Aabb, scale: f32) -> Self {
        let low = [down(bounds.min.x), down(bounds.min.y), down(bounds.min.z)];
        let high = [up(bounds.max.x), up(bounds.max.y), up(bounds.max.z)];
        Self { low, high, slack: ROUNDING * largest(low.iter().chain(&high), scale) }
    }

    pub(super) fn point(point: &Point3<f64>, scale: f32) -> Self {
        Self::new(&Aabb { min: *point, max: *point }, scale)
    }
}

impl LowerBound for BoxBound {
    #[inline]
    fn lower(&self, node: &Node) -> [f32; LANES] {
        gaps(node, &self.low, &self.high).map(|gap| larger(gap - self.slack, 0.0))
    }
}

/// A segment.
pub(super) struct SegmentBound {
    low: [f32; 3],
    high: [f32; 3],
    start: [f32; 3],
    end: [f32; 3],
    along: [f32; 3],
    /// Inverse squared length, or 0.
    inverse: f32,
    slack: f32,
}

impl SegmentBound {
    pub(super) fn new(segment: &Segment, scale: f32) -> Self {
        let [start, end] = segment.map(|end| [end.x as f32, end.y as f32, end.z as f32]);
        let (mut low, mut high, mut along) = ([0.0; 3], [0.0; 3], [0.0; 3]);
        for axis in 0..3 {
            low[axis] = start[axis].min(end[axis]);
            high[axis] = start[axis].max(end[axis]);
            along[axis] = end[axis] - start[axis];
        }
        let length_squared: f32 = along.iter().map(|part| part * part).sum();
        let inverse = if length_squared > f32::MIN_POSITIVE { 1.0 / length_squared } else { 0.0 };
        let slack = ROUNDING * largest(start.iter().chain(&end), scale);
        Self { low, high, start, end, along, inverse, slack }
    }
}

impl LowerBound for SegmentBound {
    /// The larger of two bounds: the distance of its own box, and its gap to the box along the direction from its point
    /// nearest to the box's centre towards that centre. Any direction gives a valid bound; the support of the segment
    /// is taken at both ends, so that an error of the direction does not grow with its length.
    #[inline]
    fn lower(&self, node: &Node) -> [f32; LANES] {
        let boxes = gaps(node, &self.low, &self.high);
        let mut middle = [[0.0_f32; LANES]; 3];
        let mut half = [[0.0_f32; LANES]; 3];
        let mut along = [0.0_f32; LANES];
        for axis in 0..3 {
            for lane in 0..LANES {
                middle[axis][lane] = 0.5 * (node.min[axis][lane] + node.max[axis][lane]);
                half[axis][lane] = 0.5 * (node.max[axis][lane] - node.min[axis][lane]);
                along[lane] += (middle[axis][lane] - self.start[axis]) * self.along[axis];
            }
        }
        let mut length = [0.0_f32; LANES];
        let mut support = [0.0_f32; LANES];
        let mut from_start = [0.0_f32; LANES];
        let mut from_end = [0.0_f32; LANES];
        for share in &mut along {
            *share = smaller(larger(*share * self.inverse, 0.0), 1.0);
        }
        for axis in 0..3 {
            for lane in 0..LANES {
                let direction = middle[axis][lane] - self.start[axis] - along[lane] * self.along[axis];
                length[lane] += direction * direction;
                support[lane] += direction.abs() * half[axis][lane];
                from_start[lane] += direction * (middle[axis][lane] - self.start[axis]);
                from_end[lane] += direction * (middle[axis][lane] - self.end[axis]);
            }
        }
        let mut lower = [0.0; LANES];
        for lane in 0..LANES {
            let apart = smaller(from_start[lane], from_end[lane]) - support[lane];
            // Without a direction the gap is NaN, and the first bound decides.
            let apart = larger(apart / length[lane].sqrt(), boxes[lane]);
            lower[lane] = larger(smaller(apart, FAR) - self.slack, 0.0);
        }
        lower
    }
}

/// A sphere moving along a segment: distance of its start, for boxes near enough to its path.
pub(super) struct SphereSweepBound {
    start: BoxBound,
    way: SegmentBound,
    radius: f32,
}

impl SphereSweepBound {
    pub(super) fn new(segment: &Segment, radius: f64, scale: f32) -> Self {
        let start = BoxBound::point(&segment[0], scale);
        Self { start, way: SegmentBound::new(segment, scale), radius: up(radius) }
    }
}

impl LowerBound for SphereSweepBound {
    #[inline]
    fn lower(&self, node: &Node) -> [f32; LANES] {
        let mut lower = self.start.lower(node);
        for (lower, way) in lower.iter_mut().zip(self.way.lower(node)) {
            if way > self.radius {
                *lower = f32::INFINITY;
            }
        }
        lower
    }
}

fn largest<'a>(coordinates: impl Iterator<Item = &'a f32>, scale: f32) -> f32 {
    coordinates.fold(scale, |most, coordinate| most.max(coordinate.abs())).min(FAR)
}

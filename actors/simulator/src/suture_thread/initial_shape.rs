//! Initial shape of a thread: through given points, or tied loosely by throws.

use std::f64::consts::PI;

use nalgebra::Point3;

/// Distance between the strands of a loose throw, in radii.
const LOOSE: f64 = 1.5;

/// Throws tied loosely with both ends of a loop: the knot about the origin, the loop below it (−z), the two ends at its
/// sides (±x).
#[derive(Clone, Debug, PartialEq)]
pub struct Throws<'a> {
    /// Half turns of each throw, in order of tying: 3 for a single right-handed throw, −3 for a left-handed one, 5 for
    /// a double throw.
    pub half_turns: &'a [i32],
    /// Points that the loop passes through, from the left (−x) to the right \[m\].
    pub around: &'a [Point3<f64>],
    /// Radius of the thread \[m\].
    pub radius: f64,
    /// Distance between consecutive throws \[m\]; a small value gives the closest spacing possible.
    pub apart: f64,
    /// Distance from the knot to where the loop begins, on either side \[m\].
    pub arm: f64,
    /// Length of the free ends (ears) beyond the last throw \[m\].
    pub ear: f64,
    /// Length of edges: within `arm` of the knot, and elsewhere \[m\].
    pub edges: [f64; 2],
}

/// A polyline resampled at even spacing, end points included. Empty for fewer than two points or without a positive
/// spacing.
#[must_use]
pub fn resampled(points: &[Point3<f64>], spacing: f64) -> Vec<Point3<f64>> {
    let total: f64 = points.windows(2).map(|pair| (pair[1] - pair[0]).norm()).sum();
    let count = (total / spacing).round().max(1.0);
    if points.len() < 2 || !count.is_finite() || count > super::NODES_MAX as f64 {
        return Vec::new();
    }
    let count = count as usize;
    let mut even = Vec::with_capacity(count + 1);
    let (mut edge, mut begun) = (0, 0.0);
    for k in 0..=count {
        let at = total * k as f64 / count as f64;
        while edge + 2 < points.len() && begun + (points[edge + 1] - points[edge]).norm() < at {
            begun += (points[edge + 1] - points[edge]).norm();
            edge += 1;
        }
        let length = (points[edge + 1] - points[edge]).norm();
        even.push(points[edge] + (points[edge + 1] - points[edge]) * ((at - begun) / length).min(1.0));
    }
    even
}

/// Nodes from the end of the left ear through knot, loop and knot to the end of the right ear.
#[must_use]
pub fn throws(tied: &Throws<'_>) -> Vec<Point3<f64>> {
    let circle = LOOSE * tied.radius;
    let half = 4.0 * circle;
    let level_height = tied.apart.max(6.0 * circle);
    let begin = |side: f64| Point3::new(side * (half + tied.arm), 0.0, -circle);
    let mut strands = [vec![begin(-1.0)], vec![begin(1.0)]];
    let mut top = 0.0;
    for (level, &half_turns) in tied.half_turns.iter().enumerate() {
        let z = level_height * level as f64;
        let half = half * f64::from(half_turns.unsigned_abs()) / 3.0;
        let steps = 16 * half_turns.unsigned_abs();
        for (side, strand) in strands.iter_mut().enumerate() {
            let left = side == level % 2;
            for k in 0..=steps {
                let part = f64::from(k) / f64::from(steps);
                let along = if left { part } else { 1.0 - part };
                let angle = PI * f64::from(half_turns) * along - PI / 2.0 + if left { 0.0 } else { PI };
                strand.push(Point3::new(
                    half * (2.0 * along - 1.0),
                    circle * angle.cos(),
                    z + circle * angle.sin(),
                ));
            }
            if level + 1 < tied.half_turns.len() {
                let outwards = (half + 0.25 * level_height) * if left { 1.0 } else { -1.0 };
                strand.push(Point3::new(outwards, 0.0, z + 0.5 * level_height));
            }
        }
        top = z + circle;
    }
    let near = tied.ear.min(tied.arm);
    let mut ears = [Vec::new(), Vec::new()];
    for (strand, ear) in strands.iter_mut().zip(&mut ears) {
        let last = strand[strand.len() - 1];
        let at = |reach: f64| Point3::new(last.x + reach * last.x.signum(), 0.0, top);
        strand.push(at(near));
        if tied.ear > near {
            *ear = resampled(&[at(near), at(tied.ear)], tied.edges[1]);
        }
    }
    let [left, right] = strands.map(|strand| resampled(&strand, tied.edges[0]));
    let slack: Vec<_> =
        [begin(-1.0)].into_iter().chain(tied.around.iter().copied()).chain([begin(1.0)]).collect();
    let mut points: Vec<_> = ears[0].iter().skip(1).rev().copied().collect();
    points.extend(left.iter().rev());
    points.extend(resampled(&slack, tied.edges[1]).iter().skip(1));
    points.extend(right.iter().skip(1));
    points.extend(ears[1].iter().skip(1));
    points
}

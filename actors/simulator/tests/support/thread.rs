//! A bend of two strands tied by throws, tightened and loaded: shared by the tests and the trial program of knots.

#![allow(dead_code, reason = "each program uses a part")]

use std::f64::consts::PI;

use nalgebra::{Point3, Vector3};
use trocar_collision::primitive::closest_segments;
use trocar_simulator::suture_thread::{Hold, Surroundings, Thread, ThreadReport};

/// Distance between the knot and where its loop is pulled \[m\].
const ARM: f64 = 6e-3;
/// Speed of an unloaded hand \[m/s\].
const SPEED: f64 = 0.05;
/// Length of the ends beyond the last throw \[m\].
const EAR: f64 = 5e-3;
/// Spring that keeps the slack loop hanging below the knot, in place of the object that it is tied around: stiffness
/// \[N/m\] and force limit \[N\], a hundredth of the load on each arm of the knot. Otherwise the loop swings up between
/// the ears.
const BIGHT: [f64; 2] = [20.0, 0.05];

/// A polyline resampled at even spacing, end points included.
pub fn resampled(points: &[Point3<f64>], spacing: f64) -> Vec<Point3<f64>> {
    let total: f64 = points.windows(2).map(|pair| (pair[1] - pair[0]).norm()).sum();
    let count = (total / spacing).round().max(1.0) as usize;
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

/// Least distance between centre lines of two strands, and their edges \[m\]. Edges nearer along the thread than half a
/// turn of its tightest bend belong to the same strand.
pub fn nearest_strands(points: &[Point3<f64>], radius: f64) -> (f64, [usize; 2]) {
    let mut arcs = vec![0.0];
    for pair in points.windows(2) {
        arcs.push(arcs[arcs.len() - 1] + (pair[1] - pair[0]).norm());
    }
    let mut least = (f64::INFINITY, [0, 0]);
    for first in 0..points.len() - 1 {
        for second in first + 3..points.len() - 1 {
            if arcs[second] - arcs[first + 1] < PI * radius {
                continue;
            }
            let edge = |k: usize| [points[k], points[k + 1]];
            let distance = closest_segments(&edge(first), &edge(second)).distance_squared.sqrt();
            if distance < least.0 {
                least = (distance, [first, second]);
            }
        }
    }
    least
}

/// Throws with these half turns, tied loosely with the two ends of a loop, which is long and slack.
pub fn loose_knot(turns: &[i32], radius: f64, spacing: f64) -> Vec<Point3<f64>> {
    // Strands of a throw at a distance of one and a half diameters.
    let circle = 1.5 * radius;
    let half = 4.0 * circle;
    let level_height = 6.0 * circle;
    let begin = |x: f64| Point3::new(x, 0.0, -circle);
    let mut strands = [vec![begin(-half - ARM)], vec![begin(half + ARM)]];
    let mut top = 0.0;
    for (level, &half_turns) in turns.iter().enumerate() {
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
            if level + 1 < turns.len() {
                let outwards = (half + 1.5 * circle) * if left { 1.0 } else { -1.0 };
                strand.push(Point3::new(outwards, 0.0, z + 0.5 * level_height));
            }
        }
        top = z + circle;
    }
    for strand in &mut strands {
        let last = strand[strand.len() - 1];
        strand.push(Point3::new(last.x + EAR * last.x.signum(), 0.0, top));
    }
    let [first, second] = strands;
    let first: Vec<_> = first.into_iter().rev().collect();
    let mut points = resampled(&first, spacing);
    let wide = half + ARM;
    let slack: Vec<_> = (0..=24)
        .map(|k| {
            let angle = PI * f64::from(k) / 24.0;
            Point3::new(-wide * angle.cos(), 0.0, -circle - 1.5 * wide * angle.sin())
        })
        .collect();
    points.extend(&resampled(&slack, 2e-3)[1..]);
    points.extend(&resampled(&second, spacing)[1..]);
    points
}

/// A knot on the test bench: pulled at four ends to tighten it, then at the loop alone.
pub struct Bend {
    pub thread: Thread,
    /// Where the loop is pulled.
    pub arms: [usize; 2],
    /// The lowest node of the slack loop, and where it hangs.
    bight: (usize, Point3<f64>),
}

impl Bend {
    /// From a thread made by [`loose_knot`].
    pub fn new(thread: Thread) -> Self {
        let points = thread.positions();
        let widest = |sign: f64| {
            let spacing = &thread.state().rest_lengths;
            // The corners between the fine strands and the coarse slack loop.
            let middle = points.len() / 2;
            let coarse = |edge: &usize| spacing[*edge] > 1.2e-3;
            if sign < 0.0 {
                (0..middle).find(coarse).unwrap_or(0)
            } else {
                (middle..spacing.len()).rev().find(coarse).unwrap_or(0) + 1
            }
        };
        let arms = [widest(-1.0), widest(1.0)];
        let lowest = (arms[0] + arms[1]) / 2;
        let bight = (lowest, points[lowest] - Vector3::z() * 2e-3);
        Self { thread, arms, bight }
    }

    /// Distance between the arms \[m\].
    pub fn span(&self) -> f64 {
        (self.thread.positions()[self.arms[1]] - self.thread.positions()[self.arms[0]]).norm()
    }

    /// The lowest node of the slack loop.
    pub fn bight(&self) -> usize {
        self.bight.0
    }

    /// Renumbers its nodes.
    pub fn renumber(&mut self, now: impl Fn(usize) -> usize) {
        self.arms = self.arms.map(&now);
        self.bight.0 = now(self.bight.0);
    }

    /// Advances for a time; `pull` gives the forces at the loop and at the ears.
    pub fn steps(
        &mut self,
        seconds: f64,
        dt: f64,
        pull: impl Fn(f64) -> [f64; 2],
        mut seen: impl FnMut(f64, &Self, &ThreadReport),
    ) -> Option<ThreadReport> {
        let last = self.thread.positions().len() - 1;
        let count = (seconds / dt).round() as usize;
        let mut report = None;
        for step in 0..count {
            let time = dt * (step + 1) as f64;
            let forces = pull(time);
            let side = |node: usize| self.thread.positions()[node].x.signum();
            let ends = [
                (self.arms[0], -1.0, forces[0]),
                (self.arms[1], 1.0, forces[0]),
                (0, side(0), forces[1]),
                (last, side(last), forces[1]),
            ];
            // The hand's force decreases linearly with its speed: full at rest, zero at its free speed.
            let [a, b, c, d] = ends.map(|(node, side, force)| Hold {
                node,
                to: self.thread.positions()[node] + Vector3::x() * (side * SPEED * dt),
                stiffness: (force / (SPEED * dt)).max(1e-9),
                force_max: f64::INFINITY,
            });
            let (node, to) = self.bight;
            let bight = Hold { node, to, stiffness: BIGHT[0], force_max: BIGHT[1] };
            let holds = [a, b, c, d, bight];
            let around = Surroundings { holds: &holds, ..Surroundings::default() };
            let found = self.thread.step(dt, &around).expect("a step");
            seen(time, self, &found);
            report = Some(found);
        }
        report
    }

    /// Pulls all four ends with `force` \[N\], slowly at first.
    pub fn tighten(&mut self, force: f64, seconds: f64, dt: f64) -> Option<ThreadReport> {
        let ramp = 0.6 * seconds;
        self.steps(seconds, dt, |time| [force * (time / ramp).min(1.0).powi(2); 2], |_, _, _| {})
    }

    /// Releases the ears and pulls the loop with `force` \[N\]; reports the growth of the loop every tenth.
    pub fn load(
        &mut self,
        force: f64,
        seconds: f64,
        dt: f64,
        mut tell: impl FnMut(f64, f64, &Self, &ThreadReport),
    ) -> Option<ThreadReport> {
        let begin = self.span();
        let every = (0.1 * seconds / dt).round().max(1.0) as usize;
        let mut count = 0;
        self.steps(
            seconds,
            dt,
            |time| [force, (1.0 - time / 0.05).max(0.0) * force],
            |time, bend, report| {
                count += 1;
                if count % every == 0 {
                    tell(time, bend.span() - begin, bend, report);
                }
            },
        )
    }
}

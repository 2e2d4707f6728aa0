//! Broad phase of a thread's contacts: bounding boxes around runs of neighbouring edges first, then capsules.

use nalgebra::{Point3, Vector3};
use trocar_collision::continuous::{Sweep, edge_edge, segment_face};
use trocar_collision::primitive::{Segment, closest_segments};

use super::{Motion, Obstacle, Shape};
use crate::suture_thread::state::{ContactKey, PARTED, end_of};

/// Number of neighbouring edges in one box.
const RUN: usize = 8;
/// Centre lines nearer than this fraction of the sum of the radii count as passing through each other.
const CORE: f64 = 0.3;

/// A pair that may touch during the step.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Candidate {
    pub key: ContactKey,
}

/// An axis-aligned box \[m\].
#[derive(Clone, Copy, Debug)]
struct Bounds {
    min: Vector3<f64>,
    max: Vector3<f64>,
}

impl Bounds {
    fn empty() -> Self {
        Self { min: Vector3::repeat(f64::INFINITY), max: Vector3::repeat(f64::NEG_INFINITY) }
    }

    fn add(&mut self, point: &Point3<f64>, by: f64) {
        self.min = self.min.inf(&(point.coords - Vector3::repeat(by)));
        self.max = self.max.sup(&(point.coords + Vector3::repeat(by)));
    }

    fn overlaps(&self, other: &Self) -> bool {
        (0..3).all(|axis| self.min[axis] <= other.max[axis] && other.min[axis] <= self.max[axis])
    }
}

/// Finds candidate pairs; keeps its buffers.
#[derive(Clone, Debug, Default)]
pub(crate) struct Candidates {
    pub found: Vec<Candidate>,
    boxes: Vec<Bounds>,
    arcs: Vec<f64>,
}

impl Candidates {
    /// Edges that come within `slack` of each other or of an obstacle while each node moves by at most its `reach`.
    /// Edges of one strand nearer along it than `apart` cannot touch: the strand would have to be folded.
    #[expect(clippy::too_many_arguments, reason = "lists that belong to the step")]
    pub fn find(
        &mut self,
        positions: &[Point3<f64>],
        reach: &[f64],
        rest_lengths: &[f64],
        radius: f64,
        slack: f64,
        obstacles: &[Obstacle],
        motions: &[Motion],
    ) {
        let room = radius + 0.5 * slack;
        self.begin(positions, reach, rest_lengths, room);
        for a in 0..self.boxes.len() {
            for b in a..self.boxes.len() {
                if self.boxes[a].overlaps(&self.boxes[b]) {
                    self.pairs(positions, reach, a, b, room, radius);
                }
            }
        }
        for (index, (obstacle, motion)) in obstacles.iter().zip(motions).enumerate() {
            self.with_obstacle(positions, reach, index, obstacle, motion, room);
        }
        self.found.sort_unstable();
    }

    /// Edges of a line, by its nodes, their `reach` and the lengths of its edges \[m\], that may touch the obstacles which
    /// are wanted.
    pub fn find_on_obstacles(
        &mut self,
        (positions, reach, lengths): (&[Point3<f64>], &[f64], &[f64]),
        radius: f64,
        (obstacles, motions): (&[Obstacle], &[Motion]),
        is_wanted: impl Fn(usize) -> bool,
    ) {
        self.begin(positions, reach, lengths, radius);
        for (index, (obstacle, motion)) in obstacles.iter().zip(motions).enumerate() {
            if is_wanted(index) {
                self.with_obstacle(positions, reach, index, obstacle, motion, radius);
            }
        }
        self.found.sort_unstable();
    }

    /// Boxes around the runs of a line, and the arc lengths of its nodes.
    fn begin(&mut self, positions: &[Point3<f64>], reach: &[f64], rest_lengths: &[f64], room: f64) {
        self.found.clear();
        let edges = rest_lengths.len();
        self.boxes.clear();
        self.arcs.clear();
        self.arcs.push(0.0);
        for rest in rest_lengths {
            let rest = if *rest > 0.0 { *rest } else { PARTED };
            self.arcs.push(self.arcs.last().copied().unwrap_or(0.0) + rest);
        }
        for first in (0..edges).step_by(RUN) {
            let mut bounds = Bounds::empty();
            for node in first..=(first + RUN).min(edges) {
                let node = node % positions.len();
                bounds.add(&positions[node], room + reach[node]);
            }
            self.boxes.push(bounds);
        }
    }

    fn pairs(
        &mut self,
        positions: &[Point3<f64>],
        reach: &[f64],
        a: usize,
        b: usize,
        room: f64,
        radius: f64,
    ) {
        let arcs = &self.arcs;
        let edges = arcs.len() - 1;
        // Of a closed thread the way along it may lead over the seam.
        let is_closed = edges == positions.len();
        let end = |edge: usize| end_of(edge, positions.len());
        let joins = |edge: &usize| joins(arcs, *edge);
        let run = |of: usize| (RUN * of..(RUN * (of + 1)).min(edges)).filter(joins);
        for first in run(a) {
            let middle = Point3::from((positions[first].coords + positions[end(first)].coords) * 0.5);
            let half = 0.5 * (positions[end(first)] - positions[first]).norm();
            let moved = reach[first].max(reach[end(first)]);
            for second in run(b) {
                // Half a turn of the tightest bend, in which opposite sides touch, is π/2 diameters along the strand.
                let along = if second > first { arcs[second] - arcs[first + 1] } else { 0.0 };
                if along < 2.5 * radius || (second < first + 3 && along < 0.5 * PARTED) {
                    continue;
                }
                let across = arcs[edges] - arcs[second + 1] + arcs[first];
                if is_closed && (across < 2.5 * radius || edges + first < second + 3) {
                    continue;
                }
                let other = (positions[second].coords + positions[end(second)].coords) * 0.5;
                let reached = half
                    + 0.5 * (positions[end(second)] - positions[second]).norm()
                    + moved
                    + reach[second].max(reach[end(second)])
                    + 2.0 * room;
                if (middle.coords - other).norm_squared() <= reached * reached {
                    let key = ContactKey { with: 0, edge: first as u32, feature: second as u32 };
                    self.found.push(Candidate { key });
                }
            }
        }
    }

    fn with_obstacle(
        &mut self,
        positions: &[Point3<f64>],
        reach: &[f64],
        index: usize,
        obstacle: &Obstacle,
        motion: &Motion,
        room: f64,
    ) {
        let with = 1 + index as u32;
        let arcs = &self.arcs;
        let edges = arcs.len() - 1;
        let is_closed = edges == positions.len();
        if let Shape::HalfSpace { normal } = &obstacle.shape {
            for (pose, later) in [(&motion.from, false), (&motion.to, true)] {
                let (normal, origin) = (pose.rotation * normal, pose.translation.vector);
                for edge in (0..edges).filter(|edge| joins(arcs, *edge)) {
                    // The last edge of a thread covers both of its ends.
                    let is_last = !is_closed && (edge + 1 == edges || !joins(arcs, edge + 1));
                    for end in 0..=u32::from(is_last) {
                        let node = edge + end as usize;
                        let key = ContactKey { with, edge: edge as u32, feature: end };
                        if normal.dot(&(positions[node].coords - origin)) <= room + reach[node]
                            && (!later || !self.found.contains(&Candidate { key }))
                        {
                            self.found.push(Candidate { key });
                        }
                    }
                }
            }
            return;
        }
        for_each_feature(obstacle, motion, |feature, bounds| {
            for run in 0..self.boxes.len() {
                if !self.boxes[run].overlaps(&bounds) {
                    continue;
                }
                for edge in (RUN * run..(RUN * (run + 1)).min(edges)).filter(|edge| joins(arcs, *edge)) {
                    let mut own = Bounds::empty();
                    for node in [edge, end_of(edge, positions.len())] {
                        own.add(&positions[node], room + reach[node]);
                    }
                    if own.overlaps(&bounds) {
                        self.found.push(Candidate { key: ContactKey { with, edge: edge as u32, feature } });
                    }
                }
            }
        });
    }
}

/// Whether an edge is real, by the arc lengths of its nodes.
fn joins(arcs: &[f64], edge: usize) -> bool {
    arcs[edge + 1] - arcs[edge] < 0.5 * PARTED
}

/// Visits the swept boxes of an obstacle's features.
fn for_each_feature(obstacle: &Obstacle, motion: &Motion, mut visit: impl FnMut(u32, Bounds)) {
    let poses = [&motion.from, &motion.to];
    let mut bounds = Bounds::empty();
    match &obstacle.shape {
        Shape::Sphere { radius } => {
            poses.iter().for_each(|pose| bounds.add(&Point3::from(pose.translation.vector), *radius));
            visit(0, bounds);
        }
        Shape::Capsule { ends, radius } => {
            for pose in poses {
                ends.iter().for_each(|end| bounds.add(&(pose * end), *radius));
            }
            visit(0, bounds);
        }
        Shape::HalfSpace { .. } => {}
        Shape::Mesh { from, to, triangles, radius } => {
            for (index, corners) in triangles.iter().enumerate() {
                let mut bounds = Bounds::empty();
                for &corner in corners {
                    let corner = corner as usize;
                    for (pose, fraction) in poses.iter().zip(motion.fractions) {
                        let place = from[corner].coords.lerp(&to[corner].coords, fraction);
                        bounds.add(&(*pose * Point3::from(place)), *radius);
                    }
                }
                visit(index as u32, bounds);
            }
        }
    }
}

/// Least allowed distance between centre lines \[m\].
pub(crate) fn centre_separation(radius: f64) -> f64 {
    CORE * 2.0 * radius
}

/// Whether two edges stay further apart than `separation` \[m\] because their initial distance exceeds the largest
/// relative displacement of their nodes.
fn apart(first: &Sweep<Segment>, second: &Sweep<Segment>, separation: f64) -> bool {
    let mut way = 0.0_f64;
    for a in 0..2 {
        for b in 0..2 {
            let moved = (first.to[a] - first.from[a]) - (second.to[b] - second.from[b]);
            way = way.max(moved.norm_squared());
        }
    }
    // A margin of a hundredth, more than rounding needs.
    let least = (way.sqrt() + separation) * 1.01;
    closest_segments(&first.from, &second.from).distance_squared > least * least
}

/// Whether the edge of `key` passes through the other edge or the obstacle on the way from `from` to `to`.
pub(crate) fn passed_through(
    key: &ContactKey,
    from: &[Point3<f64>],
    to: &[Point3<f64>],
    radius: f64,
    obstacles: &[Obstacle],
    motions: &[Motion],
) -> bool {
    let edge = key.edge as usize;
    let swept = |edge: usize| {
        let end = end_of(edge, from.len());
        Sweep { from: [from[edge], from[end]], to: [to[edge], to[end]] }
    };
    // A pair that was already that near at the beginning is separating and not stopped.
    let hit = |found: Option<trocar_collision::continuous::Impact>| found.is_some_and(|at| at.time > 0.0);
    // Most pairs are decided by their initial distance.
    let edges = |other: &Sweep<Segment>, separation: f64| {
        let own = swept(edge);
        !apart(&own, other, separation) && hit(edge_edge(&own, other, separation))
    };
    if key.with == 0 {
        return edges(&swept(key.feature as usize), centre_separation(radius));
    }
    let index = key.with as usize - 1;
    let (obstacle, motion) = (&obstacles[index], &motions[index]);
    match &obstacle.shape {
        Shape::HalfSpace { .. } => false,
        Shape::Sphere { radius: of } => {
            let centre = |pose: &nalgebra::Isometry3<f64>| [Point3::from(pose.translation.vector); 2];
            let other = Sweep { from: centre(&motion.from), to: centre(&motion.to) };
            edges(&other, CORE * (radius + of))
        }
        Shape::Capsule { ends, radius: of } => {
            let other =
                Sweep { from: ends.map(|end| motion.from * end), to: ends.map(|end| motion.to * end) };
            edges(&other, CORE * (radius + of))
        }
        Shape::Mesh { from: before, to: after, triangles, radius: of } => {
            let Some(corners) = triangles.get(key.feature as usize) else { return false };
            let at = |pose: &nalgebra::Isometry3<f64>, fraction: f64| {
                corners.map(|k| {
                    pose * Point3::from(before[k as usize].coords.lerp(&after[k as usize].coords, fraction))
                })
            };
            let other = Sweep {
                from: at(&motion.from, motion.fractions[0]),
                to: at(&motion.to, motion.fractions[1]),
            };
            hit(segment_face(&swept(edge), &other, CORE * (radius + of)))
        }
    }
}

/// The same for a triangle of a deforming surface, given its corners before and after.
pub(crate) fn passed_through_face(
    edge: usize,
    [from, to]: [&[Point3<f64>]; 2],
    radius: f64,
    corners: [[Point3<f64>; 3]; 2],
) -> bool {
    let end = end_of(edge, from.len());
    let own = Sweep { from: [from[edge], from[end]], to: [to[edge], to[end]] };
    let other = Sweep { from: corners[0], to: corners[1] };
    segment_face(&own, &other, CORE * radius).is_some_and(|at| at.time > 0.0)
}

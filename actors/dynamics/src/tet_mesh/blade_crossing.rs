//! Where the area that a blade has swept crosses the edges of a deformed mesh, and which nodes it passes close by.

use std::collections::BTreeMap;

use nalgebra::{Matrix3, Point3, Vector3};

use super::blade_cut::NodeMotion;
use super::cut_path::PathNode;
use super::topology::Volume;
use super::{Sweep, shape};
use trocar_scene::mesh::tet_faces::OPPOSITE;

/// How far the swept area is extended beyond its borders, as a fraction of the distance within which nodes are on it:
/// so that there is no gap to what the blade sweeps next, by rounding or by the motion of the tissue.
const OVERLAP: f64 = 0.05;
/// Motion below which a blade rests, as a fraction of the same distance: its direction is not known.
const REST: f64 = 1e-6;
/// Cosine of the angle between the motions of a blade's ends that counts as opposite.
const TURNS: f64 = 0.9;
/// How far a blade is from the tissue when its stroke ends, relative to the distance within which nodes are on its path.
const OUT: f64 = 2.0;
/// Largest height of nodes that a blade passes close by, relative to the same distance.
const CLOSE_BY: f64 = 6.0;
/// Square of the sine of the angle between an edge and a blade that counts as none.
const PARALLEL: f64 = 1e-8;
/// Steps of bisection for the time at which a blade passes.
const BISECTIONS: usize = 40;

/// Intersection of an edge with a blade's path.
#[derive(Clone, Copy, Debug)]
pub struct Crossing {
    /// Position along the edge, 0 to 1.
    pub share: f64,
    /// Normal of the path in the rest shape.
    pub normal_in_rest: Vector3<f64>,
    /// Which ends of the edge the blade has still to pass.
    pub ahead: [bool; 2],
}

/// Edges that a sweep crosses, each in the order of its ends, and nodes that it passes close by.
#[derive(Debug, Default)]
pub struct Crossings {
    /// Whether the blade is in the tissue in the end.
    pub is_inside: bool,
    pub edges: BTreeMap<[u32; 2], Crossing>,
    /// Those within the distance; marked as ahead also higher ones and those that the blade has passed before.
    pub nodes: BTreeMap<u32, PathNode>,
}

/// A point that moves evenly during a sweep: where it ends, and its motion \[m\]. Time is the fraction of the sweep.
#[derive(Clone, Copy)]
struct Moving {
    end: Point3<f64>,
    motion: Vector3<f64>,
}

impl Moving {
    fn at(&self, time: f64) -> Point3<f64> {
        self.end - self.motion * (1.0 - time)
    }
}

/// A blade's edge during a sweep, and the tissue's nodes.
struct Passage<'a> {
    ends: [Moving; 2],
    nodes: &'a NodeMotion,
    near: f64,
    /// The side that normals face, if the blade turns about a point of its own: the normal of its faster end. Else they
    /// face as the blade moves.
    facing: Option<Vector3<f64>>,
}

impl<'a> Passage<'a> {
    fn new(sweep: &Sweep, nodes: &'a NodeMotion, near: f64) -> Self {
        let ([a, b], [c, d]) = (sweep.before, sweep.after);
        let ends = [Moving { end: c, motion: c - a }, Moving { end: d, motion: d - b }];
        let blade = (b - a) + (d - c);
        let [first, last] = ends.map(|end| blade.cross(&end.motion));
        let turns = first.dot(&last) < -TURNS * first.norm() * last.norm();
        let facing = turns.then_some(if first.norm() > last.norm() { first } else { last });
        Self { ends, nodes, near, facing }
    }

    fn node(&self, node: u32) -> Moving {
        Moving { end: self.nodes.positions[node as usize], motion: self.nodes.moved[node as usize] }
    }

    /// First and last time, with an overlap, of the passage of points that move so; none if the blade rests relative to
    /// them.
    fn span(&self, motion: &Vector3<f64>) -> Option<[f64; 2]> {
        let most = self.ends.iter().map(|end| (end.motion - motion).norm()).fold(0.0, f64::max);
        (most > REST * self.near).then(|| [-OVERLAP * self.near / most, 1.0])
    }

    /// The blade at a time: its first end, and the way to the second.
    fn blade(&self, time: f64) -> (Point3<f64>, Vector3<f64>) {
        let [from, to] = self.ends.map(|end| end.at(time));
        (from, to - from)
    }

    /// Whether a fraction of the way along the blade is on it.
    fn is_on_blade(&self, along: f64, blade: &Vector3<f64>) -> bool {
        let out = OVERLAP * self.near / blade.norm();
        along > -out && along < 1.0 + out
    }

    /// Normal of the swept area at a fraction of the way along the blade, for points that move so. Of a blade that turns
    /// about a point of its own it is interpolated between the ends: that point rests, so its own motion is rounding,
    /// or that of the tissue alone.
    fn normal(&self, along: f64, blade: &Vector3<f64>, motion: &Vector3<f64>) -> Option<Vector3<f64>> {
        let [from, to] = self.ends.map(|end| end.motion - motion);
        let Some(facing) = self.facing else {
            return blade.cross(&(from + (to - from) * along)).try_normalize(0.0);
        };
        let [from, to] = [from, to].map(|motion| {
            let normal = blade.cross(&motion);
            if normal.dot(&facing) < 0.0 { -normal } else { normal }
        });
        (from + (to - from) * along).try_normalize(0.0)
    }

    /// When and where the blade passes an edge: the time, the fraction along the edge, and the normal.
    fn crosses(&self, [a, b]: [Moving; 2]) -> Option<(f64, f64, Vector3<f64>)> {
        let mean = (a.motion + b.motion) / 2.0;
        let [first, last] = self.span(&mean)?;
        // The volume between blade and edge, a cubic polynomial of time, is zero when they are in one plane.
        let volume = |time: f64| {
            let (from, blade) = self.blade(time);
            let start = a.at(time);
            (b.at(time) - start).dot(&blade.cross(&(from - start)))
        };
        roots_of_cubic(volume, first, last).into_iter().flatten().find_map(|time| {
            let (from, blade) = self.blade(time);
            let start = a.at(time);
            let (edge, off) = (b.at(time) - start, from - start);
            let across = edge.cross(&blade);
            let square = across.norm_squared();
            // An edge along the blade is as high above its path everywhere: its nodes are on the path, or it is not
            // crossed.
            if square <= PARALLEL * edge.norm_squared() * blade.norm_squared() {
                return None;
            }
            let share = off.cross(&blade).dot(&across) / square;
            let along = off.cross(&edge).dot(&across) / square;
            let apart = off + blade * along - edge * share;
            if !(0.0..=1.0).contains(&share)
                || !self.is_on_blade(along, &blade)
                || apart.norm() > OVERLAP * self.near
            {
                return None;
            }
            let motion = a.motion + (b.motion - a.motion) * share;
            Some((time, share, self.normal(along, &blade, &motion)?))
        })
    }

    /// When the blade passes a node, the height of the node above it then, and the normal.
    fn passes(&self, node: Moving) -> Option<(f64, f64, Vector3<f64>)> {
        let [first, last] = self.span(&node.motion)?;
        let side = |time: f64| self.side(&node, time).unwrap_or(f64::NAN);
        // The far side of the point about which a blade turns goes backwards: a node there comes from behind the blade
        // without being passed.
        if self.facing.is_none() && side(first) < 0.0 {
            return None;
        }
        let time = root_between(side, first, last)?;
        let Beside { height, normal, is_on_blade, .. } = self.beside(&node, time)?;
        is_on_blade.then_some((time, height, normal))
    }

    /// Whether the blade has still to pass a node in the end.
    fn is_ahead(&self, node: &Moving) -> bool {
        self.beside(node, 1.0).is_some_and(|beside| beside.ahead > 0.0)
    }

    /// The height and the normal in the end, if the blade has passed the node.
    fn has_passed(&self, node: &Moving) -> Option<(f64, f64, Vector3<f64>)> {
        self.span(&node.motion)?;
        let Beside { ahead, height, normal, is_on_blade } = self.beside(node, 1.0)?;
        (is_on_blade && ahead <= 0.0).then_some((1.0, height, normal))
    }

    /// On which side of the blade a node is: the sign changes when the blade passes it. The two halves of a blade that
    /// turns about a point of its own go opposite ways, so what lies ahead of it changes also without a passage.
    fn side(&self, node: &Moving, time: f64) -> Option<f64> {
        let Some(facing) = self.facing else { return Some(self.beside(node, time)?.ahead) };
        let (from, blade) = self.blade(time);
        Some(aside(&facing, &blade)?.cross(&blade).dot(&(node.at(time) - from)))
    }

    fn beside(&self, node: &Moving, time: f64) -> Option<Beside> {
        let (from, blade) = self.blade(time);
        let off = node.at(time) - from;
        let along = off.dot(&blade) / blade.norm_squared();
        let motions = self.ends.map(|end| end.motion - node.motion);
        let motion = motions[0] + (motions[1] - motions[0]) * along;
        let normal = self.normal(along, &blade, &node.motion)?;
        let onwards = motion - blade * (motion.dot(&blade) / blade.norm_squared());
        Some(Beside {
            ahead: onwards.dot(&off),
            height: normal.dot(&off),
            normal,
            is_on_blade: self.is_on_blade(along, &blade),
        })
    }
}

/// A point beside a blade.
struct Beside {
    /// Positive if the blade has still to pass the point.
    ahead: f64,
    /// Height above the swept area \[m\].
    height: f64,
    /// Normal of the swept area.
    normal: Vector3<f64>,
    /// Whether the blade is long enough to pass it.
    is_on_blade: bool,
}

/// The direction of a vector square to a blade.
fn aside(way: &Vector3<f64>, blade: &Vector3<f64>) -> Option<Vector3<f64>> {
    (way - blade * (way.dot(blade) / blade.norm_squared())).try_normalize(0.0)
}

/// A root of a function that changes its sign between two times.
fn root_between(value: impl Fn(f64) -> f64, mut low: f64, mut high: f64) -> Option<f64> {
    let (mut at_low, mut at_high) = (value(low), value(high));
    // Half open: so one that is met just between two sweeps belongs to one of them.
    if at_low.is_nan() || at_high.is_nan() || (at_low < 0.0) == (at_high < 0.0) {
        return None;
    }
    let mut time = low;
    for _ in 0..BISECTIONS {
        // Regula falsi with the Illinois rule: superlinear, and the root stays between both ends.
        time = low + (high - low) * (at_low / (at_low - at_high)).clamp(0.0, 1.0);
        let at = value(time);
        if at == 0.0 || (high - low).abs() < 1e-14 {
            break;
        }
        if (at < 0.0) == (at_high < 0.0) {
            at_low *= 0.5;
        } else {
            (low, at_low) = (high, at_high);
        }
        (high, at_high) = (time, at);
    }
    Some(time)
}

/// Roots of a cubic polynomial between two times.
fn roots_of_cubic(value: impl Fn(f64) -> f64, first: f64, last: f64) -> [Option<f64>; 3] {
    // By its values at four points of -1 to 1.
    let (middle, half) = ((first + last) / 2.0, (last - first) / 2.0);
    let [a, b, c, d] = [-1.0, -0.5, 0.5, 1.0].map(|x| value(middle + half * x));
    let bend = 2.0 * ((a + d) - (b + c)) / 3.0;
    let slope = (8.0 * (c - b) - (d - a)) / 6.0;
    let third = (2.0 * (d - a) - 4.0 * (c - b)) / 3.0;
    // Between extrema it is monotonous.
    let square = bend * bend - 3.0 * third * slope;
    let mut turns = [1.0; 2];
    if square > 0.0 {
        let q = -(bend + square.sqrt().copysign(bend));
        turns = [q / (3.0 * third), slope / q];
        turns = turns.map(|at| if at.is_finite() { at.clamp(-1.0, 1.0) } else { 1.0 });
        turns.sort_by(f64::total_cmp);
    }
    let ends = [-1.0, turns[0], turns[1], 1.0].map(|x| middle + half * x);
    [0, 1, 2]
        .map(|at| if ends[at] < ends[at + 1] { root_between(&value, ends[at], ends[at + 1]) } else { None })
}

/// On which sides of a box around the swept area a point lies: a bit for each of its six sides. What lies beyond the same
/// side as a whole is away from the area.
struct Surroundings {
    axes: [Vector3<f64>; 3],
    bounds: [[f64; 2]; 3],
}

impl Surroundings {
    /// Around what a blade sweeps relative to tissue that moves by up to `moved`, with a margin of `near` \[m\].
    fn new(sweep: &Sweep, moved: f64, near: f64) -> Self {
        let ([a, b], [c, d]) = (sweep.before, sweep.after);
        let along = ((b - a) + (d - c)).try_normalize(0.0).unwrap_or_else(Vector3::x);
        let motion = (c - a) + (d - b);
        let other = if along.x.abs() < 0.5 { Vector3::x() } else { Vector3::y() };
        let aside = |way: Vector3<f64>| (way - along * along.dot(&way)).try_normalize(0.0);
        let across = aside(motion).or_else(|| aside(other)).unwrap_or_else(Vector3::z);
        let axes = [along, across, along.cross(&across)];
        let out = moved + CLOSE_BY * near;
        let bounds = axes.map(|axis| {
            let [low, high] = [a, b, c, d]
                .iter()
                .map(|end| axis.dot(&end.coords))
                .fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], at| [low.min(at), high.max(at)]);
            [low - out, high + out]
        });
        Self { axes, bounds }
    }

    fn beyond(&self, point: &Point3<f64>) -> u8 {
        let mut sides = 0;
        for (at, (axis, [low, high])) in self.axes.iter().zip(self.bounds).enumerate() {
            let along = axis.dot(&point.coords);
            sides |= (u8::from(along < low) | u8::from(along > high) << 1) << (2 * at);
        }
        sides
    }
}

impl Volume {
    /// What a sweep crosses and passes; nodes within `near` of it at rest \[m\] are on it.
    pub(super) fn crossings(&self, nodes: &NodeMotion, sweep: &Sweep, near: f64) -> Crossings {
        let moved = nodes.moved.iter().map(Vector3::norm_squared).fold(0.0, f64::max).sqrt();
        let around = Surroundings::new(sweep, moved, near);
        let beyond: Vec<u8> = nodes.positions.iter().map(|point| around.beyond(point)).collect();
        let mut corners_of: Vec<(u32, u32)> = Vec::new();
        let mut edges: Vec<([u32; 2], u32)> = Vec::new();
        let mut found = Crossings::default();
        for (tet, corners) in self.tets() {
            if corners.iter().fold(u8::MAX, |sides, &node| sides & beyond[node as usize]) == 0 {
                corners_of.extend(corners.map(|node| (node, tet)));
                edges.extend(edges_of(corners).map(|edge| (edge, tet)));
                found.is_inside |= {
                    let places = corners.map(|node| nodes.positions[node as usize]);
                    is_within(&places, &sweep.after, OUT * near)
                };
            }
        }
        corners_of.sort_unstable();
        corners_of.dedup_by_key(|(node, _)| *node);
        edges.sort_unstable();
        edges.dedup_by_key(|(edge, _)| *edge);
        let passage = Passage::new(sweep, nodes, near);
        for (node, tet) in corners_of {
            if beyond[node as usize] == 0
                && let Some(mark) = self.close_by(node, tet, &passage)
            {
                found.nodes.insert(node, mark);
            }
        }
        for (edge, tet) in edges {
            if beyond[edge[0] as usize] & beyond[edge[1] as usize] == 0
                && let Some(crossing) = self.crossing(edge, tet, &passage)
            {
                found.edges.insert(edge, crossing);
            }
        }
        found
    }

    /// The path's plane at a node of an element, if the blade passes close by.
    fn close_by(&self, node: u32, tet: u32, passage: &Passage<'_>) -> Option<PathNode> {
        let place = passage.node(node);
        let passes = passage.passes(place);
        // Where a blade turns sharply it has passed without having been beside the node.
        let (time, height, normal) = passes.or_else(|| passage.has_passed(&place))?;
        // A plane h = n · x of the deformed element is h / |Fᵀ n| above the same plane at rest.
        let normal = self.gradient(tet, passage, time)?.tr_mul(&normal);
        let (length, height) = (normal.norm(), height / normal.norm());
        let ahead = passes.is_none() || height.abs() >= passage.near;
        let mark = PathNode { node, normal_in_rest: normal / length, height, stroke: 0, ahead };
        (height.abs() < CLOSE_BY * passage.near).then_some(mark)
    }

    fn crossing(&self, edge: [u32; 2], tet: u32, passage: &Passage<'_>) -> Option<Crossing> {
        let (time, share, normal) = passage.crosses(edge.map(|node| passage.node(node)))?;
        let normal_in_rest = self.gradient(tet, passage, time)?.tr_mul(&normal).try_normalize(0.0)?;
        let ahead = edge.map(|node| passage.is_ahead(&passage.node(node)));
        Some(Crossing { share, normal_in_rest, ahead })
    }

    /// Deformation gradient of an element at a time of the passage.
    fn gradient(&self, tet: u32, passage: &Passage<'_>, time: f64) -> Option<Matrix3<f64>> {
        let corners = self.tet(tet)?;
        let places = corners.map(|node| passage.node(node).at(time));
        Some(shape(&places, &[0, 1, 2, 3]) * shape(&self.rest, &corners).try_inverse()?)
    }
}

/// Whether some of a segment is in a tetrahedron with its faces moved outwards by `out`.
fn is_within(corners: &[Point3<f64>; 4], [from, to]: &[Point3<f64>; 2], out: f64) -> bool {
    let mut span = [0.0_f64, 1.0];
    for [a, b, c] in OPPOSITE.map(|face| face.map(|corner| corners[corner])) {
        let outward = (b - a).cross(&(c - a)).try_normalize(0.0).unwrap_or_default();
        let [first, last] = [from, to].map(|end| outward.dot(&(end - a)) - out);
        let at = first / (first - last);
        match (first <= 0.0, last <= 0.0) {
            (true, true) => {}
            (true, false) => span[1] = span[1].min(at),
            (false, true) => span[0] = span[0].max(at),
            (false, false) => return false,
        }
    }
    span[0] <= span[1]
}

pub fn edges_of([a, b, c, d]: [u32; 4]) -> [[u32; 2]; 6] {
    [[a, b], [a, c], [a, d], [b, c], [b, d], [c, d]].map(|[x, y]| if x < y { [x, y] } else { [y, x] })
}

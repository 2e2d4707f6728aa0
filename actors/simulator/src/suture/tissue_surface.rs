//! Contact with the tissue surface: points of the needle's body near it, and the part of the thread that is inside the
//! tissue and ignores it.

use nalgebra::{Point3, Vector3};
use trocar_collision::primitive::closest_on_triangle;

use super::material::Resistance;
use super::needle::Solid;
use super::state::{SutureState, Tip};
use super::tissue::Tissue;
use crate::suture_thread::IgnoredObstacle;
use crate::suture_thread::elastic::SurfacePoint;

/// Spacing of the needle's contact points \[m\].
const SPACING: f64 = 1e-3;
/// Length behind the tip that makes no contact, since the tip has its own rules \[m\].
const POINT: f64 = 1e-3;
/// A point deeper than this is inside the tissue, not on its surface, in radii.
const DEEP: f64 = 2.0;
/// Contact margin of the needle's points beyond their motion in a step \[m\].
const NEAR: f64 = 2e-4;

/// Maximum number of contact points on a needle.
pub(super) const SAMPLES_MAX: u32 = 512;

/// A point of the needle's body near the surface.
#[derive(Clone, Copy, Debug)]
pub(super) struct NeedleSide {
    /// Its number, from the tail.
    pub sample: u32,
    /// Arc length from the tail \[m\].
    pub along: f64,
    /// Wire radius there \[m\].
    pub radius: f64,
    /// Contact point on the surface.
    pub place: SurfacePoint,
    /// Its position at the beginning of the substep.
    pub point: Point3<f64>,
    /// Outward unit normal.
    pub normal: Vector3<f64>,
}

/// Arc lengths between which needle and thread are in the tissue, bite by bite, extended by the free margin around
/// holes.
fn buried(state: &SutureState, length: f64, workspace: f64, mut each: impl FnMut(f64, f64)) {
    let mut begin = 0;
    while let Some(first) = state.channel.get(begin) {
        let count = state.channel[begin..].iter().take_while(|point| point.bite == first.bite).count();
        let last = &state.channel[begin + count - 1];
        begin += count;
        let is_last = begin == state.channel.len();
        let with_tip = is_last && matches!(state.tip, Tip::Inside(_) | Tip::Leaving(..));
        let end = if with_tip { length } else { last.along };
        each(first.along.min(end) - workspace, first.along.max(end) + workspace);
    }
}

/// Thread edges in the tissue, and their neighbours.
pub(super) fn in_tissue(
    state: &SutureState,
    length: f64,
    resistance: &Resistance,
    surface: usize,
    spared: &mut Vec<IgnoredObstacle>,
) {
    let Some(thread) = &state.thread else { return };
    buried(state, length, resistance.spacing, |low, high| {
        let mut edges = None;
        for (edge, [begin, end]) in thread.spans() {
            if -begin >= low && -end <= high {
                edges = Some(edges.map_or([edge, edge], |[first, _]: [usize; 2]| [first, edge]));
            }
        }
        spared.extend(edges.map(|edges| IgnoredObstacle { obstacle: surface, edges }));
    });
}

/// Whether any part of a thread edge is in the tissue or at one of its holes.
pub(super) fn is_in_tissue(state: &SutureState, length: f64, resistance: &Resistance, edge: usize) -> bool {
    let span = state.thread.as_ref().and_then(|thread| thread.spans().find(|(own, _)| *own == edge));
    let Some((_, [begin, end])) = span else { return false };
    let mut is_in = false;
    buried(state, length, resistance.spacing, |low, high| is_in |= -begin >= low && -end <= high);
    is_in
}

/// Thread nodes in the tissue or at its holes.
pub(super) fn nodes_in_tissue(
    state: &SutureState,
    length: f64,
    resistance: &Resistance,
    nodes: &mut Vec<usize>,
) {
    let Some(thread) = &state.thread else { return };
    buried(state, length, resistance.spacing, |low, high| {
        nodes.extend(
            thread.spans().filter(|(_, [begin, _])| (low..=high).contains(&-begin)).map(|(edge, _)| edge),
        );
    });
}

/// Lists the needle points that may touch the surface in a substep of `dt`, with the surface at its beginning.
pub(super) fn sides(
    solid: &Solid,
    state: &SutureState,
    tissue: &Tissue,
    resistance: &Resistance,
    dt: f64,
    out: &mut Vec<NeedleSide>,
) {
    out.clear();
    let (shape, pose) = (solid.shape(), state.needle.pose());
    let length = shape.length();
    let speed = state.needle.velocity(solid).norm() + state.needle.spin(solid).norm() * 2.0 * shape.radius;
    let reach = NEAR + 1.5 * dt * speed;
    // The part behind the tip that reaches the surface in this substep makes contact in the next one.
    let behind = (length - POINT - 1.5 * dt * speed).max(0.0);
    let count = (behind / SPACING).floor().clamp(0.0, f64::from(SAMPLES_MAX - 1)) as u32;
    for sample in 0..=count {
        let along = f64::from(sample) * SPACING;
        let mut is_buried = false;
        buried(state, length, resistance.spacing, |low, high| is_buried |= (low..=high).contains(&along));
        if is_buried {
            continue;
        }
        out.push(NeedleSide {
            sample,
            along,
            radius: shape.wire_radius_at(along),
            place: SurfacePoint::default(),
            point: pose * solid.point(along),
            normal: Vector3::repeat(f64::INFINITY),
        });
    }
    let workspace = reach + shape.wire_radius;
    let Some(first) = out.first() else { return };
    let (mut low, mut high) = (first.point.coords, first.point.coords);
    for side in out.iter() {
        (low, high) = (low.inf(&side.point.coords), high.sup(&side.point.coords));
    }
    let (low, high) = (low - Vector3::repeat(workspace), high + Vector3::repeat(workspace));
    // The nearest so far for each point: signed distance and foot point.
    let mut nearest: [Option<(f64, f64, Point3<f64>)>; SAMPLES_MAX as usize] = [None; SAMPLES_MAX as usize];
    for triangle in tissue.mesh().surface() {
        let corners = triangle.map(|node| tissue.before()[node as usize]);
        let of = |f: fn(&Vector3<f64>, &Vector3<f64>) -> Vector3<f64>| {
            f(&f(&corners[0].coords, &corners[1].coords), &corners[2].coords)
        };
        let (least, most) = (of(|a, b| a.inf(b)), of(|a, b| a.sup(b)));
        if (0..3).any(|k| least[k] > high[k] || most[k] < low[k]) {
            continue;
        }
        let outwards = (corners[1] - corners[0]).cross(&(corners[2] - corners[0]));
        for (side, best) in out.iter_mut().zip(&mut nearest) {
            let at = &side.point.coords;
            if (0..3).any(|k| least[k] > at[k] + workspace || most[k] < at[k] - workspace) {
                continue;
            }
            let found = closest_on_triangle(&side.point, &corners);
            let way = side.point - found.point;
            let distance = way.norm();
            if distance > workspace || best.is_some_and(|(known, ..)| known <= distance) {
                continue;
            }
            let below = way.dot(&outwards) < 0.0;
            let Some(along) = way.try_normalize(1e-9).or_else(|| outwards.try_normalize(0.0)) else {
                continue;
            };
            side.place = SurfacePoint { nodes: *triangle, weights: found.weights };
            side.normal = if below { -along } else { along };
            *best = Some((distance, if below { -distance } else { distance }, found.point));
        }
    }
    let mut index = 0;
    out.retain_mut(|side| {
        let found = nearest[index];
        index += 1;
        let Some((_, distance, point)) = found else { return false };
        side.point = point;
        distance > -DEEP * side.radius && distance - side.radius < reach
    });
}

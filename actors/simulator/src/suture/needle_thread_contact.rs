//! Contact of the thread with its own needle: strands on the wire, as frictional contacts in the one problem of needle,
//! thread and tissue. Each edge contacts the chord of the wire nearest to it at the beginning of a substep.

use nalgebra::{Point3, Vector3};
use trocar_collision::continuous::{Sweep, edge_edge};
use trocar_collision::primitive::{Segment, closest_segments};

use super::joints::{self, Pair};
use super::needle::{NeedleState, Solid};
use super::state::{StrandContact, SutureState};
use crate::suture_thread::contact::{Rows, Side, place, tangents};
use crate::suture_thread::discrete_elastic_rod::RodIterate;
use crate::suture_thread::{ThreadMaterial, ThreadState};

/// Number of chords that approximate the wire: on a half circle of 26 mm, each is off the arc by 10 µm at most.
pub(super) const CHORDS: usize = 32;
/// Thread nearer to the swage than this, along thread and wire together, makes no contact \[m\].
const AT_SWAGE: f64 = 4e-3;
/// Contact margin beyond the possible motion in a substep \[m\].
const NEAR: f64 = 2e-4;
/// Centre lines nearer than this fraction of the sum of the radii count as passing through each other.
const CORE: f64 = 0.3;
/// Coulomb's friction coefficient of the thread on the wire: chosen, as on instruments.
const FRICTION: f64 = 0.2;
/// Maximum number of contacts.
pub(super) const STRANDS_MAX: usize = 64;

/// An edge of the thread near to the wire.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Strand {
    pub edge: usize,
    /// The chord.
    pub chord: usize,
    /// Surface gap at the beginning of the substep \[m\].
    pub gap: f64,
}

pub(super) fn chord_along(solid: &Solid, chord: usize) -> [f64; 2] {
    let length = solid.shape().length();
    [chord, chord + 1].map(|end| length * end as f64 / CHORDS as f64)
}

pub(super) fn chord_at(solid: &Solid, needle: &NeedleState, chord: usize) -> Segment {
    let pose = needle.pose();
    chord_along(solid, chord).map(|along| pose * solid.point(along))
}

pub(super) fn radius_at(solid: &Solid, chord: usize, share: f64) -> f64 {
    let [from, to] = chord_along(solid, chord);
    solid.shape().wire_radius_at(from + (to - from) * share)
}

/// Whether an edge and a chord are both next to the swage.
fn is_swage(solid: &Solid, arc: f64, chord: usize) -> bool {
    arc + chord_along(solid, chord)[0] < AT_SWAGE
}

/// Lists the edges that may touch the wire in a substep of `dt` \[s\] from `state`, the nearest first when there are
/// too many.
pub(super) fn near(solid: &Solid, state: &SutureState, radius: f64, dt: f64, out: &mut Vec<Strand>) {
    out.clear();
    let Some(thread) = &state.thread else { return };
    let needle = &state.needle;
    let speed = needle.velocity(solid).norm() + needle.spin(solid).norm() * 2.0 * solid.shape().radius;
    let chords: [Segment; CHORDS] = std::array::from_fn(|chord| chord_at(solid, needle, chord));
    let (mut low, mut high) = (Vector3::repeat(f64::INFINITY), Vector3::repeat(f64::NEG_INFINITY));
    for end in chords.iter().flatten() {
        (low, high) = (low.inf(&end.coords), high.sup(&end.coords));
    }
    for (edge, [begin, _]) in thread.spans() {
        let ends = [thread.positions[edge], thread.positions[edge + 1]];
        let fastest = thread.velocities[edge].norm().max(thread.velocities[edge + 1].norm());
        let reach = NEAR + 1.5 * dt * (speed + fastest);
        let workspace = reach + radius + solid.shape().wire_radius;
        let beyond = |axis: usize| {
            let (a, b) = (ends[0][axis], ends[1][axis]);
            a.max(b) < low[axis] - workspace || a.min(b) > high[axis] + workspace
        };
        if (0..3).any(beyond) {
            continue;
        }
        let gap = |chord: usize| {
            let nearest = closest_segments(&ends, &chords[chord]);
            let radii = radius + radius_at(solid, chord, nearest.along[1]);
            nearest.distance_squared.sqrt() - radii
        };
        let own = (0..CHORDS).filter(|chord| !is_swage(solid, begin, *chord));
        let best =
            own.map(|chord| (gap(chord), chord)).min_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        if let Some((gap, chord)) = best.filter(|(gap, _)| *gap < reach) {
            out.push(Strand { edge, chord, gap });
        }
    }
    if out.len() > STRANDS_MAX {
        out.sort_unstable_by(|a, b| a.gap.total_cmp(&b.gap).then(a.edge.cmp(&b.edge)));
        out.truncate(STRANDS_MAX);
        out.sort_unstable_by_key(|strand| strand.edge);
    }
}

/// The contact of an edge with the wire at the iterate.
pub(super) fn contact(
    solid: &Solid,
    material: &ThreadMaterial,
    (start, needle): (&SutureState, &NeedleState),
    at: &RodIterate,
    strand: &Strand,
) -> Pair {
    let Strand { edge, chord, .. } = *strand;
    let ends = [at.positions[edge], at.positions[edge + 1]];
    let wire = chord_at(solid, needle, chord);
    let [along, on_wire] = closest_segments(&ends, &wire).along;
    let (of_thread, of_wire) = (place(&ends, along), place(&wire, on_wire));
    let away = of_thread - of_wire;
    let normal = away.try_normalize(1e-12).unwrap_or_else(|| needle.pose() * Vector3::z());
    let [t1, t2] = tangents(&normal, &at.tangents[edge]);
    let directions = [normal, t1, t2];
    let side = Side {
        edge,
        along,
        arm: normal * -material.radius,
        tangent: at.tangents[edge],
        length: at.lengths[edge],
    };
    let rows = Rows::new(&side, None, directions);
    let wire_radius = radius_at(solid, chord, on_wire);
    let touching = Point3::from(of_wire + normal * wire_radius);
    // Relative tangential motion since the beginning of the substep.
    let before = start.needle.pose() * needle.pose().inverse_transform_point(&touching);
    let carried = touching - before;
    let of_start = |node: usize| {
        let thread: &ThreadState = start.thread.as_ref()?;
        thread.positions.get(node).copied()
    };
    let slid = |k: usize| {
        let nodes = [edge, edge + 1].into_iter().zip(&rows.cells[k]);
        let moved = nodes.map(|(node, cell)| {
            let by = of_start(node).map_or(Vector3::zeros(), |from| at.positions[node] - from);
            cell[0] * by.x
                + cell[1] * by.y
                + cell[2] * by.z
                + cell[3] * at.turns.get(node).copied().unwrap_or(0.0)
        });
        moved.sum::<f64>() - directions[k].dot(&carried)
    };
    let known = start.strand_contacts.iter().find(|known| known.edge as usize == edge);
    let drawn = known.map_or(Vector3::zeros(), |known| known.drawn);
    let gap =
        [away.norm() - material.radius - wire_radius, t1.dot(&drawn) + slid(1), t2.dot(&drawn) + slid(2)];
    let force = known.map_or(Vector3::zeros(), |known| known.force);
    joints::strand(needle, &touching, rows, gap, FRICTION, &force)
}

/// The first edge of the thread that passes through the wire between the beginning of the substep and the iterate.
pub(super) fn passes(
    solid: &Solid,
    radius: f64,
    start: &SutureState,
    needle: &NeedleState,
    [from, to]: [&[Point3<f64>]; 2],
) -> Option<usize> {
    let thread = start.thread.as_ref()?;
    let [before, after]: [[Segment; CHORDS]; 2] =
        [&start.needle, needle].map(|needle| std::array::from_fn(|chord| chord_at(solid, needle, chord)));
    let (mut low, mut high) = (Vector3::repeat(f64::INFINITY), Vector3::repeat(f64::NEG_INFINITY));
    for end in before.iter().chain(&after).flatten() {
        (low, high) = (low.inf(&end.coords), high.sup(&end.coords));
    }
    for (edge, [begin, _]) in thread.spans() {
        let swept = Sweep { from: [from[edge], from[edge + 1]], to: [to[edge], to[edge + 1]] };
        let ends = || swept.from.iter().chain(&swept.to);
        let beyond = |axis: usize| {
            ends().all(|end| end[axis] < low[axis] - radius)
                || ends().all(|end| end[axis] > high[axis] + radius)
        };
        if (0..3).any(beyond) {
            continue;
        }
        for chord in (0..CHORDS).filter(|chord| !is_swage(solid, begin, *chord)) {
            let other = Sweep { from: before[chord], to: after[chord] };
            let separation = CORE * (radius + radius_at(solid, chord, 0.5));
            // The relative displacement is bounded by that of the end points.
            let way = (0..2)
                .flat_map(|a| (0..2).map(move |b| (a, b)))
                .map(|(a, b)| ((swept.to[a] - swept.from[a]) - (other.to[b] - other.from[b])).norm())
                .fold(0.0, f64::max);
            let least = (way + separation) * 1.01;
            if closest_segments(&swept.from, &other.from).distance_squared > least * least {
                continue;
            }
            if edge_edge(&swept, &other, separation).is_some_and(|at| at.time > 0.0) {
                return Some(edge);
            }
        }
    }
    None
}

/// Stores the memory of contacts with non-zero force at the end of a substep.
pub(super) fn remember(
    strands: &[Strand],
    forces: impl Iterator<Item = ([f64; 3], [Vector3<f64>; 3])>,
    contacts: &mut Vec<StrandContact>,
) {
    contacts.clear();
    for (strand, (force, [n, t1, t2])) in strands.iter().zip(forces) {
        if force[0] > 0.0 {
            contacts.push(StrandContact {
                edge: strand.edge as u32,
                force: n * force[0] + t1 * force[1] + t2 * force[2],
                drawn: (t1 * force[1] + t2 * force[2]) * -joints::COMPLIANCE,
            });
        }
    }
}

//! Contact of the needle with instruments: the wire on their rods, as frictional contacts in the one problem of needle,
//! thread and tissue. Each rod touches the wire where it is nearest, at most at two places, since an arc may lie around it.
//!
//! Instruments that hold the needle do not touch it otherwise, and open jaws pass on either side of what they are to hold:
//! see [`super::StepInputs::needle_passes`]. Friction is that of the motion in a substep: nothing sticks for ever.

use nalgebra::{Point3, Vector3};
use trocar_collision::continuous::{Sweep, edge_edge};
use trocar_collision::primitive::{Segment, closest_segments};

use super::joints::{self, Pair};
use super::needle::{NeedleState, Solid};
use super::needle_thread_contact::{CHORDS, chord_at, radius_at};
use crate::suture_thread::contact::{Motion, place, tangents};
use crate::suture_thread::{Obstacle, Shape};

/// Contact margin beyond the possible motion in a substep \[m\].
const NEAR: f64 = 2e-4;
/// Centre lines nearer than this fraction of the sum of the radii count as passing through each other.
const CORE: f64 = 0.3;
/// Chords nearer to each other than this along the wire touch one rod at one place.
const APART: usize = CHORDS / 4;
/// An overlap that is deeper than this at the beginning of a substep is worked off at [`WORKED_OFF`] \[m\].
const OVERLAP: f64 = 5e-5;
/// See above \[m/s\].
const WORKED_OFF: f64 = 0.05;
/// Maximum number of contacts.
const TOUCHES_MAX: usize = 32;

/// A place where the wire is near to a rod.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Touch {
    /// Index of the obstacle.
    pub obstacle: usize,
    chord: usize,
    /// Overlap that is not pushed out in this substep \[m\].
    overlap: f64,
}

/// The axis and the radius of a rod; other shapes do not touch needles.
fn rod(obstacle: &Obstacle, motion: &Motion, at_end: bool) -> Option<(Segment, f64)> {
    let Shape::Capsule { ends, radius } = obstacle.shape else { return None };
    let pose = if at_end { &motion.to } else { &motion.from };
    Some((ends.map(|end| pose * end), radius))
}

fn chords(solid: &Solid, needle: &NeedleState) -> [Segment; CHORDS] {
    std::array::from_fn(|chord| chord_at(solid, needle, chord))
}

/// Gap between the surfaces of a chord and a rod \[m\].
fn gap(solid: &Solid, chord: usize, wire: &Segment, axis: &Segment, radius: f64) -> f64 {
    let nearest = closest_segments(wire, axis);
    nearest.distance_squared.sqrt() - radius - radius_at(solid, chord, nearest.along[0])
}

/// Lists the places where rods may touch the wire in a substep of `dt` \[s\]. `is_touched` says of an obstacle whether the
/// needle touches it at all.
pub(super) fn near(
    solid: &Solid,
    needle: &NeedleState,
    (obstacles, motions): (&[Obstacle], &[Motion]),
    is_touched: impl Fn(usize) -> bool,
    dt: f64,
    out: &mut Vec<Touch>,
) {
    out.clear();
    let speed = needle.velocity(solid).norm() + needle.spin(solid).norm() * 2.0 * solid.shape().radius;
    let chords = chords(solid, needle);
    let all = obstacles.iter().zip(motions).enumerate().filter(|(index, _)| is_touched(*index));
    for (index, (obstacle, motion)) in all {
        let (Some((from, radius)), Some((to, _))) =
            (rod(obstacle, motion, false), rod(obstacle, motion, true))
        else {
            continue;
        };
        let way = from.iter().zip(&to).map(|(from, to)| (to - from).norm()).fold(0.0, f64::max);
        let reach = NEAR + 1.5 * dt * speed + way;
        // The centre of the arc's circle is as far from all of it as its radius.
        let centre = needle.pose() * solid.center_of_arc();
        let far = closest_segments(&from, &[centre; 2]).distance_squared.sqrt();
        if far > solid.shape().radius + solid.shape().wire_radius + radius + reach {
            continue;
        }
        let gaps: [f64; CHORDS] = std::array::from_fn(|chord| {
            let [before, after] = [&from, &to].map(|axis| gap(solid, chord, &chords[chord], axis, radius));
            before.min(after)
        });
        let first = (0..CHORDS).min_by(|a, b| gaps[*a].total_cmp(&gaps[*b]));
        let beside = |other: usize| move |chord: &usize| chord.abs_diff(other) >= APART;
        let second = first
            .and_then(|first| (0..CHORDS).filter(beside(first)).min_by(|a, b| gaps[*a].total_cmp(&gaps[*b])));
        for chord in [first, second].into_iter().flatten() {
            if gaps[chord] > reach || out.len() >= TOUCHES_MAX {
                continue;
            }
            let before = gap(solid, chord, &chords[chord], &from, radius);
            // What is inside at the beginning comes out slowly.
            let overlap = if before < -OVERLAP { (-before - WORKED_OFF * dt).max(0.0) } else { 0.0 };
            out.push(Touch { obstacle: index, chord, overlap });
        }
    }
}

/// The contact at one of these places with needle and rod at the iterate, and the point where they touch.
pub(super) fn contact(
    solid: &Solid,
    [start, needle]: [&NeedleState; 2],
    (obstacle, motion): (&Obstacle, &Motion),
    touch: &Touch,
) -> Option<(Pair, Point3<f64>)> {
    let (axis, radius) = rod(obstacle, motion, true)?;
    // The needle rolls and slides on the rod within a substep.
    let beside = touch.chord.saturating_sub(1)..=(touch.chord + 1).min(CHORDS - 1);
    let wires = beside.map(|chord| (chord, chord_at(solid, needle, chord)));
    let (chord, wire) = wires.min_by(|(a, one), (b, other)| {
        gap(solid, *a, one, &axis, radius).total_cmp(&gap(solid, *b, other, &axis, radius))
    })?;
    let [along, on_rod] = closest_segments(&wire, &axis).along;
    let (of_wire, of_rod) = (Point3::from(place(&wire, along)), Point3::from(place(&axis, on_rod)));
    let away = of_wire - of_rod;
    let normal = away.try_normalize(1e-12)?;
    let tangent = (wire[1] - wire[0]).try_normalize(0.0).unwrap_or_else(Vector3::x);
    let [t1, t2] = tangents(&normal, &tangent);
    let touching = of_rod + normal * radius;
    let before = start.pose() * needle.pose().inverse_transform_point(&touching);
    let rod_before = motion.from * motion.to.inverse_transform_point(&touching);
    let slid = rod_before - before;
    let apart = away.norm() - radius - radius_at(solid, chord, along) + touch.overlap;
    let gap = [apart, t1.dot(&slid), t2.dot(&slid)];
    let pair = joints::rod(needle, &touching, touch.obstacle, [normal, t1, t2], gap, obstacle.friction);
    Some((pair, touching))
}

/// Whether the wire passes through a rod on the way from one state of the needle to the other.
pub(super) fn passes(
    solid: &Solid,
    [start, needle]: [&NeedleState; 2],
    (obstacles, motions): (&[Obstacle], &[Motion]),
    touches: &[Touch],
) -> bool {
    if touches.is_empty() {
        return false;
    }
    let [before, after] = [start, needle].map(|needle| chords(solid, needle));
    let mut last = None;
    touches.iter().any(|touch| {
        if last.replace(touch.obstacle) == Some(touch.obstacle) {
            return false;
        }
        let (obstacle, motion) = (&obstacles[touch.obstacle], &motions[touch.obstacle]);
        let (Some((from, radius)), Some((to, _))) =
            (rod(obstacle, motion, false), rod(obstacle, motion, true))
        else {
            return false;
        };
        let rod = Sweep { from, to };
        (0..CHORDS).any(|chord| {
            let wire = Sweep { from: before[chord], to: after[chord] };
            let separation = CORE * (radius + radius_at(solid, chord, 0.5));
            edge_edge(&wire, &rod, separation).is_some_and(|at| at.time > 0.0)
        })
    })
}

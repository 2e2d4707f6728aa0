//! Contact of the needle with instruments and rigid bodies: the wire, as a line of chords, on their shapes, as frictional
//! contacts in the one problem of needle, thread and tissue. A rod touches the wire where it is nearest, at most at two
//! places, since an arc may lie around it; a surface at most at four, on which an arc lies flat.
//!
//! Instruments that hold the needle do not touch it otherwise, and open jaws pass on either side of what they are to hold:
//! see [`super::StepInputs::needle_passes`]. Friction is that of the motion in a substep: nothing sticks for ever.

use nalgebra::{Point3, Vector3};

use super::joints::{self, Pair};
use super::needle::{NeedleState, Solid};
use super::needle_thread_contact::{CHORDS, chord_along, radius_at};
use crate::suture_thread::contact::{
    Candidates, Motion, crossing_of_mesh, nearest_on_obstacle, passed_through, tangents,
};
use crate::suture_thread::{Obstacle, Shape};

/// Contact margin beyond the possible motion in a substep \[m\].
const NEAR: f64 = 2e-4;
/// Chords nearer to each other than this along the wire touch one obstacle at one place.
const APART: usize = CHORDS / 4;
/// Least radius of the wire against obstacles \[m\]: a contact of the very tip would be a point without thickness.
const TIP: f64 = 3e-5;
/// An overlap that is deeper than this at the beginning of a substep is worked off at [`WORKED_OFF`] \[m\].
const OVERLAP: f64 = 5e-5;
/// See above \[m/s\].
const WORKED_OFF: f64 = 0.05;
/// Maximum number of contacts.
const TOUCHES_MAX: usize = 32;

/// A place where the wire is near to an obstacle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Touch {
    /// Index of the obstacle.
    pub obstacle: usize,
    chord: usize,
    /// Overlap that is not pushed out in this substep \[m\].
    overlap: f64,
    /// Unit normal from the obstacle to the wire at the beginning of the substep, in the world.
    away: Vector3<f64>,
}

/// The places where obstacles may touch the wire in a substep.
#[derive(Clone, Debug, Default)]
pub(super) struct NeedleTouches {
    /// The contacts.
    pub list: Vec<Touch>,
    /// Chords and features of obstacles that come near to each other.
    candidates: Candidates,
    reach: Vec<f64>,
    lengths: Vec<f64>,
}

/// The ends of the chords.
fn wire(solid: &Solid, needle: &NeedleState) -> [Point3<f64>; CHORDS + 1] {
    let pose = needle.pose();
    std::array::from_fn(|node| pose * solid.point(chord_along(solid, node)[0]))
}

fn chord_of(wire: &[Point3<f64>], chord: usize) -> [Point3<f64>; 2] {
    [wire[chord], wire[chord + 1]]
}

/// Radius of the wire against obstacles, at a share of a chord \[m\].
fn blunt(solid: &Solid, chord: usize, share: f64) -> f64 {
    radius_at(solid, chord, share).max(TIP)
}

/// Most places at which a shape touches the wire.
fn places_max(shape: &Shape<'_>) -> usize {
    match shape {
        Shape::Sphere { .. } => 1,
        Shape::Capsule { .. } => 2,
        Shape::HalfSpace { .. } | Shape::Mesh { .. } => 4,
    }
}

/// Of a chord: its least gap from an obstacle in a substep, and that at its beginning \[m\].
#[derive(Clone, Copy, Debug)]
struct ChordGap {
    least: f64,
    before: f64,
    /// The normal from the obstacle there.
    away: Vector3<f64>,
}

impl NeedleTouches {
    /// Finds them for a substep of `dt` \[s\]. `is_touched` says of an obstacle whether the needle touches it at all.
    pub fn find(
        &mut self,
        solid: &Solid,
        needle: &NeedleState,
        (obstacles, motions): (&[Obstacle<'_>], &[Motion]),
        is_touched: impl Fn(usize) -> bool,
        dt: f64,
    ) {
        self.list.clear();
        let speed = needle.velocity(solid).norm() + needle.spin(solid).norm() * 2.0 * solid.shape().radius;
        let reach = NEAR + 1.5 * dt * speed;
        self.reach.clear();
        self.reach.resize(CHORDS + 1, reach);
        self.lengths.clear();
        self.lengths.resize(CHORDS, solid.shape().length() / CHORDS as f64);
        let wire = wire(solid, needle);
        let line = (&wire[..], &self.reach[..], &self.lengths[..]);
        let around = (obstacles, motions);
        self.candidates.find_on_obstacles(line, solid.shape().wire_radius, around, is_touched);
        let far = ChordGap { least: f64::INFINITY, before: f64::INFINITY, away: Vector3::zeros() };
        for near in self.candidates.found.chunk_by(|one, other| one.key.with == other.key.with) {
            let index = near[0].key.with as usize - 1;
            let (obstacle, motion) = (&obstacles[index], &motions[index]);
            let begins = Motion { to: motion.from, fractions: [motion.fractions[0]; 2], ..*motion };
            let way = farthest_way(obstacle, motion);
            let mut gaps = [far; CHORDS];
            for candidate in near {
                let (chord, feature) = (candidate.key.edge as usize, candidate.key.feature);
                let gap = |motion: &Motion| {
                    let of = chord_of(&wire, chord);
                    let at = nearest_on_obstacle(&obstacle.shape, motion, feature, &of)?;
                    Some((at.distance - blunt(solid, chord, at.along), at.normal))
                };
                let (before, after) = (gap(&begins), gap(motion).map_or(f64::INFINITY, |(gap, _)| gap));
                let known = &mut gaps[chord];
                known.least = known.least.min(after);
                if let Some((before, away)) = before.filter(|(before, _)| *before < known.before) {
                    (known.before, known.away) = (before, away);
                    known.least = known.least.min(before);
                }
            }
            for _ in 0..places_max(&obstacle.shape) {
                let first = (0..CHORDS).min_by(|a, b| gaps[*a].least.total_cmp(&gaps[*b].least));
                let Some(chord) = first.filter(|chord| gaps[*chord].least <= reach + way) else { break };
                if self.list.len() >= TOUCHES_MAX {
                    break;
                }
                let ChordGap { before, away, .. } = gaps[chord];
                // What is inside at the beginning comes out slowly.
                let overlap = if before < -OVERLAP { (-before - WORKED_OFF * dt).max(0.0) } else { 0.0 };
                self.list.push(Touch { obstacle: index, chord, overlap, away });
                let beside = chord.saturating_sub(APART - 1)..(chord + APART).min(CHORDS);
                gaps[beside].fill(far);
            }
        }
    }

    /// The contact at one of these places with needle and obstacle at the iterate, and the point where they touch.
    pub fn contact(
        &self,
        solid: &Solid,
        [start, needle]: [&NeedleState; 2],
        (obstacle, motion): (&Obstacle<'_>, &Motion),
        touch: &Touch,
    ) -> Option<(Pair, Point3<f64>)> {
        let wire = wire(solid, needle);
        // The needle rolls and slides on it within a substep.
        let beside = touch.chord.saturating_sub(1)..=(touch.chord + 1).min(CHORDS - 1);
        let with = touch.obstacle as u32 + 1;
        let own = self.candidates.found.iter().map(|candidate| &candidate.key);
        let own = own.filter(|key| key.with == with && beside.contains(&(key.edge as usize)));
        let places = own.filter_map(|key| {
            let chord = key.edge as usize;
            let (shape, of) = (&obstacle.shape, chord_of(&wire, chord));
            // An iterate may reach through a surface, and comes back to the side of the beginning.
            let at = nearest_on_obstacle(shape, motion, key.feature, &of)
                .or_else(|| crossing_of_mesh(shape, motion, key.feature, &of, &touch.away))?;
            Some((at.distance - blunt(solid, chord, at.along), chord, at))
        });
        let (apart, chord, at) = places.min_by(|a, b| a.0.total_cmp(&b.0))?;
        let [from, to] = chord_of(&wire, chord);
        let tangent = (to - from).try_normalize(0.0).unwrap_or_else(Vector3::x);
        let [t1, t2] = tangents(&at.normal, &tangent);
        let [obstacle_before, touching] = at.surface;
        let before = start.pose() * needle.pose().inverse_transform_point(&touching);
        let slid = obstacle_before - before;
        let gap = [apart + touch.overlap, t1.dot(&slid), t2.dot(&slid)];
        let directions = [at.normal, t1, t2];
        let pair = joints::obstacle(needle, &touching, touch.obstacle, directions, gap, obstacle.friction);
        Some((pair, touching))
    }

    /// Whether the wire passes through an obstacle on the way from one state of the needle to the other.
    pub fn passes(
        &self,
        solid: &Solid,
        [start, needle]: [&NeedleState; 2],
        (obstacles, motions): (&[Obstacle<'_>], &[Motion]),
    ) -> bool {
        if self.candidates.found.is_empty() {
            return false;
        }
        let [before, after] = [start, needle].map(|needle| wire(solid, needle));
        self.candidates.found.iter().any(|candidate| {
            // The thinner end: no contact of the chord is nearer.
            let chord = candidate.key.edge as usize;
            let radius = blunt(solid, chord, 0.0).min(blunt(solid, chord, 1.0));
            passed_through(&candidate.key, &before, &after, radius, obstacles, motions)
        })
    }
}

/// The farthest way of a point of an obstacle in a substep; of a mesh it is a part of where features are sought \[m\].
fn farthest_way(obstacle: &Obstacle<'_>, motion: &Motion) -> f64 {
    let way = |point: &Point3<f64>| (motion.to * point - motion.from * point).norm();
    match &obstacle.shape {
        Shape::Capsule { ends, .. } => ends.iter().map(way).fold(0.0, f64::max),
        _ => way(&Point3::origin()),
    }
}

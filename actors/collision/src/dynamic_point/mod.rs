//! The dynamic point (Maciel and De, *An efficient dynamic point algorithm for line-based collision detection in real
//! time virtual environments involving haptics*, 2008): an instrument's shaft as a line against a triangle surface, at
//! a cost nearly independent of the surface's size.
//!
//! The line is divided into segments. Each has a *dynamic point*: its point nearest to the surface, on a triangle found
//! by walking over the surface's topology as line and surface move. A walk ends in a local minimum, which on a folded
//! organ need not be the nearest point: so each segment also has a *certificate*, the triangles that were near at the
//! last tree query and a lower bound of the distance of all others. The accumulated motion of the segment (of its
//! points near the surface; sliding along itself is free) and of the surface reduces both. A candidate is measured
//! again when it may have come nearer than the dynamic point; when another triangle may have, the tree is queried, with
//! the walked point as the first bound. The result is therefore always the nearest of all triangles, even after jumps,
//! deformation or cuts: the walk and the certificate affect only the cost.

mod contact;
mod statistics;
mod support;

pub use contact::{LineContact, LineContactKind};
pub use statistics::{LineStatistics, Quantiles};

use contact::{Crossings, beside};
use nalgebra::Point3;
use support::Support;
use thiserror::Error;

use crate::candidates::{Candidate, Candidates};
use crate::moving_surface::MovingSurface;
use crate::primitive::{Segment, SegmentTriangle, closest_on_segment, closest_segment_triangle};

/// Most segments of a line.
const SEGMENTS_MAX: usize = 256;
/// Walks end after this many triangles; the certificate does not depend on their end.
const HOPS_MAX: usize = 32;
/// Error of a distance, relative to the largest coordinate.
const ROUNDING: f64 = 1e-13;
/// Most candidates of a segment.
const KEPT: usize = 192;
/// Most candidates waiting for measurement.
const WAITING: usize = 16;
/// Target number of candidates per gathering: fewer expire soon, more cost more in each update.
const WANTED: std::ops::Range<usize> = 30..75;

/// Parameters of line tracking.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LineConfig {
    /// Segments, each with a contact of its own: 1 to 256.
    pub segments: usize,
    /// Radius of the shaft \[m\]; 0 for a line that touches only what it crosses.
    pub radius: f64,
    /// Contacts are reported from this distance on \[m\], with negative depth.
    pub margin: f64,
}

/// Why a line cannot be tracked.
#[derive(Clone, Copy, Debug, Error, PartialEq)]
pub enum LineError {
    /// Too few or too many segments.
    #[error("a line of {0} segments: 1 to {SEGMENTS_MAX} are valid")]
    Segments(usize),
    /// Not a length.
    #[error("{what} of {value} m: 0 or more is valid, and finite")]
    Length {
        /// The parameter.
        what: &'static str,
        /// Its value.
        value: f64,
    },
    /// An end is not finite.
    #[error("end {0} of the line has a coordinate that is not a finite number")]
    NotFinite(usize),
}

/// Tracking state of one segment.
#[derive(Clone, Debug)]
struct TrackedSegment {
    placed: Segment,
    /// The triangle of the dynamic point.
    triangle: Option<u32>,
    candidates: Candidates<Support, KEPT>,
    /// Distance beyond the contact within which candidates are gathered \[m\].
    ahead: f64,
}

/// The method; one for each pair of a line and a surface.
#[derive(Clone, Debug)]
pub struct DynamicPoint {
    config: LineConfig,
    watched: Vec<TrackedSegment>,
    contacts: Vec<Option<LineContact>>,
    found: Vec<Candidate<Support>>,
    /// Topology revision, and motion of the surface up to the last update.
    seen: Option<(u64, f64)>,
    statistics: LineStatistics,
}

fn distance_squared(point: &Point3<f64>, segment: &Segment) -> f64 {
    let along = closest_on_segment(point, segment);
    (segment[0] + (segment[1] - segment[0]) * along - point).norm_squared()
}

/// The part of a segment that may be as near as `horizon` \[m\] to a surface: a long shaft that turns about its tip, or
/// its port, moves most far from the surface. Conservative; `None` if there is no such part.
fn part_within(segment: &Segment, mesh: &MovingSurface, horizon: f64) -> Option<Segment> {
    let bounds = mesh.tree().bounds()?;
    let way = segment[1] - segment[0];
    let (mut from, mut until) = (0.0_f64, 1.0_f64);
    for axis in 0..3 {
        let (low, high) = (bounds.min[axis] - horizon, bounds.max[axis] + horizon);
        let (start, along) = (segment[0][axis], way[axis]);
        // Covers rounding and undefined slopes.
        let spare = ROUNDING * (start.abs() + along.abs() + low.abs() + high.abs());
        if along.abs() <= spare {
            if start < low - spare || start > high + spare {
                return None;
            }
            continue;
        }
        let (one, other) = ((low - start) / along, (high - start) / along);
        let spare = spare / along.abs();
        from = from.max(one.min(other) - spare);
        until = until.min(one.max(other) + spare);
    }
    (from <= until).then(|| [segment[0] + way * from, segment[0] + way * until])
}

/// The nearest triangle of one segment so far.
#[derive(Clone, Copy)]
struct NearestTriangle {
    triangle: Option<u32>,
    nearest: SegmentTriangle,
    distance: f64,
}

impl DynamicPoint {
    /// A detector without tracked state.
    ///
    /// # Errors
    /// For an invalid number of segments or length.
    pub fn new(config: LineConfig) -> Result<Self, LineError> {
        if !(1..=SEGMENTS_MAX).contains(&config.segments) {
            return Err(LineError::Segments(config.segments));
        }
        for (what, value) in [("a radius", config.radius), ("a margin", config.margin)] {
            if !(value >= 0.0 && value.is_finite()) {
                return Err(LineError::Length { what, value });
            }
        }
        let nothing = TrackedSegment {
            placed: [Point3::origin(); 2],
            triangle: None,
            candidates: Candidates::none(),
            ahead: 0.0,
        };
        Ok(Self {
            config,
            watched: vec![nothing; config.segments],
            contacts: vec![None; config.segments],
            found: Vec::with_capacity(4 * KEPT),
            seen: None,
            statistics: LineStatistics::default(),
        })
    }

    /// Its parameters.
    #[must_use]
    pub fn config(&self) -> &LineConfig {
        &self.config
    }

    /// Its cost so far.
    #[must_use]
    pub fn statistics(&self) -> &LineStatistics {
        &self.statistics
    }

    /// Records the time of an update, its share of the refit included \[µs\].
    pub fn record_micros(&mut self, micros: f64) {
        self.statistics.micros.record(micros);
    }

    /// Resets all tracking state, as for a new surface.
    pub fn reset(&mut self) {
        self.seen = None;
    }

    /// The contact of each segment of `line_in_surface` with the current surface: the nearest one within radius plus
    /// margin.
    ///
    /// # Errors
    /// For a non-finite end; the contacts stay unchanged.
    pub fn update(
        &mut self,
        mesh: &MovingSurface,
        line_in_surface: &Segment,
    ) -> Result<&[Option<LineContact>], LineError> {
        for (which, end) in line_in_surface.iter().enumerate() {
            if !end.iter().all(|coordinate| coordinate.is_finite()) {
                return Err(LineError::NotFinite(which));
            }
        }
        let begins = self.seen.is_none_or(|(revision, _)| revision != mesh.topology_revision());
        let motion = if begins { 0.0 } else { mesh.motion() - self.seen.map_or(0.0, |seen| seen.1) };
        self.seen = Some((mesh.topology_revision(), mesh.motion()));
        let work = |statistics: &LineStatistics| statistics.nodes + statistics.triangle_tests;
        let work_before = work(&self.statistics);
        let extent =
            mesh.tree().bounds().map_or(0.0, |bounds| bounds.min.coords.amax().max(bounds.max.coords.amax()));
        let count = self.watched.len();
        for index in 0..count {
            let at = |share: f64| line_in_surface[0] + (line_in_surface[1] - line_in_surface[0]) * share;
            let segment = [at(index as f64 / count as f64), at((index + 1) as f64 / count as f64)];
            let scale = extent.max(segment[0].coords.amax()).max(segment[1].coords.amax());
            if begins {
                let watched = &mut self.watched[index];
                watched.candidates.forget();
                watched.triangle = None;
                if watched.ahead <= 0.0 {
                    watched.ahead = 0.02 * extent;
                }
            } else {
                let watched = &self.watched[index];
                let moved = match part_within(&segment, mesh, watched.candidates.horizon()) {
                    // The distance from a convex set is greatest at an end.
                    Some(part) => part.map(|end| distance_squared(&end, &watched.placed)),
                    None => [0.0; 2],
                };
                let moved = moved[0].max(moved[1]).sqrt();
                self.watched[index].candidates.travel(moved + motion + ROUNDING * scale);
            }
            self.watched[index].placed = segment;
            let best = self.nearest(mesh, index, &segment, scale, begins);
            self.contacts[index] = self.contact(mesh, index, &segment, &best, scale);
        }
        self.statistics.updates += 1;
        self.statistics.segment_updates += count as u64;
        let spent = work(&self.statistics) - work_before;
        self.statistics.work.record(spent as f64);
        Ok(&self.contacts)
    }

    /// The contacts of the last update, one for each segment.
    #[must_use]
    pub fn contacts(&self) -> &[Option<LineContact>] {
        &self.contacts
    }

    /// The contacts of the last update without those at a joint of two segments whose neighbour is as deep or deeper,
    /// so that a contact sliding over a joint stays one contact.
    pub fn distinct_contacts(&self) -> impl Iterator<Item = &LineContact> {
        let count = self.contacts.len() as f64;
        self.contacts.iter().enumerate().filter_map(move |(index, contact)| {
            let contact = contact.as_ref()?;
            if contact.kind == LineContactKind::Crossing {
                return Some(contact);
            }
            let share = contact.along * count - index as f64;
            let neighbour = match index {
                _ if share >= 1.0 - 1e-9 => self.contacts.get(index + 1).map(|next| (next, true)),
                1.. if share <= 1e-9 => self.contacts.get(index - 1).map(|before| (before, false)),
                _ => None,
            };
            // Of two with the same point the later one is reported.
            let shadowed = neighbour.is_some_and(|(other, is_later)| {
                other.is_some_and(|other| {
                    other.distance < contact.distance || (is_later && other.distance <= contact.distance)
                })
            });
            (!shadowed).then_some(contact)
        })
    }

    /// The nearest triangle, if it may be in contact; else possibly `None`.
    fn nearest(
        &mut self,
        mesh: &MovingSurface,
        index: usize,
        segment: &Segment,
        scale: f64,
        begins: bool,
    ) -> NearestTriangle {
        let reach = self.config.radius + self.config.margin + ROUNDING * scale;
        let none = SegmentTriangle {
            on_segment: segment[0],
            on_triangle: segment[0],
            along: 0.0,
            weights: [1.0, 0.0, 0.0],
            distance_squared: f64::INFINITY,
        };
        let mut best = NearestTriangle { triangle: None, nearest: none, distance: f64::INFINITY };
        let candidates = &self.watched[index].candidates;
        if candidates.len() == 0 && candidates.certify(reach) {
            return best;
        }
        if let Some(triangle) = self.watched[index].triangle {
            self.offer(mesh, index, segment, triangle, &mut best);
            if !self.watched[index].candidates.certify(best.distance.min(reach)) {
                self.walk(mesh, index, segment, &mut best);
            }
        }
        if self.watched[index].candidates.certify(best.distance.min(reach)) {
            self.measure(mesh, index, segment, (reach, ROUNDING * scale), &mut best);
        } else {
            if begins {
                self.statistics.started += 1;
            } else {
                self.statistics.expired += 1;
            }
            self.ask_tree(mesh, index, segment, (reach, ROUNDING * scale), &mut best);
        }
        self.watched[index].triangle = best.triangle;
        best
    }

    /// Measures a triangle, and returns whether it is nearer.
    fn offer(
        &mut self,
        mesh: &MovingSurface,
        index: usize,
        segment: &Segment,
        triangle: u32,
        best: &mut NearestTriangle,
    ) -> bool {
        let corners = mesh.surface().triangle(triangle);
        let nearest = closest_segment_triangle(segment, &corners);
        let distance = nearest.distance_squared.sqrt();
        self.statistics.triangle_tests += 1;
        let candidates = &mut self.watched[index].candidates;
        if let Some(slot) = candidates.place(triangle) {
            candidates.set(slot, distance);
            candidates.set_note(slot, Support::new(&nearest, &corners, mesh.motion()));
        }
        let is_nearer = distance < best.distance;
        if is_nearer {
            *best = NearestTriangle { triangle: Some(triangle), nearest, distance };
        }
        is_nearer
    }

    /// Walks from triangle to neighbour while that is nearer: over the edge or around the vertex of the nearest point.
    fn walk(&mut self, mesh: &MovingSurface, index: usize, segment: &Segment, best: &mut NearestTriangle) {
        for _ in 0..HOPS_MAX {
            let Some(from) = best.triangle else { return };
            let corners = &mesh.surface().triangles()[from as usize];
            let mut is_nearer = false;
            for &neighbour in mesh.topology().sharing(corners, from, &best.nearest.weights) {
                let candidates = &self.watched[index].candidates;
                let known = candidates.place(neighbour);
                let hopeless = known.is_some_and(|slot| !candidates.may_reach(slot, best.distance));
                if neighbour != from && !hopeless {
                    is_nearer |= self.offer(mesh, index, segment, neighbour, best);
                }
            }
            if !is_nearer {
                return;
            }
            self.statistics.hops += 1;
        }
    }

    /// Measures the candidates that may have come nearer than the dynamic point, and into reach.
    fn measure(
        &mut self,
        mesh: &MovingSurface,
        index: usize,
        segment: &Segment,
        (reach, rounding): (f64, f64),
        best: &mut NearestTriangle,
    ) {
        let candidates = &mut self.watched[index].candidates;
        let mut from = 0;
        // Candidates to measure, by their lower bound: the nearest first, which avoids most of the others.
        let mut waiting = [(f64::INFINITY, 0_usize); WAITING];
        let mut count = 0;
        loop {
            let next = candidates.next_within(from, best.distance.min(reach));
            if let Some(slot) = next {
                from = slot + 1;
                let triangle = candidates.triangle(slot);
                if Some(triangle) == best.triangle {
                    continue;
                }
                if candidates.note(slot).is_empty() {
                    let corners = mesh.surface().triangle(triangle);
                    candidates.set_note(slot, Support::guess(segment, &corners, mesh.motion()));
                }
                let at_least = candidates.note(slot).at_least(segment, mesh.motion()) - rounding;
                candidates.set(slot, at_least);
                if at_least > best.distance.min(reach) {
                    continue;
                }
                waiting[count] = (at_least, slot);
                count += 1;
                if count < WAITING {
                    continue;
                }
            }
            while count > 0 {
                let mut least = 0;
                for other in 1..count {
                    if waiting[other].0 < waiting[least].0 {
                        least = other;
                    }
                }
                let (at_least, slot) = waiting[least];
                count -= 1;
                waiting[least] = waiting[count];
                if at_least > best.distance.min(reach) {
                    count = 0;
                    break;
                }
                // Only here, because loading a triangle and its corners is slow.
                let triangle = candidates.triangle(slot);
                let corners = mesh.surface().triangle(triangle);
                let nearest = closest_segment_triangle(segment, &corners);
                let distance = nearest.distance_squared.sqrt();
                self.statistics.triangle_tests += 1;
                candidates.set(slot, distance);
                candidates.set_note(slot, Support::new(&nearest, &corners, mesh.motion()));
                if distance < best.distance {
                    *best = NearestTriangle { triangle: Some(triangle), nearest, distance };
                }
            }
            if next.is_none() {
                return;
            }
        }
    }

    /// Queries the tree for the nearest triangle, and gathers new candidates.
    fn ask_tree(
        &mut self,
        mesh: &MovingSurface,
        index: usize,
        segment: &Segment,
        (reach, rounding): (f64, f64),
        best: &mut NearestTriangle,
    ) {
        let watched = &mut self.watched[index];
        let surface = mesh.surface();
        // If a contact may come soon, the surroundings are gathered; else the distance of the nearest is enough.
        let ahead = watched.ahead;
        let limit =
            |distance: f64| if distance < reach + ahead { distance.min(reach) + ahead } else { distance };
        self.found.clear();
        let mut tests = 0;
        let cost = mesh.tree().nearest_to_segment_first(segment, limit(best.distance), |triangle, lower| {
            let mut found = Candidate { triangle, at_least: f64::from(lower), note: Support::default() };
            if found.at_least <= best.distance && best.triangle.is_some() {
                found.note = Support::guess(segment, &surface.triangle(triangle), mesh.motion());
                let at_least = found.note.at_least(segment, mesh.motion()) - rounding;
                found.at_least = found.at_least.max(at_least);
            }
            if found.at_least <= best.distance {
                let corners = surface.triangle(triangle);
                let nearest = closest_segment_triangle(segment, &corners);
                found.at_least = nearest.distance_squared.sqrt();
                found.note = Support::new(&nearest, &corners, mesh.motion());
                tests += 1;
                if found.at_least < best.distance {
                    *best = NearestTriangle { triangle: Some(triangle), nearest, distance: found.at_least };
                }
            }
            self.found.push(found);
            limit(best.distance)
        });
        let is_near = best.distance < reach + ahead;
        let count = watched.candidates.gather(&mut self.found, limit(best.distance));
        if is_near && count >= WANTED.end {
            watched.ahead *= 0.75;
        } else if is_near && count < WANTED.start {
            watched.ahead *= 1.25;
        }
        self.statistics.nodes += u64::from(cost.nodes);
        self.statistics.triangle_tests += tests;
    }

    fn contact(
        &mut self,
        mesh: &MovingSurface,
        index: usize,
        segment: &Segment,
        best: &NearestTriangle,
        scale: f64,
    ) -> Option<LineContact> {
        let triangle = best.triangle?;
        if best.distance > self.config.radius + self.config.margin {
            return None;
        }
        let mut found = None;
        if best.nearest.distance_squared == 0.0 {
            let candidates = &mut self.watched[index].candidates;
            let mut crossings = Crossings::none();
            let mut from = 0;
            while let Some(slot) = candidates.next_within(from, 0.0) {
                from = slot + 1;
                let other = candidates.triangle(slot);
                let nearest = closest_segment_triangle(segment, &mesh.surface().triangle(other));
                if nearest.distance_squared == 0.0 {
                    crossings.push(other, nearest.along);
                }
            }
            found = crossings.shallowest(mesh, segment, self.config.radius);
        }
        let found = found.unwrap_or_else(|| beside(mesh, triangle, &best.nearest, self.config.radius, scale));
        Some(LineContact {
            segment: index as u32,
            triangle: found.triangle,
            kind: found.kind,
            on_line: found.nearest.on_segment,
            along: (index as f64 + found.nearest.along) / self.watched.len() as f64,
            on_surface: found.nearest.on_triangle,
            weights: found.nearest.weights,
            distance: best.distance,
            depth: found.depth,
            direction: found.direction,
            surface_velocity: mesh.velocity(found.triangle, &found.nearest.weights),
        })
    }
}

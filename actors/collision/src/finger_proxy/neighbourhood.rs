//! Neighbourhood of a proxy: nearby triangles, kept between steps as long as their certificate holds.

use nalgebra::{Point3, Vector3};

use super::{ProxyStatistics, TouchedTriangle};
use crate::candidates::{Candidate, Candidates};
use crate::moving_surface::MovingSurface;
use crate::primitive::sweep_sphere_triangle;

/// Most triangles kept: one bit each.
const KEPT: usize = 64;
/// Target number of triangles per gathering.
const WANTED: std::ops::Range<usize> = 24..56;

/// Triangles near the proxy.
#[derive(Clone, Debug)]
pub(super) struct Neighbourhood {
    candidates: Candidates<(), KEPT>,
    found: Vec<(u32, f32)>,
    bounds: Vec<Candidate<()>>,
    /// Radius of the gathering \[m\].
    ahead: f64,
    /// Distance, normal and slot of each triangle at the last query.
    looked: [VertexVisit; KEPT],
    count: usize,
}

/// Result of a sweep: the share reached, and the blocking triangle.
struct SweepHit {
    share: f64,
    by: Option<u32>,
}

#[derive(Clone, Copy, Debug)]
struct VertexVisit {
    slot: u32,
    distance: f64,
    normal: Vector3<f64>,
}

impl Neighbourhood {
    pub(super) fn new(hold: f64) -> Self {
        Self {
            candidates: Candidates::none(),
            found: Vec::with_capacity(8 * KEPT),
            bounds: Vec::with_capacity(8 * KEPT),
            ahead: 2.0 * hold,
            looked: [VertexVisit { slot: 0, distance: 0.0, normal: Vector3::zeros() }; KEPT],
            count: 0,
        }
    }

    pub(super) fn forget(&mut self) {
        self.candidates.forget();
    }

    pub(super) fn travel(&mut self, distance: f64) {
        self.candidates.travel(distance);
    }

    /// Makes sure that every triangle within `reach` \[m\] of `place` is among the candidates; `false` if there are too
    /// many to keep.
    pub(super) fn cover(
        &mut self,
        mesh: &MovingSurface,
        place: &Point3<f64>,
        reach: f64,
        statistics: &mut ProxyStatistics,
    ) -> bool {
        if self.candidates.certify(reach) {
            return true;
        }
        statistics.gathered += 1;
        self.found.clear();
        let limit = reach + self.ahead;
        mesh.tree().around_point(place, limit, &mut self.found);
        self.bounds.clear();
        let bound =
            |&(triangle, lower): &(u32, f32)| Candidate { triangle, at_least: lower.into(), note: () };
        self.bounds.extend(self.found.iter().map(bound));
        let count = self.candidates.gather(&mut self.bounds, limit);
        if count >= WANTED.end {
            self.ahead *= 0.75;
        } else if count < WANTED.start {
            self.ahead = (self.ahead * 1.25).min(1e3 * reach);
        }
        self.candidates.certify(reach)
    }

    /// Visits every triangle that may be within `reach` \[m\] of `place`.
    pub(super) fn look(
        &mut self,
        mesh: &MovingSurface,
        place: &Point3<f64>,
        reach: f64,
        statistics: &mut ProxyStatistics,
        mut show: impl FnMut(&TouchedTriangle),
    ) {
        self.cover(mesh, place, reach, statistics);
        self.count = 0;
        for slot in 0..self.candidates.len() {
            if !self.candidates.may_reach(slot, reach) {
                continue;
            }
            let Some(touched) = TouchedTriangle::of(mesh, self.candidates.triangle(slot), place) else {
                continue;
            };
            self.candidates.set(slot, touched.distance);
            self.looked[self.count] =
                VertexVisit { slot: slot as u32, distance: touched.distance, normal: touched.normal };
            self.count += 1;
            show(&touched);
        }
    }

    /// The share of a motion from the last query position that keeps `guard` \[m\] from every triangle, and the
    /// blocking triangle.
    pub(super) fn sweep(
        &mut self,
        mesh: &MovingSurface,
        place: &Point3<f64>,
        motion: &Vector3<f64>,
        guard: f64,
        statistics: &mut ProxyStatistics,
    ) -> (f64, Option<u32>) {
        let length = motion.norm();
        let mut met = SweepHit { share: 1.0, by: None };
        let surface = mesh.surface();
        let meet = |met: &mut SweepHit, triangle: u32| {
            let share = sweep_sphere_triangle(place, guard, motion, &surface.triangle(triangle));
            if share < met.share {
                *met = SweepHit { share, by: Some(triangle) };
            }
        };
        // On this share of the path only candidates can be hit.
        let known = ((self.candidates.others_at_least() - guard) / length).clamp(0.0, 1.0);
        let mut seen = 0_u64;
        for looked in &self.looked[..self.count] {
            seen |= 1 << looked.slot;
            // Usually the plane between it and the proxy allows the whole path.
            if looked.distance + met.share * looked.normal.dot(motion).min(0.0) < guard {
                meet(&mut met, self.candidates.triangle(looked.slot as usize));
            }
        }
        for slot in (0..self.candidates.len()).filter(|slot| seen & (1 << slot) == 0) {
            if self.candidates.may_reach(slot, guard + length * met.share.min(known)) {
                meet(&mut met, self.candidates.triangle(slot));
            }
        }
        if met.share > known {
            statistics.long_sweeps += 1;
            let looked_at = met.share;
            mesh.tree().along_way_first(&[*place, place + motion * looked_at], guard, |triangle| {
                meet(&mut met, triangle);
                met.share / looked_at
            });
        }
        (met.share, met.by)
    }

    /// The candidates, after [`cover`](Self::cover).
    pub(super) fn triangles(&self) -> impl Iterator<Item = u32> {
        (0..self.candidates.len()).map(|slot| self.candidates.triangle(slot))
    }
}

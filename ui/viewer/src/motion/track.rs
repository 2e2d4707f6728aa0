//! One thing that moves: when it was where, and where it is shown.

use std::collections::VecDeque;
use std::sync::Arc;

use nalgebra::Point3;
use trocar_scene::{JawState, Particles, Pose, VertexPositions};

/// Time between two changes of which nothing is known yet \[s\].
const INTERVAL_SECS: f64 = 1.0 / 15.0;
/// What has not changed for so long has been at rest \[s\].
const REST_SECS: f64 = 0.5;
/// Intervals that are measured.
const INTERVALS: usize = 8;
/// Places that are known.
const PLACES_MAX: usize = 8;
/// What is slower than so many frames is blended, until it is faster than so many.
const SLOW_FROM: f64 = 1.15;
const SLOW_UNTIL: f64 = 1.05;
/// What goes faster than this has been put elsewhere \[m/s\], if it goes at least as far \[m\].
const LEAP_SPEED: f64 = 3.0;
const LEAP_MIN: f64 = 0.02;
/// A larger turn could have gone either way \[rad\].
const LEAP_ANGLE: f64 = 2.5;
/// How much of what an arrival is early or late by is believed.
const GAIN: f64 = 0.2;

/// What can be between two values.
pub(super) trait Blend: Clone + PartialEq {
    /// The value at a share of the way from `self` to `to`.
    fn blend(&self, to: &Self, share: f64) -> Self;
    /// Whether nothing moves from one to the other within so long \[s\]: it is another place.
    fn leaps(&self, to: &Self, secs: f64) -> bool;
    /// Whether both are the same, as far as that is cheap to tell.
    fn is_same(&self, other: &Self) -> bool {
        self == other
    }
}

fn is_leap(distance: f64, secs: f64) -> bool {
    distance > (LEAP_SPEED * secs).max(LEAP_MIN)
}

impl Blend for Pose {
    fn blend(&self, to: &Self, share: f64) -> Self {
        let translation = self.translation.lerp(&to.translation, share);
        Self::new(translation, self.rotation.slerp(&to.rotation, share))
    }
    fn leaps(&self, to: &Self, secs: f64) -> bool {
        is_leap((to.translation - self.translation).norm(), secs)
            || self.rotation.angle_to(&to.rotation) > LEAP_ANGLE
    }
}

impl Blend for JawState {
    fn blend(&self, to: &Self, share: f64) -> Self {
        Self { angle: self.angle + (to.angle - self.angle) * share, ..*to }
    }
    fn leaps(&self, _: &Self, _: f64) -> bool {
        false
    }
}

impl Blend for VertexPositions {
    fn blend(&self, to: &Self, share: f64) -> Self {
        let between = |(from, to): (&Point3<f64>, &Point3<f64>)| from + (to - from) * share;
        Self { positions: Arc::new(self.positions.iter().zip(to.positions.iter()).map(between).collect()) }
    }
    fn leaps(&self, to: &Self, secs: f64) -> bool {
        let distances = self.positions.iter().zip(to.positions.iter()).map(|(from, to)| (to - from).norm());
        self.positions.len() != to.positions.len() || is_leap(distances.fold(0.0, f64::max), secs)
    }
    fn is_same(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.positions, &other.positions)
    }
}

/// Particles are told apart by their numbers: one that has just come is where it is, one that is gone is shown no more.
impl Blend for Particles {
    fn blend(&self, to: &Self, share: f64) -> Self {
        let before = |index: usize| self.index_of(to.first.checked_add(index as u64)?);
        let mix = |from: f64, to: f64| from + (to - from) * share;
        let positions = to.positions.iter().enumerate().map(|(index, to)| match before(index) {
            Some(from) => self.positions[from] + (to - self.positions[from]) * share,
            None => *to,
        });
        let values = |of: fn(&Self) -> &Arc<Vec<f64>>| {
            let (old, new) = (of(self), of(to));
            let blended = new.iter().enumerate().map(|(index, to)| {
                let from = before(index).and_then(|from| old.get(from));
                from.map_or(*to, |from| mix(*from, *to))
            });
            Arc::new(blended.collect())
        };
        Self {
            positions: Arc::new(positions.collect()),
            densities: values(|of| &of.densities),
            ages: values(|of| &of.ages),
            ..to.clone()
        }
    }
    fn leaps(&self, to: &Self, secs: f64) -> bool {
        let farthest = (to.first..).zip(to.positions.iter()).filter_map(|(number, to)| {
            let from = self.positions[self.index_of(number)?];
            Some((to - from).norm())
        });
        self.kind != to.kind || is_leap(farthest.fold(0.0, f64::max), secs)
    }
    fn is_same(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.positions, &other.positions)
            && Arc::ptr_eq(&self.densities, &other.densities)
            && Arc::ptr_eq(&self.ages, &other.ages)
            && self.first == other.first
    }
}

/// Where something has been.
pub(super) struct Track<T> {
    /// When it was where: times as regular as its writer is, not as snapshots came \[s\].
    places: VecDeque<(f64, T)>,
    arrived: Option<f64>,
    intervals: VecDeque<f64>,
    /// How late arrivals have been of late \[s\].
    late: f64,
    /// What is shown is where it was then \[s\].
    playhead: f64,
    slow: bool,
    blended: bool,
}

impl<T: Blend> Track<T> {
    /// Of something that has been at rest there.
    pub(super) fn new(rest: T) -> Self {
        Self {
            places: VecDeque::from([(f64::NEG_INFINITY, rest)]),
            arrived: None,
            intervals: VecDeque::new(),
            late: 0.0,
            playhead: f64::NEG_INFINITY,
            slow: true,
            blended: false,
        }
    }

    /// Takes a value that came at `now` \[s\].
    pub(super) fn push(&mut self, value: T, now: f64) {
        let passed = now - self.arrived.unwrap_or(f64::NEG_INFINITY);
        let interval = self.interval();
        let Some((last, before)) = self.places.back_mut() else { return };
        if passed <= 0.0 {
            // Two changes at once: only the later one can be seen.
            *before = value;
            return;
        }
        self.arrived = Some(now);
        let moves = passed < REST_SECS;
        let (last, leaps) = (*last, before.leaps(&value, passed.min(interval)));
        if moves {
            self.intervals.push_back(passed);
            if self.intervals.len() > INTERVALS {
                self.intervals.pop_front();
            }
        }
        let interval = self.interval();
        let time = if moves && last.is_finite() {
            let due = last + interval;
            let off = now - due;
            let time = if off.abs() < 0.6 * interval { due + GAIN * off } else { now };
            time.max(last + 0.25 * interval)
        } else {
            now
        };
        self.late = (0.9 * self.late).max(now - time).min(0.5 * interval);
        if leaps {
            self.places.clear();
            self.playhead = time;
        } else if !moves {
            // It rested until one step ago.
            if let Some((_, rest)) = self.places.pop_back() {
                self.places.clear();
                self.places.push_back((time - interval, rest));
            }
            self.playhead = time - interval;
        }
        self.places.push_back((time, value));
        while self.places.len() > PLACES_MAX {
            self.places.pop_front();
        }
    }

    /// What is shown at `now` in the place of the last value \[s\]; `None` when that is shown itself.
    pub(super) fn at(&mut self, now: f64, frame_secs: f64) -> Option<T> {
        let threshold = if self.slow { SLOW_UNTIL } else { SLOW_FROM };
        self.slow = self.interval() > threshold * frame_secs;
        let last = self.places.back()?.0;
        if self.slow {
            // Never back, also when the delay has grown.
            self.playhead = self.playhead.max(now - self.delay_secs()).min(last);
        } else {
            self.playhead = last;
        }
        if let [(_, from), (_, to)] = self.places.make_contiguous()
            && from.is_same(to)
        {
            // Written again, but not moved.
            self.playhead = last;
        }
        if self.playhead >= last {
            // Whoever follows has to be told once that the way has ended.
            self.places.drain(..self.places.len() - 1);
            let told = std::mem::take(&mut self.blended);
            return self.places.back().filter(|_| told).map(|(_, latest)| latest.clone());
        }
        while self.places.len() > 2 && self.places[1].0 <= self.playhead {
            self.places.pop_front();
        }
        let ((start, from), (end, to)) = (&self.places[0], &self.places[1]);
        self.blended = true;
        let share = ((self.playhead - start) / (end - start)).clamp(0.0, 1.0);
        Some(from.blend(to, share))
    }

    /// How long what is shown lags behind \[s\].
    pub(super) fn delay_secs(&self) -> f64 {
        if self.slow { self.interval() + self.late } else { 0.0 }
    }

    /// Whether it has not changed for so long.
    pub(super) fn has_rested(&self, now: f64, secs: f64) -> bool {
        !self.blended && self.arrived.is_none_or(|arrived| now - arrived > secs)
    }

    /// Between two changes: the mean of what was measured, without the longest and the shortest one \[s\].
    fn interval(&self) -> f64 {
        let count = self.intervals.len();
        let sum: f64 = self.intervals.iter().sum();
        match count {
            0 => INTERVAL_SECS,
            1..=3 => sum / count as f64,
            _ => {
                let longest = self.intervals.iter().copied().fold(0.0, f64::max);
                let shortest = self.intervals.iter().copied().fold(f64::MAX, f64::min);
                (sum - longest - shortest) / (count - 2) as f64
            }
        }
    }
}

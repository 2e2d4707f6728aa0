//! The track of one moving value: its past values with their times, and the playback position.

use std::collections::VecDeque;
use std::sync::Arc;

use nalgebra::Point3;
use trocar_scene::{JawState, Particles, Pose, VertexPositions};

/// Assumed interval between two changes until it is measured \[s\].
const INTERVAL_SECS: f64 = 1.0 / 15.0;
/// A value counts as at rest after so long without a change \[s\].
const REST_SECS: f64 = 0.5;
/// Number of intervals that are averaged.
const INTERVALS: usize = 8;
/// Number of past values that are kept.
const PLACES_MAX: usize = 8;
/// A value with an interval of more than so many frames is interpolated, until it is below the second limit.
const SLOW_FROM: f64 = 1.15;
const SLOW_UNTIL: f64 = 1.05;
/// A faster motion counts as a teleport \[m/s\], if it is at least as long \[m\].
const LEAP_SPEED: f64 = 3.0;
const LEAP_MIN: f64 = 0.02;
/// The direction of a larger rotation is ambiguous \[rad\].
const LEAP_ANGLE: f64 = 2.5;
/// Gain of the filter that estimates arrival times.
const GAIN: f64 = 0.2;

/// A value that can be interpolated.
pub(super) trait Blend: Clone + PartialEq {
    /// The interpolated value at a share between `self` and `to`.
    fn blend(&self, to: &Self, share: f64) -> Self;
    /// Whether a change within that time is a teleport instead of a motion \[s\].
    fn leaps(&self, to: &Self, secs: f64) -> bool;
    /// Whether both are equal, as far as that is cheap to check.
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

/// Particles are matched by their numbers: a new one is shown at its position, a removed one is not shown.
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

/// The past values of one component.
pub(super) struct Track<T> {
    /// Values with their times \[s\]: smoothed to the writer's regular interval, not the arrival times.
    places: VecDeque<(f64, T)>,
    arrived: Option<f64>,
    intervals: VecDeque<f64>,
    /// Recent lateness of arrivals \[s\].
    late: f64,
    /// The time of the displayed value \[s\].
    playhead: f64,
    slow: bool,
    blended: bool,
}

impl<T: Blend> Track<T> {
    /// A track that starts at rest.
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

    /// Takes a value that arrived at `now` \[s\].
    pub(super) fn push(&mut self, value: T, now: f64) {
        let passed = now - self.arrived.unwrap_or(f64::NEG_INFINITY);
        let interval = self.interval();
        let Some((last, before)) = self.places.back_mut() else { return };
        if passed <= 0.0 {
            // Two changes at once: only the later one is visible.
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
            // It was at rest until one interval ago.
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

    /// The interpolated value at `now` \[s\]; `None` when the latest value is shown.
    pub(super) fn at(&mut self, now: f64, frame_secs: f64) -> Option<T> {
        let threshold = if self.slow { SLOW_UNTIL } else { SLOW_FROM };
        self.slow = self.interval() > threshold * frame_secs;
        let last = self.places.back()?.0;
        if self.slow {
            // Never backwards, even when the delay has grown.
            self.playhead = self.playhead.max(now - self.delay_secs()).min(last);
        } else {
            self.playhead = last;
        }
        if let [(_, from), (_, to)] = self.places.make_contiguous()
            && from.is_same(to)
        {
            // Written again, but unchanged.
            self.playhead = last;
        }
        if self.playhead >= last {
            // The end of the motion is returned once more, so that the caller sees the final value.
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

    /// Delay of the displayed value \[s\].
    pub(super) fn delay_secs(&self) -> f64 {
        if self.slow { self.interval() + self.late } else { 0.0 }
    }

    /// Whether it has not changed for so long.
    pub(super) fn has_rested(&self, now: f64, secs: f64) -> bool {
        !self.blended && self.arrived.is_none_or(|arrived| now - arrived > secs)
    }

    /// The interval between two changes: the mean of the measured ones, without the longest and the shortest \[s\].
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

//! Frame pacing: chooses the quality and resolution that keep the frame rate, and the rest between frames, so that
//! drawing never takes processor time from the haptic threads.
//!
//! It reads no clock: a [`Pacer`] is given frame times and returns how to draw the next frame.

use crate::quality::Quality;

/// Quality and resolution of a frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pace {
    /// Its quality.
    pub quality: Quality,
    /// Rendered resolution, as a share of the displayed one, per axis.
    pub scale: f64,
}

const fn pace(quality: Quality, scale: f64) -> Pace {
    Pace { quality, scale }
}

/// The steps from the best to the cheapest, each clearly cheaper than the one before.
pub const LADDER: [Pace; 8] = [
    pace(Quality::FINE, 1.0),
    pace(Quality::FULL, 1.0),
    pace(Quality::FULL, 0.84),
    pace(Quality::FULL, 0.7),
    pace(Quality::PLAIN, 1.0),
    pace(Quality::PLAIN, 0.84),
    pace(Quality::PLAIN, 0.7),
    pace(Quality::PLAIN, 0.5),
];

/// Frames over which the median is taken: a single frame may include a pipeline compilation, or another process.
const WINDOW: usize = 5;
/// A step that takes more than this share of the period is too slow.
const TOO_SLOW: f64 = 1.1;
/// A better step is tried when its expected time is at most this share of the period.
const ROOM: f64 = 0.9;
/// Assumed cost factor of more quality at the same resolution, until it is measured: for multisampling, and otherwise.
const GUESS_FINE: f64 = 3.0;
const GUESS: f64 = 1.5;
/// Frames in time before a better step is tried; doubled after a failed attempt, halved after a successful one.
const PATIENCE: u32 = 60;
/// Most frames to wait.
const PATIENCE_MAX: u32 = 60 * 64;
/// Two frames in a row that take more than so many times the budget are no accident: the step is left at once.
const FAR_TOO_SLOW: f64 = 4.0;
/// Frames at a tried step after which the attempt counts as successful.
const PROVEN: u32 = 240;

/// Chooses a step of the [`LADDER`]. It goes down as soon as frames are late, and up only when there is room, more
/// reluctantly after failed attempts, so that it does not oscillate between two steps.
#[derive(Clone, Debug)]
pub struct Pacer {
    period: f64,
    load_max: f64,
    step: usize,
    best: usize,
    /// The last frames at this step \[s\].
    times: [f64; WINDOW],
    count: usize,
    /// The last measured frame time of each step \[s\].
    known: [Option<f64>; LADDER.len()],
    in_time: u32,
    patience: u32,
    /// Frames since a better step was tried, until it has proven right.
    trying: Option<u32>,
    /// The last frame was far too slow.
    far_too_slow: bool,
}

impl Pacer {
    /// A pacer for so many frames a second. `load_max` is the share of time that drawing may take, in (0, 1]: 1 with a
    /// graphics card; less with a software rasteriser, since haptics needs the processor. Values outside are clamped.
    pub fn new(frames_per_second: f64, load_max: f64) -> Self {
        let rate = if frames_per_second.is_finite() { frames_per_second.clamp(1.0, 1_000.0) } else { 60.0 };
        let load_max = if load_max.is_finite() { load_max.clamp(0.05, 1.0) } else { 1.0 };
        Self {
            period: 1.0 / rate,
            load_max,
            step: 1,
            best: 0,
            times: [0.0; WINDOW],
            count: 0,
            known: [None; LADDER.len()],
            in_time: 0,
            patience: PATIENCE,
            trying: None,
            far_too_slow: false,
        }
    }

    /// Limits the quality, however much time there is.
    #[must_use]
    pub fn at_best(mut self, quality: Quality) -> Self {
        self.best = LADDER.iter().position(|pace| pace.quality == quality).unwrap_or(0);
        self.go_to(self.step.max(self.best));
        self
    }

    /// Begins with that quality at full resolution; better steps are tried as soon as there is room.
    #[must_use]
    pub fn begin_with(mut self, quality: Quality) -> Self {
        let step = LADDER.iter().position(|pace| pace.quality == quality).unwrap_or(self.step);
        self.go_to(step.max(self.best));
        self
    }

    /// Quality and resolution of the next frame.
    pub fn pace(&self) -> Pace {
        LADDER[self.step]
    }

    /// Takes the drawing time of the last frame, without waits \[s\]; returns how to draw the next one.
    pub fn drawn(&mut self, secs: f64) -> Pace {
        if !secs.is_finite() || secs < 0.0 {
            return self.pace();
        }
        let is_far = secs > FAR_TOO_SLOW * self.budget();
        let was_far = std::mem::replace(&mut self.far_too_slow, is_far);
        if was_far && is_far && self.step + 1 < LADDER.len() {
            if self.trying.take().is_some() {
                self.patience = (2 * self.patience).min(PATIENCE_MAX);
            }
            self.known[self.step] = Some(secs);
            self.go_to(self.far_below(secs));
            return self.pace();
        }
        self.times[self.count % WINDOW] = secs;
        self.count += 1;
        if let Some(frames) = &mut self.trying {
            *frames += 1;
            if *frames >= PROVEN {
                self.trying = None;
                self.patience = (self.patience / 2).max(PATIENCE);
            }
        }
        if self.count < WINDOW {
            return self.pace();
        }
        let typical = self.typical();
        self.known[self.step] = Some(typical);
        let budget = self.budget();
        if typical > TOO_SLOW * budget {
            self.in_time = 0;
            if self.trying.take().is_some() {
                self.patience = (2 * self.patience).min(PATIENCE_MAX);
            }
            if self.step + 1 < LADDER.len() {
                self.go_to(self.step + 1);
            }
        } else {
            self.in_time += 1;
            if self.in_time >= self.patience && self.step > self.best && self.has_room(typical, budget) {
                self.go_to(self.step - 1);
                self.trying = Some(0);
            }
        }
        self.pace()
    }

    /// The rest after a frame of that duration \[s\]: until the next frame is due, and long enough that drawing keeps
    /// within its share. If even the cheapest step is too slow, the frame rate drops.
    pub fn rest(&self, secs: f64) -> f64 {
        let secs = if secs.is_finite() { secs.max(0.0) } else { 0.0 };
        (self.period - secs).max(secs * (1.0 / self.load_max - 1.0))
    }

    /// The time that a frame may take \[s\].
    fn budget(&self) -> f64 {
        self.period * self.load_max
    }

    /// The first step below this one that should be in time where a frame takes `secs` now; the cheapest if none is.
    fn far_below(&self, secs: f64) -> usize {
        let share = |step: usize| cost(&LADDER[step]) / cost(&LADDER[self.step]);
        let fits = |step: &usize| secs * share(*step) <= TOO_SLOW * self.budget();
        (self.step + 1..LADDER.len()).find(fits).unwrap_or(LADDER.len() - 1)
    }

    fn go_to(&mut self, step: usize) {
        self.far_too_slow = false;
        (self.step, self.count, self.in_time) = (step, 0, 0);
    }

    fn typical(&self) -> f64 {
        let mut sorted = self.times;
        sorted.sort_by(f64::total_cmp);
        sorted[WINDOW / 2]
    }

    /// Whether the next better step should be in time. An old measurement is trusted only as far as the present step
    /// still takes its old time.
    fn has_room(&self, typical: f64, budget: f64) -> bool {
        let (now, better) = (LADDER[self.step], LADDER[self.step - 1]);
        let guess = typical
            * match better.quality {
                quality if quality == now.quality => (better.scale / now.scale).powi(2),
                Quality::FINE => GUESS_FINE,
                _ => GUESS,
            };
        let expected = match self.known[self.step - 1] {
            // An old measurement may be outdated: it is retried once in a while.
            Some(known) if self.in_time < 4 * self.patience => known.min(2.0 * guess),
            _ => guess,
        };
        expected <= ROOM * budget
    }
}

/// Assumed cost of a step, in frames of [`Quality::PLAIN`] at full resolution.
fn cost(pace: &Pace) -> f64 {
    let of_quality = match pace.quality {
        Quality::FINE => GUESS * GUESS_FINE,
        Quality::FULL => GUESS,
        _ => 1.0,
    };
    of_quality * pace.scale * pace.scale
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The cost of a frame \[s\]: a constant, and per pixel by its shading.
    #[derive(Clone, Copy)]
    struct Costs {
        fixed: f64,
        fine: f64,
        full: f64,
        plain: f64,
    }

    impl Costs {
        fn of(&self, pace: &Pace) -> f64 {
            let pixels = match pace.quality {
                Quality::FINE => self.fine,
                Quality::FULL => self.full,
                _ => self.plain,
            };
            self.fixed + pixels * pace.scale * pace.scale
        }
    }

    /// A software rasteriser at 800 × 600.
    const SOFTWARE: Costs = Costs { fixed: 0.002, fine: 0.120, full: 0.026, plain: 0.010 };

    /// Noise of ±`share`, the same in every run.
    fn noise(seed: &mut u64, share: f64) -> f64 {
        *seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        1.0 + share * (2.0 * ((*seed >> 33) as f64 / f64::from(1_u32 << 31)) - 1.0)
    }

    /// Draws frames; returns how often the step changed.
    fn draw(pacer: &mut Pacer, costs: &Costs, frames: usize, share: f64) -> usize {
        let (mut seed, mut changes) = (7, 0);
        for _ in 0..frames {
            let before = pacer.pace();
            let taken = costs.of(&before) * noise(&mut seed, share);
            changes += usize::from(pacer.drawn(taken) != before);
        }
        changes
    }

    #[test]
    fn the_best_step_that_is_in_time_is_found_whatever_the_rate() {
        for rate in [10.0, 25.0, 30.0, 45.0, 60.0, 90.0, 120.0] {
            let mut pacer = Pacer::new(rate, 1.0);
            draw(&mut pacer, &SOFTWARE, 2_000, 0.1);
            let in_time = |pace: &Pace| SOFTWARE.of(pace) * rate <= TOO_SLOW;
            let first = LADDER.iter().position(in_time).unwrap_or(LADDER.len() - 1);
            let found = LADDER.iter().position(|pace| *pace == pacer.pace()).unwrap();
            // The next cheaper step is acceptable where the best has no room to spare.
            assert!((first..=first + 1).contains(&found), "{rate} Hz: {found}, not {first}");
        }
    }

    #[test]
    fn a_step_that_is_nearly_in_time_is_not_tried_again_and_again() {
        // FULL takes a little more, or less, than a period of 1/30 s.
        for full in [0.028, 0.031, 0.033, 0.036, 0.040] {
            let mut pacer = Pacer::new(30.0, 1.0);
            let costs = Costs { full, ..SOFTWARE };
            draw(&mut pacer, &costs, 600, 0.2);
            let changes = draw(&mut pacer, &costs, 20_000, 0.2);
            assert!(changes <= 12, "{full}: {changes} changes");
        }
    }

    #[test]
    fn what_gets_slower_is_drawn_with_less_care_at_once_and_with_more_again_afterwards() {
        let mut pacer = Pacer::new(30.0, 1.0);
        draw(&mut pacer, &SOFTWARE, 1_000, 0.1);
        assert_eq!(pacer.pace(), LADDER[1]);
        let loaded = Costs { fixed: 0.006, fine: 0.5, full: 0.110, plain: 0.033 };
        draw(&mut pacer, &loaded, 40, 0.1);
        assert!(loaded.of(&pacer.pace()) * 30.0 <= TOO_SLOW, "{:?}", pacer.pace());
        draw(&mut pacer, &SOFTWARE, 4_000, 0.1);
        assert_eq!(pacer.pace(), LADDER[1]);
    }

    #[test]
    fn on_a_machine_that_is_far_too_busy_the_lowest_quality_comes_within_a_few_frames() {
        // Load 6 on 2 cores, drawn in software: a frame takes half a second.
        let busy = Costs { fixed: 0.05, fine: 2.4, full: 0.5, plain: 0.2 };
        let mut pacer = Pacer::new(60.0, 0.6).at_best(Quality::FULL);
        draw(&mut pacer, &busy, 4, 0.1);
        assert_eq!(pacer.pace(), LADDER[LADDER.len() - 1], "two seconds, not twenty");
        // Where a cheaper step should do, it is the next one that does.
        let mut pacer = Pacer::new(30.0, 1.0);
        draw(&mut pacer, &Costs { fixed: 0.0, fine: 1.0, full: 0.140, plain: 0.04 }, 2, 0.0);
        assert_eq!(pacer.pace(), LADDER[7], "0.14 s against 0.033 s");
        draw(&mut pacer, &SOFTWARE, 6_000, 0.1);
        assert_eq!(pacer.pace(), LADDER[1], "and back, once the machine is free");
        let mut pacer = Pacer::new(30.0, 1.0).begin_with(Quality::PLAIN).at_best(Quality::FULL);
        assert_eq!(pacer.pace(), LADDER[4], "the first picture is a cheap one");
        draw(&mut pacer, &SOFTWARE, 2_000, 0.1);
        assert_eq!(pacer.pace(), LADDER[1], "and a fine one where there is time for it");
    }

    #[test]
    fn one_slow_frame_changes_nothing() {
        let mut pacer = Pacer::new(30.0, 1.0);
        draw(&mut pacer, &SOFTWARE, 1_000, 0.0);
        let before = pacer.pace();
        for _ in 0..50 {
            assert_eq!(pacer.drawn(0.5), before);
            draw(&mut pacer, &SOFTWARE, 10, 0.0);
            assert_eq!(pacer.pace(), before);
        }
    }

    #[test]
    fn the_frame_rate_gives_way_where_nothing_is_in_time() {
        let mut pacer = Pacer::new(60.0, 0.5);
        let slow = Costs { fixed: 0.1, fine: 1.0, full: 0.6, plain: 0.2 };
        draw(&mut pacer, &slow, 1_000, 0.1);
        assert_eq!(pacer.pace(), LADDER[LADDER.len() - 1]);
        for secs in [0.0, 0.004, 0.0083, 0.02, 0.15, 3.0] {
            let rest = pacer.rest(secs);
            assert!(
                secs + rest >= 1.0 / 60.0 - 1e-12 && secs / (secs + rest) <= 0.5 + 1e-12,
                "{secs}: {rest}"
            );
        }
        assert!((pacer.rest(0.004) - (1.0 / 60.0 - 0.004)).abs() < 1e-12);
    }

    #[test]
    fn nobody_gets_more_care_than_was_asked_for_and_nonsense_changes_nothing() {
        let fast = Costs { fixed: 1e-4, fine: 1e-3, full: 5e-4, plain: 1e-4 };
        for (quality, best) in [(Quality::FINE, 0), (Quality::FULL, 1), (Quality::PLAIN, 4)] {
            let mut pacer = Pacer::new(60.0, 1.0).at_best(quality);
            draw(&mut pacer, &fast, 2_000, 0.1);
            assert_eq!(pacer.pace(), LADDER[best]);
            for secs in [f64::NAN, f64::INFINITY, -1.0] {
                assert_eq!(pacer.drawn(secs), LADDER[best]);
                assert!(pacer.rest(secs).is_finite());
            }
        }
        for (rate, load) in [(f64::NAN, f64::NAN), (0.0, 0.0), (1e9, 7.0), (-5.0, -1.0)] {
            let pacer = Pacer::new(rate, load);
            assert!(pacer.rest(0.01).is_finite() && pacer.rest(0.01) >= 0.0);
        }
    }
}

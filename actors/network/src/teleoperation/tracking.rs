//! How well a slave tracks its master: distances of their tips at the same time and with a constant lag, range, speed,
//! share of time in contact.
//!
//! The mean squares for all lags are summed up as time goes on, so that nothing of a long session has to be kept but the
//! last second. Between two lags the mean square is a parabola very nearly, whose least value is taken.

use std::collections::VecDeque;

use nalgebra::Vector3;
use trocar_scene::{SimTime, TeleoperationFigures};

/// Time between two looks that count.
pub const LOOK_EVERY: SimTime = SimTime::from_millis(4);
/// Lags that are tried: up to this many looks.
pub const LAGS: usize = 300;
/// A force at an instrument from which on it counts as in contact \[N\].
pub const CONTACT_FORCE: f64 = 0.01;
/// A gap between two looks after which the last second does not count \[s\].
const GAP_SECS: f64 = 0.012;

/// Master and slave at one time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Look {
    /// When.
    pub at: SimTime,
    /// The master's tip \[m\].
    pub master_in_world: Vector3<f64>,
    /// The slave's tip \[m\].
    pub slave_in_world: Vector3<f64>,
    /// Force at the instrument \[N\].
    pub force: f64,
}

/// Sums up looks.
#[derive(Clone, Debug)]
pub struct TrackingMeter {
    /// Master's tips, the newest first.
    masters: VecDeque<Vector3<f64>>,
    /// When the last look was, and when the next one is due.
    last: Option<(SimTime, SimTime)>,
    /// Sum of the squared distances for each lag \[m²\], over the same looks.
    squares: Vec<f64>,
    squared: u64,
    looks: u64,
    touching: u64,
    x_range: Option<(f64, f64)>,
    speed_max: f64,
}

impl Default for TrackingMeter {
    fn default() -> Self {
        Self {
            masters: VecDeque::with_capacity(LAGS + 1),
            last: None,
            squares: vec![0.0; LAGS],
            squared: 0,
            looks: 0,
            touching: 0,
            x_range: None,
            speed_max: 0.0,
        }
    }
}

impl TrackingMeter {
    /// Takes a look; those that come sooner than [`LOOK_EVERY`] after the last one are passed over.
    pub fn look(&mut self, look: &Look) {
        let finite = |vector: &Vector3<f64>| vector.iter().all(|x| x.is_finite());
        if !(finite(&look.master_in_world) && finite(&look.slave_in_world)) {
            return;
        }
        if let Some((last, due)) = self.last {
            // An actor's ticks come a little early or late.
            if look.at + SimTime(LOOK_EVERY.0 / 4) < due {
                return;
            }
            let secs = look.at.since(last).as_secs_f64();
            if secs > GAP_SECS {
                self.masters.clear();
            }
            if let Some(before) = self.masters.front() {
                self.speed_max = self.speed_max.max((look.master_in_world - before).norm() / secs);
            }
        }
        let due = self.last.map_or(look.at, |(_, due)| due);
        // Ticks that never came are not made up for.
        self.last = Some((look.at, (due + LOOK_EVERY).max(look.at + SimTime(LOOK_EVERY.0 / 2))));
        self.looks += 1;
        self.touching += u64::from(look.force >= CONTACT_FORCE);
        let x = look.slave_in_world.x;
        let (low, high) = self.x_range.unwrap_or((x, x));
        self.x_range = Some((low.min(x), high.max(x)));
        self.masters.truncate(LAGS - 1);
        self.masters.push_front(look.master_in_world);
        if self.masters.len() == LAGS {
            // Every lag counts the same looks.
            self.squared += 1;
            for (square, master) in self.squares.iter_mut().zip(&self.masters) {
                *square += (look.slave_in_world - master).norm_squared();
            }
        }
    }

    /// The lag that makes the distance least \[s\], and the root mean square that is then left \[m\].
    pub fn constant_lag(&self) -> Option<(f64, f64)> {
        let count = (self.squared > 0).then_some(self.squared as f64)?;
        let (least, _) = self.squares.iter().enumerate().min_by(|a, b| a.1.total_cmp(b.1))?;
        let mean = |lag: usize| self.squares.get(lag).map(|square| square / count);
        let middle = mean(least)?;
        let step = LOOK_EVERY.as_secs_f64();
        let neighbours = least.checked_sub(1).and_then(mean).zip(mean(least + 1));
        let (shift, square) = match neighbours {
            Some((before, after)) if before + after > 2.0 * middle => {
                let bend = before + after - 2.0 * middle;
                let shift = 0.5 * (before - after) / bend;
                (shift, middle - 0.25 * (before - after) * shift)
            }
            _ => (0.0, middle),
        };
        Some(((least as f64 + shift) * step, square.max(0.0).sqrt()))
    }

    /// Fills in what is known.
    pub fn fill(&self, figures: &mut TeleoperationFigures) {
        figures.rms = (self.squared > 0).then(|| (self.squares[0] / self.squared as f64).sqrt());
        let constant = self.constant_lag();
        figures.constant_lag = constant.map(|(lag, _)| lag);
        figures.constant_lag_rms = constant.map(|(_, rms)| rms);
        figures.x_range = self.x_range.map_or(0.0, |(low, high)| high - low);
        figures.speed_max = self.speed_max;
        figures.contact_share = if self.looks > 0 { self.touching as f64 / self.looks as f64 } else { 0.0 };
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A hand that goes to and fro along x, 40 mm each way, once in two seconds.
    fn place(secs: f64) -> Vector3<f64> {
        let phase = std::f64::consts::PI * secs;
        Vector3::new(0.040 * phase.sin(), 0.010 * (0.7 * phase).cos(), 0.0)
    }

    fn meter(lag: impl Fn(f64) -> f64, every_ms: u64) -> TeleoperationFigures {
        let mut meter = TrackingMeter::default();
        for ms in (0..20_000).step_by(every_ms as usize) {
            let (at, secs) = (SimTime::from_millis(ms), ms as f64 * 1e-3);
            let force = if ms % 10_000 < 4_000 { 0.5 } else { 0.0 };
            let slave_in_world = place(secs - lag(secs));
            meter.look(&Look { at, master_in_world: place(secs), slave_in_world, force });
        }
        let mut figures = TeleoperationFigures::default();
        meter.fill(&mut figures);
        figures
    }

    #[test]
    fn a_constant_lag_is_found_between_two_looks_and_leaves_nothing() {
        for lag in [0.0, 0.1507, 0.151_3, 0.9] {
            for every_ms in [1, 4] {
                let figures = meter(|_| lag, every_ms);
                let found = figures.constant_lag.expect("known");
                assert!((found - lag).abs() < 1e-4, "{found} for {lag}");
                assert!(figures.constant_lag_rms.expect("known") < 2e-5, "{figures:?}");
                // Root mean square of the chord of a sine.
                let chord = 0.040 * 2.0_f64.sqrt() * (0.5 * std::f64::consts::PI * lag).sin().abs();
                assert!((figures.rms.expect("known") / chord.max(1e-9) - 1.0).abs() < 0.1 || lag == 0.0);
            }
        }
    }

    #[test]
    fn a_lag_that_varies_leaves_its_deviation_times_the_speed() {
        let figures = meter(|secs| 0.150 + 0.005 * (17.0 * secs).sin(), 4);
        assert!((figures.constant_lag.expect("known") - 0.150).abs() < 0.001);
        // 3.5 ms at 92 mm/s, both root mean squares.
        let left = figures.constant_lag_rms.expect("known");
        assert!((0.25e-3..0.40e-3).contains(&left), "{left}");
    }

    #[test]
    fn range_speed_and_contact_are_those_of_the_motion() {
        let figures = meter(|_| 0.1, 4);
        assert!((figures.x_range - 0.080).abs() < 1e-4);
        assert!((figures.speed_max - 0.127).abs() < 0.003, "{}", figures.speed_max);
        assert!((figures.contact_share - 0.4).abs() < 0.01);
    }

    #[test]
    fn a_gap_makes_no_speed_and_no_number_counts_that_is_none() {
        let mut meter = TrackingMeter::default();
        let look = |ms, x| Look {
            at: SimTime::from_millis(ms),
            master_in_world: Vector3::new(x, 0.0, 0.0),
            slave_in_world: Vector3::zeros(),
            force: 0.0,
        };
        meter.look(&look(0, 0.0));
        meter.look(&look(500, 1.0));
        meter.look(&look(504, f64::NAN));
        meter.look(&look(508, 1.0));
        let mut figures = TeleoperationFigures::default();
        meter.fill(&mut figures);
        assert_eq!((figures.speed_max, figures.rms, figures.constant_lag), (0.0, None, None));
    }
}

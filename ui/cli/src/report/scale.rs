//! Axes: from values to pixels, with ticks at round numbers.

/// Largest number of ticks on an axis.
const TICKS_MAX: usize = 24;

/// Linear or logarithmic.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Spacing {
    Linear,
    Log,
}

/// Maps a range of values onto a range of pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Scale {
    low: f64,
    high: f64,
    from: f64,
    to: f64,
    spacing: Spacing,
}

impl Scale {
    /// A linear axis from `low` to `high`, drawn from pixel `from` to pixel `to`. An empty or unusable range
    /// is widened, so that a constant series can be drawn.
    pub fn linear((low, high): (f64, f64), from: f64, to: f64) -> Self {
        let (low, high) = usable(low, high);
        Self { low, high, from, to, spacing: Spacing::Linear }
    }

    /// A logarithmic axis; `low` must be above zero or is taken as a thousandth of `high`.
    pub fn log((low, high): (f64, f64), from: f64, to: f64) -> Self {
        let high = if high.is_finite() && high > 0.0 { high } else { 1.0 };
        let low = if low.is_finite() && low > 0.0 && low < high { low } else { high * 1e-3 };
        Self { low, high, from, to, spacing: Spacing::Log }
    }

    /// The same with its ends moved out to round numbers.
    pub fn nice(mut self) -> Self {
        if self.spacing == Spacing::Linear {
            let step = round_step((self.high - self.low) / 5.0);
            self.low = (self.low / step).floor() * step;
            self.high = (self.high / step).ceil() * step;
        }
        self
    }

    /// The pixel of a value; values outside of the range land outside of the axis.
    pub fn pixel(&self, value: f64) -> f64 {
        let share = match self.spacing {
            Spacing::Linear => (value - self.low) / (self.high - self.low),
            Spacing::Log => (value.max(self.low * 1e-3) / self.low).ln() / (self.high / self.low).ln(),
        };
        self.from + share * (self.to - self.from)
    }

    /// Like [`Self::pixel`], held within the axis.
    pub fn clamped(&self, value: f64) -> f64 {
        let (low, high) = if self.from < self.to { (self.from, self.to) } else { (self.to, self.from) };
        self.pixel(value).clamp(low, high)
    }

    /// Ends of the range in values.
    pub fn range(&self) -> (f64, f64) {
        (self.low, self.high)
    }

    /// First and last pixel.
    pub fn pixels(&self) -> (f64, f64) {
        (self.from, self.to)
    }

    /// About `count` round values within the range, with the text of each.
    pub fn ticks(&self, count: usize) -> Vec<(f64, String)> {
        match self.spacing {
            Spacing::Log => {
                let (first, last) = (self.low.log10().ceil() as i32, self.high.log10().floor() as i32);
                let step = (((last - first).max(0) as usize) / count.max(1) + 1) as i32;
                (first..=last)
                    .step_by(step.max(1) as usize)
                    .take(TICKS_MAX)
                    .map(|power| (10f64.powi(power), short(10f64.powi(power))))
                    .collect()
            }
            Spacing::Linear => {
                let step = round_step((self.high - self.low) / count.max(1) as f64);
                let digits = (-step.log10().floor()).clamp(0.0, 9.0) as usize;
                let first = (self.low / step - 1e-9).ceil();
                (0..TICKS_MAX)
                    .map(|i| (first + i as f64) * step)
                    .take_while(|value| *value <= self.high + step * 1e-9)
                    .map(|value| if value.abs() < step * 1e-6 { 0.0 } else { value })
                    .map(|value| (value, format!("{value:.digits$}")))
                    .collect()
            }
        }
    }
}

fn usable(low: f64, high: f64) -> (f64, f64) {
    if !(low.is_finite() && high.is_finite()) {
        return (0.0, 1.0);
    }
    let span = high - low;
    let least = low.abs().max(high.abs()) * 1e-9;
    if span > least && span > 1e-15 {
        (low, high)
    } else if high.abs() > 1e-12 {
        (low - 0.5 * low.abs(), high + 0.5 * high.abs())
    } else {
        (0.0, 1.0)
    }
}

/// The next of 1, 2, 5 × a power of ten at or above `raw`.
fn round_step(raw: f64) -> f64 {
    let power = 10f64.powf(raw.log10().floor());
    let lead = raw / power;
    let round = [1.0, 2.0, 5.0].into_iter().find(|step| lead <= step * 1.000_000_1).unwrap_or(10.0);
    round * power
}

/// Three significant digits, without a long tail of zeros.
pub fn short(value: f64) -> String {
    if !value.is_finite() {
        return "–".to_owned();
    }
    let size = value.abs();
    if size == 0.0 {
        "0".to_owned()
    } else if !(1e-4..1e6).contains(&size) {
        format!("{value:.1e}")
    } else {
        let digits = (2.0 - size.log10().floor()).clamp(0.0, 6.0) as usize;
        let text = format!("{value:.digits$}");
        if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_owned() } else { text }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_round_and_lie_within_the_axis() {
        let scale = Scale::linear((0.0, 97.3), 0.0, 500.0);
        let ticks = scale.ticks(6);
        let texts: Vec<&str> = ticks.iter().map(|(_, text)| text.as_str()).collect();
        assert_eq!(texts, ["0", "20", "40", "60", "80"]);
        let fine = Scale::linear((-0.031, 0.052), 0.0, 1.0).ticks(4);
        let texts: Vec<&str> = fine.iter().map(|(_, text)| text.as_str()).collect();
        assert_eq!(texts, ["0.00", "0.05"]);
        let negative = Scale::linear((-0.02, 0.02), 0.0, 1.0).ticks(4);
        let texts: Vec<&str> = negative.iter().map(|(_, text)| text.as_str()).collect();
        assert_eq!(texts, ["-0.02", "-0.01", "0.00", "0.01", "0.02"]);
        assert!(fine.iter().all(|(value, _)| (-0.031..=0.052).contains(value)));
    }

    #[test]
    fn a_log_axis_has_its_powers_of_ten() {
        let scale = Scale::log((1.0, 1e5), 0.0, 100.0);
        assert_eq!(scale.ticks(10).len(), 6);
        assert!((scale.pixel(1e5) - 100.0).abs() < 1e-9);
        assert!((scale.pixel(10.0) - 20.0).abs() < 1e-9);
        assert!(scale.pixel(0.0).is_finite());
    }

    #[test]
    fn constant_empty_and_broken_ranges_can_be_drawn() {
        for range in [(0.0, 0.0), (3.3, 3.3), (f64::NAN, 1.0), (f64::INFINITY, f64::NEG_INFINITY)] {
            let scale = Scale::linear(range, 0.0, 100.0).nice();
            let (low, high) = scale.range();
            assert!(low < high, "{range:?}");
            assert!(!scale.ticks(5).is_empty());
        }
    }

    #[test]
    fn numbers_are_short() {
        let cases = [(0.0, "0"), (1234.6, "1235"), (0.12345, "0.123"), (3.3, "3.3"), (1.5e-7, "1.5e-7")];
        for (value, text) in cases {
            assert_eq!(short(value), text);
        }
    }
}

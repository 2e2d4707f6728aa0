//! Histogram of delays in bins of one width, for quantiles of any number of packets in bounded memory.

use trocar_scene::SimTime;

/// Counts of delays. Recording allocates nothing.
#[derive(Clone, Debug)]
pub struct DelayHistogram {
    width: SimTime,
    bins: Box<[u64]>,
    /// Above the last bin.
    above: u64,
    count: u64,
    sum_nanos: u128,
    min: SimTime,
    max: SimTime,
}

impl DelayHistogram {
    /// An empty histogram; the width is at least a nanosecond, and there is at least one bin.
    pub fn new(width: SimTime, bins: usize) -> Self {
        Self {
            width: width.max(SimTime(1)),
            bins: vec![0; bins.max(1)].into(),
            above: 0,
            count: 0,
            sum_nanos: 0,
            min: SimTime(u64::MAX),
            max: SimTime::ZERO,
        }
    }

    /// Counts a delay.
    pub fn record(&mut self, delay: SimTime) {
        self.count += 1;
        self.sum_nanos += u128::from(delay.as_nanos());
        self.min = self.min.min(delay);
        self.max = self.max.max(delay);
        let place = delay.as_nanos() / self.width.as_nanos();
        let bin = usize::try_from(place).ok().and_then(|place| self.bins.get_mut(place));
        *bin.unwrap_or(&mut self.above) += 1;
    }

    /// How many were counted.
    pub fn count(&self) -> u64 {
        self.count
    }

    /// Their mean \[s\]; `None` before the first.
    pub fn mean(&self) -> Option<f64> {
        (self.count > 0).then(|| self.sum_nanos as f64 / self.count as f64 * 1e-9)
    }

    /// The shortest and the longest \[s\]; `None` before the first.
    pub fn range(&self) -> Option<(f64, f64)> {
        (self.count > 0).then(|| (self.min.as_secs_f64(), self.max.as_secs_f64()))
    }

    /// A delay that this share of them does not exceed \[s\]: the upper edge of its bin, or the longest delay.
    pub fn quantile(&self, share: f64) -> Option<f64> {
        let (_, max) = self.range()?;
        let wanted = ((share.clamp(0.0, 1.0) * self.count as f64).ceil() as u64).max(1);
        let mut counted = 0;
        for (place, bin) in self.bins.iter().enumerate() {
            counted += bin;
            if counted >= wanted {
                return Some(((place as f64 + 1.0) * self.width.as_secs_f64()).min(max));
            }
        }
        Some(max)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_are_never_below_the_true_ones_and_at_most_a_bin_above() {
        let mut delays = DelayHistogram::new(SimTime::from_micros(10), 1_000);
        assert_eq!((delays.mean(), delays.range(), delays.quantile(0.99)), (None, None, None));
        for us in 1..=1_000 {
            delays.record(SimTime::from_micros(us));
        }
        assert!((delays.mean().expect("counted") - 500.5e-6).abs() < 1e-12);
        for share in [0.01, 0.5, 0.9, 0.99, 1.0] {
            let (true_one, found) = (share * 1e-3, delays.quantile(share).expect("counted"));
            assert!(found >= true_one - 1e-12 && found <= true_one + 10.1e-6, "{share}: {found}");
        }
    }

    #[test]
    fn what_lies_beyond_the_last_bin_counts_as_the_longest() {
        let mut delays = DelayHistogram::new(SimTime::from_millis(1), 2);
        for delay in [SimTime::ZERO, SimTime::from_millis(900), SimTime(u64::MAX)] {
            delays.record(delay);
        }
        assert_eq!((delays.count(), delays.quantile(0.3)), (3, Some(0.001)));
        assert_eq!(delays.quantile(0.9), Some(SimTime(u64::MAX).as_secs_f64()));
    }
}

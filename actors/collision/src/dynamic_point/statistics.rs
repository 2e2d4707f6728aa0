//! Statistics of the dynamic point: its cost, and the rate of expired certificates.

/// Buckets of a [`Quantiles`]: eight to an octave.
const BUCKETS: usize = 256;
const PER_OCTAVE: f64 = 8.0;

/// Quantiles of positive numbers to within 9 %, in fixed memory.
#[derive(Clone, PartialEq)]
pub struct Quantiles {
    counts: [u64; BUCKETS],
    total: u64,
}

impl std::fmt::Debug for Quantiles {
    fn fmt(&self, formatter: &mut std::fmt::Formatter) -> std::fmt::Result {
        let at = |share| self.quantile(share);
        write!(formatter, "Quantiles of {}: p50 {}, p99 {}, all {}", self.total, at(0.5), at(0.99), at(1.0))
    }
}

impl Default for Quantiles {
    fn default() -> Self {
        Self { counts: [0; BUCKETS], total: 0 }
    }
}

impl Quantiles {
    /// Records a value; clamped to 2⁻¹⁶ to 2¹⁶, and NaN counts as the smallest.
    pub fn record(&mut self, value: f64) {
        let octave = if value > 0.0 { value.log2() } else { f64::NEG_INFINITY };
        let bucket = ((octave + 16.0) * PER_OCTAVE).clamp(0.0, BUCKETS as f64 - 1.0) as usize;
        self.counts[bucket] += 1;
        self.total += 1;
    }

    /// The quantile of a share (0 to 1); 0 without values.
    #[must_use]
    pub fn quantile(&self, share: f64) -> f64 {
        let wanted = (share.clamp(0.0, 1.0) * self.total as f64).ceil().max(1.0) as u64;
        let mut seen = 0;
        for (bucket, count) in self.counts.iter().enumerate() {
            seen += count;
            if seen >= wanted {
                return ((bucket as f64 + 1.0) / PER_OCTAVE - 16.0).exp2();
            }
        }
        0.0
    }

    /// Number of recorded values.
    #[must_use]
    pub fn total(&self) -> u64 {
        self.total
    }
}

/// Counters since a [`DynamicPoint`](super::DynamicPoint) was made.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LineStatistics {
    /// Updates of the whole line.
    pub updates: u64,
    /// Updates of a segment: segments times updates.
    pub segment_updates: u64,
    /// Segment updates that queried the tree because the certificate had expired.
    pub expired: u64,
    /// Segment updates that queried the tree without a start: the first update, or other triangles.
    pub started: u64,
    /// Steps of walks from triangle to neighbouring triangle.
    pub hops: u64,
    /// Exact segment–triangle distances.
    pub triangle_tests: u64,
    /// Visited nodes of the tree.
    pub nodes: u64,
    /// Nodes plus triangles of each update of the line.
    pub work: Quantiles,
    /// Time of each update, the refit included \[µs\], as recorded by the caller.
    pub micros: Quantiles,
}

impl LineStatistics {
    /// Share of segment updates that fell back on the tree; 0 before the first.
    #[must_use]
    pub fn fallback_rate(&self) -> f64 {
        if self.segment_updates == 0 {
            return 0.0;
        }
        (self.expired + self.started) as f64 / self.segment_updates as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_are_within_nine_percent() {
        let mut quantiles = Quantiles::default();
        assert_eq!(quantiles.quantile(0.5), 0.0);
        for value in 1..=1000 {
            quantiles.record(f64::from(value) / 10.0);
        }
        for (share, value) in [(0.5, 50.0), (0.99, 99.0), (1.0, 100.0)] {
            let found = quantiles.quantile(share);
            assert!((value..value * 1.0906).contains(&found), "{share}: {found}");
        }
        for odd in [f64::NAN, -1.0, 0.0, f64::INFINITY] {
            quantiles.record(odd);
        }
        assert_eq!(quantiles.total(), 1004);
    }
}

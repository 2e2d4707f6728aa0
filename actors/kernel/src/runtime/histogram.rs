//! Lock-free latency histogram: one thread records while others read, through atomics only. Buckets as in HdrHistogram
//! (Tene 2012): linear within each power of two, here 128 per power, so that the relative error of every value is below
//! 1 %.

use std::sync::atomic::{AtomicU32, AtomicU64, Ordering};

use hdrhistogram::Histogram;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

const SUB_BITS: u32 = 7;
const SUB: u64 = 1 << SUB_BITS;
/// Largest value with a bucket of its own, ns; 17 s. Larger values are counted in the last bucket.
pub const VALUE_MAX: u64 = (1 << 34) - 1;
const BUCKETS: usize = ((34 - SUB_BITS + 1) * SUB as u32) as usize;

/// Counts of nanosecond values. Recording takes a few nanoseconds and never allocates.
pub struct AtomicHistogram {
    buckets: Box<[AtomicU32]>,
    max: AtomicU64,
}

impl Default for AtomicHistogram {
    fn default() -> Self {
        Self { buckets: (0..BUCKETS).map(|_| AtomicU32::new(0)).collect(), max: AtomicU64::new(0) }
    }
}

fn bucket_of(value: u64) -> usize {
    let value = value.min(VALUE_MAX);
    if value < SUB {
        return value as usize;
    }
    let shift = 63 - SUB_BITS - value.leading_zeros();
    // value >> shift lies in SUB..2·SUB.
    ((u64::from(shift) << SUB_BITS) + (value >> shift)) as usize
}

/// The largest value that falls into the bucket.
fn upper_of(bucket: usize) -> u64 {
    let bucket = bucket as u64;
    if bucket < 2 * SUB {
        return bucket;
    }
    let shift = (bucket >> SUB_BITS) - 1;
    let mantissa = (bucket & (SUB - 1)) + SUB;
    ((mantissa + 1) << shift) - 1
}

impl AtomicHistogram {
    /// Counts one value, ns.
    pub fn record(&self, value: u64) {
        self.buckets[bucket_of(value)].fetch_add(1, Ordering::Relaxed);
        self.max.fetch_max(value, Ordering::Relaxed);
    }
    /// How many values were counted.
    pub fn count(&self) -> u64 {
        self.buckets.iter().map(|n| u64::from(n.load(Ordering::Relaxed))).sum()
    }
    /// The largest value, ns, exactly; 0 when there is none.
    pub fn max(&self) -> u64 {
        self.max.load(Ordering::Relaxed)
    }
    /// How many values lie at or below `limit`, to the resolution of the buckets.
    pub fn count_to(&self, limit: u64) -> u64 {
        let last = bucket_of(limit);
        self.buckets[..=last].iter().map(|n| u64::from(n.load(Ordering::Relaxed))).sum()
    }
    /// A copy for quantiles and arithmetic.
    pub fn to_hdr(&self) -> Histogram<u64> {
        let mut copy = Histogram::new_with_bounds(1, VALUE_MAX, 3).expect("constant bounds are valid");
        for (bucket, n) in self.buckets.iter().enumerate() {
            let n = n.load(Ordering::Relaxed);
            if n > 0 {
                copy.saturating_record_n(upper_of(bucket), u64::from(n));
            }
        }
        copy
    }
    /// The quantiles that the report shows.
    pub fn quantiles(&self) -> Quantiles {
        let copy = self.to_hdr();
        let max = self.max();
        let us = |value: u64| value.min(max) as f64 * 1e-3;
        if copy.is_empty() {
            return Quantiles::default();
        }
        Quantiles {
            p50: us(copy.value_at_quantile(0.5)),
            p99: us(copy.value_at_quantile(0.99)),
            p999: us(copy.value_at_quantile(0.999)),
            max: us(max),
        }
    }
    /// The compact form for a plot: counts between the edges of [`BAR_EDGES_US`].
    pub fn bars(&self) -> Bars {
        let mut counts = vec![0; BAR_EDGES_US.len() + 1];
        for (bucket, n) in self.buckets.iter().enumerate() {
            let n = n.load(Ordering::Relaxed);
            if n > 0 {
                let us = upper_of(bucket) as f64 * 1e-3;
                let bar = BAR_EDGES_US.iter().position(|edge| us < *edge).unwrap_or(BAR_EDGES_US.len());
                counts[bar] += u64::from(n);
            }
        }
        Bars { upper_us: BAR_EDGES_US.to_vec(), counts }
    }
}

/// Upper edges of the bars, µs; one more bar holds what lies above the last.
pub const BAR_EDGES_US: [f64; 16] = [
    1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0, 500.0, 1_000.0, 2_000.0, 5_000.0, 10_000.0, 20_000.0,
    50_000.0, 100_000.0,
];

/// A small histogram for plots.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Bars {
    /// Upper edge of each bar but the last, µs.
    pub upper_us: Vec<f64>,
    /// How many values fell into each bar; one more than edges.
    pub counts: Vec<u64>,
}

/// Quantiles of a latency \[µs\].
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Quantiles {
    /// Median.
    pub p50: f64,
    /// 99 % lie below.
    pub p99: f64,
    /// 99.9 % lie below.
    pub p999: f64,
    /// Largest.
    pub max: f64,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_value_lies_in_its_bucket_to_better_than_one_percent() {
        let mut last = 0;
        for value in (0..2_000).chain((11..34).flat_map(|bit| {
            let power = 1_u64 << bit;
            [power - 1, power, power + power / 3]
        })) {
            let bucket = bucket_of(value);
            let upper = upper_of(bucket);
            assert!(value <= upper, "{value} above {upper}");
            assert!(upper - value <= value / 100, "{value} in a bucket up to {upper}");
            assert!(bucket == 0 || upper_of(bucket - 1) < value);
            last = last.max(bucket);
        }
        assert_eq!(bucket_of(u64::MAX), BUCKETS - 1);
        assert!(last < BUCKETS);
    }

    #[test]
    fn quantiles_of_a_uniform_ramp() {
        let histogram = AtomicHistogram::default();
        assert_eq!(histogram.quantiles(), Quantiles::default());
        (1..=100_000).for_each(|value| histogram.record(value * 10));
        let q = histogram.quantiles();
        assert!((q.p50 / 500.0 - 1.0).abs() < 0.01, "{q:?}");
        assert!((q.p99 / 990.0 - 1.0).abs() < 0.01, "{q:?}");
        assert_eq!(q.max, 1_000.0);
        assert_eq!(histogram.count(), 100_000);
        let half = histogram.count_to(500_000) as f64;
        assert!((half / 50_000.0 - 1.0).abs() < 0.01);
    }

    #[test]
    fn bars_hold_every_value_once() {
        let histogram = AtomicHistogram::default();
        for value in [0, 500, 1_500, 70_000, 3_000_000, u64::MAX] {
            histogram.record(value);
        }
        let bars = histogram.bars();
        assert_eq!(bars.counts.iter().sum::<u64>(), 6);
        assert_eq!(bars.counts[0], 2);
        assert_eq!(bars.counts[1], 1);
        assert_eq!(bars.counts[6], 1);
        assert_eq!(*bars.counts.last().expect("bars"), 1);
    }
}

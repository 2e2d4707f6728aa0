//! Time series of any length in bounded memory: buckets of equal width that double when they run out.
//!
//! Each bucket keeps the extremes and the last value, so a peak of one sample survives any number of
//! doublings (the min–max decimation of oscilloscopes).

use serde::{Deserialize, Serialize};

/// Values that can be merged with those of the neighbouring bucket.
pub trait Merge {
    /// Merges a later value.
    fn merge(&mut self, later: Self);
}

/// Extremes and last value of a number within a bucket.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Extent {
    /// Smallest.
    pub min: f64,
    /// Largest.
    pub max: f64,
    /// Latest.
    pub last: f64,
}

impl From<f64> for Extent {
    fn from(value: f64) -> Self {
        Self { min: value, max: value, last: value }
    }
}
impl Merge for Extent {
    fn merge(&mut self, later: Self) {
        self.min = self.min.min(later.min);
        self.max = self.max.max(later.max);
        self.last = later.last;
    }
}
/// A position: a bucket keeps its latest.
impl Merge for [f64; 3] {
    fn merge(&mut self, later: Self) {
        *self = later;
    }
}

/// A series of at most `capacity` buckets.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Decimated<T> {
    interval_secs: f64,
    capacity: usize,
    /// Number of the bucket since time 0, and its merged value; numbers increase.
    buckets: Vec<(u64, T)>,
}

impl<T: Merge + Copy> Decimated<T> {
    /// An empty series with buckets of `interval_secs` \[s\] (at least 1 µs) and room for `capacity` of them
    /// (at least 2).
    pub fn new(interval_secs: f64, capacity: usize) -> Self {
        Self { interval_secs: interval_secs.max(1e-6), capacity: capacity.max(2), buckets: Vec::new() }
    }

    /// Adds a value at `secs` \[s\]. A time before the last bucket, negative or non-finite, is ignored.
    pub fn push(&mut self, secs: f64, value: T) {
        if !(secs.is_finite() && secs >= 0.0) {
            return;
        }
        let mut number = (secs / self.interval_secs) as u64;
        match self.buckets.last_mut() {
            Some((last, _)) if number < *last => return,
            Some((last, kept)) if number == *last => return kept.merge(value),
            _ => {}
        }
        while self.buckets.len() >= self.capacity {
            self.halve();
            number = (secs / self.interval_secs) as u64;
        }
        match self.buckets.last_mut() {
            Some((last, kept)) if number == *last => kept.merge(value),
            _ => self.buckets.push((number, value)),
        }
    }

    fn halve(&mut self) {
        self.interval_secs *= 2.0;
        let mut kept: Vec<(u64, T)> = Vec::with_capacity(self.buckets.len());
        for (number, value) in self.buckets.drain(..) {
            match kept.last_mut() {
                Some((last, merged)) if *last == number / 2 => merged.merge(value),
                _ => kept.push((number / 2, value)),
            }
        }
        self.buckets = kept;
    }

    /// Width of a bucket \[s\].
    pub fn interval_secs(&self) -> f64 {
        self.interval_secs
    }
    /// Middle \[s\] and merged value of each bucket that is not empty.
    pub fn iter(&self) -> impl Iterator<Item = (f64, T)> + '_ {
        self.buckets.iter().map(|(number, value)| ((*number as f64 + 0.5) * self.interval_secs, *value))
    }
    /// Number of buckets that are not empty.
    pub fn len(&self) -> usize {
        self.buckets.len()
    }
    /// Whether no value was added.
    pub fn is_empty(&self) -> bool {
        self.buckets.is_empty()
    }
}

/// A number over time.
pub type Series = Decimated<Extent>;
/// A position over time \[m\].
pub type Track = Decimated<[f64; 3]>;

impl Series {
    /// Smallest and largest value; `None` while empty.
    pub fn range(&self) -> Option<(f64, f64)> {
        self.buckets.iter().fold(None, |range, (_, extent)| match range {
            None => Some((extent.min, extent.max)),
            Some((low, high)) => Some((extent.min.min(low), extent.max.max(high))),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn a_peak_of_one_sample_survives_a_hundred_thousand_others() {
        let mut series = Series::new(0.001, 64);
        for i in 0..100_000 {
            let value = if i == 31_415 { 9.0 } else { (f64::from(i) * 0.01).sin() };
            series.push(f64::from(i) * 0.001, value.into());
        }
        assert!(series.len() <= 64 && series.len() > 32, "{}", series.len());
        assert_eq!(series.range().unwrap().1, 9.0);
        let (secs, _) = series.iter().find(|(_, extent)| extent.max == 9.0).unwrap();
        assert!((secs - 31.415).abs() <= series.interval_secs());
    }

    #[test]
    fn time_going_backwards_is_ignored() {
        let mut track = Track::new(0.01, 8);
        track.push(1.0, [1.0; 3]);
        track.push(0.5, [2.0; 3]);
        track.push(f64::NAN, [3.0; 3]);
        track.push(-1.0, [4.0; 3]);
        assert_eq!(track.iter().map(|(_, point)| point).collect::<Vec<_>>(), [[1.0; 3]]);
    }

    proptest! {
        #[test]
        fn any_times_stay_within_the_bound_and_in_order(
            times in prop::collection::vec(0.0..1e6f64, 1..400), capacity in 2usize..40,
        ) {
            let mut sorted = times.clone();
            sorted.sort_by(f64::total_cmp);
            let mut series = Series::new(1e-3, capacity);
            for (i, secs) in sorted.iter().enumerate() {
                series.push(*secs, (i as f64).into());
            }
            prop_assert!(series.len() <= capacity && !series.is_empty());
            let middles: Vec<f64> = series.iter().map(|(secs, _)| secs).collect();
            prop_assert!(middles.windows(2).all(|pair| pair[0] < pair[1]));
            prop_assert_eq!(series.range().unwrap(), (0.0, (sorted.len() - 1) as f64));
        }
    }
}

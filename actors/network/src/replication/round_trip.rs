//! Smoothed round trip and the time after which a datagram counts as lost (Jacobson, "Congestion avoidance and control",
//! 1988; the constants of RFC 6298, with a shorter least time).

use trocar_scene::SimTime;

/// Time after which a datagram counts as lost before the first acknowledgement has come.
const FIRST: SimTime = SimTime::from_millis(1_000);
/// Shortest such time.
const SHORTEST: SimTime = SimTime::from_millis(50);
/// Longest such time, also when nothing comes back.
pub const LONGEST: SimTime = SimTime::from_millis(4_000);

/// Estimate of a link's round trip, acknowledgement delay included.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RoundTrip {
    mean: Option<SimTime>,
    /// Mean deviation from it.
    spread: SimTime,
    /// How often the time has been doubled because nothing came back.
    doubled: u32,
}

impl RoundTrip {
    /// The mean, once one is known.
    pub fn mean(&self) -> Option<SimTime> {
        self.mean
    }

    /// A datagram was acknowledged so long after it was sent.
    pub fn acknowledged(&mut self, after: SimTime) {
        self.doubled = 0;
        let Some(mean) = self.mean else {
            self.mean = Some(after);
            self.spread = SimTime(after.0 / 2);
            return;
        };
        let off = after.0.abs_diff(mean.0);
        self.spread = SimTime(self.spread.0 - self.spread.0 / 4 + off / 4);
        self.mean = Some(SimTime(mean.0 - mean.0 / 8 + after.0 / 8));
    }

    /// Nothing has come back for so long that the time doubles.
    pub fn nothing_came(&mut self) {
        self.doubled = (self.doubled + 1).min(8);
    }

    /// Time after which a datagram counts as lost.
    pub fn lost_after(&self) -> SimTime {
        let usual = self
            .mean
            .map_or(FIRST, |mean| SimTime(mean.0.saturating_add(4 * (self.spread.0.min(LONGEST.0)))));
        SimTime(usual.max(SHORTEST).0.saturating_mul(1 << self.doubled)).min(LONGEST)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_follows_the_link_and_doubles_while_nothing_comes_back() {
        let mut trip = RoundTrip::default();
        assert_eq!((trip.lost_after(), trip.mean()), (FIRST, None));
        (0..100).for_each(|_| trip.acknowledged(SimTime::from_millis(150)));
        assert!((149..=151).contains(&(trip.mean().unwrap_or_default().as_nanos() / 1_000_000)));
        assert!(trip.lost_after() < SimTime::from_millis(160));
        (0..100).for_each(|k| trip.acknowledged(SimTime::from_millis(100 + 100 * (k % 2))));
        assert!(trip.lost_after() > SimTime::from_millis(250), "it leaves room for jitter");
        (0..20).for_each(|_| trip.nothing_came());
        assert_eq!(trip.lost_after(), LONGEST);
        (0..50).for_each(|_| trip.acknowledged(SimTime(1)));
        assert_eq!(trip.lost_after(), SHORTEST);
        trip.acknowledged(SimTime(u64::MAX));
        assert_eq!(trip.lost_after(), LONGEST);
    }
}

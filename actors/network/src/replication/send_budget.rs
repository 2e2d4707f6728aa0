//! How much may be sent: a limit on bytes a second, and only probes while nothing comes back.
//!
//! The limit is a token bucket. What was not sent for a while does not add up beyond [`BURST_SECS`], so that a link that
//! has been idle is not flooded.

use trocar_scene::SimTime;

use super::ROWS_PAYLOAD_MAX;
use super::round_trip::LONGEST;

/// Bytes around a payload that count against the limit: header, tag, UDP and IP.
const AROUND_BYTES: usize = 24 + 16 + 28;
/// What may be sent at once, in seconds of the limit; two datagrams at least.
pub const BURST_SECS: f64 = 0.05;
/// How long after the first unanswered datagram only probes go out.
pub const SILENT_AFTER: SimTime = LONGEST;
/// Time between two probes.
pub const PROBE_EVERY: SimTime = SimTime::from_millis(250);

/// The limit and what is left of it.
#[derive(Clone, Debug)]
pub(super) struct SendBudget {
    bytes_per_sec: f64,
    credit: f64,
    credit_at: SimTime,
    /// When the first datagram was sent that nothing has come back after.
    unanswered_since: Option<SimTime>,
    sent_at: SimTime,
}

impl SendBudget {
    pub(super) fn new(bytes_per_sec: f64) -> Self {
        let bytes_per_sec = valid(bytes_per_sec);
        let (credit_at, sent_at) = (SimTime::ZERO, SimTime::ZERO);
        Self { bytes_per_sec, credit: burst(bytes_per_sec), credit_at, unanswered_since: None, sent_at }
    }

    /// Another limit from now on.
    pub(super) fn limit(&mut self, bytes_per_sec: f64) {
        self.bytes_per_sec = valid(bytes_per_sec);
        self.credit = self.credit.clamp(-burst(self.bytes_per_sec), burst(self.bytes_per_sec));
    }

    /// Whether a datagram may be sent now.
    pub(super) fn may_send(&mut self, now: SimTime) -> bool {
        let earned = now.since(self.credit_at).as_secs_f64() * self.bytes_per_sec;
        self.credit = (self.credit + earned).min(burst(self.bytes_per_sec));
        self.credit_at = self.credit_at.max(now);
        self.credit >= 0.0 && self.next_probe().is_none_or(|probe| now >= probe)
    }

    /// A payload of so many bytes was sent.
    pub(super) fn sent(&mut self, now: SimTime, bytes: usize) {
        self.credit -= (bytes + AROUND_BYTES) as f64;
        self.unanswered_since.get_or_insert(now);
        self.sent_at = now;
    }

    /// Something came back.
    pub(super) fn answered(&mut self) {
        self.unanswered_since = None;
    }

    /// Whether nothing has come back since that time.
    pub(super) fn is_unanswered_since(&self, time: SimTime) -> bool {
        self.unanswered_since.is_some_and(|since| since <= time)
    }

    /// The earliest time at which a datagram may be sent.
    pub(super) fn free_at(&self) -> SimTime {
        let debt = if self.credit < 0.0 { -self.credit / self.bytes_per_sec } else { 0.0 };
        // A nanosecond more than rounding may take away.
        let debt = SimTime::from_secs_f64(debt) + SimTime(u64::from(debt > 0.0));
        (self.credit_at + debt).max(self.next_probe().unwrap_or_default())
    }

    fn next_probe(&self) -> Option<SimTime> {
        let since = self.unanswered_since?;
        (self.sent_at.since(since) > SILENT_AFTER).then(|| self.sent_at + PROBE_EVERY)
    }
}

fn valid(bytes_per_sec: f64) -> f64 {
    if bytes_per_sec.is_finite() { bytes_per_sec.max(1.0) } else { 1e9 }
}

fn burst(bytes_per_sec: f64) -> f64 {
    (bytes_per_sec * BURST_SECS).max(2.0 * (ROWS_PAYLOAD_MAX + AROUND_BYTES) as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Sends whenever it may, for ten seconds; returns the datagrams.
    fn sent(budget: &mut SendBudget, begin: SimTime, answered: bool) -> usize {
        let mut count = 0;
        for ms in 0..10_000 {
            let now = begin + SimTime::from_millis(ms);
            while budget.may_send(now) {
                assert!(budget.free_at() <= now);
                budget.sent(now, 932);
                count += 1;
                if answered {
                    budget.answered();
                }
            }
            assert!(budget.free_at() > now);
        }
        count
    }

    #[test]
    fn the_limit_holds_and_silence_leaves_probes() {
        let mut budget = SendBudget::new(100_000.0);
        // A million bytes, and the burst of five thousand.
        let count = sent(&mut budget, SimTime::ZERO, true);
        assert!((1_004..=1_007).contains(&count), "{count}");
        budget.limit(50_000.0);
        let half = sent(&mut budget, SimTime::from_millis(10_000), true);
        assert!((500..=504).contains(&half), "{half}");
        budget.limit(100_000.0);
        // An idle minute does not add up.
        let later = SimTime::from_millis(70_000);
        assert!((1_004..=1_007).contains(&sent(&mut budget, later, true)));
        let silent = SimTime::from_millis(200_000);
        let first = sent(&mut budget, silent, false);
        assert!((400..=440).contains(&first), "four seconds, then probes: {first}");
        assert_eq!(sent(&mut budget, SimTime::from_millis(210_000), false), 40);
        budget.answered();
        assert!(sent(&mut budget, SimTime::from_millis(220_000), true) > 1_000);
        assert!(SendBudget::new(f64::NAN).may_send(SimTime::ZERO));
    }
}

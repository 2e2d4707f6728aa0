//! Link report: what the receiver of a direction tells its sender, a few times a second.
//!
//! Expected and received datagrams are counted by sequence numbers as in RTP's receiver report (RFC 3550, 6.4
//! and A.3), and the queue is the *least* time that a datagram of the interval stood in queues: a burst
//! leaves it at zero, and a queue that does not drain does not (Nichols and Jacobson, "Controlling queue
//! delay", 2012).

use thiserror::Error;
use trocar_scene::SimTime;

use crate::datagram::ReplayWindow;

/// Bytes of a report.
pub const REPORT_BYTES: usize = 20;
/// How often a report is due.
pub const REPORT_EVERY: SimTime = SimTime::from_millis(250);

/// Counts of one interval, as the receiver saw it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LinkReport {
    /// The newest sequence number that had arrived; a later report has none that is smaller.
    pub newest: u64,
    /// Datagrams that were sent in the interval, by their numbers.
    pub expected: u32,
    /// Datagrams that arrived, each counted once; those that were overtaken from the interval before may be
    /// among them.
    pub received: u32,
    /// Least time in queues \[µs\] of the datagrams that arrived.
    pub queueing_us: u32,
}

/// Why bytes are no report.
#[derive(Clone, Copy, Debug, Error, PartialEq, Eq)]
pub enum ReportError {
    /// The length is wrong.
    #[error("a link report of {0} bytes; it has {REPORT_BYTES}")]
    Length(usize),
    /// More than a session's worth arrived, or none with a number.
    #[error("a link report of {received} datagrams received of {expected} expected up to number {newest}")]
    Counts {
        /// The newest number.
        newest: u64,
        /// Expected.
        expected: u32,
        /// Received.
        received: u32,
    },
}

impl LinkReport {
    /// Little-endian: newest u64, expected u32, received u32, queueing u32 \[µs\].
    pub fn encode(&self) -> [u8; REPORT_BYTES] {
        let mut bytes = [0; REPORT_BYTES];
        bytes[..8].copy_from_slice(&self.newest.to_le_bytes());
        bytes[8..12].copy_from_slice(&self.expected.to_le_bytes());
        bytes[12..16].copy_from_slice(&self.received.to_le_bytes());
        bytes[16..].copy_from_slice(&self.queueing_us.to_le_bytes());
        bytes
    }

    /// Reads a report.
    ///
    /// # Errors
    /// When the length is wrong, or the counts exceed the newest number.
    pub fn decode(bytes: &[u8]) -> Result<Self, ReportError> {
        let bytes: &[u8; REPORT_BYTES] = bytes.try_into().map_err(|_| ReportError::Length(bytes.len()))?;
        let number = |at: usize| u32::from_le_bytes(std::array::from_fn(|byte| bytes[at + byte]));
        let newest = u64::from_le_bytes(std::array::from_fn(|byte| bytes[byte]));
        let (expected, received, queueing_us) = (number(8), number(12), number(16));
        if u64::from(expected.max(received)) > newest {
            return Err(ReportError::Counts { newest, expected, received });
        }
        Ok(Self { newest, expected, received, queueing_us })
    }

    /// Share of the expected that did not arrive; 0 when none was expected.
    pub fn loss(&self) -> f64 {
        loss(self.expected.into(), self.received.into())
    }
}

/// Share of `expected` beyond `received`.
pub(super) fn loss(expected: u64, received: u64) -> f64 {
    if expected == 0 { 0.0 } else { 1.0 - received.min(expected) as f64 / expected as f64 }
}

/// Where a datagram stands among those that arrived before.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Order {
    /// Newer than all of them.
    Newest,
    /// Overtaken by a newer one.
    Late,
    /// It has arrived before, or is older than can be told, or has a number that no sender uses.
    Repeated,
}

/// Counts a connection's datagrams of one direction, of all kinds, since they share their numbers.
#[derive(Clone, Debug, Default)]
pub struct LossMeter {
    window: ReplayWindow,
    first: Option<u64>,
    received: u64,
    late: u64,
    repeated: u64,
    /// Expected and received at the last report, and when that was.
    reported: (u64, u64),
    reported_at: Option<SimTime>,
    queueing: Option<SimTime>,
}

impl LossMeter {
    /// A datagram arrived that stood in queues for `queueing`.
    pub fn arrived(&mut self, sequence: u64, queueing: SimTime) -> Order {
        let newest = self.window.newest();
        if self.window.accept(sequence).is_err() {
            self.repeated += 1;
            return Order::Repeated;
        }
        // Those before the first one may have been sent before anybody listened; one that is overtaken is
        // not.
        self.first = Some(self.first.map_or(sequence, |first| first.min(sequence)));
        self.received += 1;
        self.queueing = Some(self.queueing.map_or(queueing, |least| least.min(queueing)));
        if sequence > newest {
            return Order::Newest;
        }
        self.late += 1;
        Order::Late
    }

    /// Datagrams sent since the first that arrived, up to the newest, by their numbers.
    pub fn expected(&self) -> u64 {
        self.first.map_or(0, |first| self.window.newest() - first + 1)
    }

    /// Datagrams that arrived, each counted once.
    pub fn received(&self) -> u64 {
        self.received
    }

    /// Those of them that a newer one overtook.
    pub fn late(&self) -> u64 {
        self.late
    }

    /// Datagrams that had arrived before.
    pub fn repeated(&self) -> u64 {
        self.repeated
    }

    /// Datagrams that have not arrived, so far: one that is overtaken counts as lost until it comes.
    pub fn lost(&self) -> u64 {
        self.expected().saturating_sub(self.received)
    }

    /// The next report, if [`REPORT_EVERY`] has passed since the last, and a datagram has arrived ever.
    pub fn report(&mut self, now: SimTime) -> Option<LinkReport> {
        let since = *self.reported_at.get_or_insert(now);
        if now.since(since) < REPORT_EVERY || self.first.is_none() {
            return None;
        }
        let (expected, received) = (self.expected(), self.received);
        let count = |now: u64, before: u64| u32::try_from(now - before).unwrap_or(u32::MAX);
        let queueing = self.queueing.take().unwrap_or_default().as_nanos() / 1_000;
        let report = LinkReport {
            newest: self.window.newest(),
            expected: count(expected, self.reported.0),
            received: count(received, self.reported.1),
            queueing_us: u32::try_from(queueing).unwrap_or(u32::MAX),
        };
        (self.reported, self.reported_at) = ((expected, received), Some(now));
        Some(report)
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const MS: fn(u64) -> SimTime = SimTime::from_millis;

    #[test]
    fn a_report_counts_its_own_interval_and_the_least_queue() {
        let mut meter = LossMeter::default();
        assert_eq!(meter.report(MS(0)), None);
        assert_eq!(meter.report(MS(300)), None, "nothing has ever arrived");
        for (sequence, queue) in [(11, 9), (12, 5), (15, 7)] {
            assert_eq!(meter.arrived(sequence, MS(queue)), Order::Newest);
        }
        let report = meter.report(MS(310)).expect("due");
        assert_eq!(report, LinkReport { newest: 15, expected: 5, received: 3, queueing_us: 5_000 });
        assert!((report.loss() - 0.4).abs() < 1e-12);
        assert_eq!(meter.arrived(14, MS(20)), Order::Late);
        assert_eq!(meter.arrived(14, MS(20)), Order::Repeated);
        assert_eq!(meter.arrived(16, MS(21)), Order::Newest);
        assert_eq!(meter.report(MS(550)), None, "not yet");
        let report = meter.report(MS(560)).expect("due");
        assert_eq!(report, LinkReport { newest: 16, expected: 1, received: 2, queueing_us: 20_000 });
        assert_eq!(report.loss(), 0.0);
        assert_eq!((meter.received(), meter.late(), meter.repeated(), meter.lost()), (5, 1, 1, 1));
    }

    #[test]
    fn what_is_no_report_is_refused() {
        assert_eq!(LinkReport::decode(&[0; 19]), Err(ReportError::Length(19)));
        let report = LinkReport { newest: 4, expected: 5, received: 3, queueing_us: 0 };
        let refused = Err(ReportError::Counts { newest: 4, expected: 5, received: 3 });
        assert_eq!(LinkReport::decode(&report.encode()), refused);
    }

    proptest! {
        #[test]
        fn any_bytes_are_a_report_that_encodes_to_them_or_an_error(
            mut bytes in proptest::collection::vec(any::<u8>(), 0..2 * REPORT_BYTES), fits: bool, likely: bool,
        ) {
            if fits {
                bytes.resize(REPORT_BYTES, 7);
                // Most random counts exceed the newest number.
                if likely {
                    bytes[7] |= 1;
                }
            }
            match LinkReport::decode(&bytes) {
                Ok(report) => {
                    prop_assert_eq!(&report.encode()[..], &bytes[..]);
                    prop_assert!((0.0..=1.0).contains(&report.loss()));
                }
                Err(_) => prop_assert!(!(fits && likely)),
            }
        }

        #[test]
        fn a_report_comes_back_as_it_was(
            newest in 0_u64.., expected in 0_u32.., received in 0_u32.., queueing_us in 0_u32..,
        ) {
            let newest = newest.max(expected.max(received).into());
            let report = LinkReport { newest, expected, received, queueing_us };
            prop_assert_eq!(LinkReport::decode(&report.encode()), Ok(report));
        }

        #[test]
        fn counts_add_up_for_every_order_of_arrival(numbers in proptest::collection::vec(1..200_u64, 1..400)) {
            let mut meter = LossMeter::default();
            let mut seen = std::collections::BTreeSet::new();
            for number in numbers {
                let newest = seen.last().copied().unwrap_or(0);
                let order = meter.arrived(number, SimTime::ZERO);
                let expected = match seen.insert(number) {
                    false => Order::Repeated,
                    true if number > newest => Order::Newest,
                    true => Order::Late,
                };
                prop_assert_eq!(order, expected);
            }
            let (first, last) = (*seen.first().expect("one"), *seen.last().expect("one"));
            prop_assert_eq!(meter.expected(), last - first + 1);
            prop_assert_eq!(meter.lost(), last - first + 1 - seen.len() as u64);
        }
    }
}

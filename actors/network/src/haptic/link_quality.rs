//! Link quality: what panels and reports show of a link, in bounded memory.
//!
//! Each quantity has its value of the last second, its median and the value that 99 % stay below since the
//! link began, and a curve with a point a second. Round trip and age are counted at every measurement, the
//! others once a second.

use std::collections::VecDeque;

use serde::{Deserialize, Serialize};
use trocar_kernel::runtime::AtomicHistogram;
use trocar_scene::SimTime;

use super::link_report::loss;
use super::receiver::ReceiverCounts;

/// Most points of the curve; the oldest make room: an hour remains.
pub const POINTS_MAX: usize = 3_600;
/// Time from one point to the next.
pub const POINT_EVERY: SimTime = SimTime::from_millis(1_000);
/// Parts in which shares are counted.
const PARTS: f64 = 1e6;

/// A second of a link.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct LinkPoint {
    /// When the second ended, on the session's clock \[s\].
    pub at: f64,
    /// Mean round trip \[ms\]; `None` if none was measured.
    pub round_trip: Option<f64>,
    /// Jitter of arriving datagrams at its end \[ms\].
    pub jitter: f64,
    /// Share of arriving datagrams that was lost.
    pub loss: f64,
    /// Greatest age of what was shown \[ms\]; `None` if nothing was.
    pub age: Option<f64>,
    /// Datagrams that arrived.
    pub rate: f64,
    /// Bytes that arrived.
    pub bytes_received: f64,
    /// Bytes that were sent.
    pub bytes_sent: f64,
}

/// A quantity: in the last second, and over the link's life.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Figure {
    /// In the last second in which it was measured.
    pub now: f64,
    /// Median.
    pub p50: f64,
    /// 99 % lie below.
    pub p99: f64,
}

/// All quantities of a link.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct LinkSummary {
    /// Round trip \[ms\].
    pub round_trip: Figure,
    /// Jitter \[ms\].
    pub jitter: Figure,
    /// Share lost.
    pub loss: Figure,
    /// Age of what is shown \[ms\].
    pub age: Figure,
    /// Datagrams that arrive \[Hz\].
    pub rate: Figure,
    /// Bytes that arrive [B/s].
    pub bytes_received: Figure,
    /// Bytes that are sent [B/s].
    pub bytes_sent: Figure,
}

/// Values of one quantity, in units small enough for whole numbers.
#[derive(Default)]
struct Quantity {
    histogram: AtomicHistogram,
    now: f64,
}

impl Quantity {
    /// `unit` is how many counted parts one is.
    fn record(&self, value: f64, unit: f64) {
        self.histogram.record((value * unit).round() as u64);
    }

    fn figure(&self, unit: f64) -> Figure {
        let quantiles = self.histogram.quantiles();
        // The histogram takes its values for nanoseconds, and gives microseconds.
        let back = |micros: f64| micros * 1e3 / unit;
        Figure { now: self.now, p50: back(quantiles.p50), p99: back(quantiles.p99) }
    }
}

/// The second that is being measured.
#[derive(Clone, Copy, Debug, Default)]
struct Second {
    began: Option<SimTime>,
    /// Sum and number of round trips \[ns\].
    round_trips: (u64, u64),
    age: Option<SimTime>,
    bytes_received: u64,
    bytes_sent: u64,
    /// The counts when it began.
    counts: ReceiverCounts,
}

/// Quality of a link, as seen from one station. Does not allocate after it was made, but for a summary.
pub struct LinkQuality {
    round_trip: Quantity,
    jitter: Quantity,
    loss: Quantity,
    age: Quantity,
    rate: Quantity,
    bytes_received: Quantity,
    bytes_sent: Quantity,
    second: Second,
    curve: VecDeque<LinkPoint>,
}

impl Default for LinkQuality {
    fn default() -> Self {
        let quantity = Quantity::default;
        Self {
            round_trip: quantity(),
            jitter: quantity(),
            loss: quantity(),
            age: quantity(),
            rate: quantity(),
            bytes_received: quantity(),
            bytes_sent: quantity(),
            second: Second::default(),
            curve: VecDeque::with_capacity(POINTS_MAX),
        }
    }
}

const NANOS_PER_MS: f64 = 1e6;

fn millis(time: SimTime) -> f64 {
    time.as_nanos() as f64 / NANOS_PER_MS
}

impl LinkQuality {
    /// A datagram of so many bytes arrived; its round trip, if it told one.
    pub fn received(&mut self, bytes: usize, round_trip: Option<SimTime>) {
        self.second.bytes_received += bytes as u64;
        if let Some(round_trip) = round_trip {
            let nanos = round_trip.as_nanos();
            self.round_trip.histogram.record(nanos);
            let (sum, count) = self.second.round_trips;
            self.second.round_trips = (sum.saturating_add(nanos), count + 1);
        }
    }

    /// A datagram of so many bytes was sent.
    pub fn sent(&mut self, bytes: usize) {
        self.second.bytes_sent += bytes as u64;
    }

    /// A hand of this age was shown.
    pub fn shown(&mut self, age: SimTime) {
        self.age.histogram.record(age.as_nanos());
        self.second.age = Some(self.second.age.map_or(age, |oldest| oldest.max(age)));
    }

    /// Ends the second when it is over, and gives its point; `counts` and `jitter` are the receiver's. To be
    /// called at every tick, or at least once a second.
    pub fn tick(&mut self, counts: &ReceiverCounts, jitter: SimTime, now: SimTime) -> Option<LinkPoint> {
        let Some(began) = self.second.began else {
            (self.second.began, self.second.counts) = (Some(now), *counts);
            return None;
        };
        let span = now.since(began);
        if span < POINT_EVERY {
            return None;
        }
        let point = self.point(counts, jitter, now, span.as_secs_f64());
        self.second = Second { began: Some(now), counts: *counts, ..Second::default() };
        self.take(&point);
        Some(point)
    }

    fn point(&self, counts: &ReceiverCounts, jitter: SimTime, now: SimTime, secs: f64) -> LinkPoint {
        let Second { round_trips: (sum, count), age, bytes_received, bytes_sent, counts: before, .. } =
            &self.second;
        let received = counts.received.saturating_sub(before.received);
        let sent = (counts.received + counts.lost).saturating_sub(before.received + before.lost);
        LinkPoint {
            at: now.as_secs_f64(),
            round_trip: (*count > 0).then(|| *sum as f64 / *count as f64 / NANOS_PER_MS),
            jitter: millis(jitter),
            loss: loss(sent, received),
            age: age.map(millis),
            rate: received as f64 / secs,
            bytes_received: *bytes_received as f64 / secs,
            bytes_sent: *bytes_sent as f64 / secs,
        }
    }

    fn take(&mut self, point: &LinkPoint) {
        self.jitter.record(point.jitter, NANOS_PER_MS);
        self.loss.record(point.loss, PARTS);
        let plain = [
            (&mut self.rate, point.rate),
            (&mut self.bytes_received, point.bytes_received),
            (&mut self.bytes_sent, point.bytes_sent),
        ];
        for (quantity, value) in plain {
            quantity.record(value, 1.0);
            quantity.now = value;
        }
        (self.jitter.now, self.loss.now) = (point.jitter, point.loss);
        self.round_trip.now = point.round_trip.unwrap_or(self.round_trip.now);
        self.age.now = point.age.unwrap_or(self.age.now);
        if self.curve.len() == POINTS_MAX {
            self.curve.pop_front();
        }
        self.curve.push_back(*point);
    }

    /// All quantities. It copies the histograms: for panels and reports, not for every tick.
    pub fn summary(&self) -> LinkSummary {
        LinkSummary {
            round_trip: self.round_trip.figure(NANOS_PER_MS),
            jitter: self.jitter.figure(NANOS_PER_MS),
            loss: self.loss.figure(PARTS),
            age: self.age.figure(NANOS_PER_MS),
            rate: self.rate.figure(1.0),
            bytes_received: self.bytes_received.figure(1.0),
            bytes_sent: self.bytes_sent.figure(1.0),
        }
    }

    /// The points of the last hour, oldest first.
    pub fn curve(&self) -> impl ExactSizeIterator<Item = &LinkPoint> {
        self.curve.iter()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: fn(u64) -> SimTime = SimTime::from_millis;

    fn counts(received: u64, lost: u64) -> ReceiverCounts {
        ReceiverCounts { received, lost, ..ReceiverCounts::default() }
    }

    /// Runs so many seconds with a datagram each 10 ms, of which every tenth is lost in every second second.
    fn run(quality: &mut LinkQuality, secs: u64) -> ReceiverCounts {
        let mut total = ReceiverCounts::default();
        quality.tick(&total, SimTime::ZERO, SimTime::ZERO);
        for step in 0..100 * secs {
            let is_lost = (step / 100) % 2 == 1 && step % 10 == 0;
            total = counts(total.received + u64::from(!is_lost), total.lost + u64::from(is_lost));
            if !is_lost {
                quality.received(244, Some(MS(150 + step % 100 / 98 * 50)));
            }
            quality.sent(144);
            quality.shown(MS(75 + step % 20));
            quality.tick(&total, MS(3), MS(10 * (step + 1)));
        }
        total
    }

    fn is_near(value: f64, expected: f64) -> bool {
        (value - expected).abs() <= 0.01 * expected.abs() + 1e-9
    }

    #[test]
    fn each_second_has_a_point_with_its_own_numbers() {
        let mut quality = LinkQuality::default();
        run(&mut quality, 4);
        let points: Vec<LinkPoint> = quality.curve().copied().collect();
        assert_eq!(points.len(), 4);
        assert_eq!((points[0].at, points[0].loss, points[0].rate), (1.0, 0.0, 100.0));
        assert!(is_near(points[1].loss, 0.1) && is_near(points[1].rate, 90.0), "{:?}", points[1]);
        assert_eq!((points[0].bytes_received, points[0].bytes_sent), (24_400.0, 14_400.0));
        assert_eq!((points[2].age, points[2].jitter), (Some(94.0), 3.0));
        assert!(is_near(points[2].round_trip.expect("measured"), 151.0), "{:?}", points[2]);
    }

    #[test]
    fn medians_and_tails_are_those_of_what_was_measured() {
        let mut quality = LinkQuality::default();
        assert_eq!(quality.summary(), LinkSummary::default());
        run(&mut quality, 100);
        let summary = quality.summary();
        assert!(
            is_near(summary.round_trip.p50, 150.0) && is_near(summary.round_trip.p99, 200.0),
            "{summary:?}"
        );
        assert!(is_near(summary.age.p50, 84.0) && is_near(summary.age.p99, 94.0), "{summary:?}");
        assert!(is_near(summary.loss.p99, 0.1) && is_near(summary.loss.now, 0.1), "{summary:?}");
        assert!(is_near(summary.loss.p50, 0.0) && is_near(summary.jitter.p50, 3.0), "{summary:?}");
        assert!(is_near(summary.rate.p99, 100.0) && is_near(summary.rate.now, 90.0), "{summary:?}");
        assert!(is_near(summary.bytes_sent.p50, 14_400.0), "{summary:?}");
    }

    #[test]
    fn the_curve_is_bounded_and_keeps_the_newest() {
        let mut quality = LinkQuality::default();
        let room = quality.curve.capacity();
        quality.tick(&counts(0, 0), SimTime::ZERO, SimTime::ZERO);
        for second in 1..=POINTS_MAX as u64 + 50 {
            quality.tick(&counts(second, 0), SimTime::ZERO, MS(1_000 * second));
        }
        assert_eq!((quality.curve().len(), quality.curve.capacity()), (POINTS_MAX, room));
        assert_eq!(quality.curve().next().map(|point| point.at), Some(51.0));
        assert_eq!(quality.curve().last().map(|point| point.at), Some(POINTS_MAX as f64 + 50.0));
    }

    #[test]
    fn a_second_without_datagrams_shows_nothing_measured_and_keeps_the_last() {
        let mut quality = LinkQuality::default();
        let total = run(&mut quality, 2);
        let silent = quality.tick(&total, MS(3), MS(3_000)).expect("a second");
        assert_eq!((silent.round_trip, silent.age, silent.rate, silent.loss), (None, None, 0.0, 0.0));
        assert!(quality.summary().round_trip.now > 149.0);
        // A stall of two seconds is one point, with its rates per second.
        quality.received(244, None);
        let stalled =
            quality.tick(&counts(total.received + 1, total.lost), MS(3), MS(5_000)).expect("two seconds");
        assert_eq!((stalled.rate, stalled.bytes_received), (0.5, 122.0));
    }
}

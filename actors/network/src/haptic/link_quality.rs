//! Link quality: what panels and reports show of a link, in bounded memory.
//!
//! Each quantity has its value of the last second, its median and the value that 99 % stay below since the
//! link began, and a curve with a point a second. Round trip and age are counted at every measurement, the
//! others once a second.

use std::collections::VecDeque;
use std::sync::Arc;

use serde::{Deserialize, Serialize};
use trocar_kernel::runtime::AtomicHistogram;

use super::link_meter::{LinkHistograms, LinkPoint};

/// Most points of the curve; the oldest make room: an hour remains.
pub const POINTS_MAX: usize = 3_600;
/// Parts in which shares are counted.
const PARTS: f64 = 1e6;

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
        figure(&self.histogram, self.now, unit)
    }
}

fn figure(histogram: &AtomicHistogram, now: f64, unit: f64) -> Figure {
    let quantiles = histogram.quantiles();
    // The histogram takes its values for nanoseconds, and gives microseconds.
    let back = |micros: f64| micros * 1e3 / unit;
    Figure { now, p50: back(quantiles.p50), p99: back(quantiles.p99) }
}

/// Quality of a link, as seen from one station: what its meter counts, in figures and curves.
pub struct LinkQuality {
    histograms: Arc<LinkHistograms>,
    round_trip_now: f64,
    age_now: f64,
    jitter: Quantity,
    loss: Quantity,
    rate: Quantity,
    bytes_received: Quantity,
    bytes_sent: Quantity,
    curve: VecDeque<LinkPoint>,
}

/// Units of a counted millisecond.
const NANOS_PER_MS: f64 = 1e6;

impl LinkQuality {
    /// Of the meter with these histograms; every point of it is to be taken.
    pub fn new(histograms: Arc<LinkHistograms>) -> Self {
        let quantity = Quantity::default;
        Self {
            histograms,
            round_trip_now: 0.0,
            age_now: 0.0,
            jitter: quantity(),
            loss: quantity(),
            rate: quantity(),
            bytes_received: quantity(),
            bytes_sent: quantity(),
            curve: VecDeque::with_capacity(POINTS_MAX),
        }
    }

    /// A second is over.
    pub fn take(&mut self, point: &LinkPoint) {
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
        self.round_trip_now = point.round_trip.unwrap_or(self.round_trip_now);
        self.age_now = point.age.unwrap_or(self.age_now);
        if self.curve.len() == POINTS_MAX {
            self.curve.pop_front();
        }
        self.curve.push_back(*point);
    }

    /// All quantities. It copies the histograms: for panels and reports, not for every tick.
    pub fn summary(&self) -> LinkSummary {
        LinkSummary {
            round_trip: figure(&self.histograms.round_trip, self.round_trip_now, NANOS_PER_MS),
            jitter: self.jitter.figure(NANOS_PER_MS),
            loss: self.loss.figure(PARTS),
            age: figure(&self.histograms.age, self.age_now, NANOS_PER_MS),
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
    use trocar_scene::SimTime;

    use super::*;
    use crate::haptic::link_meter::LinkMeter;
    use crate::haptic::receiver::ReceiverCounts;

    const MS: fn(u64) -> SimTime = SimTime::from_millis;

    fn counts(received: u64, lost: u64) -> ReceiverCounts {
        ReceiverCounts { received, lost, ..ReceiverCounts::default() }
    }

    /// A meter with its reader.
    struct Link {
        meter: LinkMeter,
        quality: LinkQuality,
    }

    impl Link {
        fn new() -> Self {
            let meter = LinkMeter::default();
            Self { quality: LinkQuality::new(meter.histograms().clone()), meter }
        }

        fn tick(&mut self, counts: &ReceiverCounts, jitter: SimTime, now: SimTime) -> Option<LinkPoint> {
            let point = self.meter.tick(counts, jitter, now)?;
            self.quality.take(&point);
            Some(point)
        }
    }

    /// Runs so many seconds with a datagram each 10 ms, of which every tenth is lost in every second second.
    fn run(link: &mut Link, secs: u64) -> ReceiverCounts {
        let mut total = ReceiverCounts::default();
        link.tick(&total, SimTime::ZERO, SimTime::ZERO);
        for step in 0..100 * secs {
            let is_lost = (step / 100) % 2 == 1 && step % 10 == 0;
            total = counts(total.received + u64::from(!is_lost), total.lost + u64::from(is_lost));
            if !is_lost {
                link.meter.received(244, Some(MS(150 + step % 100 / 98 * 50)));
            }
            link.meter.sent(144);
            link.meter.shown(MS(75 + step % 20));
            link.tick(&total, MS(3), MS(10 * (step + 1)));
        }
        total
    }

    fn is_near(value: f64, expected: f64) -> bool {
        (value - expected).abs() <= 0.01 * expected.abs() + 1e-9
    }

    #[test]
    fn each_second_has_a_point_with_its_own_numbers() {
        let mut link = Link::new();
        run(&mut link, 4);
        let points: Vec<LinkPoint> = link.quality.curve().copied().collect();
        assert_eq!(points.len(), 4);
        assert_eq!((points[0].at, points[0].loss, points[0].rate), (1.0, 0.0, 100.0));
        assert!(is_near(points[1].loss, 0.1) && is_near(points[1].rate, 90.0), "{:?}", points[1]);
        assert_eq!((points[0].bytes_received, points[0].bytes_sent), (24_400.0, 14_400.0));
        assert_eq!((points[2].age, points[2].jitter), (Some(94.0), 3.0));
        assert!(is_near(points[2].round_trip.expect("measured"), 151.0), "{:?}", points[2]);
    }

    #[test]
    fn medians_and_tails_are_those_of_what_was_measured() {
        let mut link = Link::new();
        assert_eq!(link.quality.summary(), LinkSummary::default());
        run(&mut link, 100);
        let summary = link.quality.summary();
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
        let mut link = Link::new();
        let room = link.quality.curve.capacity();
        link.tick(&counts(0, 0), SimTime::ZERO, SimTime::ZERO);
        for second in 1..=POINTS_MAX as u64 + 50 {
            link.tick(&counts(second, 0), SimTime::ZERO, MS(1_000 * second));
        }
        assert_eq!((link.quality.curve().len(), link.quality.curve.capacity()), (POINTS_MAX, room));
        assert_eq!(link.quality.curve().next().map(|point| point.at), Some(51.0));
        assert_eq!(link.quality.curve().last().map(|point| point.at), Some(POINTS_MAX as f64 + 50.0));
    }

    #[test]
    fn a_second_without_datagrams_shows_nothing_measured_and_keeps_the_last() {
        let mut link = Link::new();
        let total = run(&mut link, 2);
        let silent = link.tick(&total, MS(3), MS(3_000)).expect("a second");
        assert_eq!((silent.round_trip, silent.age, silent.rate, silent.loss), (None, None, 0.0, 0.0));
        assert!(link.quality.summary().round_trip.now > 149.0);
        // A stall of two seconds is one point, with its rates per second.
        link.meter.received(244, None);
        let stalled =
            link.tick(&counts(total.received + 1, total.lost), MS(3), MS(5_000)).expect("two seconds");
        assert_eq!((stalled.rate, stalled.bytes_received), (0.5, 122.0));
    }
}

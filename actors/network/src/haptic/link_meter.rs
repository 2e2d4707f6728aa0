//! Link meter: counts what a link does, on the thread that moves its datagrams. [`LinkQuality`](super::LinkQuality) makes
//! figures and curves of it elsewhere.

use std::sync::Arc;

use serde::{Deserialize, Serialize};
use trocar_kernel::runtime::AtomicHistogram;
use trocar_scene::SimTime;

use super::link_report::loss;
use super::receiver::ReceiverCounts;

/// Time from one point to the next.
pub const POINT_EVERY: SimTime = SimTime::from_millis(1_000);

const NANOS_PER_MS: f64 = 1e6;

fn millis(time: SimTime) -> f64 {
    time.as_nanos() as f64 / NANOS_PER_MS
}

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
    /// Whether the control channel carries datagrams of one direction or both, since they do not arrive by themselves.
    pub is_carried: bool,
}

/// What is counted at every measurement, for meter and reader together \[ns\].
#[derive(Default)]
pub struct LinkHistograms {
    /// Round trips.
    pub round_trip: AtomicHistogram,
    /// Ages of what was shown.
    pub age: AtomicHistogram,
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

/// Counts a link's datagrams, and gives a point each second. Does not allocate after it was made.
#[derive(Default)]
pub struct LinkMeter {
    histograms: Arc<LinkHistograms>,
    second: Second,
}

impl LinkMeter {
    /// What the reader needs beside the points.
    pub fn histograms(&self) -> &Arc<LinkHistograms> {
        &self.histograms
    }

    /// A datagram of so many bytes arrived; its round trip, if it told one.
    pub fn received(&mut self, bytes: usize, round_trip: Option<SimTime>) {
        self.second.bytes_received += bytes as u64;
        if let Some(round_trip) = round_trip {
            let nanos = round_trip.as_nanos();
            self.histograms.round_trip.record(nanos);
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
        self.histograms.age.record(age.as_nanos());
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
            is_carried: false,
        }
    }
}

//! Clock synchronisation: what another station's session clock shows, from the datagrams that come anyway.
//!
//! Four time stamps give offset and round trip (Mills, "Internet time synchronization: the Network Time
//! Protocol", 1991): when our datagram was sent, when it arrived there, when theirs was sent, when it arrived
//! here. The second is not sent: an echo says for how long the datagram was held, and the third minus that is
//! the second.
//!
//! With offset `o` (their clock minus ours), the way there shows `f = o + delay there`, the way back
//! `b = delay back − o`. Queues only ever lengthen a delay, so the smallest `f` and the smallest `b` of each
//! second are kept, each direction by itself: with jitter both are near their bounds long before a single
//! round trip is. `(f − b) / 2` is the offset, but for half the path's asymmetry, which no exchange of times
//! can see. The median slope over the pairs of seconds (Theil 1950, Sen 1968) is the skew; it is not moved by
//! seconds in which a queue stood. The offset is that of the second with the shortest round trip, which
//! counts as longer the older it is, carried on along the slope.
//!
//! Both clocks are monotonic session clocks, and no wall clock enters. A clock that was stopped is noticed:
//! every exchange bounds the offset to `−b ≤ o ≤ f` (Marzullo and Owicki, "Maintaining the time in a
//! distributed system", 1983), and an estimate that lies outside again and again is dropped.

use trocar_scene::SimTime;

use crate::datagram::ClockEcho;

/// Seconds that are kept.
pub const WINDOW: usize = 32;
/// Greatest skew that is believed: crystals are within 100 ppm, and NTP's bound is 500.
pub const SKEW_MAX: f64 = 500e-6;
/// Length of what is called a second \[ns\].
const BIN: u64 = 1_000_000_000;
/// Span over which the slope is measured at least \[ns\]; over a shorter one jitter would be taken for skew.
const SPAN_MIN: f64 = 4e9;
/// How much longer a round trip counts for each second of age: twice what the skew may be off, known and
/// unknown.
const AGEING: [f64; 2] = [2.0 * 20e-6, 2.0 * 100e-6];
/// So many exchanges in a row must contradict the estimate by this much \[ns\] before it is dropped.
const CONTRADICTIONS: u32 = 16;
const CONTRADICTION: f64 = 1e6;
/// How much longer than the shortest \[ns\], besides the jitter, a second's round trip may be for the skew.
const QUEUE_MAX: f64 = 1e6;
/// Pairs of the seconds kept.
const PAIRS: usize = WINDOW * (WINDOW - 1) / 2;

/// A reading \[ns\], and when it was taken on our clock.
#[derive(Clone, Copy, Debug)]
struct Reading {
    value: i64,
    at: SimTime,
}

impl Reading {
    fn keep_smaller(kept: &mut Option<Self>, value: i64, at: SimTime) {
        if kept.is_none_or(|kept| value <= kept.value) {
            *kept = Some(Self { value, at });
        }
    }
}

/// The smallest readings of a second.
#[derive(Clone, Copy, Debug, Default)]
struct Second {
    number: u64,
    there: Option<Reading>,
    back: Option<Reading>,
}

/// The offset that a second shows.
#[derive(Clone, Copy, Debug)]
struct Shown {
    offset: f64,
    /// The instant on our clock for which it holds, exactly so while the skew is constant.
    at: f64,
    round_trip: f64,
}

impl Second {
    fn shown(&self) -> Option<Shown> {
        let (there, back) = (self.there?, self.back?);
        Some(Shown {
            offset: 0.5 * (there.value as f64 - back.value as f64),
            at: 0.5 * (there.at.as_nanos() as f64 + back.at.as_nanos() as f64),
            round_trip: there.value as f64 + back.value as f64,
        })
    }
}

/// What a datagram said about the path.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Transit {
    /// How much longer it took than the fastest of the last seconds: the time in queues. Needs no echo.
    pub queueing: SimTime,
    /// How long it took, by the estimate of the offset; `None` before the first echo.
    pub delay: Option<SimTime>,
    /// Round trip without the time held, if the datagram echoed one of ours for the first time.
    pub round_trip: Option<SimTime>,
}

/// Estimates of another station's clock, and of the path to it. One for each connection.
#[derive(Clone, Debug)]
pub struct ClockSync {
    seconds: [Second; WINDOW],
    /// The second that is being filled.
    current: usize,
    skew: Option<f64>,
    best: Option<Shown>,
    /// Place for the slopes.
    slopes: Box<[f64; PAIRS]>,
    /// The newest datagram: when it was sent there, when it arrived here, and how long that took by both
    /// clocks.
    newest: Option<(SimTime, SimTime, i64)>,
    newest_echo: Option<SimTime>,
    round_trip: Option<f64>,
    jitter: f64,
    contradictions: u32,
    resets: u64,
    refused: u64,
}

impl Default for ClockSync {
    fn default() -> Self {
        Self {
            seconds: [Second::default(); WINDOW],
            current: 0,
            skew: None,
            best: None,
            slopes: Box::new([0.0; PAIRS]),
            newest: None,
            newest_echo: None,
            round_trip: None,
            jitter: 0.0,
            contradictions: 0,
            resets: 0,
            refused: 0,
        }
    }
}

impl ClockSync {
    /// A datagram that was sent at `sent_at` (their clock) has arrived at `now` (ours, not decreasing).
    pub fn received(&mut self, sent_at: SimTime, echo: Option<ClockEcho>, now: SimTime) -> Transit {
        let back = difference(now, sent_at);
        self.begin_second(now);
        Reading::keep_smaller(&mut self.seconds[self.current].back, back, now);
        self.note_jitter(sent_at, now, back);
        let round_trip = echo.and_then(|echo| self.echoed(sent_at, echo, back, now));
        self.choose(now);
        Transit { queueing: self.queueing(back, now), delay: self.delay(sent_at, now), round_trip }
    }

    /// What our next datagram echoes: their newest datagram, and for how long it has been held at `now`.
    pub fn echo(&self, now: SimTime) -> Option<ClockEcho> {
        self.newest.map(|(sent_at, arrived, _)| ClockEcho { sent_at, held: now.since(arrived) })
    }

    /// Their clock minus ours \[ns\] at `now` on ours; `None` before the first echo.
    ///
    /// It is corrected as better readings come, by small steps: times that are converted at different
    /// instants need not be in order.
    pub fn offset(&self, now: SimTime) -> Option<i64> {
        self.best.map(|best| self.carried(&best, now).round() as i64)
    }

    /// What our clock showed when theirs showed `remote`, by the estimate at `now`.
    pub fn to_local(&self, remote: SimTime, now: SimTime) -> Option<SimTime> {
        self.offset(now).map(|offset| shifted(remote, offset.saturating_neg()))
    }

    /// What their clock showed when ours showed `local`, by the estimate at `now`.
    pub fn to_remote(&self, local: SimTime, now: SimTime) -> Option<SimTime> {
        self.offset(now).map(|offset| shifted(local, offset))
    }

    /// How long before `now` their clock showed `sent_at`; at the arrival of a datagram, the delay of its
    /// way.
    pub fn delay(&self, sent_at: SimTime, now: SimTime) -> Option<SimTime> {
        self.to_local(sent_at, now).map(|local| now.since(local))
    }

    /// Round trip without the time held, smoothed over eight echoes.
    pub fn round_trip(&self) -> Option<SimTime> {
        self.round_trip.map(|nanos| SimTime(nanos as u64))
    }

    /// The shortest delays there and back in one of the seconds kept, together.
    pub fn round_trip_min(&self) -> Option<SimTime> {
        let shown = self.seconds.iter().filter_map(Second::shown);
        shown.map(|shown| shown.round_trip).min_by(f64::total_cmp).map(|nanos| SimTime(nanos.max(0.0) as u64))
    }

    /// Mean deviation of the delay between neighbouring datagrams (RFC 3550, 6.4.1).
    pub fn jitter(&self) -> SimTime {
        SimTime(self.jitter as u64)
    }

    /// How much faster their clock runs than ours, as a share; `None` until it has been measured for seconds.
    pub fn skew(&self) -> Option<f64> {
        self.skew
    }

    /// How often the estimate was dropped since the exchanges contradicted it: a clock was stopped or set.
    pub fn resets(&self) -> u64 {
        self.resets
    }

    /// Echoes that cannot be: of a datagram that is yet to be sent, or held for longer than the round trip.
    pub fn refused(&self) -> u64 {
        self.refused
    }

    fn begin_second(&mut self, now: SimTime) {
        let number = now.as_nanos() / BIN;
        if self.seconds[self.current].number == number {
            return;
        }
        self.measure_skew();
        self.current = (self.current + 1) % WINDOW;
        self.seconds[self.current] = Second { number, ..Second::default() };
        // After a silence, seconds remain in the ring that are older than the window.
        for second in &mut self.seconds {
            if number.saturating_sub(second.number) >= WINDOW as u64 {
                *second = Second { number: second.number, ..Second::default() };
            }
        }
    }

    fn note_jitter(&mut self, sent_at: SimTime, now: SimTime, back: i64) {
        match self.newest {
            Some((newest, _, _)) if sent_at <= newest => return,
            Some((_, _, last)) => {
                self.jitter += (back.saturating_sub(last).unsigned_abs() as f64 - self.jitter) / 16.0;
            }
            None => {}
        }
        self.newest = Some((sent_at, now, back));
    }

    fn echoed(&mut self, sent_at: SimTime, echo: ClockEcho, back: i64, now: SimTime) -> Option<SimTime> {
        // The same datagram may be echoed many times, and arrived there but once.
        if self.newest_echo.is_some_and(|newest| echo.sent_at <= newest) {
            return None;
        }
        if echo.sent_at > now || echo.held > now.since(echo.sent_at) {
            self.refused += 1;
            return None;
        }
        self.newest_echo = Some(echo.sent_at);
        let there = difference(sent_at, echo.sent_at + echo.held);
        self.check(there, back, now);
        Reading::keep_smaller(&mut self.seconds[self.current].there, there, now);
        let round_trip = now.since(echo.sent_at).since(echo.held);
        let nanos = round_trip.as_nanos() as f64;
        self.round_trip = Some(self.round_trip.map_or(nanos, |smooth| smooth + (nanos - smooth) / 8.0));
        Some(round_trip)
    }

    /// Drops all estimates when one exchange after the other says that the offset cannot be what is
    /// estimated.
    fn check(&mut self, there: i64, back: i64, now: SimTime) {
        let Some(best) = self.best else { return };
        let offset = self.carried(&best, now);
        let is_possible = offset <= there as f64 + CONTRADICTION && offset >= -(back as f64) - CONTRADICTION;
        self.contradictions = if is_possible { 0 } else { self.contradictions + 1 };
        if self.contradictions >= CONTRADICTIONS {
            let number = self.seconds[self.current].number;
            self.seconds = [Second::default(); WINDOW];
            let back = Some(Reading { value: back, at: now });
            self.seconds[self.current] = Second { number, there: None, back };
            (self.best, self.skew, self.contradictions) = (None, None, 0);
            self.resets += 1;
        }
    }

    fn measure_skew(&mut self) {
        // A second in which a queue stood shows the queue.
        let least = self.seconds.iter().filter_map(Second::shown).map(|shown| shown.round_trip);
        let bound = least.fold(f64::INFINITY, f64::min) + QUEUE_MAX + self.jitter;
        let free = |second: &Second| second.shown().filter(|shown| shown.round_trip <= bound);
        let mut pairs = 0;
        for (index, first) in self.seconds.iter().enumerate() {
            let Some(first) = free(first) else { continue };
            for second in self.seconds[..index].iter().filter_map(free) {
                let span = first.at - second.at;
                if span.abs() >= SPAN_MIN {
                    self.slopes[pairs] = (first.offset - second.offset) / span;
                    pairs += 1;
                }
            }
        }
        if pairs > 0 {
            let (_, median, _) = self.slopes[..pairs].select_nth_unstable_by(pairs / 2, f64::total_cmp);
            self.skew = Some(median.clamp(-SKEW_MAX, SKEW_MAX));
        }
    }

    fn choose(&mut self, now: SimTime) {
        let now = now.as_nanos() as f64;
        let ageing = AGEING[usize::from(self.skew.is_none())];
        let cost = |shown: &Shown| shown.round_trip + ageing * (now - shown.at);
        let shown = self.seconds.iter().filter_map(Second::shown);
        self.best = shown.min_by(|a, b| cost(a).total_cmp(&cost(b))).or(self.best);
    }

    fn carried(&self, shown: &Shown, now: SimTime) -> f64 {
        shown.offset + self.skew.unwrap_or(0.0) * (now.as_nanos() as f64 - shown.at)
    }

    /// `back` above the smallest reading of the window, each carried on along the skew.
    fn queueing(&self, back: i64, now: SimTime) -> SimTime {
        let skew = self.skew.unwrap_or(0.0);
        // Their faster clock makes later readings smaller.
        let carried = |back: &Reading| back.value as f64 - skew * now.since(back.at).as_nanos() as f64;
        let readings = self.seconds.iter().filter_map(|second| second.back);
        let least = readings.map(|back| carried(&back)).fold(back as f64, f64::min);
        SimTime((back as f64 - least) as u64)
    }
}

/// `a − b` \[ns\], as near as it can be represented.
fn difference(a: SimTime, b: SimTime) -> i64 {
    let nanos = i128::from(a.as_nanos()) - i128::from(b.as_nanos());
    nanos.clamp(i64::MIN.into(), i64::MAX.into()) as i64
}

fn shifted(time: SimTime, nanos: i64) -> SimTime {
    SimTime(time.as_nanos().saturating_add_signed(nanos))
}

#[cfg(test)]
#[path = "clock_sync_tests.rs"]
mod tests;

//! Rate ladder: how often hands are sent, 1,000, 500, 250 or 60 times a second, by what the receiver reports.
//!
//! A rung down at a loss of [`LOSS_DOWN`], or when the time in queues has grown for [`GROWING`]: the path
//! carries less than it is given. Up as carefully as TCP's additive increase after its multiplicative
//! decrease (Chiu and Jain, 1989): a rung at a time, after a quiet time that doubles with each failed
//! attempt. Between [`LOSS_UP`] and [`LOSS_DOWN`] the rate stays.
//!
//! A radio that loses at random cannot be told from a queue that overflows but by the rate: when as much is
//! lost on the lowest rung as on the highest, the loss is not ours. The rate then returns to its top, that
//! loss is tolerated, and only what is lost beyond it counts.

use serde::{Deserialize, Serialize};
use trocar_scene::SimTime;

use super::link_report::{LinkReport, loss};

/// Share of lost datagrams from which the rate goes down.
pub const LOSS_DOWN: f64 = 0.2;
/// Share of lost datagrams above which the rate does not go up.
pub const LOSS_UP: f64 = 0.05;
/// How long the time in queues must have grown before the rate goes down.
pub const GROWING: SimTime = SimTime::from_millis(2_000);
/// By how much it must have grown \[µs\]: less is jitter.
pub const GROWTH_US: u32 = 10_000;
/// A report with so much less time in queues \[µs\] than the one before it ends the growth.
const DRAINED_US: u32 = 2_000;
/// A queue that has not grown by [`RISEN_US`] for this long stands; a longer path looks the same.
const STANDS: SimTime = SimTime::from_millis(1_000);
const RISEN_US: u32 = 1_000;
/// Fewest datagrams from which a loss is judged: with 50 of which a tenth is lost, a fifth has a chance of 1
/// %.
const JUDGED: u64 = 50;
/// Fewest reports: a second's, so that a break of a tenth of a second is not taken for a bad link.
const REPORTS_JUDGED: u32 = 4;
/// Datagrams from which the loss on the lowest rung is compared with that on the highest.
const COMPARED: u64 = 200;
/// A loss is not ours if by the lowest rate no more than this many times the share arrives.
const CURED: f64 = 1.12;
/// Greatest loss that is tolerated: of a kilohertz, a hundred still arrive.
const TOLERATED_MAX: f64 = 0.9;
/// How much the tolerated loss may exceed the loss that is measured.
const TOLERANCE: f64 = 0.05;
/// Time after a change during which reports are still of the rate before, besides the round trip.
const SETTLE: SimTime = SimTime::from_millis(500);
/// Quiet time before the first attempt to go up.
pub const QUIET_MIN: SimTime = SimTime::from_millis(5_000);
/// Longest quiet time.
pub const QUIET_MAX: SimTime = SimTime::from_millis(80_000);
/// An attempt that holds for so long has succeeded.
const HELD: SimTime = SimTime::from_millis(10_000);
/// Without a report for so long, after there were some, the rate goes down.
pub const SILENCE: SimTime = SimTime::from_millis(2_000);

/// A rung of the ladder.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub enum Rate {
    /// 60 a second: a hand is seen to move smoothly.
    Hz60,
    /// 250 a second.
    Hz250,
    /// 500 a second.
    Hz500,
    /// 1,000 a second: as often as forces are rendered.
    #[default]
    Hz1000,
}

impl Rate {
    /// All of them, lowest first.
    pub const ALL: [Self; 4] = [Self::Hz60, Self::Hz250, Self::Hz500, Self::Hz1000];

    /// Datagrams a second.
    pub fn hz(self) -> u32 {
        [60, 250, 500, 1_000][self as usize]
    }

    /// Time from one datagram to the next.
    pub fn period(self) -> SimTime {
        SimTime(1_000_000_000 / u64::from(self.hz()))
    }

    fn below(self) -> Self {
        Self::ALL[(self as usize).saturating_sub(1)]
    }

    fn above(self) -> Self {
        Self::ALL[(self as usize + 1).min(Self::ALL.len() - 1)]
    }
}

/// Why the rate changed.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum RateReason {
    /// Down: this share was lost.
    Loss(f64),
    /// Down: the time in queues has grown by this much, and for [`GROWING`].
    Queue(SimTime),
    /// Down: no report has come for [`SILENCE`].
    NoReport,
    /// Up: nothing was wrong for this long.
    Quiet(SimTime),
    /// Up: this share is lost at the lowest rate as well.
    NotOurs(f64),
}

/// A change of the rate.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct RateChange {
    /// When.
    pub at: SimTime,
    /// From which rate.
    pub from: Rate,
    /// To which rate.
    pub to: Rate,
    /// Why.
    pub reason: RateReason,
}

/// How the time in queues has grown \[µs\]: since when and from what, the newest report's, and the greatest
/// and when.
#[derive(Clone, Copy, Debug)]
struct Growth {
    since: SimTime,
    from_us: u32,
    last_us: u32,
    peak_us: u32,
    peak_at: SimTime,
}

/// The rate of one direction of a connection.
#[derive(Clone, Debug)]
pub struct RateLadder {
    top: Rate,
    rate: Rate,
    changed: Option<RateChange>,
    downs: u64,
    /// Expected and received, until there are enough to judge.
    counted: (u64, u64),
    counted_for: u32,
    growth: Option<Growth>,
    /// Share that was lost before the rate first went down, until it has climbed again.
    lost_above: Option<f64>,
    /// Share that is lost at any rate, and the measured share, smoothed.
    tolerated: f64,
    smooth: f64,
    /// Since when nothing has been wrong.
    quiet_since: Option<SimTime>,
    quiet: SimTime,
    /// Whether the last change was up, and may still turn out to be too much.
    is_attempt: bool,
    newest: u64,
    heard: Option<SimTime>,
}

impl Default for RateLadder {
    fn default() -> Self {
        Self::new(Rate::Hz1000)
    }
}

impl RateLadder {
    /// A ladder that begins at its top, `top`: 1 kHz is for hands whose forces are rendered.
    pub fn new(top: Rate) -> Self {
        Self {
            top,
            rate: top,
            changed: None,
            downs: 0,
            counted: (0, 0),
            counted_for: 0,
            growth: None,
            lost_above: None,
            tolerated: 0.0,
            smooth: 0.0,
            quiet_since: None,
            quiet: QUIET_MIN,
            is_attempt: false,
            newest: 0,
            heard: None,
        }
    }

    /// Begins again at the top: the path is another one.
    pub fn restart(&mut self) {
        *self = Self { downs: self.downs, newest: self.newest, ..Self::new(self.top) };
    }

    /// The rate now.
    pub fn rate(&self) -> Rate {
        self.rate
    }

    /// The last change; `None` if there was none.
    pub fn last_change(&self) -> Option<&RateChange> {
        self.changed.as_ref()
    }

    /// How often the rate went down.
    pub fn downs(&self) -> u64 {
        self.downs
    }

    /// A report arrived at `now`; `round_trip` is the path's, as far as it is known. Reports may repeat or
    /// come out of order.
    pub fn report(&mut self, report: &LinkReport, round_trip: SimTime, now: SimTime) -> Option<RateChange> {
        if report.newest < self.newest {
            return None;
        }
        (self.newest, self.heard) = (report.newest, Some(now));
        if self.changed.is_some_and(|change| now.since(change.at) < SETTLE + round_trip) {
            return None;
        }
        let quiet_since = *self.quiet_since.get_or_insert(now);
        self.counted.0 += u64::from(report.expected);
        self.counted.1 += u64::from(report.received.min(report.expected));
        if let Some(grown) = self.grown(report, now) {
            return self.down(RateReason::Queue(grown), now);
        }
        self.counted_for += 1;
        let is_compared = self.lost_above.is_some() && self.rate == Rate::Hz60;
        let enough = if is_compared { COMPARED } else { JUDGED };
        if self.counted.0 >= enough && self.counted_for >= REPORTS_JUDGED {
            let lost = loss(self.counted.0, self.counted.1);
            (self.counted, self.counted_for) = ((0, 0), 0);
            if let Some(judged) = self.judge(lost, now) {
                return judged;
            }
        }
        self.up(quiet_since, now)
    }

    /// What follows from a measured loss: a change or none; nothing if the loss is no hindrance to going up.
    fn judge(&mut self, lost: f64, now: SimTime) -> Option<Option<RateChange>> {
        self.smooth += (lost - self.smooth) / 8.0;
        self.tolerated = self.tolerated.min(self.smooth + TOLERANCE);
        let excess = ((lost - self.tolerated) / (1.0 - self.tolerated)).max(0.0);
        if let Some(above) = self.lost_above.filter(|_| self.rate == Rate::Hz60) {
            // By chance one comparison may fail; the next ones are as good.
            if excess >= LOSS_UP && 1.0 - lost <= CURED * (1.0 - above) {
                (self.tolerated, self.smooth) = (lost.min(TOLERATED_MAX), lost);
                return Some(self.change(self.top, RateReason::NotOurs(lost), now));
            }
        }
        if excess >= LOSS_DOWN {
            if self.rate > Rate::Hz60 {
                self.lost_above.get_or_insert(lost);
            }
            return Some(self.down(RateReason::Loss(lost), now));
        }
        if excess > LOSS_UP {
            self.quiet_since = Some(now);
            return Some(None);
        }
        None
    }

    /// Time passes without a report, as far as this end knows.
    pub fn tick(&mut self, now: SimTime) -> Option<RateChange> {
        if self.heard.is_none_or(|heard| now.since(heard) < SILENCE) {
            return None;
        }
        self.heard = Some(now);
        self.down(RateReason::NoReport, now)
    }

    /// By how much the time in queues has grown, when it has for long enough.
    fn grown(&mut self, report: &LinkReport, now: SimTime) -> Option<SimTime> {
        let last_us = report.queueing_us;
        let new = Growth { since: now, from_us: last_us, last_us, peak_us: last_us, peak_at: now };
        let goes_on = |growth: &Growth| {
            let is_drained = last_us.saturating_add(DRAINED_US) < growth.last_us;
            !is_drained
                && (last_us > growth.peak_us.saturating_add(RISEN_US) || now.since(growth.peak_at) < STANDS)
        };
        let mut growth = self.growth.filter(goes_on).unwrap_or(new);
        growth.last_us = last_us;
        if last_us > growth.peak_us.saturating_add(RISEN_US) {
            (growth.peak_us, growth.peak_at) = (last_us, now);
        }
        self.growth = Some(growth);
        let grown = last_us.saturating_sub(growth.from_us);
        let is_long = now.since(growth.since) >= GROWING;
        (is_long && grown >= GROWTH_US).then(|| SimTime::from_micros(grown.into()))
    }

    fn down(&mut self, reason: RateReason, now: SimTime) -> Option<RateChange> {
        if self.is_attempt {
            self.quiet = (self.quiet + self.quiet).min(QUIET_MAX);
        }
        self.change(self.rate.below(), reason, now)
    }

    fn up(&mut self, quiet_since: SimTime, now: SimTime) -> Option<RateChange> {
        if self.is_attempt && self.changed.is_some_and(|change| now.since(change.at) >= HELD) {
            self.is_attempt = false;
            self.quiet = SimTime(self.quiet.as_nanos() / 2).max(QUIET_MIN);
        }
        let quiet = now.since(quiet_since);
        if self.rate >= self.top || quiet < self.quiet {
            return None;
        }
        self.change(self.rate.above(), RateReason::Quiet(quiet), now)
    }

    fn change(&mut self, to: Rate, reason: RateReason, now: SimTime) -> Option<RateChange> {
        (self.counted, self.counted_for) = ((0, 0), 0);
        (self.growth, self.quiet_since) = (None, None);
        let from = std::mem::replace(&mut self.rate, to);
        if from == to {
            return None;
        }
        self.is_attempt = to > from;
        if self.is_attempt {
            self.lost_above = None;
        }
        self.downs += u64::from(to < from);
        self.changed = Some(RateChange { at: now, from, to, reason });
        self.changed
    }
}

#[cfg(test)]
#[path = "rate_ladder_tests.rs"]
mod tests;

//! Sender of hands: whether a datagram goes at this tick, and why.
//!
//! A datagram has the newest sample of every hand. Nothing is ever queued: what cannot go now is asked for
//! again at the next tick, with newer samples. In this order a datagram goes
//!
//! 1. at once, if a button, what is held, or a connection changed;
//! 2. at the earliest a period of the [`RateLadder`] after the last, if the deadband is off, or the receiver is probably
//!    wrong by more than the deadband ([`ReceiverBelief`]);
//! 3. at the latest after a heartbeat, of 20 ms. With loss heartbeats come closer, so that of ten thousand
//!    silences of the sender not one is so long at the receiver that a force fades.

use trocar_scene::SimTime;

use super::clock_sync::ClockSync;
use super::deadband::Deadband;
use super::link_report::LinkReport;
use super::rate_ladder::{Rate, RateChange, RateLadder};
use super::receiver_belief::ReceiverBelief;
use crate::datagram::ClockEcho;
use crate::hand_sample::HandSample;

/// Longest time between two datagrams.
pub const HEARTBEAT: SimTime = SimTime::from_millis(20);
/// Within this time one heartbeat at least must arrive: what a force stands without fading, less a tick at
/// each end and jitter.
const HEARD_WITHIN: SimTime = SimTime::from_millis(45);
/// Probability that none does.
const UNHEARD: f64 = 1e-4;
/// By how many times the jitter a datagram may come later than the one before it, and the least time \[s\] that is then left
/// for heartbeats. The jitter of the way here stands for that of the way there, which this end does not see.
const JITTERS: f64 = 1.5;
const LEFT_MIN: f64 = 0.015;
/// Least time between two discrete changes that go before the ladder's period has passed: a contact that bounces at every
/// tick does not climb around the ladder.
pub const DISCRETE_GAP: SimTime = SimTime::from_millis(4);
/// How much earlier than the ladder's period a datagram may go: ticks come with jitter.
const EARLY: SimTime = SimTime::from_micros(250);
/// How much of a period that passed without a datagram is made up for, at most half of it.
const MISSED_MAX: SimTime = SimTime::from_millis(2);
/// Longest path that is reckoned with beyond the round trip, besides four times the jitter.
const LOST_MARGIN: SimTime = SimTime::from_millis(5);

/// How hands are sent.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SenderConfig {
    /// Greatest rate.
    pub top: Rate,
    /// What need not be sent; `None` to send at every period.
    pub deadband: Option<Deadband>,
}

impl Default for SenderConfig {
    fn default() -> Self {
        Self { top: Rate::Hz1000, deadband: Some(Deadband::default()) }
    }
}

/// Why a datagram goes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SendReason {
    /// A button, what is held, a connection, or the set of hands changed.
    Discrete,
    /// A period has passed, and the deadband is off.
    Period,
    /// The receiver is probably wrong about something noticeable.
    Deadband,
    /// Nothing has been sent for a while.
    Heartbeat,
}

/// A datagram that is to go now.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Outgoing {
    /// Why.
    pub reason: SendReason,
    /// What it says of the other side's newest datagram.
    pub echo: Option<ClockEcho>,
}

/// Counts since the sender was made.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SenderCounts {
    /// Ticks.
    pub ticks: u64,
    /// Datagrams sent for a discrete change.
    pub discrete: u64,
    /// Datagrams sent for their period.
    pub period: u64,
    /// Datagrams sent for the deadband.
    pub deadband: u64,
    /// Heartbeats.
    pub heartbeat: u64,
    /// Ticks at which one was to go and did not, for want of room below.
    pub blocked: u64,
}

impl SenderCounts {
    /// Datagrams sent.
    pub fn sent(&self) -> u64 {
        self.discrete + self.period + self.deadband + self.heartbeat
    }
}

/// Decides when the hands of a station go to one other station. Does not allocate after it was made.
#[derive(Clone, Debug)]
pub struct HapticSender {
    deadband: Option<Deadband>,
    ladder: RateLadder,
    belief: ReceiverBelief,
    /// When the last datagram went, and the earliest time for the next.
    last: Option<SimTime>,
    earliest: SimTime,
    /// When the last one went for a discrete change.
    last_discrete: Option<SimTime>,
    heartbeat: SimTime,
    /// Why the datagram goes that was last asked for.
    reason: Option<SendReason>,
    counts: SenderCounts,
}

impl HapticSender {
    /// A sender; a deadband that is not valid counts as off.
    pub fn new(config: &SenderConfig) -> Self {
        let belief = ReceiverBelief::default();
        Self {
            deadband: config.deadband.filter(Deadband::is_valid),
            ladder: RateLadder::new(config.top),
            heartbeat: heartbeat(belief.loss(), SimTime::ZERO),
            belief,
            last: None,
            last_discrete: None,
            earliest: SimTime::ZERO,
            reason: None,
            counts: SenderCounts::default(),
        }
    }

    /// A tick at `now`, which must not decrease, with the newest sample of every hand, always in the same
    /// order. `clock` is that of the receiver of the other direction. [`Self::sent`] or [`Self::blocked`]
    /// must follow when a datagram is to go.
    pub fn tick(&mut self, samples: &[HandSample], clock: &ClockSync, now: SimTime) -> Option<Outgoing> {
        self.counts.ticks += 1;
        self.ladder.tick(now);
        self.reason = self.due(samples, now);
        self.reason.map(|reason| Outgoing { reason, echo: clock.echo(now) })
    }

    fn due(&self, samples: &[HandSample], now: SimTime) -> Option<SendReason> {
        let is_early = now + EARLY < self.earliest;
        let has_bounced = self.last_discrete.is_some_and(|last| now.since(last) + EARLY < DISCRETE_GAP);
        if !(is_early && has_bounced) && self.belief.is_discretely_new(samples) {
            return Some(SendReason::Discrete);
        }
        if is_early {
            return None;
        }
        let Some(deadband) = &self.deadband else { return Some(SendReason::Period) };
        if self.last.is_none_or(|last| now.since(last) + EARLY >= self.heartbeat) {
            return Some(SendReason::Heartbeat);
        }
        self.belief.wrong(deadband, samples).is_too_likely().then_some(SendReason::Deadband)
    }

    /// The datagram went, with these samples.
    pub fn sent(&mut self, samples: &[HandSample], now: SimTime) {
        // The very first tells everything, and is no bounce.
        if self.reason == Some(SendReason::Discrete) && self.last.is_some() {
            self.last_discrete = Some(now);
        }
        let count = match self.reason.take() {
            Some(SendReason::Discrete) => &mut self.counts.discrete,
            Some(SendReason::Deadband) => &mut self.counts.deadband,
            Some(SendReason::Heartbeat) => &mut self.counts.heartbeat,
            Some(SendReason::Period) | None => &mut self.counts.period,
        };
        *count += 1;
        self.belief.sent(now, samples);
        self.last = Some(now);
        // The periods follow each other exactly though ticks do not meet them; more than that is not made up
        // for.
        let period = self.ladder.rate().period();
        let missed = SimTime(period.as_nanos() / 2).min(MISSED_MAX);
        // Discrete changes go ahead of the periods, and are no debt for which later datagrams would have to wait.
        self.earliest = (self.earliest.max(now.since(missed)) + period).min(now + EARLY + period);
    }

    /// A datagram with these samples went another way, which has its own rate.
    pub fn carried(&mut self, samples: &[HandSample], now: SimTime) {
        self.counts.period += 1;
        self.belief.sent(now, samples);
        self.last = Some(now);
    }

    /// The path is another one, or was lost and is found again: its rate is to be found anew.
    pub fn restart(&mut self) {
        self.ladder.restart();
    }

    /// The datagram did not go: there was no room below. The next tick tries again with newer samples.
    pub fn blocked(&mut self) {
        self.counts.blocked += u64::from(self.reason.take().is_some());
    }

    /// A datagram of the other side arrived with this echo; `clock` has seen it.
    pub fn echoed(&mut self, echo: ClockEcho, clock: &ClockSync, now: SimTime) {
        let path = clock.round_trip().map(|round_trip| {
            let jitter = clock.jitter();
            round_trip + jitter + jitter + jitter + jitter + LOST_MARGIN
        });
        self.belief.acknowledge(echo.sent_at, path.map_or(SimTime::ZERO, |path| now.since(path)));
    }

    /// The receiver reports.
    pub fn report(&mut self, report: &LinkReport, clock: &ClockSync, now: SimTime) -> Option<RateChange> {
        if report.expected > 0 {
            self.belief.note_loss(report.loss());
            self.heartbeat = heartbeat(self.belief.loss(), clock.jitter());
        }
        self.ladder.report(report, clock.round_trip().unwrap_or_default(), now)
    }

    /// The ladder of rates.
    pub fn ladder(&self) -> &RateLadder {
        &self.ladder
    }

    /// The loss that is reckoned with.
    pub fn loss(&self) -> f64 {
        self.belief.loss()
    }

    /// Longest time between two datagrams at that loss, unless the ladder's period is longer.
    pub fn heartbeat(&self) -> SimTime {
        self.heartbeat
    }

    /// Counts so far.
    pub fn counts(&self) -> &SenderCounts {
        &self.counts
    }
}

/// Time between heartbeats at a loss of `loss`, on a path with this jitter.
fn heartbeat(loss: f64, jitter: SimTime) -> SimTime {
    let needed = (UNHEARD.ln() / loss.clamp(1e-9, 0.9).ln()).ceil();
    let left = (HEARD_WITHIN.as_secs_f64() - JITTERS * jitter.as_secs_f64()).max(LEFT_MIN);
    SimTime::from_secs_f64(left / needed).min(HEARTBEAT)
}

#[cfg(test)]
#[path = "sender_tests.rs"]
mod tests;

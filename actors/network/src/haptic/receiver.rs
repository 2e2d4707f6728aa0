//! Receiver of hands: the newest sample of each, how old it is, and how far its force has faded.
//!
//! Of each hand the newest sample wins, by strictly greater sequence number; whatever comes late is counted
//! and never applied. Between datagrams the sample is held (zero-order hold). Two times go with it, which are
//! not to be confused:
//!
//! - its *age*: the time since it was measured, by the estimate of the other clock. A long path makes it old, and
//!   compensation of delays has to know;
//! - the *silence*: the time since it arrived, by our own clock. It is what a force fades by: a path of a second is no
//!   reason to fade, a path that fell silent is.

use thiserror::Error;
use trocar_scene::SimTime;

use super::clock_sync::ClockSync;
use super::link_report::{LinkReport, LossMeter, Order};
use crate::datagram::{ClockEcho, HANDS_MAX};
use crate::hand_sample::HandSample;

/// Silence up to which a remote force is rendered in full.
pub const FADE_START: SimTime = SimTime::from_millis(50);
/// Silence from which it is zero.
pub const FADE_END: SimTime = SimTime::from_millis(100);

/// Factor of a remote force after this much silence: 1 up to [`FADE_START`], 0 from [`FADE_END`], linear
/// between.
pub fn fade(silence: SimTime) -> f64 {
    FADE_END.since(silence).as_secs_f64().min((FADE_END - FADE_START).as_secs_f64())
        / (FADE_END - FADE_START).as_secs_f64()
}

/// What is known of a remote hand at an instant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RemoteHandSample {
    /// The newest sample.
    pub sample: HandSample,
    /// How long ago it was measured; `None` until the other clock is known.
    pub age: Option<SimTime>,
    /// How long ago it arrived.
    pub silence: SimTime,
    /// Factor of its force, by [`fade`].
    pub fade: f64,
    /// Whether it has not been read before.
    pub is_new: bool,
}

/// How many samples and reads.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct HandCounts {
    /// Samples that were the newest when they arrived.
    pub applied: u64,
    /// Of them, those that a newer one replaced before anybody read them.
    pub superseded: u64,
    /// Samples that a newer one had overtaken.
    pub late: u64,
    /// Reads that found the same sample as the one before.
    pub held: u64,
}

/// Counts of a direction, since it began.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ReceiverCounts {
    /// Datagrams of all kinds that arrived, each once.
    pub received: u64,
    /// Of them, those that a newer one overtook.
    pub late: u64,
    /// Datagrams that came again.
    pub duplicate: u64,
    /// Datagrams that were sent, by their numbers, and have not arrived.
    pub lost: u64,
    /// Samples of hands that nobody expects.
    pub unknown: u64,
    /// Samples and reads of all hands together.
    pub hands: HandCounts,
}

/// Why there is no such receiver.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum ReceiverError {
    /// There are more than fit into a datagram.
    #[error("{0} hands are too many for a datagram; {HANDS_MAX} fit")]
    TooMany(usize),
    /// A hand comes twice.
    #[error("hand {0} comes twice; each has a number of its own")]
    Twice(u8),
}

#[derive(Clone, Copy, Debug)]
struct Newest {
    sequence: u64,
    sent_at: SimTime,
    arrived: SimTime,
    sample: HandSample,
    is_read: bool,
}

#[derive(Clone, Debug)]
struct Hand {
    number: u8,
    newest: Option<Newest>,
    counts: HandCounts,
}

/// The hands of another station, as they arrive. Does not allocate after it was made.
#[derive(Clone, Debug)]
pub struct HapticReceiver {
    hands: Vec<Hand>,
    clock: ClockSync,
    meter: LossMeter,
    unknown: u64,
}

impl HapticReceiver {
    /// A receiver of these hands.
    ///
    /// # Errors
    /// When there are more than [`HANDS_MAX`], or one comes twice.
    pub fn new(hands: &[u8]) -> Result<Self, ReceiverError> {
        let mut receiver = Self {
            hands: Vec::with_capacity(HANDS_MAX),
            clock: ClockSync::default(),
            meter: LossMeter::default(),
            unknown: 0,
        };
        receiver.expect_hands(hands)?;
        Ok(receiver)
    }

    /// Expects these hands from now on. What is known of those among them that it expected before is kept.
    ///
    /// # Errors
    /// As in [`Self::new`]; then nothing has changed.
    pub fn expect_hands(&mut self, hands: &[u8]) -> Result<(), ReceiverError> {
        if hands.len() > HANDS_MAX {
            return Err(ReceiverError::TooMany(hands.len()));
        }
        if let Some((_, twice)) =
            hands.iter().enumerate().find(|(index, hand)| hands[..*index].contains(hand))
        {
            return Err(ReceiverError::Twice(*twice));
        }
        self.hands.retain(|hand| hands.contains(&hand.number));
        for number in hands {
            if !self.hands.iter().any(|hand| hand.number == *number) {
                self.hands.push(Hand { number: *number, newest: None, counts: HandCounts::default() });
            }
        }
        Ok(())
    }

    /// An authenticated datagram of hands arrived at `now`, which must not decrease.
    pub fn receive(
        &mut self,
        sequence: u64,
        sent_at: SimTime,
        echo: Option<ClockEcho>,
        samples: &[HandSample],
        now: SimTime,
    ) -> Order {
        let order = self.count(sequence, sent_at, echo, now);
        if order == Order::Repeated {
            return order;
        }
        for sample in samples {
            match self.hands.iter_mut().find(|hand| hand.number == sample.hand) {
                Some(hand) => {
                    hand.apply(Newest { sequence, sent_at, arrived: now, sample: *sample, is_read: false })
                }
                None => self.unknown += 1,
            }
        }
        order
    }

    /// An authenticated datagram of another kind arrived. Its number and times count, as all kinds share
    /// them.
    pub fn receive_other(&mut self, sequence: u64, sent_at: SimTime, now: SimTime) -> Order {
        self.count(sequence, sent_at, None, now)
    }

    fn count(&mut self, sequence: u64, sent_at: SimTime, echo: Option<ClockEcho>, now: SimTime) -> Order {
        let transit = self.clock.received(sent_at, echo, now);
        self.meter.arrived(sequence, transit.queueing)
    }

    /// The newest sample of a hand; `None` before the first, and of a hand that is not expected.
    pub fn read(&mut self, hand: u8, now: SimTime) -> Option<RemoteHandSample> {
        let read = self.newest(hand, now)?;
        let hand = self.hands.iter_mut().find(|candidate| candidate.number == hand)?;
        hand.newest.as_mut()?.is_read = true;
        hand.counts.held += u64::from(!read.is_new);
        Some(read)
    }

    /// The same without its being read by that.
    pub fn newest(&self, hand: u8, now: SimTime) -> Option<RemoteHandSample> {
        let hand = self.hands.iter().find(|candidate| candidate.number == hand)?;
        let newest = hand.newest.as_ref()?;
        let before = SimTime::from_micros(newest.sample.age_us.into());
        let silence = now.since(newest.arrived);
        let age = self.clock.delay(newest.sent_at, now).map(|delay| delay + before);
        let (sample, is_new) = (newest.sample, !newest.is_read);
        Some(RemoteHandSample { sample, age, silence, fade: fade(silence), is_new })
    }

    /// The other station's clock, and the path.
    pub fn clock(&self) -> &ClockSync {
        &self.clock
    }

    /// The next report for the sender, when it is due.
    pub fn report(&mut self, now: SimTime) -> Option<LinkReport> {
        self.meter.report(now)
    }

    /// Counts of a hand; `None` of one that is not expected.
    pub fn hand_counts(&self, hand: u8) -> Option<HandCounts> {
        self.hands.iter().find(|candidate| candidate.number == hand).map(|hand| hand.counts)
    }

    /// Counts of all.
    pub fn counts(&self) -> ReceiverCounts {
        let hands = self.hands.iter().fold(HandCounts::default(), |sum, hand| HandCounts {
            applied: sum.applied + hand.counts.applied,
            superseded: sum.superseded + hand.counts.superseded,
            late: sum.late + hand.counts.late,
            held: sum.held + hand.counts.held,
        });
        ReceiverCounts {
            received: self.meter.received(),
            late: self.meter.late(),
            duplicate: self.meter.repeated(),
            lost: self.meter.lost(),
            unknown: self.unknown,
            hands,
        }
    }
}

impl Hand {
    fn apply(&mut self, newer: Newest) {
        match &self.newest {
            Some(newest) if newer.sequence <= newest.sequence => {
                self.counts.late += 1;
                return;
            }
            Some(newest) => self.counts.superseded += u64::from(!newest.is_read),
            None => {}
        }
        self.counts.applied += 1;
        self.newest = Some(newer);
    }
}

#[cfg(test)]
#[path = "receiver_tests.rs"]
mod tests;

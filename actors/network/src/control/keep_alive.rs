//! Whether the other side is still there, and what its clock shows: a ping each second, and the answers' four time stamps
//! (Mills, "Internet time synchronization: the Network Time Protocol", 1991).

use std::collections::VecDeque;

use serde::{Deserialize, Serialize};
use trocar_scene::SimTime;

/// Time between two pings.
pub const PING_EVERY: SimTime = SimTime::from_millis(1_000);
/// After this time without a byte the connection counts as dead.
pub const SILENCE_MAX: SimTime = SimTime::from_millis(5_000);
/// Most pings that wait for their answer; an older one is given up.
const WAITING_PINGS_MAX: usize = 8;

/// A question for the other side's clock.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Ping {
    /// When it was sent, by the sender's session clock.
    pub sent_at: SimTime,
}

/// The answer to a ping.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Pong {
    /// When the ping was sent, as it says.
    pub ping_sent_at: SimTime,
    /// When the ping arrived, by the clock of who answers.
    pub received_at: SimTime,
    /// When the answer was sent, by the same clock.
    pub sent_at: SimTime,
}

/// The four time stamps of a ping and its answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ClockSample {
    /// When the ping was sent, by the local session clock.
    pub sent_at: SimTime,
    /// When it arrived, by the other side's session clock.
    pub received_there_at: SimTime,
    /// When the answer was sent, by the other side's session clock.
    pub answered_there_at: SimTime,
    /// When the answer arrived, by the local session clock.
    pub received_at: SimTime,
}

impl ClockSample {
    /// Time under way, there and back, without the time at the other side.
    pub fn round_trip(&self) -> SimTime {
        self.received_at.since(self.sent_at) - self.answered_there_at.since(self.received_there_at)
    }

    /// How far the other side's clock is ahead \[ns\], if both ways take the same time.
    pub fn offset_ns(&self) -> i64 {
        let there = i128::from(self.received_there_at.0) + i128::from(self.answered_there_at.0);
        let here = i128::from(self.sent_at.0) + i128::from(self.received_at.0);
        let offset = (there - here) / 2;
        offset.clamp(i128::from(i64::MIN), i128::from(i64::MAX)) as i64
    }
}

/// Pings of one end of a connection.
#[derive(Clone, Debug)]
pub struct KeepAlive {
    heard_at: SimTime,
    next_ping_at: SimTime,
    waiting: VecDeque<SimTime>,
    round_trip: Option<SimTime>,
}

impl KeepAlive {
    /// Of a connection that begins now.
    pub fn new(now: SimTime) -> Self {
        let waiting = VecDeque::with_capacity(WAITING_PINGS_MAX);
        Self { heard_at: now, next_ping_at: now + PING_EVERY, waiting, round_trip: None }
    }

    /// Some bytes arrived.
    pub fn hear(&mut self, now: SimTime) {
        self.heard_at = now;
    }

    /// Whether nothing was heard for too long.
    pub fn is_silent(&self, now: SimTime) -> bool {
        now >= self.heard_at + SILENCE_MAX
    }

    /// The next ping, if it is time for it.
    pub fn ping(&mut self, now: SimTime) -> Option<Ping> {
        if now < self.next_ping_at {
            return None;
        }
        self.next_ping_at = now + PING_EVERY;
        if self.waiting.len() == WAITING_PINGS_MAX {
            self.waiting.pop_front();
        }
        self.waiting.push_back(now);
        Some(Ping { sent_at: now })
    }

    /// The time stamps of an answer; `None` if no ping waits for it.
    pub fn pong(&mut self, pong: Pong, now: SimTime) -> Option<ClockSample> {
        let at = self.waiting.iter().position(|sent_at| *sent_at == pong.ping_sent_at)?;
        // The stream keeps its order: answers to the pings before this one will not come any more.
        self.waiting.drain(..=at);
        let sample = ClockSample {
            sent_at: pong.ping_sent_at,
            received_there_at: pong.received_at,
            answered_there_at: pong.sent_at,
            received_at: now,
        };
        self.round_trip = Some(sample.round_trip());
        Some(sample)
    }

    /// Newest round trip.
    pub fn round_trip(&self) -> Option<SimTime> {
        self.round_trip
    }

    /// When there is something to do next.
    pub fn deadline(&self) -> SimTime {
        self.next_ping_at.min(self.heard_at + SILENCE_MAX)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_clock_that_is_ahead_is_found_and_the_time_at_the_other_side_does_not_count() {
        let sample = ClockSample {
            sent_at: SimTime::from_millis(100),
            received_there_at: SimTime::from_millis(5_150),
            answered_there_at: SimTime::from_millis(5_180),
            received_at: SimTime::from_millis(230),
        };
        assert_eq!(sample.round_trip(), SimTime::from_millis(100));
        assert_eq!(sample.offset_ns(), 5_000_000_000);
        let absurd = ClockSample {
            received_there_at: SimTime(u64::MAX),
            answered_there_at: SimTime(u64::MAX),
            ..sample
        };
        assert_eq!(absurd.offset_ns(), i64::MAX);
    }

    #[test]
    fn pings_go_each_second_and_only_their_own_answers_count() {
        let mut alive = KeepAlive::new(SimTime::ZERO);
        assert_eq!(alive.ping(SimTime::from_millis(999)), None);
        let mut sent = Vec::new();
        for second in 1..=20 {
            let now = SimTime::from_millis(1_000 * second);
            sent.extend(alive.ping(now));
            assert_eq!(alive.ping(now), None);
        }
        assert_eq!((sent.len(), alive.waiting.len()), (20, WAITING_PINGS_MAX));
        let answer =
            |ping: Ping| Pong { ping_sent_at: ping.sent_at, received_at: SimTime(7), sent_at: SimTime(7) };
        let now = SimTime::from_millis(20_100);
        assert_eq!(alive.pong(answer(sent[2]), now), None, "given up");
        assert!(alive.pong(answer(sent[18]), now).is_some());
        assert_eq!(alive.pong(answer(sent[18]), now), None, "answered twice");
        assert_eq!(alive.round_trip(), Some(SimTime::from_millis(1_100)));
    }

    #[test]
    fn five_seconds_of_silence_are_the_end() {
        let mut alive = KeepAlive::new(SimTime::ZERO);
        alive.hear(SimTime::from_millis(300));
        assert!(!alive.is_silent(SimTime::from_millis(5_299)));
        assert!(alive.is_silent(SimTime::from_millis(5_300)));
        assert_eq!(alive.deadline(), PING_EVERY);
    }
}

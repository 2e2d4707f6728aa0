//! Way of a connection's datagrams: by themselves over UDP, or carried by the control channel where they do not arrive.
//!
//! Each end watches whether it hears the other one, and tells it over the control channel when that changes. An end that is
//! not heard has its newest hands carried a hundred times a second, and goes on to try by itself; once these tries are
//! heard for a while, the datagrams go by themselves again. So each direction has its own way, and neither end has to guess
//! what the other one hears.
//!
//! A host says nothing before its station has: a station may take its time between its welcome and its first datagram.

use trocar_scene::SimTime;

use crate::datagram::Side;

/// Time between two datagrams of hands that the control channel carries.
pub const CARRY_EVERY: SimTime = SimTime::from_millis(10);
/// Time between two tries to reach the other end by a datagram itself.
pub const TRY_EVERY: SimTime = SimTime::from_millis(100);
/// Longest wait for the first datagram: a path may take a second, and its answer another one.
pub const FIRST_MAX: SimTime = SimTime::from_millis(2_000);
/// After so long without a datagram the path counts as lost. A well path brings one every 20 ms.
pub const LOST_AFTER: SimTime = SimTime::from_millis(1_000);
/// A path counts as found again after so many datagrams, over so long, none later than so much after the one before.
const FOUND_COUNT: u32 = 5;
const FOUND_SPAN: SimTime = SimTime::from_millis(300);
const FOUND_GAP: SimTime = SimTime::from_millis(300);
/// How much earlier than its time something may go: ticks come with jitter.
const EARLY: SimTime = SimTime::from_micros(250);

/// The ways of both directions of a connection, at one end.
#[derive(Clone, Copy, Debug)]
pub struct Way {
    speaks_first: bool,
    /// Since when datagrams are expected.
    begun: Option<SimTime>,
    /// When the newest came by itself.
    came_at: Option<SimTime>,
    /// The row of datagrams that came by themselves without a gap: since when, and how many.
    row: Option<(SimTime, u32)>,
    hears: bool,
    /// What the other end was told last.
    told: bool,
    is_heard: bool,
    carried_at: Option<SimTime>,
    tried_at: Option<SimTime>,
}

impl Way {
    /// Of a new connection: until somebody says otherwise, both ends are heard.
    pub fn new(side: Side) -> Self {
        Self {
            speaks_first: side == Side::Client,
            begun: None,
            came_at: None,
            row: None,
            hears: true,
            told: true,
            is_heard: true,
            carried_at: None,
            tried_at: None,
        }
    }

    /// Of a connection that follows this one between the same two ends: what was blocked is probably still, and the other
    /// end is told so at once. What it hears it tells itself, since it may be a program that was started anew.
    #[must_use]
    pub fn again(self) -> Self {
        let side = if self.speaks_first { Side::Client } else { Side::Server };
        Self { hears: self.hears, ..Self::new(side) }
    }

    /// An authentic datagram came by itself.
    pub fn came(&mut self, now: SimTime) {
        let is_in_row = self.came_at.is_some_and(|last| now.since(last) <= FOUND_GAP);
        self.came_at = Some(now);
        let (since, count) = self.row.filter(|_| is_in_row).unwrap_or((now, 0));
        self.row = Some((since, count.saturating_add(1)));
        if !self.hears && count + 1 >= FOUND_COUNT && now.since(since) >= FOUND_SPAN {
            self.hears = true;
        }
    }

    /// The other end says whether it hears this one; true if it does again after it did not.
    pub fn heard(&mut self, is_heard: bool) -> bool {
        let is_back = is_heard && !self.is_heard;
        self.is_heard = is_heard;
        // A station has tried for a while before it says so.
        if !is_heard && !self.speaks_first && self.came_at.is_none() {
            self.hears = false;
        }
        is_back
    }

    /// What time brings.
    pub fn tick(&mut self, now: SimTime) {
        if self.speaks_first {
            self.begun.get_or_insert(now);
        }
        let is_lost = match (self.came_at, self.begun) {
            (Some(came_at), _) => now.since(came_at) >= LOST_AFTER,
            (None, Some(begun)) => now.since(begun) >= FIRST_MAX,
            (None, None) => false,
        };
        if self.hears && is_lost {
            (self.hears, self.row) = (false, None);
        }
    }

    /// What the other end is to be told, if it is something new. It is asked for again until it was [told](Self::told).
    pub fn news(&self) -> Option<bool> {
        (self.hears != self.told).then_some(self.hears)
    }

    /// The other end will be told.
    pub fn told(&mut self, hears: bool) {
        self.told = hears;
    }

    /// Whether this end hears the other one's datagrams by themselves.
    pub fn hears(&self) -> bool {
        self.hears
    }

    /// Whether the control channel carries this end's datagrams.
    pub fn carries(&self) -> bool {
        !self.is_heard
    }

    /// Whether hands are to be carried now; they then count as carried.
    pub fn carry(&mut self, now: SimTime) -> bool {
        !self.is_heard && due(&mut self.carried_at, CARRY_EVERY, now)
    }

    /// Whether hands are to be tried by themselves although they are carried; they then count as tried.
    pub fn try_again(&mut self, now: SimTime) -> bool {
        !self.is_heard && due(&mut self.tried_at, TRY_EVERY, now)
    }
}

/// Whether something is due that was last done at `last`. It follows its period exactly, and makes nothing up.
fn due(last: &mut Option<SimTime>, every: SimTime, now: SimTime) -> bool {
    let Some(before) = *last else {
        *last = Some(now);
        return true;
    };
    let is_due = now.since(before) + EARLY >= every;
    if is_due {
        let next = before + every;
        *last = Some(if now.since(next) >= every { now } else { next });
    }
    is_due
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: fn(u64) -> SimTime = SimTime::from_millis;

    #[test]
    fn a_station_waits_two_seconds_for_the_first_datagram_and_one_for_a_later_one() {
        let mut way = Way::new(Side::Client);
        let lost_at = |way: &mut Way, from: u64| {
            (from..from + 5_000).find(|ms| {
                way.tick(MS(*ms));
                way.news() == Some(false)
            })
        };
        assert_eq!(lost_at(&mut way, 10), Some(2_010));
        way.told(false);
        let mut way = Way::new(Side::Client);
        (0..500).step_by(20).for_each(|ms| way.came(MS(ms)));
        assert_eq!(lost_at(&mut way, 490), Some(1_480));
    }

    #[test]
    fn a_host_says_nothing_before_its_station_has() {
        let mut way = Way::new(Side::Server);
        (0..20_000).for_each(|ms| way.tick(MS(ms)));
        assert!(way.hears() && way.news().is_none());
        way.heard(false);
        assert_eq!(way.news(), Some(false), "nothing of what the station tried has come");
        let mut way = Way::new(Side::Server);
        way.came(MS(20_000));
        way.heard(false);
        assert!(way.hears() && way.carries(), "only the way to the station is blocked");
    }

    #[test]
    fn a_path_is_found_again_by_a_row_of_datagrams_and_not_by_one() {
        let mut way = Way::new(Side::Client);
        way.tick(MS(0));
        way.tick(MS(2_000));
        way.told(false);
        way.came(MS(3_000));
        way.came(MS(3_500));
        way.came(MS(4_000));
        assert!(!way.hears(), "one now and then is no path");
        let found = (0..20).map(|step| 5_000 + 100 * step).find(|ms| {
            way.came(MS(*ms));
            way.hears()
        });
        assert_eq!((found, way.news()), (Some(5_400), Some(true)));
        // A burst that came late is no path, either.
        let mut way = Way::new(Side::Client);
        way.tick(MS(0));
        way.tick(MS(2_000));
        (0..100).for_each(|_| way.came(MS(2_500)));
        assert!(!way.hears());
    }

    #[test]
    fn a_connection_that_follows_one_whose_path_was_blocked_says_so_at_once() {
        let mut way = Way::new(Side::Client);
        way.heard(false);
        way.tick(MS(0));
        way.tick(MS(2_000));
        way.told(false);
        let mut next = way.again();
        next.tick(MS(5_000));
        assert_eq!((next.news(), next.carries()), (Some(false), false));
        (0..10).for_each(|step| next.came(MS(5_000 + 100 * step)));
        assert_eq!(next.news(), None, "it is heard after all, and nothing was said");
    }

    #[test]
    fn hands_are_carried_a_hundred_times_a_second_and_tried_ten_times() {
        let mut way = Way::new(Side::Server);
        let count = |way: &mut Way| {
            let (mut carried, mut tried) = (0, 0);
            for ms in 0..1_000 {
                carried += u32::from(way.carry(MS(ms)));
                tried += u32::from(way.try_again(MS(ms)));
            }
            (carried, tried)
        };
        assert_eq!(count(&mut way), (0, 0));
        assert!(!way.heard(false));
        assert_eq!(count(&mut way), (100, 10));
        assert!(way.heard(true) && !way.heard(true));
        assert_eq!(count(&mut way), (0, 0));
    }
}

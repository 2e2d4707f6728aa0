//! Carrier: the datagrams of one connection that travel in the control channel, since UDP is blocked.
//!
//! A stream delivers everything, also what nobody wants any more. So no more datagrams of hands are under way than the
//! path needs at [`CARRY_EVERY`], and one waits, the newest: behind a stall come a few old poses and then the present one,
//! never a queue. The other end tells how many it has taken. Of what arrives at once the newest hands count.

use std::collections::VecDeque;

use trocar_scene::SimTime;

use crate::control::{Blob, Carried};
use crate::hands_link::{CARRY_EVERY, Sealed};

/// Other datagrams that wait, the newest.
pub const OTHERS_MAX: usize = 32;
/// Bytes that may wait in the control channel before other datagrams do.
pub const ROOM_BYTES: usize = 8 << 10;
/// Fewest datagrams of hands that may be under way, and how many more than one and a half round trips need.
const UNDER_WAY_MIN: u32 = 12;
const UNDER_WAY_MORE: u32 = 3;

/// What a connection's control channel is to send.
#[derive(Debug)]
pub struct CarriedFrame {
    hears: bool,
    taken: u32,
    datagram: Option<Sealed>,
    /// Whether it goes ahead of all that waits.
    pub is_urgent: bool,
}

impl CarriedFrame {
    /// As a message.
    pub fn message(&self) -> Carried<'_> {
        let bytes = self.datagram.as_ref().map_or(&[][..], Sealed::bytes);
        Carried { hears: self.hears, taken: self.taken, datagram: Blob::from(bytes) }
    }
}

/// The carried datagrams of one connection, at one end.
#[derive(Debug)]
pub struct Carrier {
    /// The newest hands, and other datagrams, on their way out.
    hands: Option<Sealed>,
    others: VecDeque<Sealed>,
    /// The same on their way in.
    hands_in: Option<Sealed>,
    others_in: VecDeque<Sealed>,
    hears: bool,
    /// What the other end hears, and whether that is news.
    is_heard: bool,
    heard_is_new: bool,
    must_tell: bool,
    sent: u32,
    acknowledged: u32,
    taken: u32,
    taken_told: u32,
    told_at: SimTime,
    shortest: Option<SimTime>,
}

impl Default for Carrier {
    fn default() -> Self {
        Self {
            hands: None,
            others: VecDeque::new(),
            hands_in: None,
            others_in: VecDeque::new(),
            hears: true,
            is_heard: true,
            heard_is_new: false,
            must_tell: false,
            sent: 0,
            acknowledged: 0,
            taken: 0,
            taken_told: 0,
            told_at: SimTime::ZERO,
            shortest: None,
        }
    }
}

impl Carrier {
    /// A datagram of the hands link is to be carried. Of hands the newest replaces one that waits.
    pub fn carry(&mut self, datagram: Sealed) {
        if datagram.has_hands() {
            self.hands = Some(datagram);
        } else {
            push(&mut self.others, datagram);
        }
    }

    /// The hands link hears the other end by itself from now on, or does not.
    pub fn hears(&mut self, hears: bool) {
        (self.hears, self.must_tell) = (hears, true);
    }

    /// Whether this end's datagrams are carried.
    pub fn is_carrying(&self) -> bool {
        !self.is_heard
    }

    /// Whether other datagrams would find room.
    pub fn has_room(&self, waiting: usize) -> bool {
        waiting < ROOM_BYTES && self.others.is_empty()
    }

    /// The other end's control channel brought this.
    pub fn arrived(&mut self, hears: bool, taken: u32, datagram: &[u8]) {
        if hears != self.is_heard {
            (self.is_heard, self.heard_is_new) = (hears, true);
        }
        // More than was sent cannot have been taken; a number from before is no news.
        if taken.wrapping_sub(self.acknowledged) <= self.sent.wrapping_sub(self.acknowledged) {
            self.acknowledged = taken;
        }
        let Some(datagram) = Sealed::new(datagram).filter(|_| !datagram.is_empty()) else { return };
        if datagram.has_hands() {
            self.taken = self.taken.wrapping_add(1);
            self.hands_in = Some(datagram);
        } else {
            push(&mut self.others_in, datagram);
        }
    }

    /// Whether the other end hears this one, if that has changed since the last call.
    pub fn take_heard(&mut self) -> Option<bool> {
        std::mem::take(&mut self.heard_is_new).then_some(self.is_heard)
    }

    /// The next datagram that has arrived, for the hands link.
    pub fn take_arrived(&mut self) -> Option<Sealed> {
        self.hands_in.take().or_else(|| self.others_in.pop_front())
    }

    /// What is to be sent now, if the control channel has room: `has_urgent` and `waiting` are those of its outbox, and
    /// `round_trip` the newest of its pings. Call it until there is nothing.
    pub fn next(
        &mut self,
        round_trip: Option<SimTime>,
        has_urgent: bool,
        waiting: usize,
        now: SimTime,
    ) -> Option<CarriedFrame> {
        if let Some(round_trip) = round_trip {
            self.shortest = Some(self.shortest.map_or(round_trip, |shortest| shortest.min(round_trip)));
        }
        if !has_urgent {
            if self.sent.wrapping_sub(self.acknowledged) < self.under_way_max()
                && let Some(datagram) = self.hands.take()
            {
                self.sent = self.sent.wrapping_add(1);
                return Some(self.frame(Some(datagram), true, now));
            }
            // What was taken is told also while nothing more may be under way: the other end waits for it likewise.
            let is_due = self.taken != self.taken_told && now.since(self.told_at) >= CARRY_EVERY;
            if self.must_tell || is_due {
                return Some(self.frame(None, true, now));
            }
        }
        if waiting < ROOM_BYTES
            && let Some(datagram) = self.others.pop_front()
        {
            return Some(self.frame(Some(datagram), false, now));
        }
        None
    }

    fn frame(&mut self, datagram: Option<Sealed>, is_urgent: bool, now: SimTime) -> CarriedFrame {
        (self.must_tell, self.taken_told, self.told_at) = (false, self.taken, now);
        CarriedFrame { hears: self.hears, taken: self.taken, datagram, is_urgent }
    }

    fn under_way_max(&self) -> u32 {
        let round_trip = self.shortest.unwrap_or_default().as_nanos();
        let needed = round_trip * 3 / 2 / CARRY_EVERY.as_nanos();
        u32::try_from(needed).unwrap_or(u32::MAX).saturating_add(UNDER_WAY_MORE).max(UNDER_WAY_MIN)
    }
}

fn push(queue: &mut VecDeque<Sealed>, datagram: Sealed) {
    if queue.len() == OTHERS_MAX {
        queue.pop_front();
    }
    queue.push_back(datagram);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::datagram::{DATAGRAM_MAX, Keys, Kind, Sealer, Side};

    const MS: fn(u64) -> SimTime = SimTime::from_millis;

    fn sealer() -> Sealer {
        Sealer::new(Keys::unprotected(7, 0).split(Side::Client).0)
    }

    fn hands(sealer: &mut Sealer, now: SimTime) -> Sealed {
        let mut out = [0; DATAGRAM_MAX];
        let length = sealer.seal_hands(now, None, &[], &mut out).expect("sealed");
        Sealed::new(&out[..length]).expect("it fits")
    }

    fn rows(sealer: &mut Sealer) -> Sealed {
        let mut out = [0; DATAGRAM_MAX];
        let length = sealer.seal(Kind::Rows, 0, MS(0), b"rows", &mut out).expect("sealed");
        Sealed::new(&out[..length]).expect("it fits")
    }

    /// When a frame's datagram was sent, by its header.
    fn sent_at(frame: &CarriedFrame) -> SimTime {
        let bytes = frame.datagram.as_ref().expect("a datagram").bytes();
        crate::datagram::Header::decode(bytes).expect("a header").sent_at
    }

    #[test]
    fn behind_a_path_that_stalls_few_poses_are_under_way_and_the_newest_waits() {
        let (mut carrier, mut sealer) = (Carrier::default(), sealer());
        let mut under_way = Vec::new();
        for step in 0..200 {
            carrier.carry(hands(&mut sealer, MS(10 * step)));
            while let Some(frame) = carrier.next(Some(MS(40)), false, 0, MS(10 * step)) {
                under_way.push(sent_at(&frame));
            }
        }
        assert_eq!(under_way.len() as u32, UNDER_WAY_MIN);
        // The path is well again: what comes next is what is newest.
        carrier.arrived(true, UNDER_WAY_MIN, &[]);
        let frame = carrier.next(Some(MS(2_000)), false, 0, MS(2_000)).expect("it waited");
        assert!(frame.is_urgent);
        assert_eq!(sent_at(&frame), MS(1_990));
    }

    #[test]
    fn a_long_path_has_as_many_under_way_as_it_needs() {
        let (mut carrier, mut sealer) = (Carrier::default(), sealer());
        let mut sent = 0;
        for step in 0..500 {
            carrier.carry(hands(&mut sealer, MS(10 * step)));
            sent += u32::from(carrier.next(Some(MS(1_000)), false, 0, MS(10 * step)).is_some());
            // What was sent a second before has been taken.
            carrier.arrived(true, sent.min((step as u32).saturating_sub(99)), &[]);
        }
        assert_eq!(sent, 500);
    }

    #[test]
    fn of_what_comes_at_once_the_newest_hands_count_and_are_acknowledged() {
        let (mut carrier, mut sealer) = (Carrier::default(), sealer());
        for step in 0..50 {
            carrier.arrived(false, 0, hands(&mut sealer, MS(step)).bytes());
            carrier.arrived(false, 0, rows(&mut sealer).bytes());
        }
        assert_eq!((carrier.take_heard(), carrier.take_heard()), (Some(false), None));
        assert!(carrier.is_carrying());
        let newest = carrier.take_arrived().expect("hands");
        assert!(newest.has_hands());
        let header = crate::datagram::Header::decode(newest.bytes()).expect("a header");
        assert_eq!(header.sent_at, MS(49));
        let others = std::iter::from_fn(|| carrier.take_arrived()).count();
        assert_eq!(others, OTHERS_MAX);
        let told = carrier.next(None, false, 0, MS(100)).expect("what was taken").message().taken;
        assert_eq!(told, 50);
        assert!(carrier.next(None, false, 0, MS(101)).is_none(), "it was told");
    }

    #[test]
    fn other_datagrams_wait_for_room_and_no_number_of_the_other_end_is_believed_that_cannot_be() {
        let (mut carrier, mut sealer) = (Carrier::default(), sealer());
        carrier.carry(rows(&mut sealer));
        assert!(!carrier.has_room(0), "one waits");
        assert!(carrier.next(None, false, ROOM_BYTES, MS(0)).is_none());
        assert!(!carrier.next(None, true, 0, MS(0)).expect("there is room").is_urgent);
        carrier.arrived(true, 1_000_000, &[]);
        assert_eq!(carrier.acknowledged, 0);
        carrier.arrived(true, 0, &[1; DATAGRAM_MAX + 1]);
        assert!(carrier.take_arrived().is_none());
    }
}

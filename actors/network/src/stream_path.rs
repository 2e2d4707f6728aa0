//! One direction of a stream over a faulty path, as TCP behaves: it delivers everything once and in order, and what the path
//! loses comes a retransmission timeout later, with all that was sent behind it.

use std::collections::BTreeMap;

use trocar_kernel::faults::{LinkCounts, LinkFaults, Message};
use trocar_kernel::spec::FaultOrder;
use trocar_scene::SimTime;

use crate::impairments::Impairments;

/// Bytes of a stream that travel as one segment.
const SEGMENT: usize = 1_400;
/// Segments under way; the sender waits for room, as behind a full window.
const WINDOW: usize = 4_096;
/// Time after which a lost segment is sent again (RFC 6298 begins with a second, and takes 200 ms in practice), besides
/// the path's own delay.
const RETRANSMIT_AFTER: SimTime = SimTime::from_millis(200);

#[derive(Debug)]
struct Segment {
    number: u64,
    bytes: Vec<u8>,
}

impl Message for Segment {
    fn bytes(&self) -> usize {
        self.bytes.len() + 40
    }
    fn duplicate(&self) -> Option<Self> {
        None
    }
    fn through(self, _: &mut dyn FnMut(&mut [u8])) -> Option<Self> {
        // TCP's checksum refuses it, and it is sent again.
        None
    }
}

/// The bytes of one direction under way.
#[derive(Debug, Default)]
pub struct StreamPath {
    segments: LinkFaults<Segment>,
    /// Segments that the path lost, by the time at which they are sent again.
    again: BTreeMap<(SimTime, u64), Vec<u8>>,
    /// Segments that overtook a lost one.
    early: BTreeMap<u64, Vec<u8>>,
    next_number: u64,
    next_expected: u64,
    received: Vec<u8>,
    /// The sender sends no more; the receiver learns of it behind the last byte.
    is_finished: bool,
}

impl StreamPath {
    /// A path with these properties; the same seed gives the same luck.
    pub fn new(path: &Impairments, seed: u64) -> Self {
        Self { segments: path.link(seed), ..Self::default() }
    }

    /// A fault of the path begins or ends.
    pub fn apply(&mut self, order: &FaultOrder) {
        self.segments.apply(order);
    }

    /// Whether bytes may pass it by: it has no fault, and nothing is under way.
    pub fn is_idle(&self) -> bool {
        self.segments.is_idle() && self.under_way() == 0 && self.received.is_empty()
    }

    /// Whether nothing is under way, although a fault may last.
    pub fn is_idle_but_for_faults(&self) -> bool {
        self.under_way() == 0 && self.received.is_empty()
    }

    /// Whether the sender may send.
    pub fn has_room(&self) -> bool {
        self.under_way() < WINDOW
    }

    fn under_way(&self) -> usize {
        (self.next_number - self.next_expected) as usize
    }

    /// Sends as many bytes as there is room for, and returns how many.
    pub fn send(&mut self, now: SimTime, bytes: &[u8]) -> usize {
        let mut sent = 0;
        for segment in bytes.chunks(SEGMENT) {
            if !self.has_room() {
                break;
            }
            self.send_new(now, segment);
            sent += segment.len();
        }
        sent
    }

    /// Sends all these bytes: whoever reads them elsewhere looks for [room](Self::has_room) before.
    pub fn send_all(&mut self, now: SimTime, bytes: &[u8]) {
        bytes.chunks(SEGMENT).for_each(|segment| self.send_new(now, segment));
    }

    fn send_new(&mut self, now: SimTime, segment: &[u8]) {
        let number = self.next_number;
        self.next_number += 1;
        self.send_segment(now, number, segment.to_vec());
    }

    fn send_segment(&mut self, now: SimTime, number: u64, bytes: Vec<u8>) {
        let lost = |counts: &LinkCounts| counts.lost + counts.corrupted;
        let before = lost(self.segments.counts());
        let copy = bytes.clone();
        self.segments.send(now, Segment { number, bytes });
        if lost(self.segments.counts()) > before {
            self.again.insert((now + RETRANSMIT_AFTER, number), copy);
        }
    }

    /// Appends the bytes that have arrived by `now`.
    pub fn receive(&mut self, now: SimTime, into: &mut Vec<u8>) {
        self.carry(now);
        into.append(&mut self.received);
    }

    fn carry(&mut self, now: SimTime) {
        while let Some(entry) = self.again.first_entry().filter(|entry| entry.key().0 <= now) {
            let ((_, number), bytes) = entry.remove_entry();
            self.send_segment(now, number, bytes);
        }
        while let Some(Segment { number, bytes }) = self.segments.due(now) {
            self.early.insert(number, bytes);
        }
        while let Some(bytes) = self.early.remove(&self.next_expected) {
            self.received.extend_from_slice(&bytes);
            self.next_expected += 1;
        }
    }

    /// The sender sends no more.
    pub fn finish(&mut self) {
        self.is_finished = true;
    }

    /// Whether the sender has finished, and everything was received.
    pub fn is_finished(&mut self, now: SimTime) -> bool {
        self.carry(now);
        self.is_finished && self.under_way() == 0 && self.received.is_empty()
    }

    /// Forgets what is under way, as when an end dies. The faults stay.
    pub fn reset(&mut self) {
        *self = Self { segments: self.segments.fork(|_| None), ..Self::default() };
    }
}

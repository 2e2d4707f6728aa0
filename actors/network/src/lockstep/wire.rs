//! A link between two stations inside the process: datagrams, and a stream that repairs what is lost.
//!
//! Both suffer the same faults. Datagrams arrive or do not. The stream behaves as TCP does ([`StreamPath`]).

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use trocar_kernel::faults::{LinkCounts, LinkFaults};
use trocar_kernel::spec::{FaultOrder, FaultSink};
use trocar_scene::SimTime;

use crate::impairments::Impairments;
use crate::reflector::Parcel;
use crate::stream_path::StreamPath;

/// Datagrams that arrived and wait to be taken, as in the buffer of a socket; further ones are lost.
const ARRIVED_MAX: usize = 16_384;

/// One of the two ends of a wire.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum End {
    /// The station that others join.
    Host,
    /// The station that joined.
    Station,
}

/// A wire; clones are the same wire. In virtual time one thread steps everything, so its lock is never waited for.
#[derive(Clone)]
pub struct Wire {
    inner: Arc<Mutex<Inner>>,
}

struct Inner {
    /// From the host to the station, and back.
    ways: [OneWay; 2],
    /// Whether the stream is connected; numbered, so that an end learns of a break.
    connections: u64,
    is_connected: bool,
    now: SimTime,
    /// How far the session clock of each end is behind the wire's.
    behind: [SimTime; 2],
}

impl Inner {
    /// The wire's time when the session clock of this end shows `now`.
    fn time(&self, at: End, now: SimTime) -> SimTime {
        now + self.behind[at as usize]
    }
}

#[derive(Default)]
struct OneWay {
    datagrams: LinkFaults<Parcel<()>>,
    /// Whether a firewall lets the stream pass and no datagram.
    is_blocked: bool,
    blocked: u64,
    arrived: VecDeque<Vec<u8>>,
    overflown: u64,
    /// Bytes that were sent, in datagrams and in the stream.
    bytes: [u64; 2],
    stream: StreamPath,
}

impl OneWay {
    fn new(path: &Impairments, seed: u64) -> Self {
        let stream = StreamPath::new(path, seed ^ 0x5DEE_CE66);
        Self { datagrams: path.link(seed), stream, ..Self::default() }
    }

    fn carry(&mut self, now: SimTime) {
        while let Some(Parcel { bytes, .. }) = self.datagrams.due(now) {
            if self.arrived.len() < ARRIVED_MAX {
                self.arrived.push_back(bytes);
            } else {
                self.overflown += 1;
            }
        }
    }
}

impl Wire {
    /// A wire with these properties in both directions; the same seed gives the same luck.
    pub fn new(path: &Impairments, seed: u64) -> Self {
        let ways = [OneWay::new(path, seed), OneWay::new(path, seed.wrapping_add(1))];
        let inner = Inner {
            ways,
            connections: 0,
            is_connected: false,
            now: SimTime::ZERO,
            behind: Default::default(),
        };
        Self { inner: Arc::new(Mutex::new(inner)) }
    }

    fn lock(&self) -> MutexGuard<'_, Inner> {
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// A fault of the link begins or ends, in both directions.
    pub fn fault(&self, order: &FaultOrder) {
        for (index, way) in self.lock().ways.iter_mut().enumerate() {
            let order = FaultOrder { seed: order.seed.wrapping_add(index as u64), ..order.clone() };
            way.datagrams.apply(&order);
            way.stream.apply(&order);
        }
    }

    /// The session clock of this end is behind the wire's by so much from now on, as that of a host that was killed and goes
    /// on from its recording.
    pub fn set_behind(&self, end: End, behind: SimTime) {
        self.lock().behind[end as usize] = behind;
    }

    /// Lets no datagram of this end pass, as a firewall does, or lets them pass again. The stream goes on.
    pub fn block_datagrams(&self, from: End, is_blocked: bool) {
        self.lock().ways[from as usize].is_blocked = is_blocked;
    }

    /// Datagrams that were blocked, of the host and of the station.
    pub fn blocked(&self) -> [u64; 2] {
        let inner = self.lock();
        [0, 1].map(|way: usize| inner.ways[way].blocked)
    }

    /// What the link did to datagrams, sent by the host and by the station.
    pub fn counts(&self) -> [LinkCounts; 2] {
        let inner = self.lock();
        [0, 1].map(|way: usize| *inner.ways[way].datagrams.counts())
    }

    /// Bytes that were sent by the host and by the station: of each in datagrams, and in the stream.
    pub fn bytes(&self) -> [[u64; 2]; 2] {
        let inner = self.lock();
        [0, 1].map(|way: usize| inner.ways[way].bytes)
    }

    /// Connects the stream; what an earlier one still had is gone.
    pub fn connect(&self) -> u64 {
        self.disconnect();
        let mut inner = self.lock();
        inner.is_connected = true;
        inner.connections += 1;
        inner.connections
    }

    /// Breaks the stream: what is under way is lost, as when an end dies.
    pub fn disconnect(&self) {
        let mut inner = self.lock();
        inner.is_connected = false;
        inner.ways.iter_mut().for_each(|way| way.stream.reset());
    }

    /// This end sends no more: the other one learns of it behind the last byte, as of a closed connection.
    pub fn finish(&self, from: End) {
        self.lock().ways[from as usize].stream.finish();
    }

    /// Whether the other end has finished, and everything of it was taken.
    pub fn is_finished(&self, at: End, now: SimTime) -> bool {
        let mut inner = self.lock();
        let now = inner.time(at, now);
        inner.ways[1 - at as usize].stream.is_finished(now)
    }

    /// The number of the connection, if the stream is connected.
    pub fn connection(&self) -> Option<u64> {
        let inner = self.lock();
        inner.is_connected.then_some(inner.connections)
    }

    /// Sends a datagram from this end.
    pub fn send_datagram(&self, from: End, now: SimTime, bytes: &[u8]) {
        let mut inner = self.lock();
        inner.now = inner.now.max(inner.time(from, now));
        let now = inner.now;
        let way = &mut inner.ways[from as usize];
        if way.is_blocked {
            way.blocked += 1;
        } else {
            way.bytes[0] += bytes.len() as u64;
            way.datagrams.send(now, Parcel { to: (), bytes: bytes.to_vec() });
        }
    }

    /// The next datagram that has arrived at this end by `now`.
    pub fn receive_datagram(&self, at: End, now: SimTime) -> Option<Vec<u8>> {
        let mut inner = self.lock();
        let now = inner.time(at, now);
        let way = &mut inner.ways[1 - at as usize];
        way.carry(now);
        way.arrived.pop_front()
    }

    /// Sends as many bytes of the stream as there is room for, and returns how many.
    pub fn send_stream(&self, from: End, now: SimTime, bytes: &[u8]) -> usize {
        let mut inner = self.lock();
        if !inner.is_connected {
            return 0;
        }
        inner.now = inner.now.max(inner.time(from, now));
        let now = inner.now;
        let way = &mut inner.ways[from as usize];
        let sent = way.stream.send(now, bytes);
        way.bytes[1] += sent as u64;
        sent
    }

    /// Appends the bytes of the stream that have arrived at this end by `now`.
    pub fn receive_stream(&self, at: End, now: SimTime, into: &mut Vec<u8>) {
        let mut inner = self.lock();
        let now = inner.time(at, now);
        inner.ways[1 - at as usize].stream.receive(now, into);
    }
}

impl FaultSink for Wire {
    fn fault(&self, order: &FaultOrder) {
        Wire::fault(self, order);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use trocar_kernel::spec::FaultKind;

    /// Sends a long text through the stream; returns it as received, with the time at which it was whole [ms].
    fn pass(path: &Impairments, seed: u64) -> (Vec<u8>, Vec<u8>, u64) {
        let wire = Wire::new(path, seed);
        wire.connect();
        let text: Vec<u8> = (0..200_000_u32).flat_map(u32::to_le_bytes).collect();
        let (mut sent, mut received) = (0, Vec::new());
        for ms in 0..60_000 {
            let now = SimTime::from_millis(ms);
            sent += wire.send_stream(End::Host, now, &text[sent..]);
            wire.receive_stream(End::Station, now, &mut received);
            if received.len() == text.len() {
                return (text, received, ms);
            }
        }
        (text, received, u64::MAX)
    }

    #[test]
    fn a_stream_delivers_everything_once_and_in_order_whatever_the_link_does() {
        let paths = [
            Impairments::default(),
            Impairments::delay(SimTime::from_millis(75)),
            Impairments { loss: 0.2, burst: 4.0, ..Impairments::delay(SimTime::from_millis(75)) },
            Impairments {
                independent: true,
                jitter: SimTime::from_millis(40),
                ..Impairments::delay(SimTime::from_millis(40))
            },
            Impairments { reorder: 0.1, corrupt: 0.1, duplicate: 0.1, ..Impairments::default() },
        ];
        let mut times = Vec::new();
        for path in &paths {
            let (sent, received, ms) = pass(path, 5);
            assert!(sent == received, "{path:?}: {} of {}", received.len(), sent.len());
            assert_eq!(pass(path, 5).2, ms, "the same seed, the same time");
            times.push(ms);
        }
        assert!(times[0] == 0 && times[1] >= 75 && times[2] > times[1] + 200, "{times:?}");
    }

    #[test]
    fn during_a_partition_datagrams_are_lost_and_the_stream_waits() {
        let wire = Wire::new(&Impairments::default(), 1);
        wire.connect();
        let mut order = Impairments { loss: 1.0, ..Impairments::default() }.orders(1).remove(0);
        (order.kind, order.index) = (FaultKind::Partition, 9);
        wire.fault(&order);
        let (mut received, mut datagrams) = (Vec::new(), 0);
        for ms in 0..2_000 {
            let now = SimTime::from_millis(ms);
            if ms == 1_000 {
                order.begins = false;
                wire.fault(&order);
            }
            if ms % 100 == 0 {
                wire.send_datagram(End::Station, now, b"pose");
                assert_eq!(wire.send_stream(End::Station, now, &[ms as u8]), 1);
            }
            while wire.receive_datagram(End::Host, now).is_some() {
                assert!(ms >= 1_000);
                datagrams += 1;
            }
            wire.receive_stream(End::Host, now, &mut received);
            assert!(ms >= 1_000 || received.is_empty());
        }
        assert_eq!(datagrams, 10);
        let expected: Vec<u8> = (0..20).map(|step| (step * 100) as u8).collect();
        assert_eq!(received, expected);
        assert_eq!(wire.counts().map(|counts| counts.lost), [0, 10]);
    }

    #[test]
    fn a_broken_stream_loses_what_was_under_way_and_the_next_one_begins_empty() {
        let wire = Wire::new(&Impairments::delay(SimTime::from_millis(10)), 1);
        let first = wire.connect();
        wire.send_stream(End::Host, SimTime::ZERO, b"old");
        wire.disconnect();
        assert_eq!((wire.connection(), wire.send_stream(End::Host, SimTime::ZERO, b"x")), (None, 0));
        assert_ne!(wire.connect(), first);
        wire.send_stream(End::Host, SimTime::from_millis(1), b"new");
        let mut received = Vec::new();
        wire.receive_stream(End::Station, SimTime::from_millis(20), &mut received);
        assert_eq!(received, b"new");
    }
}

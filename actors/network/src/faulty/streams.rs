//! Faults of control channels, in both directions: their bytes are late and in order. A connection that opens is not touched.

use std::collections::BTreeMap;
use std::sync::Arc;

use trocar_kernel::spec::{FaultKind, FaultOrder};
use trocar_scene::SimTime;

use super::board::{LinkBoard, Orders};
use crate::datagram::Keys;
use crate::stream_path::StreamPath;
use crate::streams::{Closed, HostStreams, StationStream, StreamId, StreamState};

/// How a stream ends that a fault cuts.
const CUT: &str = "cut by a fault";
/// Luck of streams is another than that of datagrams.
const SEED: u64 = 2;

/// Both directions of one stream.
#[derive(Debug, Default)]
struct FaultyStream {
    /// Its number in datagrams, once its station was let in; a station's own has none.
    connection: Option<u32>,
    looked_at: usize,
    /// Whether its orders were looked at.
    is_known: bool,
    inbound: StreamPath,
    outbound: StreamPath,
    /// What has come through and was not taken.
    unsent: Vec<u8>,
    /// How it ended, which is told behind its last byte.
    closed: Option<Closed>,
    is_cut: bool,
}

impl FaultyStream {
    /// Takes in its orders. A connection that comes after it was cut is another one.
    fn apply(&mut self, orders: &mut Orders<'_>) {
        let (from, is_new) = (self.looked_at, !std::mem::replace(&mut self.is_known, true));
        for (index, order) in orders.skip_while(|(index, _)| *index < from) {
            self.looked_at = index + 1;
            self.is_cut |= order.kind == FaultKind::Kill && !is_new;
            for (path, more) in [(&mut self.inbound, SEED), (&mut self.outbound, SEED + 1)] {
                path.apply(&FaultOrder { seed: order.seed.wrapping_add(more), ..order.clone() });
            }
        }
    }

    /// Appends what has come; `read` gives what the inner stream has.
    fn receive(
        &mut self,
        now: SimTime,
        into: &mut Vec<u8>,
        mut read: impl FnMut(&mut Vec<u8>) -> Result<(), Closed>,
    ) -> Result<(), Closed> {
        if self.is_cut {
            return Err(Closed(CUT.to_owned()));
        }
        if self.closed.is_none() && self.inbound.is_idle() {
            return read(into);
        }
        if self.closed.is_none() && self.inbound.has_room() {
            let mut come = Vec::new();
            self.closed = read(&mut come).err();
            self.inbound.send_all(now, &come);
        }
        self.inbound.receive(now, into);
        match &self.closed {
            Some(closed) if into.is_empty() && self.inbound.is_idle_but_for_faults() => Err(closed.clone()),
            _ => Ok(()),
        }
    }

    /// Sends as much as there is room for; `write` gives it to the inner stream.
    fn send(
        &mut self,
        now: SimTime,
        bytes: &[u8],
        write: impl FnOnce(&[u8]) -> Result<usize, Closed>,
    ) -> Result<usize, Closed> {
        if self.is_cut {
            return Err(Closed(CUT.to_owned()));
        }
        if self.outbound.is_idle() && self.unsent.is_empty() {
            return write(bytes);
        }
        Ok(self.outbound.send(now, bytes))
    }

    /// Gives what has come through to the inner stream.
    fn flush(&mut self, now: SimTime, write: impl FnOnce(&[u8]) -> Result<usize, Closed>) {
        self.outbound.receive(now, &mut self.unsent);
        if !self.unsent.is_empty() {
            match write(&self.unsent) {
                Ok(count) => drop(self.unsent.drain(..count.min(self.unsent.len()))),
                // The receiving side tells how it ended.
                Err(_) => self.unsent.clear(),
            }
        }
    }

    /// The stream is another one, on the same path.
    fn reset(&mut self) {
        self.inbound.reset();
        self.outbound.reset();
        self.unsent.clear();
        (self.closed, self.is_cut) = (None, false);
    }
}

/// The streams of a host under the faults of a board.
pub struct FaultyHostStreams {
    inner: Box<dyn HostStreams>,
    board: Arc<LinkBoard>,
    version: Option<u64>,
    streams: BTreeMap<StreamId, FaultyStream>,
    heard: Vec<Option<u32>>,
}

impl FaultyHostStreams {
    /// These streams under these faults.
    pub fn new(inner: Box<dyn HostStreams>, board: Arc<LinkBoard>) -> Self {
        Self { inner, board, version: None, streams: BTreeMap::new(), heard: Vec::new() }
    }

    fn look(&mut self) {
        let version = self.board.version();
        if self.version == Some(version) {
            return;
        }
        let streams = &mut self.streams;
        let is_seen = self.board.look(|connection, orders| {
            let stream = streams.values_mut().find(|stream| stream.connection == connection);
            if let Some(stream) = stream.filter(|_| connection.is_some()) {
                stream.apply(orders);
            }
        });
        if is_seen {
            self.version = Some(version);
        }
    }
}

impl HostStreams for FaultyHostStreams {
    /// # Panics
    /// When a fault wants the network to die at work.
    fn work(&mut self, now: SimTime, opened: &mut Vec<StreamId>) {
        assert!(!self.board.takes_its_life(), "killed by a fault, with all its connections");
        self.inner.work(now, opened);
        for stream in opened.iter() {
            self.streams.entry(*stream).or_default();
        }
        self.look();
        let Self { inner, streams, heard, board, .. } = self;
        for (id, stream) in streams.iter_mut() {
            stream.flush(now, |bytes| inner.send(*id, now, bytes));
        }
        board.heard(now, heard);
    }

    fn receive(
        &mut self,
        stream: StreamId,
        now: SimTime,
        most: usize,
        into: &mut Vec<u8>,
    ) -> Result<(), Closed> {
        let Self { inner, streams, heard, .. } = self;
        let Some(known) = streams.get_mut(&stream) else { return inner.receive(stream, now, most, into) };
        let before = into.len();
        let received = known.receive(now, into, |into| inner.receive(stream, now, most, into));
        if into.len() > before && known.connection.is_some() {
            heard.push(known.connection);
        }
        received
    }

    fn send(&mut self, stream: StreamId, now: SimTime, bytes: &[u8]) -> Result<usize, Closed> {
        let Self { inner, streams, .. } = self;
        match streams.get_mut(&stream) {
            Some(known) => known.send(now, bytes, |bytes| inner.send(stream, now, bytes)),
            None => inner.send(stream, now, bytes),
        }
    }

    fn keys(&mut self, stream: StreamId, connection: u32, phase: u32) -> Option<Keys> {
        self.inner.keys(stream, connection, phase)
    }

    fn close(&mut self, stream: StreamId) {
        self.streams.remove(&stream);
        self.inner.close(stream);
    }

    fn admitted(&mut self, stream: StreamId, connection: u32, station: u16, name: &str) {
        if let Some(known) = self.streams.get_mut(&stream) {
            known.connection = Some(connection);
        }
        self.board.admit(connection, station, name);
        // What is said to it from now on meets its faults.
        self.look();
        self.inner.admitted(stream, connection, station, name);
    }
}

/// The stream of a station under the faults of a board.
pub struct FaultyStationStream<A> {
    inner: Box<dyn StationStream<A>>,
    board: Arc<LinkBoard>,
    version: Option<u64>,
    stream: FaultyStream,
    heard: Vec<Option<u32>>,
}

impl<A: 'static> FaultyStationStream<A> {
    /// This stream under these faults.
    pub fn new(inner: Box<dyn StationStream<A>>, board: Arc<LinkBoard>) -> Self {
        Self { inner, board, version: None, stream: FaultyStream::default(), heard: Vec::new() }
    }

    fn look(&mut self) {
        let version = self.board.version();
        if self.version == Some(version) {
            return;
        }
        let stream = &mut self.stream;
        if self.board.look(|_, orders| stream.apply(orders)) {
            self.version = Some(version);
        }
    }
}

impl<A: 'static> StationStream<A> for FaultyStationStream<A> {
    fn peer(&self) -> Option<A> {
        self.inner.peer()
    }

    fn connect(&mut self, now: SimTime) {
        self.stream.reset();
        self.board.reconnect();
        self.inner.connect(now);
    }

    /// # Panics
    /// When a fault wants the network to die at work.
    fn work(&mut self, now: SimTime) -> StreamState {
        assert!(!self.board.takes_its_life(), "killed by a fault, with its connection");
        let state = self.inner.work(now);
        self.look();
        let Self { inner, stream, board, heard, .. } = self;
        stream.flush(now, |bytes| inner.send(now, bytes));
        board.heard(now, heard);
        match state {
            StreamState::Open if self.stream.is_cut => {
                self.inner.close();
                StreamState::Closed(CUT.to_owned())
            }
            // What is under way comes before the end.
            StreamState::Closed(why) if !self.stream.inbound.is_idle_but_for_faults() => {
                self.stream.closed.get_or_insert(Closed(why));
                StreamState::Open
            }
            state => state,
        }
    }

    fn receive(&mut self, now: SimTime, most: usize, into: &mut Vec<u8>) -> Result<(), Closed> {
        let Self { inner, stream, heard, .. } = self;
        let before = into.len();
        let received = stream.receive(now, into, |into| inner.receive(now, most, into));
        if into.len() > before {
            heard.push(None);
        }
        received
    }

    fn send(&mut self, now: SimTime, bytes: &[u8]) -> Result<usize, Closed> {
        let Self { inner, stream, .. } = self;
        stream.send(now, bytes, |bytes| inner.send(now, bytes))
    }

    fn keys(&mut self, connection: u32, phase: u32) -> Option<Keys> {
        self.inner.keys(connection, phase)
    }

    fn close(&mut self) {
        self.inner.close();
    }
}

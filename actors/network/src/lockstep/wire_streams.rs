//! Streams over wires, in virtual time. Whoever has a wire is who he should be; its keys come of the wire's number.

use std::collections::BTreeMap;

use trocar_scene::SimTime;

use super::hands_peer::Wires;
use super::wire::{End, Wire};
use crate::datagram::Keys;
use crate::streams::{Closed, HostStreams, StationStream, StreamId, StreamState};

/// Keys that both ends of a wire make, of what both know. Nobody else is in the process.
fn keys(wire: usize, stream: u64, connection: u32, phase: u32) -> Option<Keys> {
    let made = Keys::from_exporter(connection, phase, |label, context, out: &mut [u8]| {
        let mut hasher = blake3::Hasher::new_derive_key("trocar-network lock-step keys of a wire");
        hasher
            .update(&(wire as u64).to_le_bytes())
            .update(&stream.to_le_bytes())
            .update(label)
            .update(context);
        hasher.finalize_xof().fill(out);
        Ok::<(), ()>(())
    });
    made.ok()
}

/// The streams of a host over its wires.
pub struct WireHostStreams {
    wires: Wires,
    /// Number of each open stream's wire, and of its connection there.
    open: BTreeMap<StreamId, (usize, u64)>,
    /// The connections that have been taken, by wire.
    taken: BTreeMap<usize, u64>,
    last: u64,
}

impl WireHostStreams {
    /// Over these wires.
    pub fn new(wires: Wires) -> Self {
        Self { wires, open: BTreeMap::new(), taken: BTreeMap::new(), last: 0 }
    }

    fn wire(&self, stream: StreamId) -> Result<Wire, Closed> {
        let (number, connection) = self.open.get(&stream).ok_or_else(over)?;
        let wire = self.wires.all().get(*number).cloned().ok_or_else(over)?;
        if wire.connection() == Some(*connection) { Ok(wire) } else { Err(over()) }
    }
}

fn over() -> Closed {
    Closed("the wire is cut".to_owned())
}

impl HostStreams for WireHostStreams {
    fn work(&mut self, _: SimTime, opened: &mut Vec<StreamId>) {
        for (number, wire) in self.wires.all().iter().enumerate() {
            let Some(connection) = wire.connection() else { continue };
            if self.taken.insert(number, connection) != Some(connection) {
                self.last += 1;
                self.open.insert(StreamId(self.last), (number, connection));
                opened.push(StreamId(self.last));
            }
        }
    }

    fn receive(
        &mut self,
        stream: StreamId,
        now: SimTime,
        _: usize,
        into: &mut Vec<u8>,
    ) -> Result<(), Closed> {
        let wire = self.wire(stream)?;
        wire.receive_stream(End::Host, now, into);
        if into.is_empty() && wire.is_finished(End::Host, now) { Err(over()) } else { Ok(()) }
    }

    fn send(&mut self, stream: StreamId, now: SimTime, bytes: &[u8]) -> Result<usize, Closed> {
        Ok(self.wire(stream)?.send_stream(End::Host, now, bytes))
    }

    fn keys(&mut self, stream: StreamId, connection: u32, phase: u32) -> Option<Keys> {
        let (wire, stream) = self.open.get(&stream)?;
        keys(*wire, *stream, connection, phase)
    }

    fn close(&mut self, stream: StreamId) {
        if let Ok(wire) = self.wire(stream) {
            wire.finish(End::Host);
        }
        self.open.remove(&stream);
    }
}

/// A station's stream over its wire.
pub struct WireStationStream {
    wire: Wire,
    /// The wire's number at the host.
    number: usize,
    connection: Option<u64>,
    /// When the stream is open: a handshake takes two round trips.
    open_at: SimTime,
    handshake: SimTime,
    /// The address of the wire's datagrams.
    peer: usize,
}

impl WireStationStream {
    /// Over the wire that has this number at its host; a handshake takes so long.
    pub fn new(wire: Wire, number: usize, handshake: SimTime) -> Self {
        Self { wire, number, connection: None, open_at: SimTime::ZERO, handshake, peer: 0 }
    }

    /// The same where the wire's datagrams have another address than those to the host.
    #[must_use]
    pub fn with_peer(self, peer: usize) -> Self {
        Self { peer, ..self }
    }

    fn is_connected(&self) -> bool {
        self.connection.is_some() && self.wire.connection() == self.connection
    }
}

impl StationStream<usize> for WireStationStream {
    fn peer(&self) -> Option<usize> {
        Some(self.peer)
    }

    fn connect(&mut self, now: SimTime) {
        self.open_at = now + self.handshake;
        self.connection = Some(self.wire.connect());
    }

    fn work(&mut self, now: SimTime) -> StreamState {
        match self.connection {
            None => StreamState::None,
            Some(_) if !self.is_connected() => StreamState::Closed(over().0),
            Some(_) if now < self.open_at => StreamState::Connecting,
            Some(_) => StreamState::Open,
        }
    }

    fn receive(&mut self, now: SimTime, _: usize, into: &mut Vec<u8>) -> Result<(), Closed> {
        if !self.is_connected() {
            return Err(over());
        }
        self.wire.receive_stream(End::Station, now, into);
        if into.is_empty() && self.wire.is_finished(End::Station, now) { Err(over()) } else { Ok(()) }
    }

    fn send(&mut self, now: SimTime, bytes: &[u8]) -> Result<usize, Closed> {
        if !self.is_connected() {
            return Err(over());
        }
        Ok(self.wire.send_stream(End::Station, now, bytes))
    }

    fn keys(&mut self, connection: u32, phase: u32) -> Option<Keys> {
        keys(self.number, self.connection?, connection, phase)
    }

    fn close(&mut self) {
        if self.is_connected() {
            self.wire.finish(End::Station);
        }
        self.connection = None;
    }
}

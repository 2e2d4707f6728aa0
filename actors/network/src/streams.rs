//! Streams: what the control channel needs of a transport. Ordered, reliable and authenticated bytes, and keys for the
//! datagrams of the same connection.
//!
//! No method waits. Live, a stream is TLS 1.3 over TCP ([`crate::live`]); in virtual time it is the stream of a
//! [`Wire`](crate::lockstep::Wire).

use trocar_scene::SimTime;

use crate::datagram::Keys;

/// Number of a stream at its host, never used twice.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct StreamId(pub u64);

/// A stream that has ended, with the reason in words.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Closed(pub String);

/// Where a station's stream is.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum StreamState {
    /// There is none.
    None,
    /// It connects, or shakes hands.
    Connecting,
    /// It is open, and the host is who it should be.
    Open,
    /// It failed or ended.
    Closed(String),
}

/// The streams of a host.
pub trait HostStreams: Send + 'static {
    /// Takes new connections and goes on with their handshakes; appends the streams whose handshake is done. Strangers are
    /// bounded in number and time here, below everything that understands them.
    fn work(&mut self, now: SimTime, opened: &mut Vec<StreamId>);
    /// Appends bytes that have come, at most `most`.
    ///
    /// # Errors
    /// [`Closed`] when the stream has ended, after its last bytes were taken.
    fn receive(
        &mut self,
        stream: StreamId,
        now: SimTime,
        most: usize,
        into: &mut Vec<u8>,
    ) -> Result<(), Closed>;
    /// Sends as many bytes as there is room for, and returns how many.
    ///
    /// # Errors
    /// [`Closed`].
    fn send(&mut self, stream: StreamId, now: SimTime, bytes: &[u8]) -> Result<usize, Closed>;
    /// Keys for datagrams of a connection and phase, from the exporter of this stream's TLS session.
    fn keys(&mut self, stream: StreamId, connection: u32, phase: u32) -> Option<Keys>;
    /// Ends a stream. Bytes that were taken still go out if the system takes them at once.
    fn close(&mut self, stream: StreamId);
    /// The stream is that of a station which was let in, and whose datagrams have this number.
    fn admitted(&mut self, _stream: StreamId, _connection: u32, _station: u16, _name: &str) {}
}

/// The one stream of a station; `A` is an address of datagrams.
pub trait StationStream<A>: Send + 'static {
    /// Where the host that was reached takes datagrams; `None` before it was reached.
    fn peer(&self) -> Option<A>;
    /// Begins a new connection; an earlier one is closed. It tries all addresses that it knows.
    fn connect(&mut self, now: SimTime);
    /// Goes on with the handshake, and says where the stream is.
    fn work(&mut self, now: SimTime) -> StreamState;
    /// Appends bytes that have come, at most `most`.
    ///
    /// # Errors
    /// [`Closed`] when the stream has ended, after its last bytes were taken.
    fn receive(&mut self, now: SimTime, most: usize, into: &mut Vec<u8>) -> Result<(), Closed>;
    /// Sends as many bytes as there is room for, and returns how many.
    ///
    /// # Errors
    /// [`Closed`].
    fn send(&mut self, now: SimTime, bytes: &[u8]) -> Result<usize, Closed>;
    /// Keys for datagrams of a connection and phase, from the exporter of this stream's TLS session.
    fn keys(&mut self, connection: u32, phase: u32) -> Option<Keys>;
    /// Ends the stream. Bytes that were taken still go out if the system takes them at once.
    fn close(&mut self);
}

//! The streams of a host: TLS over TCP, below everything that understands what they carry.
//!
//! Strangers open connections as they like. This is what bounds them:
//!
//! | what | limit |
//! |---|---|
//! | new connections taken in one `work` | [`ACCEPTED_MAX`] |
//! | openers: connections whose handshake is not done | [`OPENERS_MAX`], and a quarter of the files that the process may open |
//! | time from a new connection to the end of its handshake | [`OPENING_TIME_MAX`] 5 s |
//! | handshakes moved on in one `work` | [`HANDSHAKES_MAX`] |
//! | time between two looks at the openers' sockets | [`LOOK_EVERY`], longer when there are many |
//! | streams | [`STREAMS_MAX`] |
//! | memory of an opener | 64 KiB, the longest handshake message that rustls takes |
//! | bytes of a stream that wait for the system, that one call takes or gives | [`SEND_BUFFER`], [`SENT_MAX`], [`RECEIVED_MAX`] |
//! | closed streams whose last words are under way | [`LEAVING_MAX`], each for [`LEAVING_TIME_MAX`] |
//!
//! When there is no room for another opener, the oldest one goes. A station whose handshake takes a round trip of 0.2 s
//! then gets in as long as strangers open fewer than some 5,000 connections a second. When there is no room for another
//! stream, the oldest stranger goes: a stream on which the host has not said anything, since a host speaks to those only
//! whose ticket it knows, and to those that it refuses and closes.

use std::collections::BTreeMap;
use std::io::{self, ErrorKind};
use std::net::{SocketAddr, TcpListener};
use std::sync::Arc;

use rustix::event::{PollFd, PollFlags};
use rustix::process::{Resource, getrlimit};
use rustls::{Connection, ServerConfig, ServerConnection};
use thiserror::Error;
use trocar_scene::SimTime;

pub use super::leaving::LEAVING_TIME_MAX;
use super::leaving::Leaving;
pub use super::tls_socket::{RECEIVED_MAX, SEND_BUFFER, SENT_MAX};
use super::tls_socket::{TlsSocket, poll_now};
use crate::datagram::{Keys, Seal};
use crate::streams::{Closed, HostStreams, StreamId};

/// Most connections whose handshake is not done. Fewer where the process may open fewer than four times as many files.
pub const OPENERS_MAX: usize = 1_024;
/// Longest time from a new connection to the end of its handshake.
pub const OPENING_TIME_MAX: SimTime = SimTime::from_millis(5_000);
/// Most streams.
pub const STREAMS_MAX: usize = 256;
/// Most connections that one `work` takes. The system keeps others until the next.
pub const ACCEPTED_MAX: usize = 32;
/// Most handshakes that one `work` moves on: each may cost a signature and a key exchange, some 0.1 ms.
pub const HANDSHAKES_MAX: usize = 8;
/// Shortest time between two looks at the openers' sockets.
pub const LOOK_EVERY: SimTime = SimTime::from_millis(1);
/// The time between two looks is at least this long for each opener. A look takes some 0.2 µs for each, so that idle
/// strangers in any number take 4 % of a processor.
const LOOK_EVERY_FOR_EACH: SimTime = SimTime::from_micros(5);
/// Most closed streams whose last words are under way.
pub const LEAVING_MAX: usize = 64;
/// One of so many files that the process may open is an opener's at most: scenes and recordings need some, too.
const FILES_SHARE: u64 = 4;

/// Why a host cannot have streams.
#[derive(Debug, Error)]
pub enum TlsHostError {
    /// Everybody could make datagrams that count.
    #[error(
        "{address} can be reached from other machines, and datagrams without protection are for this machine alone: \
         bind the host to 127.0.0.1 or ::1, or leave out `--insecure`"
    )]
    NotLoopback {
        /// Where the host listens.
        address: SocketAddr,
    },
    /// The listener cannot be used.
    #[error("the port cannot be used: {0}")]
    Listener(#[from] io::Error),
}

/// What has become of the connections so far.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct OpenerCounts {
    /// Connections that were taken.
    pub accepted: u64,
    /// Handshakes that were done.
    pub opened: u64,
    /// Connections that ended during the handshake, or spoke something else.
    pub failed: u64,
    /// Handshakes that were not done in time.
    pub too_slow: u64,
    /// Openers and strangers' streams that made room for newer ones.
    pub crowded_out: u64,
    /// Handshakes that were done while all streams were in use.
    pub no_room: u64,
}

/// The streams of a host over TLS.
#[derive(Debug)]
pub struct TlsHostStreams {
    listener: TcpListener,
    config: Arc<ServerConfig>,
    datagrams: Seal,
    /// By their numbers, and so by their age.
    openers: BTreeMap<u64, Opener>,
    openers_max: usize,
    /// Openers that were ready at the last look and have not had their turn, the newest last: it comes first, since those
    /// who make others wait are older. The next look comes when all have had their turn.
    ready: Vec<u64>,
    next_look: SimTime,
    streams: BTreeMap<StreamId, Stream>,
    leaving: Leaving,
    next_number: u64,
    /// Whether the process can open no file, so that the listener is ready and yet gives nothing.
    is_short_of_files: bool,
    counts: OpenerCounts,
}

#[derive(Debug)]
struct Opener {
    socket: TlsSocket,
    address: SocketAddr,
    until: SimTime,
}

#[derive(Debug)]
struct Stream {
    socket: TlsSocket,
    address: SocketAddr,
    /// Whether the host has said something.
    is_known: bool,
}

impl TlsHostStreams {
    /// Streams of those who connect to the listener of [`HostSockets`](super::sockets::HostSockets), with the
    /// configuration of [`tls::host`](super::tls::host). [`Seal::Checksum`] is `--insecure`: then the keys of datagrams
    /// are none, while the streams stay what they are.
    ///
    /// # Errors
    /// [`TlsHostError::NotLoopback`] when datagrams are not protected and the listener is not on the loopback.
    pub fn new(
        listener: TcpListener,
        config: Arc<ServerConfig>,
        datagrams: Seal,
    ) -> Result<Self, TlsHostError> {
        let address = listener.local_addr()?;
        if !datagrams.is_protected() && !address.ip().to_canonical().is_loopback() {
            return Err(TlsHostError::NotLoopback { address });
        }
        listener.set_nonblocking(true)?;
        let files = getrlimit(Resource::Nofile).current.map_or(u64::MAX, |files| files / FILES_SHARE);
        Ok(Self {
            listener,
            config,
            datagrams,
            openers: BTreeMap::new(),
            openers_max: usize::try_from(files).unwrap_or(OPENERS_MAX).clamp(1, OPENERS_MAX),
            ready: Vec::new(),
            next_look: SimTime::ZERO,
            streams: BTreeMap::new(),
            leaving: Leaving::new(LEAVING_MAX),
            next_number: 0,
            is_short_of_files: false,
            counts: OpenerCounts::default(),
        })
    }

    /// From where a stream's station has connected.
    pub fn address(&self, stream: StreamId) -> Option<SocketAddr> {
        self.streams.get(&stream).map(|stream| stream.address)
    }

    /// What has become of the connections so far.
    pub fn counts(&self) -> OpenerCounts {
        self.counts
    }

    /// How many connections have not done their handshake.
    pub fn openers(&self) -> usize {
        self.openers.len()
    }

    /// How many streams there are.
    pub fn streams(&self) -> usize {
        self.streams.len()
    }

    /// Appends what a driver may wait for before it calls `work` and `receive` again, until [`Self::due`]. A stream from
    /// which `receive` gave as many bytes as were asked for may have more, of which the system does not know.
    pub fn wake_on<'a>(&'a self, into: &mut Vec<PollFd<'a>>) {
        if !self.is_short_of_files {
            into.push(PollFd::new(&self.listener, PollFlags::IN));
        }
        let streams = self.streams.values().filter(|stream| stream.socket.over().is_none());
        into.extend(streams.map(|stream| stream.socket.poll_fd()));
    }

    /// When `work` is due although no socket of [`Self::wake_on`] is ready; `None` as long as nobody opens or leaves.
    pub fn due(&self) -> Option<SimTime> {
        let is_busy = !self.openers.is_empty() || !self.leaving.is_empty() || self.is_short_of_files;
        is_busy.then_some(self.next_look)
    }

    fn accept(&mut self, now: SimTime) {
        self.is_short_of_files = false;
        for _ in 0..ACCEPTED_MAX {
            let (tcp, address) = match self.listener.accept() {
                Ok(taken) => taken,
                Err(error) if is_lack_of_files(&error) => {
                    // The oldest opener has the file that the newest needs.
                    if self.openers.pop_first().is_some() {
                        self.counts.crowded_out += 1;
                        continue;
                    }
                    self.is_short_of_files = true;
                    return;
                }
                // A connection that ended before it was taken.
                Err(error)
                    if matches!(error.kind(), ErrorKind::ConnectionAborted | ErrorKind::Interrupted) =>
                {
                    continue;
                }
                Err(_) => return,
            };
            self.counts.accepted += 1;
            let ready = tcp.set_nonblocking(true).is_ok();
            let (true, Ok(tls)) = (ready, ServerConnection::new(Arc::clone(&self.config))) else {
                self.counts.failed += 1;
                continue;
            };
            if self.openers.len() >= self.openers_max {
                self.openers.pop_first();
                self.counts.crowded_out += 1;
            }
            self.next_number += 1;
            let socket = TlsSocket::new(tcp, Connection::Server(tls));
            self.openers.insert(self.next_number, Opener { socket, address, until: now + OPENING_TIME_MAX });
        }
    }

    fn end_slow_openers(&mut self, now: SimTime) {
        // Who came first must be done first.
        while let Some(oldest) = self.openers.first_entry()
            && now >= oldest.get().until
        {
            oldest.remove();
            self.counts.too_slow += 1;
        }
    }

    fn look(&mut self, now: SimTime) {
        if now < self.next_look || !self.ready.is_empty() {
            return;
        }
        let for_all = SimTime(LOOK_EVERY_FOR_EACH.0 * self.openers.len() as u64);
        self.next_look = now + for_all.max(LOOK_EVERY);
        if self.openers.is_empty() {
            return;
        }
        let mut sockets: Vec<PollFd<'_>> =
            self.openers.values().map(|opener| opener.socket.poll_fd()).collect();
        if !poll_now(&mut sockets) {
            return;
        }
        let numbers = self.openers.keys().zip(&sockets);
        let ready = numbers.filter(|(_, socket)| !socket.revents().is_empty()).map(|(number, _)| *number);
        self.ready = ready.collect();
    }

    fn shake_hands(&mut self, opened: &mut Vec<StreamId>) {
        for _ in 0..HANDSHAKES_MAX {
            let Some(number) = self.ready.pop() else { return };
            // It may have been dropped meanwhile.
            let Some(opener) = self.openers.get_mut(&number) else { continue };
            match opener.socket.shake_hands() {
                Ok(false) => {}
                Ok(true) => opened.extend(self.open(number)),
                Err(_) => {
                    self.openers.remove(&number);
                    self.counts.failed += 1;
                }
            }
        }
    }

    /// Makes a stream of an opener whose handshake is done, if there is room.
    fn open(&mut self, number: u64) -> Option<StreamId> {
        let Opener { socket, address, .. } = self.openers.remove(&number)?;
        if self.streams.len() >= STREAMS_MAX {
            let stranger = self.streams.iter().find(|(_, stream)| !stream.is_known).map(|(id, _)| *id);
            match stranger {
                Some(stranger) => {
                    self.close(stranger);
                    self.counts.crowded_out += 1;
                }
                None => {
                    self.leaving.add(socket);
                    self.counts.no_room += 1;
                    return None;
                }
            }
        }
        self.counts.opened += 1;
        self.streams.insert(StreamId(number), Stream { socket, address, is_known: false });
        Some(StreamId(number))
    }

    fn stream(&mut self, stream: StreamId) -> Result<&mut Stream, Closed> {
        let gone = || Closed("the stream was closed, or has made room for another one".to_owned());
        self.streams.get_mut(&stream).ok_or_else(gone)
    }
}

/// Each `work` takes new connections, moves handshakes on and sends what waits. A stream that has ended is told by
/// `receive`, after its last bytes; until then `send` takes nothing.
impl HostStreams for TlsHostStreams {
    fn work(&mut self, now: SimTime, opened: &mut Vec<StreamId>) {
        self.end_slow_openers(now);
        self.accept(now);
        self.look(now);
        self.shake_hands(opened);
        for stream in self.streams.values_mut() {
            stream.socket.flush();
        }
        self.leaving.work(now);
    }

    fn receive(
        &mut self,
        stream: StreamId,
        _: SimTime,
        most: usize,
        into: &mut Vec<u8>,
    ) -> Result<(), Closed> {
        self.stream(stream)?.socket.receive(most, into)
    }

    fn send(&mut self, stream: StreamId, _: SimTime, bytes: &[u8]) -> Result<usize, Closed> {
        let stream = self.stream(stream)?;
        stream.is_known |= !bytes.is_empty();
        stream.socket.send(bytes)
    }

    fn keys(&mut self, stream: StreamId, connection: u32, phase: u32) -> Option<Keys> {
        let stream = self.streams.get(&stream)?;
        match self.datagrams {
            Seal::Aead => stream.socket.keys(connection, phase),
            Seal::Checksum => Some(Keys::unprotected(connection, phase)),
        }
    }

    fn close(&mut self, stream: StreamId) {
        if let Some(stream) = self.streams.remove(&stream) {
            self.leaving.add(stream.socket);
        }
    }
}

/// Of the process, or of the machine.
fn is_lack_of_files(error: &io::Error) -> bool {
    let errors = [rustix::io::Errno::MFILE, rustix::io::Errno::NFILE];
    errors.iter().any(|errno| error.raw_os_error() == Some(errno.raw_os_error()))
}

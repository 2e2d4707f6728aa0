//! A host's part of a relay: it dials out, gets a port there, and brings what comes to that port to the host's own, as if the
//! stations had come here. All that it carries is sealed; it has no key of the session either.

use std::collections::BTreeMap;
use std::io::{self, ErrorKind, Read, Write};
use std::net::{SocketAddr, TcpStream, UdpSocket};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU16, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use rustix::event::{PollFd, PollFlags, Timespec, poll};
use thiserror::Error;
use trocar_scene::SimTime;

use super::splice::Splice;
use crate::control::STATIONS_MAX;
use crate::datagram::DATAGRAM_MAX;
use crate::live::sockets::{self, SocketError};
use crate::relay::{
    Bind, FromHost, FromRelay, HOST_SILENCE_MAX, LineDecoder, NUMBER_BYTES, Nonce, RelayKey, RelayRefusal,
    STATION_IDLE_MAX, STREAMS_MAX, WireError, numbered, split_number,
};

/// Longest time to dial the relay, and for its answer.
const DIAL_TIME_MAX: Duration = Duration::from_secs(5);
/// Time between two binds: routers forget a way of datagrams after 30 s.
const BIND_EVERY: SimTime = SimTime::from_millis(2_000);
/// Longest wait before the agent looks whether it shall end.
const LOOK_EVERY: SimTime = SimTime::from_millis(50);
/// Pauses before the relay is dialled again, the first and the longest.
const PAUSES: [Duration; 2] = [Duration::from_millis(500), Duration::from_secs(8)];
/// Datagrams taken from one socket before the others have their turn.
const TAKEN_MAX: usize = 128;
/// Streams that are being fetched at once.
const FETCHES_MAX: usize = 16;

/// Why a host has no port at a relay.
#[derive(Debug, Error)]
pub enum RelayError {
    /// It cannot be reached.
    #[error("the relay {0} cannot be reached: {1}")]
    Unreached(SocketAddr, io::Error),
    /// It says something else.
    #[error("what answers at {0} is no relay of this program: {1}")]
    NoRelay(SocketAddr, WireError),
    /// It does not give a port.
    #[error("{0}: {1}")]
    Refused(SocketAddr, RelayRefusal),
    /// No socket for datagrams.
    #[error(transparent)]
    Socket(#[from] SocketError),
    /// The system has no thread.
    #[error("no thread for the relay: {0}")]
    Thread(io::Error),
}

/// Where a host and its relay are.
#[derive(Clone, Debug)]
struct Ends {
    relay: SocketAddr,
    /// The host's own port.
    host: SocketAddr,
    key: RelayKey,
}

/// A host's part of a relay, on its threads; dropping it ends the session there.
#[derive(Debug)]
pub struct RelayAgent {
    port: Arc<AtomicU16>,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl RelayAgent {
    /// Gets a port at a relay for the host at `host`, an address of this machine. When the relay is lost later, the agent dials
    /// it again and asks for the same port.
    ///
    /// # Errors
    /// [`RelayError`].
    pub fn register(relay: SocketAddr, key: RelayKey, host: SocketAddr) -> Result<Self, RelayError> {
        let ends = Ends { relay, host, key };
        let registered = Registered::new(&ends, 0)?;
        let (port, stop) = (Arc::new(AtomicU16::new(registered.port)), Arc::new(AtomicBool::new(false)));
        let (known, ending) = (port.clone(), stop.clone());
        let thread = std::thread::Builder::new()
            .name("network.relay".into())
            .spawn(move || keep(&ends, registered, &known, &ending))
            .map_err(RelayError::Thread)?;
        Ok(Self { port, stop, thread: Some(thread) })
    }

    /// The port at the relay.
    pub fn port(&self) -> u16 {
        self.port.load(Ordering::Acquire)
    }
}

impl Drop for RelayAgent {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Release);
        if let Some(thread) = self.thread.take() {
            // Its panic would have been told by the panic hook.
            let _ = thread.join();
        }
    }
}

/// The line of a session at its relay, and the socket of its datagrams.
struct Registered {
    line: TcpStream,
    decoder: LineDecoder,
    nonce: Nonce,
    port: u16,
    datagrams: UdpSocket,
}

/// Dials a relay, and reads its question.
fn dial(relay: SocketAddr) -> Result<(TcpStream, LineDecoder, Nonce), RelayError> {
    let unreached = |error| RelayError::Unreached(relay, error);
    let mut line = TcpStream::connect_timeout(&relay, DIAL_TIME_MAX).map_err(unreached)?;
    line.set_read_timeout(Some(DIAL_TIME_MAX)).map_err(unreached)?;
    line.set_write_timeout(Some(DIAL_TIME_MAX)).map_err(unreached)?;
    let _ = line.set_nodelay(true);
    let mut decoder = LineDecoder::default();
    match next(&mut line, &mut decoder, relay)? {
        FromRelay::Challenge(nonce) => Ok((line, decoder, nonce)),
        _ => Err(RelayError::NoRelay(relay, WireError::Unknown)),
    }
}

/// The next message of a line that blocks. One byte after the other, since what follows may not be a message.
fn next(line: &mut TcpStream, decoder: &mut LineDecoder, relay: SocketAddr) -> Result<FromRelay, RelayError> {
    let begun = Instant::now();
    loop {
        let mut byte = [0];
        match line.read(&mut byte) {
            Ok(0) => return Err(RelayError::Unreached(relay, ErrorKind::UnexpectedEof.into())),
            Ok(_) => {}
            Err(error) if error.kind() == ErrorKind::Interrupted => continue,
            Err(error) => return Err(RelayError::Unreached(relay, error)),
        }
        let message = decoder.next(&mut &byte[..]).map_err(|error| RelayError::NoRelay(relay, error))?;
        if let Some(message) = message {
            return FromRelay::decode(&message).map_err(|error| RelayError::NoRelay(relay, error));
        }
        if begun.elapsed() > DIAL_TIME_MAX {
            return Err(RelayError::Unreached(relay, ErrorKind::TimedOut.into()));
        }
    }
}

impl Registered {
    /// Asks for a port, this one if it is free.
    fn new(ends: &Ends, wish: u16) -> Result<Self, RelayError> {
        let relay = ends.relay;
        let unreached = |error| RelayError::Unreached(relay, error);
        let (mut line, mut decoder, nonce) = dial(relay)?;
        line.write_all(&ends.key.register(&nonce, wish).encode()).map_err(unreached)?;
        let port = match next(&mut line, &mut decoder, relay)? {
            FromRelay::Registered(port) => port,
            FromRelay::Refused(refusal) => return Err(RelayError::Refused(relay, refusal)),
            _ => return Err(RelayError::NoRelay(relay, WireError::Unknown)),
        };
        line.set_nonblocking(true).map_err(unreached)?;
        let datagrams = sockets::station(&relay)?;
        datagrams.connect(relay).map_err(unreached)?;
        Ok(Self { line, decoder, nonce, port, datagrams })
    }
}

/// Serves the session, and registers it again when the relay was lost.
fn keep(ends: &Ends, first: Registered, port: &AtomicU16, stop: &AtomicBool) {
    let (mut next, mut pause) = (Some(first), PAUSES[0]);
    while !stop.load(Ordering::Acquire) {
        let registered = match next.take() {
            Some(registered) => Ok(registered),
            None => Registered::new(ends, port.load(Ordering::Acquire)),
        };
        match registered {
            Ok(registered) => {
                let before = port.swap(registered.port, Ordering::AcqRel);
                if before != registered.port {
                    tracing::warn!(
                        "the relay {} gives port {} now: tickets for its port {before} lead here no longer",
                        ends.relay,
                        registered.port
                    );
                }
                pause = PAUSES[0];
                Serving::new(ends, registered).run(stop);
                if !stop.load(Ordering::Acquire) {
                    tracing::warn!("the relay {} is lost; it is dialled again", ends.relay);
                }
            }
            Err(error) => tracing::debug!("{error}"),
        }
        let begun = Instant::now();
        while !stop.load(Ordering::Acquire) && begun.elapsed() < pause {
            std::thread::sleep(LOOK_EVERY.to_duration());
        }
        pause = (pause * 2).min(PAUSES[1]);
    }
}

/// A station's datagrams on this side.
struct Station {
    socket: UdpSocket,
    seen: SimTime,
}

/// A session while its relay is there.
struct Serving<'a> {
    ends: &'a Ends,
    registered: Registered,
    stations: BTreeMap<u32, Station>,
    splices: Vec<Splice>,
    fetched: Receiver<Option<(TcpStream, TcpStream)>>,
    fetching: SyncSender<Option<(TcpStream, TcpStream)>>,
    /// Fetches under way.
    fetches: usize,
    begun: Instant,
    bind_at: SimTime,
    binds: u64,
    heard_at: SimTime,
}

impl<'a> Serving<'a> {
    fn new(ends: &'a Ends, registered: Registered) -> Self {
        let (fetching, fetched) = sync_channel(FETCHES_MAX);
        Self {
            ends,
            registered,
            stations: BTreeMap::new(),
            splices: Vec::new(),
            fetched,
            fetching,
            fetches: 0,
            begun: Instant::now(),
            bind_at: SimTime::ZERO,
            binds: 0,
            heard_at: SimTime::ZERO,
        }
    }

    fn now(&self) -> SimTime {
        SimTime::from(self.begun.elapsed())
    }

    /// Until the relay is lost, or `stop` is set.
    fn run(mut self, stop: &AtomicBool) {
        while !stop.load(Ordering::Acquire) {
            self.wait();
            let now = self.now();
            if !self.hear(now) || now.since(self.heard_at) >= HOST_SILENCE_MAX {
                return;
            }
            while let Ok(fetched) = self.fetched.try_recv() {
                self.fetches -= 1;
                if let Some((there, here)) = fetched
                    && let Ok(splice) = Splice::new(there, here, &[], now)
                {
                    self.splices.push(splice);
                }
            }
            self.splices.retain_mut(|splice| splice.work(now));
            self.datagrams(now);
            if now >= self.bind_at {
                self.bind(now);
            }
        }
    }

    fn bind(&mut self, now: SimTime) {
        self.bind_at = now + BIND_EVERY;
        self.binds += 1;
        let Registered { port, nonce, datagrams, .. } = &self.registered;
        let bind = Bind { port: *port, number: self.binds };
        // One that is lost is followed by the next.
        let _ = datagrams.send(&bind.encode(&self.ends.key, nonce));
        self.stations.retain(|_, station| now.since(station.seen) < STATION_IDLE_MAX);
    }

    fn wait(&self) {
        let mut sockets = vec![
            PollFd::new(&self.registered.line, PollFlags::IN),
            PollFd::new(&self.registered.datagrams, PollFlags::IN),
        ];
        sockets.extend(self.stations.values().map(|station| PollFd::new(&station.socket, PollFlags::IN)));
        self.splices.iter().for_each(|splice| splice.wake_on(&mut sockets));
        // Fetched streams come over a channel, which nothing here waits for.
        let span = if self.fetches > 0 { SimTime::from_millis(2) } else { LOOK_EVERY };
        let limit = Timespec { tv_sec: 0, tv_nsec: span.as_nanos() as _ };
        let _ = poll(&mut sockets, Some(&limit));
    }

    /// Takes what the relay says; false when it is gone.
    fn hear(&mut self, now: SimTime) -> bool {
        let mut bytes = [0; 256];
        let mut input: &[u8] = match self.registered.line.read(&mut bytes) {
            Ok(0) => return false,
            Ok(count) => &bytes[..count],
            Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted) => {
                return true;
            }
            Err(_) => return false,
        };
        self.heard_at = now;
        loop {
            match self.registered.decoder.next(&mut input) {
                Ok(Some(message)) => match FromRelay::decode(&message) {
                    Ok(FromRelay::Ping) => {
                        // A line that takes not even this is broken, and is seen by its silence.
                        let _ = self.registered.line.write(&FromHost::Pong.encode());
                    }
                    Ok(FromRelay::Knock(stream)) => self.fetch(stream),
                    _ => return false,
                },
                Ok(None) => return true,
                Err(_) => return false,
            }
        }
    }

    /// Comes for a stream, on a thread of its own: dialling takes as long as it takes.
    fn fetch(&mut self, stream: u64) {
        if self.fetches >= FETCHES_MAX || self.splices.len() + self.fetches >= STREAMS_MAX {
            return;
        }
        let (ends, told) = (self.ends.clone(), self.fetching.clone());
        let spawned = std::thread::Builder::new().name("relay.fetch".into()).spawn(move || {
            let fetched = fetched(&ends, stream);
            if let Err(error) = &fetched {
                tracing::debug!("a station of the relay: {error}");
            }
            // There is room for each; and who asked may be gone.
            let _ = told.try_send(fetched.ok());
        });
        self.fetches += usize::from(spawned.is_ok());
    }

    fn datagrams(&mut self, now: SimTime) {
        let mut bytes = [0; NUMBER_BYTES + DATAGRAM_MAX + 1];
        for _ in 0..TAKEN_MAX {
            let Ok(length) = self.registered.datagrams.recv(&mut bytes) else { break };
            let Some((number, datagram)) = split_number(&bytes[..length]) else { continue };
            if let Some(station) = self.station(number, now) {
                station.seen = now;
                // What the system does not take is lost, as on any path.
                let _ = station.socket.send(datagram);
            }
        }
        let mut out = Vec::with_capacity(bytes.len());
        for (number, station) in &self.stations {
            for _ in 0..TAKEN_MAX {
                let Ok(length) = station.socket.recv(&mut bytes[..=DATAGRAM_MAX]) else { break };
                if length <= DATAGRAM_MAX {
                    numbered(*number, &bytes[..length], &mut out);
                    let _ = self.registered.datagrams.send(&out);
                }
            }
        }
    }

    /// The socket that stands for a station here; `None` when there are too many.
    fn station(&mut self, number: u32, now: SimTime) -> Option<&mut Station> {
        if !self.stations.contains_key(&number) {
            if self.stations.len() >= STATIONS_MAX {
                return None;
            }
            let socket = sockets::station(&self.ends.host).ok()?;
            socket.connect(self.ends.host).ok()?;
            self.stations.insert(number, Station { socket, seen: now });
        }
        self.stations.get_mut(&number)
    }
}

/// A stream at the relay, and the one at the host that is its other half.
fn fetched(ends: &Ends, stream: u64) -> Result<(TcpStream, TcpStream), RelayError> {
    let unreached = |error| RelayError::Unreached(ends.relay, error);
    let (mut there, _, nonce) = dial(ends.relay)?;
    there.write_all(&ends.key.fetch(&nonce, stream).encode()).map_err(unreached)?;
    let here = TcpStream::connect_timeout(&ends.host, DIAL_TIME_MAX).map_err(unreached)?;
    Ok((there, here))
}

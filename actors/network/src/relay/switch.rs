//! The relay's machine: who has which port, which stream waits for which host, and where a datagram goes.

use core::net::{IpAddr, SocketAddr};
use std::collections::BTreeMap;

use trocar_scene::SimTime;

use super::wire::{BIND_BYTES, Bind, FromHost, FromRelay, Nonce, RelayKey, RelayRefusal, split_number};
use crate::control::STATIONS_MAX;

/// Most sessions.
pub const SESSIONS_MAX: usize = 64;
/// Most lines that have not said who they are; when there are more, the oldest goes.
pub const OPENERS_MAX: usize = 64;
/// Longest time for that.
pub const OPENING_TIME_MAX: SimTime = SimTime::from_millis(5_000);
/// Most streams of a session.
pub const STREAMS_MAX: usize = 64;
/// Most streams of a session from one address: a router with several stations behind it.
pub const STREAMS_OF_ONE_MAX: usize = 8;
/// Longest time until a host has fetched a stream.
pub const FETCH_TIME_MAX: SimTime = SimTime::from_millis(10_000);
/// A station whose datagrams have been silent for so long makes room for another one.
pub const STATION_IDLE_MAX: SimTime = SimTime::from_millis(60_000);
/// Bytes of datagrams of a session that pass each way in a second.
pub const BYTES_PER_SEC: u64 = 16_000_000;
/// Time between two questions whether a host is there.
pub const PING_EVERY: SimTime = SimTime::from_millis(5_000);
/// A host that has said nothing for so long is gone, and its session with it.
pub const HOST_SILENCE_MAX: SimTime = SimTime::from_millis(20_000);
/// How much of a second's bytes may come at once, as a part of a second.
const BURST: u64 = 4;

/// Number of a stream, never used twice.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct StreamId(pub u64);

/// What follows from a message of a line.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum LineNews {
    /// Nothing.
    Nothing,
    /// The line is a host's now, and is told so.
    Registered(u16, Vec<u8>),
    /// From here on the line is the other half of this stream, at this port.
    Splice(u16, StreamId),
    /// It is over, after these words.
    Stop(Vec<u8>),
}

/// Why a stream or a session is not there any more: its driver's part is to be closed.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Stopped {
    /// The port whose session is over, if one is.
    pub port: Option<u16>,
    /// Its streams.
    pub streams: Vec<StreamId>,
}

/// What time has brought.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Overdue {
    /// Lines that are to be asked whether they are there, with the words.
    pub pings: Vec<(u64, Vec<u8>)>,
    /// Lines that are to be closed; then [`RelaySwitch::line_closed`].
    pub lines: Vec<u64>,
    /// Streams that no host has fetched, to be closed.
    pub streams: Vec<StreamId>,
}

/// What a relay has done.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RelayCounts {
    /// Datagrams that were forwarded.
    pub forwarded: u64,
    /// Datagrams that were not: of strangers, beyond the rate, or without a session.
    pub dropped: u64,
    /// Lines without the key.
    pub refused: u64,
    /// Streams that were not taken: no session, too many.
    pub turned_away: u64,
}

/// How many bytes may still pass.
#[derive(Clone, Copy, Debug)]
struct Budget {
    left: u64,
    at: SimTime,
}

impl Budget {
    fn new(now: SimTime) -> Self {
        Self { left: BYTES_PER_SEC / BURST, at: now }
    }

    fn takes(&mut self, bytes: usize, now: SimTime) -> bool {
        let earned = u128::from(now.since(self.at).as_nanos()) * u128::from(BYTES_PER_SEC) / 1_000_000_000;
        if earned > 0 {
            let earned = u64::try_from(earned).unwrap_or(u64::MAX);
            (self.left, self.at) = (self.left.saturating_add(earned).min(BYTES_PER_SEC / BURST), now);
        }
        let takes = self.left >= bytes as u64;
        self.left -= if takes { bytes as u64 } else { 0 };
        takes
    }
}

#[derive(Clone, Copy, Debug)]
struct Opener {
    nonce: Nonce,
    until: SimTime,
}

#[derive(Clone, Copy, Debug)]
struct Stream {
    from: IpAddr,
    /// By when its host must have come for it, until it has.
    until: Option<SimTime>,
}

#[derive(Clone, Copy, Debug)]
struct Station {
    number: u32,
    seen: SimTime,
}

#[derive(Debug)]
struct Session {
    line: u64,
    nonce: Nonce,
    /// Where its datagrams come from and go to, by its newest bind.
    host: Option<SocketAddr>,
    bind: u64,
    heard_at: SimTime,
    ping_at: SimTime,
    streams: BTreeMap<StreamId, Stream>,
    stations: BTreeMap<SocketAddr, Station>,
    last_number: u32,
    to_host: Budget,
    to_stations: Budget,
}

/// The relay's machine. Lines and streams are the driver's, by their numbers.
#[derive(Debug)]
pub struct RelaySwitch {
    key: RelayKey,
    ports: Vec<u16>,
    openers: BTreeMap<u64, Opener>,
    sessions: BTreeMap<u16, Session>,
    last_stream: u64,
    counts: RelayCounts,
}

impl RelaySwitch {
    /// A relay that gives these ports, the first [`SESSIONS_MAX`] of them, to hosts with this key.
    pub fn new(key: RelayKey, mut ports: Vec<u16>) -> Self {
        ports.truncate(SESSIONS_MAX);
        Self {
            key,
            ports,
            openers: BTreeMap::new(),
            sessions: BTreeMap::new(),
            last_stream: 0,
            counts: RelayCounts::default(),
        }
    }

    /// What it has done.
    pub fn counts(&self) -> RelayCounts {
        self.counts
    }

    /// Ports with a session.
    pub fn sessions(&self) -> usize {
        self.sessions.len()
    }

    /// Somebody has dialled the relay itself, by a line whose number rises: what he is asked, with a nonce that is random,
    /// and a line that makes room for his.
    pub fn line_opened(&mut self, line: u64, nonce: Nonce, now: SimTime) -> (Vec<u8>, Option<u64>) {
        let oldest = self.openers.keys().next().copied().filter(|_| self.openers.len() >= OPENERS_MAX);
        if let Some(oldest) = oldest {
            self.openers.remove(&oldest);
        }
        self.openers.insert(line, Opener { nonce, until: now + OPENING_TIME_MAX });
        (FromRelay::Challenge(nonce).encode(), oldest)
    }

    /// A message has come over a line.
    pub fn line_heard(&mut self, line: u64, message: &FromHost, now: SimTime) -> LineNews {
        let Some(opener) = self.openers.remove(&line) else {
            let session = self.sessions.values_mut().find(|session| session.line == line);
            return match (session, message) {
                (Some(session), FromHost::Pong) => {
                    session.heard_at = now;
                    LineNews::Nothing
                }
                _ => LineNews::Stop(Vec::new()),
            };
        };
        if !self.key.accepts(&opener.nonce, message) {
            self.counts.refused += 1;
            return LineNews::Stop(FromRelay::Refused(RelayRefusal::Key).encode());
        }
        match message {
            FromHost::Register { wish, .. } => self.register(line, *wish, opener.nonce, now),
            FromHost::Fetch { stream, .. } => {
                let wanted = StreamId(*stream);
                let found = self.sessions.iter_mut().find_map(|(port, session)| {
                    let stream = session.streams.get_mut(&wanted)?;
                    stream.until.take().map(|_| *port)
                });
                match found {
                    Some(port) => LineNews::Splice(port, wanted),
                    None => LineNews::Stop(FromRelay::Refused(RelayRefusal::Gone).encode()),
                }
            }
            // Whoever says that he is there has not said who he is.
            FromHost::Pong => LineNews::Stop(Vec::new()),
        }
    }

    fn register(&mut self, line: u64, wish: u16, nonce: Nonce, now: SimTime) -> LineNews {
        let mut free = self.ports.iter().copied().filter(|port| !self.sessions.contains_key(port));
        let Some(port) = free.clone().find(|port| *port == wish).or_else(|| free.next()) else {
            return LineNews::Stop(FromRelay::Refused(RelayRefusal::Full).encode());
        };
        let session = Session {
            line,
            nonce,
            host: None,
            bind: 0,
            heard_at: now,
            ping_at: now + PING_EVERY,
            streams: BTreeMap::new(),
            stations: BTreeMap::new(),
            last_number: 0,
            to_host: Budget::new(now),
            to_stations: Budget::new(now),
        };
        self.sessions.insert(port, session);
        LineNews::Registered(port, FromRelay::Registered(port).encode())
    }

    /// A line is closed; its session is over with it.
    pub fn line_closed(&mut self, line: u64) -> Stopped {
        self.openers.remove(&line);
        let port = self.sessions.iter().find(|(_, session)| session.line == line).map(|(port, _)| *port);
        let session = port.and_then(|port| self.sessions.remove(&port));
        Stopped {
            port,
            streams: session.map(|session| session.streams.into_keys().collect()).unwrap_or_default(),
        }
    }

    /// Somebody has connected to a session's port: the number of his stream, and the line on which its host is told.
    /// `None` if there is no session, or there are too many streams.
    pub fn knocked(&mut self, port: u16, from: SocketAddr, now: SimTime) -> Option<(StreamId, u64, Vec<u8>)> {
        let from = from.ip().to_canonical();
        let room = self.sessions.get_mut(&port).filter(|session| {
            let of_one = session.streams.values().filter(|stream| stream.from == from).count();
            session.streams.len() < STREAMS_MAX && of_one < STREAMS_OF_ONE_MAX
        });
        let Some(session) = room else {
            self.counts.turned_away += 1;
            return None;
        };
        self.last_stream += 1;
        let id = StreamId(self.last_stream);
        session.streams.insert(id, Stream { from, until: Some(now + FETCH_TIME_MAX) });
        Some((id, session.line, FromRelay::Knock(id.0).encode()))
    }

    /// A stream is over.
    pub fn stream_ended(&mut self, port: u16, stream: StreamId) {
        if let Some(session) = self.sessions.get_mut(&port) {
            session.streams.remove(&stream);
        }
    }

    /// Where a datagram of so many bytes goes that has come to a session's port, and the number under which the host knows
    /// its sender; `None` if nowhere.
    pub fn from_station(
        &mut self,
        port: u16,
        from: SocketAddr,
        bytes: usize,
        now: SimTime,
    ) -> Option<(SocketAddr, u32)> {
        let forwarded = self.sessions.get_mut(&port).and_then(|session| {
            let host = session.host?;
            let number = session.station(from, now)?;
            session.to_host.takes(bytes, now).then_some((host, number))
        });
        let count = if forwarded.is_some() { &mut self.counts.forwarded } else { &mut self.counts.dropped };
        *count += 1;
        forwarded
    }

    /// Where a datagram goes that has come to the relay's own port: the session's port from which it is sent, the station, and
    /// what it gets. `None` for a bind, which is taken in, and for what is to go nowhere.
    pub fn from_host<'a>(
        &mut self,
        from: SocketAddr,
        bytes: &'a [u8],
        now: SimTime,
    ) -> Option<(u16, SocketAddr, &'a [u8])> {
        if bytes.len() == BIND_BYTES
            && let Some(bind) = Bind::read(bytes)
        {
            self.bind(&bind, from, bytes);
            return None;
        }
        let forwarded = split_number(bytes).and_then(|(number, datagram)| {
            let of_host = |(_, session): &(&u16, &mut Session)| session.host == Some(from);
            let (port, session) = self.sessions.iter_mut().find(of_host)?;
            let station = session.stations.iter().find(|(_, station)| station.number == number)?.0;
            let station = *station;
            session.to_stations.takes(datagram.len(), now).then_some((*port, station, datagram))
        });
        let count = if forwarded.is_some() { &mut self.counts.forwarded } else { &mut self.counts.dropped };
        *count += 1;
        forwarded
    }

    fn bind(&mut self, bind: &Bind, from: SocketAddr, bytes: &[u8]) {
        let session = self.sessions.get_mut(&bind.port);
        let session = session.filter(|session| {
            bind.number > session.bind && bind.is_authentic(bytes, &self.key, &session.nonce)
        });
        match session {
            Some(session) => (session.host, session.bind) = (Some(from), bind.number),
            None => self.counts.dropped += 1,
        }
    }

    /// What time has brought; to be called about once a second.
    pub fn work(&mut self, now: SimTime) -> Overdue {
        let mut overdue = Overdue::default();
        let slow = self.openers.iter().filter(|(_, opener)| now >= opener.until);
        overdue.lines.extend(slow.map(|(line, _)| *line));
        self.openers.retain(|_, opener| now < opener.until);
        for session in self.sessions.values_mut() {
            if now.since(session.heard_at) >= HOST_SILENCE_MAX {
                overdue.lines.push(session.line);
            } else if now >= session.ping_at {
                session.ping_at = now + PING_EVERY;
                overdue.pings.push((session.line, FromRelay::Ping.encode()));
            }
            let late =
                session.streams.iter().filter(|(_, stream)| stream.until.is_some_and(|until| now >= until));
            let late: Vec<StreamId> = late.map(|(id, _)| *id).collect();
            session.streams.retain(|id, _| !late.contains(id));
            overdue.streams.extend(late);
        }
        overdue
    }
}

impl Session {
    /// The number of who sends datagrams from here; `None` for a stranger, and when there are too many.
    fn station(&mut self, from: SocketAddr, now: SimTime) -> Option<u32> {
        if let Some(station) = self.stations.get_mut(&from) {
            station.seen = now;
            return Some(station.number);
        }
        let ip = from.ip().to_canonical();
        let has_stream = |stream: &Stream| stream.from == ip && stream.until.is_none();
        if !self.streams.values().any(has_stream) {
            return None;
        }
        self.stations.retain(|_, station| now.since(station.seen) < STATION_IDLE_MAX);
        if self.stations.len() >= STATIONS_MAX {
            return None;
        }
        self.last_number = self.last_number.wrapping_add(1);
        self.stations.insert(from, Station { number: self.last_number, seen: now });
        Some(self.last_number)
    }
}

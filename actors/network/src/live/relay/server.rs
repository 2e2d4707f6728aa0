//! The relay over sockets: its own port for hosts, and a port for each session. One thread waits for all of them.

use std::collections::BTreeMap;
use std::io::{self, ErrorKind, Read, Write};
use std::net::{IpAddr, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};
use std::time::Instant;

use ring::rand::{SecureRandom, SystemRandom};
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use trocar_scene::SimTime;

use super::splice::Splice;
use crate::datagram::DATAGRAM_MAX;
use crate::live::sockets::{HostSockets, SocketError};
use crate::relay::{
    FromHost, LineDecoder, LineNews, NONCE_BYTES, NUMBER_BYTES, RelayKey, RelaySwitch, StreamId, numbered,
};

/// The relay's own port.
pub const RELAY_PORT: u16 = 7_419;
/// Longest wait before the relay looks whether it shall end.
const LOOK_EVERY: SimTime = SimTime::from_millis(50);
/// Time between two looks at who is overdue.
const WORK_EVERY: SimTime = SimTime::from_millis(500);
/// Connections taken from one listener, and datagrams from one socket, before the others have their turn.
const TAKEN_MAX: usize = 64;
/// Bytes of a line that wait for the system; a host that takes none of its short messages is gone.
const LINE_WAITING_MAX: usize = 8 << 10;

/// What a relay has done so far; read while it runs.
#[derive(Debug, Default)]
pub struct RelayServerCounts {
    /// Sessions now.
    pub sessions: AtomicUsize,
    /// Streams that are spliced now.
    pub streams: AtomicUsize,
    /// Datagrams forwarded.
    pub forwarded: AtomicU64,
    /// Datagrams not forwarded.
    pub dropped: AtomicU64,
    /// Hosts without the key.
    pub refused: AtomicU64,
}

struct Line {
    tcp: TcpStream,
    decoder: LineDecoder,
    out: Vec<u8>,
    /// Whether it is to be closed when `out` is sent.
    is_over: bool,
}

/// A relay on its ports.
pub struct RelayServer {
    own: HostSockets,
    ports: BTreeMap<u16, HostSockets>,
    switch: RelaySwitch,
    lines: BTreeMap<u64, Line>,
    waiting: BTreeMap<StreamId, TcpStream>,
    splices: BTreeMap<StreamId, (u16, Splice)>,
    last_line: u64,
    work_at: SimTime,
    random: SystemRandom,
    begun: Instant,
    counts: Arc<RelayServerCounts>,
}

impl RelayServer {
    /// Binds the relay's own port, and those of the sessions; 0 is any.
    ///
    /// # Errors
    /// [`SocketError`].
    pub fn bind(
        address: Option<IpAddr>,
        own: u16,
        sessions: impl IntoIterator<Item = u16>,
        key: RelayKey,
    ) -> Result<Self, SocketError> {
        let own = HostSockets::bind(address, own)?;
        let mut ports = BTreeMap::new();
        for port in sessions.into_iter().take(crate::relay::SESSIONS_MAX) {
            let sockets = HostSockets::bind(address, port)?;
            ports.insert(sockets.port, sockets);
        }
        for sockets in ports.values().chain([&own]) {
            let told = |error| SocketError::Other { port: sockets.port, protocol: "TCP", error };
            sockets.tcp.set_nonblocking(true).map_err(told)?;
        }
        Ok(Self {
            switch: RelaySwitch::new(key, ports.keys().copied().collect()),
            own,
            ports,
            lines: BTreeMap::new(),
            waiting: BTreeMap::new(),
            splices: BTreeMap::new(),
            last_line: 0,
            work_at: SimTime::ZERO,
            random: SystemRandom::new(),
            begun: Instant::now(),
            counts: Arc::default(),
        })
    }

    /// The relay's own port.
    pub fn port(&self) -> u16 {
        self.own.port
    }

    /// What it has done so far.
    pub fn counts(&self) -> &Arc<RelayServerCounts> {
        &self.counts
    }

    fn now(&self) -> SimTime {
        SimTime::from(self.begun.elapsed())
    }

    /// Relays until `stop` is set.
    ///
    /// # Errors
    /// When the system refuses to wait for sockets.
    pub fn run(mut self, stop: &AtomicBool) -> io::Result<()> {
        while !stop.load(Ordering::Relaxed) {
            self.wait()?;
            let now = self.now();
            self.take_lines(now);
            self.hear_lines(now);
            self.take_stations(now);
            self.datagrams(now);
            self.splice(now);
            if now >= self.work_at {
                self.work_at = now + WORK_EVERY;
                self.work(now);
            }
        }
        Ok(())
    }

    fn wait(&self) -> io::Result<()> {
        let mut sockets = Vec::new();
        for HostSockets { tcp, udp, .. } in self.ports.values().chain([&self.own]) {
            sockets.push(PollFd::new(tcp, PollFlags::IN));
            sockets.push(PollFd::new(udp, PollFlags::IN));
        }
        for line in self.lines.values() {
            let mut flags = PollFlags::IN;
            flags.set(PollFlags::OUT, !line.out.is_empty());
            sockets.push(PollFd::new(&line.tcp, flags));
        }
        self.splices.values().for_each(|(_, splice)| splice.wake_on(&mut sockets));
        let limit = Timespec { tv_sec: 0, tv_nsec: LOOK_EVERY.as_nanos() as _ };
        match poll(&mut sockets, Some(&limit)) {
            Ok(_) | Err(rustix::io::Errno::INTR) => Ok(()),
            Err(error) => Err(error.into()),
        }
    }

    /// Who dials the relay itself is asked who he is.
    fn take_lines(&mut self, now: SimTime) {
        for _ in 0..TAKEN_MAX {
            let Ok((tcp, _)) = self.own.tcp.accept() else { return };
            let mut nonce = [0; NONCE_BYTES];
            if tcp.set_nonblocking(true).is_err() || self.random.fill(&mut nonce).is_err() {
                continue;
            }
            // Short messages go out at once; a system without the option only sends them a little later.
            let _ = tcp.set_nodelay(true);
            self.last_line += 1;
            let (out, crowded_out) = self.switch.line_opened(self.last_line, nonce, now);
            let line = Line { tcp, decoder: LineDecoder::default(), out, is_over: false };
            self.lines.insert(self.last_line, line);
            if let Some(line) = crowded_out {
                self.close(line);
            }
        }
    }

    fn hear_lines(&mut self, now: SimTime) {
        let numbers: Vec<u64> = self.lines.keys().copied().collect();
        for number in numbers {
            if !self.hear(number, now) {
                self.close(number);
            }
        }
    }

    /// Takes what has come over a line, and sends what waits; false when it is over.
    fn hear(&mut self, number: u64, now: SimTime) -> bool {
        let Some(line) = self.lines.get_mut(&number) else { return true };
        let mut bytes = [0; 256];
        let mut input: &[u8] = match line.tcp.read(&mut bytes) {
            Ok(0) => return false,
            Ok(count) => &bytes[..count],
            Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted) => &[],
            Err(_) => return false,
        };
        while !line.is_over {
            let message = match line.decoder.next(&mut input) {
                Ok(Some(message)) => message,
                Ok(None) => break,
                Err(_) => return false,
            };
            let Ok(message) = FromHost::decode(&message) else { return false };
            match self.switch.line_heard(number, &message, now) {
                LineNews::Nothing => {}
                LineNews::Registered(_, words) => line.out.extend_from_slice(&words),
                LineNews::Stop(words) => {
                    line.out.extend_from_slice(&words);
                    line.is_over = true;
                }
                LineNews::Splice(port, stream) => {
                    let rest = input.to_vec();
                    return self.begin_splice(number, port, stream, &rest, now);
                }
            }
        }
        line.send()
    }

    /// A host has come for a stream: its line is the other half.
    fn begin_splice(&mut self, line: u64, port: u16, stream: StreamId, rest: &[u8], now: SimTime) -> bool {
        let (Some(line), Some(station)) = (self.lines.remove(&line), self.waiting.remove(&stream)) else {
            return false;
        };
        match Splice::new(station, line.tcp, rest, now) {
            Ok(splice) => drop(self.splices.insert(stream, (port, splice))),
            Err(_) => self.switch.stream_ended(port, stream),
        }
        true
    }

    fn close(&mut self, line: u64) {
        self.lines.remove(&line);
        for stream in self.switch.line_closed(line).streams {
            self.waiting.remove(&stream);
            self.splices.remove(&stream);
        }
    }

    /// A station has connected to a session's port: its host is told.
    fn take_stations(&mut self, now: SimTime) {
        for (port, sockets) in &self.ports {
            for _ in 0..TAKEN_MAX {
                let Ok((tcp, from)) = sockets.tcp.accept() else { break };
                let Some((stream, line, words)) = self.switch.knocked(*port, from, now) else { continue };
                match self.lines.get_mut(&line) {
                    Some(line) if tcp.set_nonblocking(true).is_ok() => {
                        line.out.extend_from_slice(&words);
                        self.waiting.insert(stream, tcp);
                    }
                    _ => self.switch.stream_ended(*port, stream),
                }
            }
        }
    }

    /// Forwards datagrams, both ways. What the system does not take is lost, as on any path.
    fn datagrams(&mut self, now: SimTime) {
        let mut bytes = [0; NUMBER_BYTES + DATAGRAM_MAX + 1];
        let mut out = Vec::with_capacity(bytes.len());
        for _ in 0..TAKEN_MAX * 4 {
            let Ok((length, from)) = self.own.udp.recv_from(&mut bytes) else { break };
            if length > NUMBER_BYTES + DATAGRAM_MAX {
                continue;
            }
            if let Some((port, station, datagram)) = self.switch.from_host(from, &bytes[..length], now)
                && let Some(sockets) = self.ports.get(&port)
            {
                let _ = sockets.udp.send_to(datagram, station);
            }
        }
        for (port, sockets) in &self.ports {
            for _ in 0..TAKEN_MAX {
                let Ok((length, from)) = sockets.udp.recv_from(&mut bytes) else { break };
                if length > DATAGRAM_MAX {
                    continue;
                }
                if let Some((host, number)) = self.switch.from_station(*port, from, length, now) {
                    numbered(number, &bytes[..length], &mut out);
                    let _ = self.own.udp.send_to(&out, host);
                }
            }
        }
    }

    fn splice(&mut self, now: SimTime) {
        let switch = &mut self.switch;
        self.splices.retain(|stream, (port, splice)| {
            let goes_on = splice.work(now);
            if !goes_on {
                switch.stream_ended(*port, *stream);
            }
            goes_on
        });
    }

    fn work(&mut self, now: SimTime) {
        let overdue = self.switch.work(now);
        for (line, words) in overdue.pings {
            if let Some(line) = self.lines.get_mut(&line) {
                line.out.extend_from_slice(&words);
            }
        }
        overdue.lines.into_iter().for_each(|line| self.close(line));
        overdue.streams.iter().for_each(|stream| drop(self.waiting.remove(stream)));
        let (done, counts) = (self.switch.counts(), &self.counts);
        counts.sessions.store(self.switch.sessions(), Ordering::Relaxed);
        counts.streams.store(self.splices.len(), Ordering::Relaxed);
        counts.forwarded.store(done.forwarded, Ordering::Relaxed);
        counts.dropped.store(done.dropped, Ordering::Relaxed);
        counts.refused.store(done.refused, Ordering::Relaxed);
    }
}

impl Line {
    /// Sends what waits; false when it is over.
    fn send(&mut self) -> bool {
        while !self.out.is_empty() {
            match self.tcp.write(&self.out) {
                Ok(0) => return false,
                Ok(count) => drop(self.out.drain(..count)),
                Err(error) if error.kind() == ErrorKind::WouldBlock => break,
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(_) => return false,
            }
        }
        !(self.is_over && self.out.is_empty()) && self.out.len() <= LINE_WAITING_MAX
    }
}

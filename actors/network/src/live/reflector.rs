//! The packet reflector over sockets: it returns what comes, or forwards it to a host and its answers back, for datagrams
//! and for streams on one port.

use std::collections::BTreeMap;
use std::io::{self, Read, Write};
use std::net::{IpAddr, Shutdown, SocketAddr, TcpListener, TcpStream, UdpSocket};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, sync_channel};
use std::time::{Duration, Instant};

use rustix::event::{PollFd, PollFlags, Timespec, poll};
use trocar_scene::SimTime;

use super::sockets::{HostSockets, SocketError, station};
use crate::impairments::Impairments;
use crate::reflector::{Parcel, REFLECTED_MAX, Reflector};

/// Most stations that are forwarded at once.
pub const STATIONS_MAX: usize = 64;
/// A station that has been silent for so long makes room for another one.
const IDLE_MAX: SimTime = SimTime::from_millis(120_000);
/// Longest wait before the reflector looks whether it shall end.
const LOOK_EVERY: SimTime = SimTime::from_millis(50);
/// Bytes of a stream that are forwarded in one piece.
const PIECE: usize = 16 << 10;
/// Pieces of one direction of a stream under way; when there are more, the sender waits.
const PIECES_MAX: usize = 4_096;
/// Datagrams taken from one socket before the others have their turn.
const TAKEN_MAX: usize = 64;

/// Where a datagram goes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Way {
    /// Back to a station, from the port that it knows.
    ToStation(SocketAddr),
    /// On to the host, from the socket that stands for this station.
    ToHost(SocketAddr),
}

/// What a reflector has done so far; read while it runs.
#[derive(Debug, Default)]
pub struct ReflectorCounts {
    /// Datagrams that came.
    pub received: AtomicU64,
    /// Datagrams sent on.
    pub sent: AtomicU64,
    /// Datagrams lost on the way.
    pub lost: AtomicU64,
    /// Stations that have sent something lately.
    pub stations: AtomicUsize,
    /// Streams that are open.
    pub streams: AtomicUsize,
}

/// A reflector on its port.
pub struct ReflectorServer {
    sockets: HostSockets,
    host: Option<SocketAddr>,
    path: Impairments,
    seed: u64,
    begun: Instant,
    counts: Arc<ReflectorCounts>,
}

/// A station that is forwarded.
struct Forwarded {
    socket: UdpSocket,
    seen: SimTime,
}

impl ReflectorServer {
    /// Binds the port; 0 is any. Without a `host` datagrams go back to their senders; each goes along `path` once, or twice
    /// with its answer.
    ///
    /// # Errors
    /// [`SocketError`].
    pub fn bind(
        port: u16,
        host: Option<SocketAddr>,
        path: Impairments,
        seed: u64,
    ) -> Result<Self, SocketError> {
        Self::bind_at(None, port, host, path, seed)
    }

    /// The same at one address of the machine.
    ///
    /// # Errors
    /// [`SocketError`].
    pub fn bind_at(
        address: Option<IpAddr>,
        port: u16,
        host: Option<SocketAddr>,
        path: Impairments,
        seed: u64,
    ) -> Result<Self, SocketError> {
        let sockets = HostSockets::bind(address, port)?;
        Ok(Self { sockets, host, path, seed, begun: Instant::now(), counts: Arc::default() })
    }

    /// The port.
    pub fn port(&self) -> u16 {
        self.sockets.port
    }

    /// What it has done so far.
    pub fn counts(&self) -> &Arc<ReflectorCounts> {
        &self.counts
    }

    /// Reflects until `stop` is set.
    ///
    /// # Errors
    /// When the system refuses to wait for sockets.
    pub fn run(self, stop: &Arc<AtomicBool>) -> io::Result<()> {
        if let Some(host) = self.host {
            let (listener, counts) = (self.sockets.tcp.try_clone()?, self.counts.clone());
            let (delay, stop) = (self.path.clone(), stop.clone());
            std::thread::Builder::new()
                .name("reflect-tcp".into())
                .spawn(move || forward_streams(&listener, host, &delay, &counts, &stop))?;
        }
        let mut there = Reflector::new(&self.path, self.seed);
        let mut back = Reflector::new(&self.path, self.seed.wrapping_add(0x9E37_79B9));
        let mut stations: BTreeMap<SocketAddr, Forwarded> = BTreeMap::new();
        let mut bytes = [0; REFLECTED_MAX + 1];
        while !stop.load(Ordering::Relaxed) {
            let now = self.now();
            for reflector in [&mut there, &mut back] {
                while let Some(Parcel { to, bytes }) = reflector.due(now) {
                    self.send(to, &bytes, &stations);
                }
            }
            self.wait(&stations, there.next_due().into_iter().chain(back.next_due()).min())?;
            for _ in 0..TAKEN_MAX {
                let Ok((length, from)) = self.sockets.udp.recv_from(&mut bytes) else { break };
                let now = self.now();
                let way = match self.host {
                    None => Way::ToStation(from),
                    Some(host) if self.admit(&mut stations, from, &host, now) => Way::ToHost(from),
                    Some(_) => continue,
                };
                there.receive(&bytes[..length], way, now);
            }
            for (station, forwarded) in &stations {
                for _ in 0..TAKEN_MAX {
                    let Ok((length, from)) = forwarded.socket.recv_from(&mut bytes) else { break };
                    if Some(from) == self.host {
                        back.receive(&bytes[..length], Way::ToStation(*station), self.now());
                    }
                }
            }
            let lost = there.path().lost + back.path().lost;
            self.counts.lost.store(lost, Ordering::Relaxed);
            self.counts.received.store(there.counts().0 + back.counts().0, Ordering::Relaxed);
            self.counts.sent.store(there.counts().1 + back.counts().1, Ordering::Relaxed);
        }
        Ok(())
    }

    fn now(&self) -> SimTime {
        SimTime(self.begun.elapsed().as_nanos() as u64)
    }

    fn send(&self, to: Way, bytes: &[u8], stations: &BTreeMap<SocketAddr, Forwarded>) {
        // A datagram that cannot be sent is lost, as on any path.
        let _ = match (to, self.host) {
            (Way::ToStation(station), _) => self.sockets.udp.send_to(bytes, station),
            (Way::ToHost(station), Some(host)) => match stations.get(&station) {
                Some(forwarded) => forwarded.socket.send_to(bytes, host),
                None => return,
            },
            (Way::ToHost(_), None) => return,
        };
    }

    /// Remembers a station; false when there are too many.
    fn admit(
        &self,
        stations: &mut BTreeMap<SocketAddr, Forwarded>,
        from: SocketAddr,
        host: &SocketAddr,
        now: SimTime,
    ) -> bool {
        if let Some(known) = stations.get_mut(&from) {
            known.seen = now;
            return true;
        }
        stations.retain(|_, station| now.since(station.seen) < IDLE_MAX);
        if stations.len() >= STATIONS_MAX {
            return false;
        }
        let Ok(socket) = station(host) else { return false };
        stations.insert(from, Forwarded { socket, seen: now });
        self.counts.stations.store(stations.len(), Ordering::Relaxed);
        true
    }

    /// Waits until a datagram comes or is due.
    fn wait(&self, stations: &BTreeMap<SocketAddr, Forwarded>, due: Option<SimTime>) -> io::Result<()> {
        let span = due.map_or(LOOK_EVERY, |due| due.since(self.now()).min(LOOK_EVERY));
        let sockets =
            std::iter::once(&self.sockets.udp).chain(stations.values().map(|station| &station.socket));
        let mut waiting: Vec<PollFd<'_>> = sockets.map(|socket| PollFd::new(socket, PollFlags::IN)).collect();
        let limit = Timespec { tv_sec: 0, tv_nsec: span.as_nanos() as _ };
        match poll(&mut waiting, Some(&limit)) {
            Ok(_) | Err(rustix::io::Errno::INTR) => Ok(()),
            Err(error) => Err(error.into()),
        }
    }
}

/// Takes streams and forwards each to the host. A stream is late by the path's delay and loses nothing, as TCP repairs.
fn forward_streams(
    listener: &TcpListener,
    host: SocketAddr,
    path: &Impairments,
    counts: &Arc<ReflectorCounts>,
    stop: &Arc<AtomicBool>,
) {
    while !stop.load(Ordering::Relaxed) {
        let taken = match listener.accept() {
            Ok((station, _)) if counts.streams.load(Ordering::Relaxed) < STATIONS_MAX => station,
            Ok(_) => continue,
            Err(_) => {
                std::thread::sleep(Duration::from_millis(5));
                continue;
            }
        };
        let Ok(onward) = TcpStream::connect_timeout(&host, Duration::from_secs(5)) else { continue };
        let _ = (taken.set_nonblocking(false), taken.set_nodelay(true), onward.set_nodelay(true));
        let Ok((back_from, back_to)) = onward.try_clone().and_then(|from| Ok((from, taken.try_clone()?)))
        else {
            continue;
        };
        counts.streams.fetch_add(1, Ordering::Relaxed);
        let counts = counts.clone();
        let answers = carry(back_from, back_to, path.clone());
        let asked = carry(taken, onward, path.clone());
        let _ = std::thread::Builder::new().name("reflect-end".into()).spawn(move || {
            for thread in [answers, asked].into_iter().flatten() {
                let _ = thread.join();
            }
            counts.streams.fetch_sub(1, Ordering::Relaxed);
        });
    }
}

/// Carries one direction of a stream, late.
fn carry(mut from: TcpStream, to: TcpStream, path: Impairments) -> io::Result<std::thread::JoinHandle<()>> {
    let (pieces, received) = sync_channel::<(Instant, Vec<u8>)>(PIECES_MAX);
    let begun = Instant::now();
    std::thread::Builder::new().name("reflect-out".into()).spawn(move || release(&received, to))?;
    std::thread::Builder::new().name("reflect-in".into()).spawn(move || {
        let mut bytes = vec![0; PIECE];
        while let Ok(length @ 1..) = from.read(&mut bytes) {
            let delay = if path.trace.delays.is_empty() {
                path.delay
            } else {
                let step = begun.elapsed().as_nanos() as u64 / path.trace.every.as_nanos().max(1);
                path.trace.delays[(step % path.trace.delays.len() as u64) as usize]
            };
            if pieces.send((Instant::now() + delay.to_duration(), bytes[..length].to_vec())).is_err() {
                break;
            }
        }
        let _ = from.shutdown(Shutdown::Read);
    })
}

/// Writes the pieces when they are due.
fn release(pieces: &Receiver<(Instant, Vec<u8>)>, mut to: TcpStream) {
    while let Ok((due, bytes)) = pieces.recv() {
        std::thread::sleep(due.saturating_duration_since(Instant::now()));
        if to.write_all(&bytes).is_err() {
            break;
        }
    }
    let _ = to.shutdown(Shutdown::Both);
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::net::Ipv4Addr;

    fn start(
        host: Option<SocketAddr>,
        path: Impairments,
    ) -> (SocketAddr, Arc<AtomicBool>, Arc<ReflectorCounts>) {
        let server = ReflectorServer::bind(0, host, path, 1).expect("a port");
        let address = SocketAddr::from((Ipv4Addr::LOCALHOST, server.port()));
        let (stop, counts) = (Arc::new(AtomicBool::new(false)), server.counts().clone());
        let ends = stop.clone();
        std::thread::spawn(move || server.run(&ends));
        (address, stop, counts)
    }

    #[test]
    fn datagrams_come_back_no_earlier_than_the_path_takes() {
        let (reflector, stop, counts) = start(None, Impairments::delay(SimTime::from_millis(30)));
        let socket = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).expect("a socket");
        socket.set_read_timeout(Some(Duration::from_secs(20))).expect("a limit");
        let begun = Instant::now();
        socket.send_to(b"pose", reflector).expect("sends");
        let mut bytes = [0; 16];
        let (length, from) = socket.recv_from(&mut bytes).expect("it comes back");
        assert!(begun.elapsed() >= Duration::from_millis(30));
        assert_eq!((&bytes[..length], from), (&b"pose"[..], reflector));
        assert_eq!(counts.received.load(Ordering::Relaxed).max(1), 1);
        stop.store(true, Ordering::Relaxed);
    }

    #[test]
    fn a_host_behind_the_reflector_answers_datagrams_and_streams() {
        let host = HostSockets::bind(Some(Ipv4Addr::LOCALHOST.into()), 0).expect("a port");
        host.udp.set_nonblocking(false).expect("blocks");
        host.tcp.set_nonblocking(false).expect("blocks");
        let address = SocketAddr::from((Ipv4Addr::LOCALHOST, host.port));
        let (udp, tcp) = (host.udp, host.tcp);
        std::thread::spawn(move || {
            let mut bytes = [0; 64];
            while let Ok((length, from)) = udp.recv_from(&mut bytes) {
                bytes[..length].reverse();
                let _ = udp.send_to(&bytes[..length], from);
            }
        });
        std::thread::spawn(move || {
            let (mut stream, _) = tcp.accept().expect("a stream");
            let mut bytes = [0; 5];
            stream.read_exact(&mut bytes).expect("reads");
            bytes.reverse();
            stream.write_all(&bytes).expect("writes");
        });
        let (reflector, stop, _) = start(Some(address), Impairments::delay(SimTime::from_millis(20)));
        let socket = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).expect("a socket");
        socket.set_read_timeout(Some(Duration::from_secs(20))).expect("a limit");
        let begun = Instant::now();
        socket.send_to(b"abc", reflector).expect("sends");
        let mut bytes = [0; 16];
        let (length, _) = socket.recv_from(&mut bytes).expect("an answer");
        assert_eq!(&bytes[..length], b"cba");
        assert!(begun.elapsed() >= Duration::from_millis(40), "there and back");
        let mut stream = TcpStream::connect(reflector).expect("connects");
        let begun = Instant::now();
        stream.write_all(b"12345").expect("writes");
        let mut answer = Vec::new();
        stream.read_to_end(&mut answer).expect("an answer and an end");
        assert_eq!(answer, b"54321");
        assert!(begun.elapsed() >= Duration::from_millis(40));
        stop.store(true, Ordering::Relaxed);
    }
}

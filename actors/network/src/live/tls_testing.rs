//! Hosts and stations on the loopback, for the tests of the streams.

use std::cell::Cell;
use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::time::{Duration, Instant};

use rustix::event::{PollFd, PollFlags, Timespec, poll};
use socket2::{Domain, Socket, Type};
use trocar_scene::SimTime;

use super::sockets::HostSockets;
use super::tls;
use super::tls_host_streams::TlsHostStreams;
use super::tls_station_stream::TlsStationStream;
use crate::datagram::Seal;
use crate::streams::{HostStreams, StationStream, StreamId, StreamState};
use crate::ticket::{HostAddress, Identity};

/// What happens on the loopback happens within this time, also on a machine that is busy.
const PATIENCE: Duration = Duration::from_secs(60);

/// Real time, which a test may let pass at once.
pub struct Clock {
    begun: Instant,
    jumped: Cell<SimTime>,
}

impl Clock {
    pub fn new() -> Self {
        Self { begun: Instant::now(), jumped: Cell::new(SimTime::ZERO) }
    }

    pub fn now(&self) -> SimTime {
        SimTime::from(self.begun.elapsed()) + self.jumped.get()
    }

    pub fn jump(&self, span: SimTime) {
        self.jumped.set(self.jumped.get() + span);
    }

    /// Calls until it gives something.
    pub fn wait<R>(&self, what: &str, mut step: impl FnMut(SimTime) -> Option<R>) -> R {
        let begun = Instant::now();
        loop {
            if let Some(result) = step(self.now()) {
                return result;
            }
            assert!(begun.elapsed() < PATIENCE, "{what}: it never happened");
            std::thread::sleep(Duration::from_micros(100));
        }
    }
}

/// A host, and what a ticket says of it.
pub struct Host {
    pub streams: TlsHostStreams,
    pub identity: Identity,
    pub address: SocketAddr,
    pub opened: Vec<StreamId>,
}

impl Host {
    pub fn new() -> Self {
        Self::at(Ipv4Addr::LOCALHOST.into(), Seal::Aead)
    }

    pub fn at(ip: IpAddr, datagrams: Seal) -> Self {
        let sockets = HostSockets::bind(Some(ip), 0).expect("some port is free");
        let identity = Identity::create(&"theatre 2".parse().expect("a name")).expect("an identity");
        let config = tls::host(identity.certificate().clone(), identity.private_key().expect("a key"));
        let streams =
            TlsHostStreams::new(sockets.tcp, config.expect("they fit"), datagrams).expect("the loopback");
        Self { streams, identity, address: SocketAddr::new(ip, sockets.port), opened: Vec::new() }
    }

    pub fn work(&mut self, now: SimTime) {
        self.streams.work(now, &mut self.opened);
    }

    /// A station that has a ticket of this host, with these addresses before the host's own.
    pub fn station(&self, before: &[SocketAddr]) -> TlsStationStream {
        let addresses = before.iter().chain([&self.address]).map(place).collect();
        TlsStationStream::new(addresses, self.identity.fingerprint(), Seal::Aead).expect("a ticket")
    }

    /// Works until a stream is open at both ends.
    pub fn meet(&mut self, clock: &Clock, station: &mut TlsStationStream) -> StreamId {
        station.connect(clock.now());
        self.opened.clear();
        clock.wait("a stream", |now| {
            self.work(now);
            let state = station.work(now);
            assert!(matches!(state, StreamState::Connecting | StreamState::Open), "{state:?}");
            (state == StreamState::Open).then(|| self.opened.pop()).flatten()
        })
    }
}

pub fn place(address: &SocketAddr) -> HostAddress {
    HostAddress::of_socket(*address).expect("an address")
}

/// Works until the station's stream has failed, and returns why.
pub fn failure(clock: &Clock, station: &mut TlsStationStream, mut host: Option<&mut Host>) -> String {
    clock.wait("a failure", |now| {
        if let Some(host) = &mut host {
            host.work(now);
        }
        match station.work(now) {
            StreamState::Closed(why) => Some(why),
            StreamState::Connecting => None,
            other => panic!("{other:?}"),
        }
    })
}

/// An address of this machine at which nobody listens: somebody has it, and takes no connections.
pub struct Nobody {
    pub address: SocketAddr,
    _socket: Socket,
}

impl Nobody {
    pub fn new() -> Self {
        let socket = Socket::new(Domain::IPV4, Type::STREAM, None).expect("a socket");
        socket.bind(&SocketAddr::from((Ipv4Addr::LOCALHOST, 0)).into()).expect("some port is free");
        let address = socket.local_addr().expect("it is bound");
        Self { address: address.as_socket().expect("of the internet"), _socket: socket }
    }
}

/// An address that answers nothing: its listener has as many connections as the system keeps for it, so that the system
/// drops others without a word.
pub struct BlackHole {
    pub address: SocketAddr,
    _sockets: Vec<Socket>,
}

impl BlackHole {
    pub fn new() -> Self {
        let socket = || Socket::new(Domain::IPV4, Type::STREAM, None).expect("a socket");
        let listener = socket();
        listener.bind(&SocketAddr::from((Ipv4Addr::LOCALHOST, 0)).into()).expect("some port is free");
        listener.listen(0).expect("it is bound");
        let address = listener.local_addr().expect("it is bound");
        let mut sockets = vec![listener];
        loop {
            assert!(sockets.len() < 16, "it takes every connection");
            let filling = socket();
            filling.set_nonblocking(true).expect("a socket");
            let _ = filling.connect(&address);
            let mut ready = [PollFd::new(&filling, PollFlags::OUT)];
            let limit = Timespec { tv_sec: 0, tv_nsec: 200_000_000 };
            let is_taken = poll(&mut ready, Some(&limit)).expect("it waits") > 0;
            sockets.push(filling);
            if !is_taken {
                break;
            }
        }
        Self { address: address.as_socket().expect("of the internet"), _sockets: sockets }
    }
}

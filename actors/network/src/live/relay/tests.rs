//! A host behind a relay, over the loopback: streams and datagrams of a station go through, and strangers get nowhere.

use std::io::{Read, Write};
use std::net::{Ipv4Addr, SocketAddr, TcpStream, UdpSocket};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use super::agent::{RelayAgent, RelayError};
use super::server::{RelayServer, RelayServerCounts};
use crate::live::sockets::HostSockets;
use crate::relay::{RelayKey, RelayRefusal};

const PATIENCE: Duration = Duration::from_secs(30);

fn key(digits: &str) -> RelayKey {
    digits.repeat(32).parse().expect("a key")
}

struct Relay {
    address: SocketAddr,
    counts: Arc<RelayServerCounts>,
    stop: Arc<AtomicBool>,
}

impl Relay {
    fn start() -> Self {
        let here = Some(Ipv4Addr::LOCALHOST.into());
        let server = RelayServer::bind(here, 0, [0, 0], key("ab")).expect("some ports are free");
        let address = SocketAddr::from((Ipv4Addr::LOCALHOST, server.port()));
        let (counts, stop) = (server.counts().clone(), Arc::new(AtomicBool::new(false)));
        let ending = stop.clone();
        std::thread::spawn(move || server.run(&ending).expect("it waits"));
        Self { address, counts, stop }
    }
}

impl Drop for Relay {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Release);
    }
}

/// A host that turns around what it gets: five bytes of a stream, and each datagram.
fn host() -> SocketAddr {
    let sockets = HostSockets::bind(Some(Ipv4Addr::LOCALHOST.into()), 0).expect("a port");
    let address = SocketAddr::from((Ipv4Addr::LOCALHOST, sockets.port));
    sockets.udp.set_nonblocking(false).expect("blocks");
    sockets.tcp.set_nonblocking(false).expect("blocks");
    std::thread::spawn(move || {
        let mut bytes = [0; 2_000];
        while let Ok((length, from)) = sockets.udp.recv_from(&mut bytes) {
            bytes[..length].reverse();
            // A test that is over does not listen any more.
            let _ = sockets.udp.send_to(&bytes[..length], from);
        }
    });
    std::thread::spawn(move || {
        while let Ok((mut stream, _)) = sockets.tcp.accept() {
            std::thread::spawn(move || {
                let mut bytes = [0; 5];
                while stream.read_exact(&mut bytes).is_ok() {
                    bytes.reverse();
                    if stream.write_all(&bytes).is_err() {
                        return;
                    }
                }
            });
        }
    });
    address
}

fn socket(to: SocketAddr) -> UdpSocket {
    let socket = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).expect("a socket");
    socket.connect(to).expect("an address");
    socket.set_read_timeout(Some(Duration::from_millis(100))).expect("a limit");
    socket
}

/// Sends until an answer comes: what comes before the host has bound its own datagrams is lost.
fn answer(socket: &UdpSocket, question: &[u8]) -> Vec<u8> {
    let begun = std::time::Instant::now();
    let mut bytes = [0; 2_000];
    loop {
        assert!(begun.elapsed() < PATIENCE, "no answer");
        socket.send(question).expect("it sends");
        if let Ok(length) = socket.recv(&mut bytes) {
            return bytes[..length].to_vec();
        }
    }
}

#[test]
fn a_station_reaches_a_host_that_has_dialled_out() {
    let (relay, host) = (Relay::start(), host());
    let agent = RelayAgent::register(relay.address, key("ab"), host).expect("a port");
    let port = SocketAddr::from((Ipv4Addr::LOCALHOST, agent.port()));
    // Datagrams alone, from an address without a stream, go nowhere.
    let stranger = socket(port);
    for _ in 0..3 {
        stranger.send(b"hello").expect("it sends");
        assert!(stranger.recv(&mut [0; 16]).is_err(), "a stranger got an answer");
    }
    let mut stream = TcpStream::connect(port).expect("it connects");
    stream.set_read_timeout(Some(PATIENCE)).expect("a limit");
    for word in [b"12345", b"abcde"] {
        stream.write_all(word).expect("it writes");
        let (mut bytes, mut turned) = ([0; 5], *word);
        stream.read_exact(&mut bytes).expect("an answer");
        turned.reverse();
        assert_eq!(bytes, turned);
    }
    let longest: Vec<u8> = (0..1_200).map(|k| k as u8).collect();
    let mut turned = longest.clone();
    turned.reverse();
    assert_eq!(answer(&socket(port), &longest), turned);
    // The station leaves, and its place is free.
    drop(stream);
    let begun = std::time::Instant::now();
    while relay.counts.streams.load(Ordering::Relaxed) != 0
        || relay.counts.sessions.load(Ordering::Relaxed) != 1
    {
        assert!(begun.elapsed() < PATIENCE, "the stream stays");
        std::thread::sleep(Duration::from_millis(10));
    }
}

#[test]
fn a_host_without_the_key_gets_no_port() {
    let (relay, host) = (Relay::start(), host());
    let refused = RelayAgent::register(relay.address, key("cd"), host).expect_err("it is refused");
    assert!(matches!(refused, RelayError::Refused(_, RelayRefusal::Key)), "{refused}");
    let first = RelayAgent::register(relay.address, key("ab"), host).expect("a port");
    let second = RelayAgent::register(relay.address, key("ab"), host).expect("a port");
    assert_ne!(first.port(), second.port());
    let full = RelayAgent::register(relay.address, key("ab"), host).expect_err("there are two ports");
    assert!(matches!(full, RelayError::Refused(_, RelayRefusal::Full)), "{full}");
    let nobody = RelayAgent::register(host, key("ab"), host);
    assert!(nobody.is_err(), "the host is no relay");
}

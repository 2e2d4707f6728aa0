//! Streams between a host and a station, both over real sockets: bytes, keys, and ends.

use std::net::{Ipv4Addr, Ipv6Addr, Shutdown, SocketAddr, TcpStream};
use std::time::Instant;

use rustls::{ClientConnection, StreamOwned};
use trocar_scene::SimTime;
use trocar_scene::random::SplitMix64;

use super::leaving::LEAVING_TIME_MAX;
use super::sockets::HostSockets;
use super::tls;
use super::tls_host_streams::{TlsHostError, TlsHostStreams};
use super::tls_socket::{RECEIVED_MAX, SENT_MAX};
use super::tls_station_stream::{TlsStationError, TlsStationStream};
use super::tls_testing::{Clock, Host, failure, place};
use crate::datagram::{DATAGRAM_MAX, Keys, Kind, Opener, Sealer, Side};
use crate::datagram::{Refused, Seal};
use crate::streams::{Closed, HostStreams, StationStream, StreamState};

const GRACE: SimTime = SimTime::from_millis(100);

fn noise(seed: u64, length: usize) -> Vec<u8> {
    let mut random = SplitMix64::new(seed);
    (0..length.div_ceil(8)).flat_map(|_| random.next_u64().to_le_bytes()).take(length).collect()
}

#[test]
fn bytes_pass_both_ways_in_odd_pieces() {
    let (clock, mut host) = (Clock::new(), Host::new());
    let mut station = host.station(&[]);
    let stream = host.meet(&clock, &mut station);
    let (up, down) = (noise(1, 300_000), noise(2, 300_000));
    let (mut sent_up, mut sent_down) = (0, 0);
    let (mut at_host, mut at_station) = (Vec::new(), Vec::new());
    let mut random = SplitMix64::new(3);
    clock.wait("all bytes", |now| {
        host.work(now);
        assert_eq!(station.work(now), StreamState::Open);
        let mut piece = |most: u64| random.next_u64() as usize % most as usize;
        let end = up.len().min(sent_up + piece(5_000));
        sent_up += station.send(now, &up[sent_up..end]).expect("it is open");
        let end = down.len().min(sent_down + piece(5_000));
        sent_down += host.streams.send(stream, now, &down[sent_down..end]).expect("it is open");
        let (most, before) = (piece(7_000), at_host.len());
        host.streams.receive(stream, now, most, &mut at_host).expect("it is open");
        assert!(at_host.len() - before <= most);
        let (most, before) = (piece(7_000), at_station.len());
        station.receive(now, most, &mut at_station).expect("it is open");
        assert!(at_station.len() - before <= most);
        (at_host.len() == up.len() && at_station.len() == down.len()).then_some(())
    });
    assert!(at_host == up && at_station == down);
    let here = host.streams.address(stream).expect("it is open");
    assert!(here.ip().is_loopback() && here != host.address, "{here}");
    assert_eq!(station.address(), Some(host.address));
}

#[test]
fn megabytes_wait_while_the_other_side_takes_nothing_and_none_is_lost() {
    const TOTAL: usize = 64 << 20;
    let (clock, mut host) = (Clock::new(), Host::new());
    let mut station = host.station(&[]);
    let stream = host.meet(&clock, &mut station);
    let bytes = noise(4, TOTAL);
    let mut sent = 0;
    // The system takes what its own buffers hold, and no more.
    let mut full = 0;
    clock.wait("a full stream", |now| {
        host.work(now);
        let taken = host.streams.send(stream, now, &bytes[sent..]).expect("it is open");
        assert!(taken <= SENT_MAX);
        sent += taken;
        full = if taken == 0 { full + 1 } else { 0 };
        (full == 200).then_some(())
    });
    assert!(sent < TOTAL / 2, "{sent} bytes were taken, which nobody has read");
    let waiting = sent;
    let (begun, mut read) = (Instant::now(), Vec::with_capacity(TOTAL));
    while read.len() < TOTAL {
        let now = clock.now();
        host.work(now);
        sent += host.streams.send(stream, now, &bytes[sent..]).expect("it is open");
        station.work(now);
        let before = read.len();
        station.receive(now, usize::MAX, &mut read).expect("it is open");
        assert!(read.len() - before <= RECEIVED_MAX);
        assert!(begun.elapsed().as_secs() < 60, "{} of {TOTAL} bytes", read.len());
    }
    let rate = TOTAL as f64 / begun.elapsed().as_secs_f64() / 1e6;
    eprintln!("{waiting} bytes waited; then {rate:.0} MB/s with both ends in one thread");
    assert!(read == bytes);
}

#[test]
fn both_ends_have_keys_that_fit_and_other_connections_phases_and_streams_have_others() {
    let (clock, mut host) = (Clock::new(), Host::new());
    let (mut station, mut other) = (host.station(&[]), host.station(&[]));
    let stream = host.meet(&clock, &mut station);
    let another = host.meet(&clock, &mut other);
    let opens = |sender: Keys, side: Side, receiver: Keys| {
        let other_side = if side == Side::Client { Side::Server } else { Side::Client };
        let mut sealer = Sealer::new(sender.split(side).0);
        let mut opener = Opener::new(receiver.split(other_side).1, GRACE);
        assert!(sealer.is_protected() && opener.is_protected());
        let mut out = [0; DATAGRAM_MAX];
        let length = sealer.seal(Kind::Rows, 0, SimTime::ZERO, b"rows", &mut out).expect("it fits");
        opener.open(SimTime::ZERO, &mut out[..length]).map(|(_, payload)| payload.to_vec())
    };
    for (connection, phase) in [(7, 0), (7, 1), (0xFFFF_FFFF, 300)] {
        let ours = |station: &mut TlsStationStream| station.keys(connection, phase).expect("keys");
        let mut theirs = |stream| host.streams.keys(stream, connection, phase).expect("keys");
        let sent = opens(ours(&mut station), Side::Client, theirs(stream));
        assert_eq!(sent.as_deref(), Ok(&b"rows"[..]));
        let sent = opens(theirs(stream), Side::Server, ours(&mut station));
        assert_eq!(sent.as_deref(), Ok(&b"rows"[..]));
        let wrong = opens(ours(&mut station), Side::Client, theirs(another));
        assert_eq!(wrong, Err(Refused::Forged), "keys of another stream");
    }
    let of_phase = |host: &mut Host, phase| host.streams.keys(stream, 7, phase).expect("keys");
    let wrong = opens(station.keys(7, 256).expect("keys"), Side::Client, of_phase(&mut host, 0));
    assert_eq!(wrong, Err(Refused::Forged), "another phase with the same byte in the header");
    station.close();
    assert!(station.keys(7, 0).is_none(), "keys without a stream");
    host.streams.close(stream);
    assert!(host.streams.keys(stream, 7, 0).is_none(), "keys without a stream");
}

#[test]
fn what_a_host_sent_before_it_closed_arrives_although_the_station_was_slow_and_talking() {
    let (clock, mut host) = (Clock::new(), Host::new());
    let mut station = host.station(&[]);
    let stream = host.meet(&clock, &mut station);
    // Bytes that the host never reads: with them, a plain close would reset the connection.
    let said = station.send(clock.now(), &noise(5, 100_000)).expect("it is open");
    assert_eq!(said, 100_000);
    let bytes = noise(6, 64 << 20);
    let (mut sent, mut full) = (0, 0);
    while full < 50 {
        host.work(clock.now());
        let taken = host.streams.send(stream, clock.now(), &bytes[sent..]).expect("it is open");
        (sent, full) = (sent + taken, if taken == 0 { full + 1 } else { 0 });
    }
    host.streams.close(stream);
    let gone = host.streams.send(stream, clock.now(), b"more").expect_err("it is closed");
    assert!(gone.0.contains("closed"), "{gone:?}");
    let mut read = Vec::new();
    let end = clock.wait("the end", |now| {
        host.work(now);
        station.work(now);
        station.receive(now, 100_000, &mut read).err()
    });
    assert_eq!(end, Closed("the other side closed the stream".into()));
    assert!(read == bytes[..sent], "{} of {sent} bytes", read.len());
    assert_eq!(station.work(clock.now()), StreamState::Closed(end.0.clone()));
    assert_eq!(station.send(clock.now(), b"more"), Err(end));
}

#[test]
fn a_closed_stream_whose_station_reads_nothing_is_dropped_in_time() {
    let (clock, mut host) = (Clock::new(), Host::new());
    let mut station = host.station(&[]);
    let stream = host.meet(&clock, &mut station);
    let bytes = noise(7, 64 << 20);
    let (mut sent, mut full) = (0, 0);
    while full < 50 {
        host.work(clock.now());
        let taken = host.streams.send(stream, clock.now(), &bytes[sent..]).expect("it is open");
        (sent, full) = (sent + taken, if taken == 0 { full + 1 } else { 0 });
    }
    host.streams.close(stream);
    host.work(clock.now());
    clock.jump(LEAVING_TIME_MAX);
    host.work(clock.now());
    let mut read = Vec::new();
    let end = clock.wait("the end", |now| {
        host.work(now);
        station.receive(now, usize::MAX, &mut read).err()
    });
    assert!(end.0.contains("cut off") || end.0.contains("broke off"), "{end:?}");
    assert!(bytes.starts_with(&read), "what came is in order");
}

#[test]
fn a_station_that_leaves_is_told_to_the_host_after_its_last_words() {
    let (clock, mut host) = (Clock::new(), Host::new());
    let mut station = host.station(&[]);
    let stream = host.meet(&clock, &mut station);
    assert_eq!(station.send(clock.now(), b"goodbye"), Ok(7));
    station.close();
    assert_eq!(station.work(clock.now()), StreamState::None);
    let mut read = Vec::new();
    let end = clock.wait("the end", |now| {
        host.work(now);
        station.work(now);
        host.streams.receive(stream, now, 1_000, &mut read).err()
    });
    assert_eq!((read.as_slice(), end.0.as_str()), (&b"goodbye"[..], "the other side closed the stream"));
    assert_eq!(host.streams.streams(), 1, "the host closes it");
    host.streams.close(stream);
    assert_eq!(host.streams.streams(), 0);
}

#[test]
fn a_station_comes_back_on_a_new_stream() {
    let (clock, mut host) = (Clock::new(), Host::new());
    let mut station = host.station(&[]);
    let first = host.meet(&clock, &mut station);
    let second = host.meet(&clock, &mut station);
    assert_ne!(first, second);
    let end = clock.wait("the end of the first", |now| {
        host.work(now);
        station.work(now);
        host.streams.receive(first, now, 10, &mut Vec::new()).err()
    });
    assert_eq!(end.0, "the other side closed the stream");
    assert_eq!(station.send(clock.now(), b"here"), Ok(4));
    let mut read = Vec::new();
    clock.wait("bytes", |now| {
        host.streams.receive(second, now, 10, &mut read).expect("it is open");
        (read == b"here").then_some(())
    });
}

#[test]
fn a_process_that_dies_at_one_end_is_told_at_the_other() {
    let clock = Clock::new();
    let mut host = Host::new();
    let mut station = host.station(&[]);
    host.meet(&clock, &mut station);
    drop(host);
    let end = clock.wait("the end", |now| station.receive(now, 10, &mut Vec::new()).err());
    assert_eq!(end.0, "the other side was cut off");
    let mut host = Host::new();
    let mut station = host.station(&[]);
    let stream = host.meet(&clock, &mut station);
    drop(station);
    let end = clock.wait("the end", |now| host.streams.receive(stream, now, 10, &mut Vec::new()).err());
    assert_eq!(end.0, "the other side was cut off");
}

#[test]
fn a_half_open_connection_has_ended_for_the_host() {
    let (clock, mut host) = (Clock::new(), Host::new());
    // A station that closes the socket's direction to the host without the session's goodbye.
    let (config, address) = (tls::client(host.identity.fingerprint()).expect("a client"), host.address);
    let mut tls = ClientConnection::new(config, tls::name()).expect("a client");
    let shaken = std::thread::spawn(move || {
        let mut tcp = TcpStream::connect(address).expect("connects");
        while tls.is_handshaking() {
            tls.complete_io(&mut tcp).expect("shakes hands");
        }
        let mut stream = StreamOwned::new(tls, tcp);
        std::io::Write::write_all(&mut stream, b"half").expect("writes");
        std::io::Write::flush(&mut stream).expect("writes");
        stream.sock.shutdown(Shutdown::Write).expect("it is open");
        stream
    });
    let stream = clock.wait("a stream", |now| {
        host.work(now);
        host.opened.pop()
    });
    let _half_open = shaken.join().expect("it has shaken hands");
    let mut read = Vec::new();
    let end = clock.wait("the end", |now| host.streams.receive(stream, now, 10, &mut read).err());
    assert_eq!((read.as_slice(), end.0.as_str()), (&b"half"[..], "the other side was cut off"));
    assert!(host.streams.send(stream, clock.now(), b"x").is_err());
}

#[test]
fn damaged_records_end_a_stream_after_what_came_before() {
    let (clock, mut host) = (Clock::new(), Host::new());
    let (config, address) = (tls::client(host.identity.fingerprint()).expect("a client"), host.address);
    let shaken = std::thread::spawn(move || {
        let tls = ClientConnection::new(config, tls::name()).expect("a client");
        let mut stream = StreamOwned::new(tls, TcpStream::connect(address).expect("connects"));
        std::io::Write::write_all(&mut stream, b"whole").expect("writes");
        std::io::Write::flush(&mut stream).expect("writes");
        // A record of application data that no key has sealed.
        std::io::Write::write_all(&mut stream.sock, &[23, 3, 3, 0, 32]).expect("writes");
        std::io::Write::write_all(&mut stream.sock, &[7; 32]).expect("writes");
        stream
    });
    let stream = clock.wait("a stream", |now| {
        host.work(now);
        host.opened.pop()
    });
    let _other_end = shaken.join().expect("it has shaken hands");
    let mut read = Vec::new();
    let end = clock.wait("the end", |now| host.streams.receive(stream, now, 10, &mut read).err());
    assert_eq!(read, b"whole");
    assert!(end.0.starts_with("the stream is damaged"), "{end:?}");
}

#[test]
fn datagrams_without_protection_are_for_the_loopback_alone() {
    let identity = Host::new().identity;
    let everywhere = HostSockets::bind(Some(Ipv4Addr::UNSPECIFIED.into()), 0).expect("some port is free");
    let config = tls::host(identity.certificate().clone(), identity.private_key().expect("a key"));
    let refused = TlsHostStreams::new(everywhere.tcp, config.expect("they fit"), Seal::Checksum);
    let refused = refused.expect_err("other machines reach it");
    assert!(matches!(refused, TlsHostError::NotLoopback { .. }), "{refused}");
    assert!(refused.to_string().contains("127.0.0.1"), "{refused}");
    let far: SocketAddr = "192.0.2.1:7417".parse().expect("an address");
    let refused = TlsStationStream::new(vec![place(&far)], identity.fingerprint(), Seal::Checksum);
    let refused = refused.expect_err("another machine's");
    assert!(matches!(refused, TlsStationError::NotLoopback { .. }), "{refused}");
    let none = TlsStationStream::new(Vec::new(), identity.fingerprint(), Seal::Aead);
    assert!(matches!(none, Err(TlsStationError::Addresses(0))));

    let clock = Clock::new();
    let mut host = Host::at(Ipv4Addr::LOCALHOST.into(), Seal::Checksum);
    let addresses = vec![place(&host.address)];
    let mut station = TlsStationStream::new(addresses, host.identity.fingerprint(), Seal::Checksum)
        .expect("on this machine");
    let stream = host.meet(&clock, &mut station);
    let ours = Sealer::new(station.keys(7, 0).expect("keys").split(Side::Client).0);
    let theirs = Opener::new(host.streams.keys(stream, 7, 0).expect("keys").split(Side::Server).1, GRACE);
    assert!(!ours.is_protected() && !theirs.is_protected());
    // Control stays protected: a station that pins another certificate does not come in.
    let other = Host::new().identity.fingerprint();
    let mut station =
        TlsStationStream::new(vec![place(&host.address)], other, Seal::Checksum).expect("on this machine");
    station.connect(clock.now());
    let why = failure(&clock, &mut station, Some(&mut host));
    assert!(why.contains("another certificate"), "{why}");
}

#[test]
fn streams_pass_over_ipv6_too() {
    let Ok(probe) = std::net::TcpListener::bind((Ipv6Addr::LOCALHOST, 0)) else {
        eprintln!("this machine has no IPv6");
        return;
    };
    drop(probe);
    let (clock, mut host) = (Clock::new(), Host::at(Ipv6Addr::LOCALHOST.into(), Seal::Aead));
    let mut station = host.station(&[]);
    let stream = host.meet(&clock, &mut station);
    assert_eq!(station.send(clock.now(), b"six"), Ok(3));
    let mut read = Vec::new();
    clock.wait("bytes", |now| {
        host.streams.receive(stream, now, 10, &mut read).expect("it is open");
        (read == b"six").then_some(())
    });
    assert_eq!(station.address(), Some(host.address));
}

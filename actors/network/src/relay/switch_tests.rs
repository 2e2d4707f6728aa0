//! What a relay does for hosts with its key, and what it does not do for strangers.

use core::net::SocketAddr;

use trocar_scene::SimTime;

use super::*;
use crate::control::STATIONS_MAX;

const MS: fn(u64) -> SimTime = SimTime::from_millis;
const PORTS: [u16; 2] = [7_500, 7_501];

fn key() -> RelayKey {
    "ab".repeat(32).parse().expect("a key")
}

fn address(text: &str) -> SocketAddr {
    text.parse().expect("an address")
}

fn nonce(line: u64) -> Nonce {
    [line as u8; NONCE_BYTES]
}

fn relay() -> RelaySwitch {
    RelaySwitch::new(key(), PORTS.to_vec())
}

/// A host by this line; its port.
fn register(relay: &mut RelaySwitch, line: u64, now: SimTime) -> u16 {
    relay.line_opened(line, nonce(line), now);
    match relay.line_heard(line, &key().register(&nonce(line), 0), now) {
        LineNews::Registered(port, words) => {
            assert_eq!(words, FromRelay::Registered(port).encode());
            port
        }
        other => panic!("{other:?}"),
    }
}

/// The host fetches a stream by a line of its own.
fn fetch(relay: &mut RelaySwitch, line: u64, stream: StreamId, now: SimTime) -> LineNews {
    relay.line_opened(line, nonce(line), now);
    relay.line_heard(line, &key().fetch(&nonce(line), stream.0), now)
}

fn bind(relay: &mut RelaySwitch, port: u16, line: u64, number: u64, from: &str, now: SimTime) {
    let bytes = Bind { port, number }.encode(&key(), &nonce(line));
    assert_eq!(relay.from_host(address(from), &bytes, now), None, "a bind is not answered");
}

/// A session with one station whose stream is spliced; its port.
fn session(relay: &mut RelaySwitch) -> u16 {
    let port = register(relay, 1, MS(0));
    bind(relay, port, 1, 1, "198.51.100.1:9", MS(0));
    let (stream, line, words) = relay.knocked(port, address("203.0.113.5:1000"), MS(1)).expect("a stream");
    assert_eq!((line, words), (1, FromRelay::Knock(stream.0).encode()));
    assert_eq!(fetch(relay, 2, stream, MS(2)), LineNews::Splice(port, stream));
    port
}

#[test]
fn datagrams_of_a_station_go_to_its_host_with_a_number_and_come_back_by_it() {
    let mut relay = relay();
    let port = session(&mut relay);
    let station = address("203.0.113.5:2000");
    let (host, number) = relay.from_station(port, station, 252, MS(3)).expect("it is forwarded");
    assert_eq!(host, address("198.51.100.1:9"));
    let mut bytes = Vec::new();
    numbered(number, b"sealed", &mut bytes);
    let back = relay.from_host(host, &bytes, MS(4));
    assert_eq!(back, Some((port, station, &b"sealed"[..])));
    // Two stations behind one router are two.
    let other = relay.from_station(port, address("203.0.113.5:2001"), 252, MS(5)).expect("it is forwarded");
    assert_ne!(other.1, number);
    numbered(99, b"sealed", &mut bytes);
    assert_eq!(relay.from_host(host, &bytes, MS(6)), None, "nobody has that number");
}

#[test]
fn a_stranger_without_the_key_gets_no_port_no_stream_and_no_hosts_datagrams() {
    let mut relay = relay();
    let port = session(&mut relay);
    let other: RelayKey = "cd".repeat(32).parse().expect("a key");
    let (stream, ..) = relay.knocked(port, address("203.0.113.6:1000"), MS(3)).expect("a stream");
    for (line, answer) in [
        (10, other.register(&nonce(10), 0)),
        (11, key().register(&nonce(10), 0)),
        (12, other.fetch(&nonce(12), stream.0)),
    ] {
        relay.line_opened(line, nonce(line), MS(3));
        let refused = LineNews::Stop(FromRelay::Refused(RelayRefusal::Key).encode());
        assert_eq!(relay.line_heard(line, &answer, MS(3)), refused);
    }
    // He repeats a bind of the host from elsewhere, and makes one of his own.
    let old = Bind { port, number: 1 }.encode(&key(), &nonce(1));
    let own = Bind { port, number: 9 }.encode(&other, &nonce(1));
    for bytes in [old, own] {
        assert_eq!(relay.from_host(address("203.0.113.66:1"), &bytes, MS(4)), None);
    }
    let to = relay.from_station(port, address("203.0.113.5:2000"), 252, MS(5)).expect("it is forwarded").0;
    assert_eq!(to, address("198.51.100.1:9"), "the host's datagrams go where they went");
    // What he sends as if he were the host goes to nobody.
    let mut bytes = Vec::new();
    numbered(1, b"forged", &mut bytes);
    assert_eq!(relay.from_host(address("203.0.113.66:1"), &bytes, MS(6)), None);
}

#[test]
fn a_flood_from_addresses_without_a_stream_reaches_no_host() {
    let mut relay = relay();
    let port = session(&mut relay);
    for number in 0..1_000_u16 {
        let forged = SocketAddr::from(([192, 0, 2, 1], number + 1));
        assert_eq!(relay.from_station(port, forged, 1_200, MS(3)), None);
    }
    assert_eq!(relay.from_station(PORTS[1], address("203.0.113.5:2000"), 10, MS(3)), None, "no session");
    assert_eq!((relay.counts().dropped, relay.counts().forwarded), (1_001, 0));
    // A stream that waits to be fetched is a stranger's still.
    relay.knocked(port, address("192.0.2.1:1"), MS(4)).expect("a stream");
    assert_eq!(relay.from_station(port, address("192.0.2.1:5"), 10, MS(4)), None);
}

#[test]
fn streams_stations_bytes_and_sessions_have_limits() {
    let mut relay = relay();
    let port = session(&mut relay);
    let of_one =
        (0..20).filter(|k| relay.knocked(port, SocketAddr::from(([192, 0, 2, 9], 1 + k)), MS(3)).is_some());
    assert_eq!(of_one.count(), STREAMS_OF_ONE_MAX);
    let others =
        (0..100_u8).filter(|k| relay.knocked(port, SocketAddr::from(([192, 0, 3, *k], 1)), MS(3)).is_some());
    assert_eq!(others.count(), STREAMS_MAX - STREAMS_OF_ONE_MAX - 1);
    let station = |k: u16| SocketAddr::from(([203, 0, 113, 5], 2_000 + k));
    let known = (0..100).filter(|k| relay.from_station(port, station(*k), 10, MS(4)).is_some());
    assert_eq!(known.count(), STATIONS_MAX);
    let later = MS(5) + STATION_IDLE_MAX;
    assert!(relay.from_station(port, station(99), 10, later).is_some(), "the silent ones made room");
    let mut passed = 0;
    while relay.from_station(port, station(99), 1_200, later).is_some() {
        passed += 1_200;
    }
    assert!(passed <= BYTES_PER_SEC / 4, "{passed}");
    assert!(relay.from_station(port, station(99), 1_200, later + MS(1)).is_some());
    assert_eq!(register(&mut relay, 20, MS(6)), PORTS[1]);
    relay.line_opened(21, nonce(21), MS(6));
    let full = relay.line_heard(21, &key().register(&nonce(21), 0), MS(6));
    assert_eq!(full, LineNews::Stop(FromRelay::Refused(RelayRefusal::Full).encode()));
    for line in 100..100 + OPENERS_MAX as u64 {
        assert_eq!(relay.line_opened(line, nonce(1), MS(7)).1, None);
    }
    assert_eq!(relay.line_opened(500, nonce(1), MS(7)).1, Some(100), "the oldest makes room");
}

#[test]
fn who_is_slow_or_silent_goes_and_a_host_that_is_gone_takes_its_streams_along() {
    let mut relay = relay();
    let port = session(&mut relay);
    let (waiting, ..) = relay.knocked(port, address("203.0.113.6:1"), MS(3)).expect("a stream");
    relay.line_opened(30, nonce(30), MS(3));
    let overdue = relay.work(MS(3) + OPENING_TIME_MAX);
    assert_eq!(overdue.lines, [30]);
    assert_eq!(overdue.pings, [(1, FromRelay::Ping.encode())]);
    assert_eq!(relay.line_heard(1, &FromHost::Pong, MS(10_000)), LineNews::Nothing);
    assert_eq!(relay.work(MS(3) + FETCH_TIME_MAX).streams, [waiting]);
    let late = fetch(&mut relay, 31, waiting, MS(14_000));
    assert_eq!(late, LineNews::Stop(FromRelay::Refused(RelayRefusal::Gone).encode()));
    assert!(relay.work(MS(29_000)).lines.is_empty());
    assert_eq!(relay.work(MS(10_000) + HOST_SILENCE_MAX).lines, [1]);
    let stopped = relay.line_closed(1);
    assert_eq!((stopped.port, stopped.streams.len()), (Some(port), 1));
    assert_eq!(relay.knocked(port, address("203.0.113.5:1"), MS(31_000)), None);
    assert_eq!(register(&mut relay, 40, MS(31_000)), port, "the port is free again");
    relay.line_closed(40);
    relay.line_opened(41, nonce(41), MS(31_000));
    let wished = relay.line_heard(41, &key().register(&nonce(41), PORTS[1]), MS(31_000));
    assert_eq!(wished, LineNews::Registered(PORTS[1], FromRelay::Registered(PORTS[1]).encode()));
}

#[test]
fn a_stream_is_fetched_once() {
    let mut relay = relay();
    let port = session(&mut relay);
    let (stream, ..) = relay.knocked(port, address("203.0.113.7:1"), MS(3)).expect("a stream");
    assert_eq!(fetch(&mut relay, 50, stream, MS(4)), LineNews::Splice(port, stream));
    let again = fetch(&mut relay, 51, stream, MS(4));
    assert_eq!(again, LineNews::Stop(FromRelay::Refused(RelayRefusal::Gone).encode()));
    assert_eq!(relay.line_heard(1, &key().register(&nonce(1), 0), MS(5)), LineNews::Stop(Vec::new()));
}

//! A station on its way to a host: which address it takes, and what it says when none leads there.

use std::io::{self, Write};
use std::net::{Ipv4Addr, SocketAddr, TcpListener};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

use trocar_scene::SimTime;

use super::dial::{DIAL_TIME_MAX, HANDSHAKE_PATIENCE, NEXT_AFTER};
use super::lookup::Resolver;
use super::tls_station_stream::TlsStationStream;
use super::tls_testing::{BlackHole, Clock, Host, Nobody, failure, place};
use crate::datagram::Seal;
use crate::streams::{StationStream, StreamState};
use crate::ticket::{Fingerprint, HostAddress, HostPlace};

/// A station whose names are resolved in this way.
fn named(names: &[&str], fingerprint: Fingerprint, resolver: Resolver) -> TlsStationStream {
    let addresses = names.iter().map(|name| name.parse::<HostAddress>().expect("an address")).collect();
    TlsStationStream::with_resolver(addresses, fingerprint, Seal::Aead, resolver).expect("a ticket")
}

fn loopback(last: u8, port: u16) -> SocketAddr {
    (Ipv4Addr::new(127, 0, 0, last), port).into()
}

#[test]
fn another_certificate_than_the_tickets_is_refused_with_its_word() {
    let (clock, mut host, other) = (Clock::new(), Host::new(), Host::new());
    let addresses = vec![place(&host.address)];
    let mut station =
        TlsStationStream::new(addresses, other.identity.fingerprint(), Seal::Aead).expect("a ticket");
    assert_eq!(station.work(clock.now()), StreamState::None);
    station.connect(clock.now());
    let why = failure(&clock, &mut station, Some(&mut host));
    assert!(why.contains(&host.address.to_string()), "{why}");
    assert!(why.contains("another certificate than the ticket's"), "{why}");
    assert_eq!(station.address(), None);
    assert!(station.keys(1, 0).is_none());
    clock.wait("the host's end", |now| {
        host.work(now);
        (host.streams.openers() == 0).then_some(())
    });
    assert_eq!((host.streams.counts().failed, host.streams.counts().opened), (1, 0));
}

#[test]
fn nobody_listening_is_told_with_every_address() {
    let clock = Clock::new();
    let (first, second) = (Nobody::new(), Nobody::new());
    let addresses = [first.address, second.address].iter().map(place).collect();
    let mut station =
        TlsStationStream::new(addresses, Fingerprint::from_bytes([1; 32]), Seal::Aead).expect("a ticket");
    let begun = clock.now();
    station.connect(begun);
    // The station's time stands still: the second is tried because the first has failed.
    let why = clock.wait("a failure", |_| match station.work(begun) {
        StreamState::Closed(why) => Some(why),
        _ => None,
    });
    assert_eq!(
        why,
        format!("no host reached: {}, {}: refused, nobody listens there", first.address, second.address)
    );
}

#[test]
fn the_next_address_is_tried_after_a_quarter_of_a_second_without_an_answer() {
    let (clock, mut host, hole) = (Clock::new(), Host::new(), BlackHole::new());
    let refused = Nobody::new();
    let mut station = host.station(&[hole.address, refused.address]);
    let begun = clock.now();
    host.meet(&clock, &mut station);
    assert_eq!(station.address(), Some(host.address));
    let taken = clock.now().since(begun);
    assert!(taken >= NEXT_AFTER && taken < NEXT_AFTER + SimTime::from_millis(4_000), "{taken}");
}

#[test]
fn an_address_without_an_answer_is_given_up_in_time() {
    let (clock, hole, refused) = (Clock::new(), BlackHole::new(), Nobody::new());
    let addresses = [hole.address, refused.address].iter().map(place).collect();
    let mut station =
        TlsStationStream::new(addresses, Fingerprint::from_bytes([1; 32]), Seal::Aead).expect("a ticket");
    station.connect(clock.now());
    let begun = clock.now();
    while clock.now().since(begun) < NEXT_AFTER + SimTime::from_millis(50) {
        assert_eq!(station.work(clock.now()), StreamState::Connecting);
        std::thread::sleep(Duration::from_millis(1));
    }
    clock.jump(DIAL_TIME_MAX);
    let why = failure(&clock, &mut station, None);
    let expected = format!(
        "no host reached: {}: refused, nobody listens there; {}: timed out, no answer",
        refused.address, hole.address
    );
    assert_eq!(why, expected);
}

#[test]
fn another_machine_behind_the_first_address_does_not_keep_the_station_from_its_host() {
    let (clock, mut host, mut other) = (Clock::new(), Host::new(), Host::new());
    let mut station = host.station(&[other.address]);
    station.connect(clock.now());
    clock.wait("a stream", |now| {
        host.work(now);
        other.work(now);
        (station.work(now) == StreamState::Open).then_some(())
    });
    assert_eq!(station.address(), Some(host.address));
    assert_eq!(other.streams.counts().opened, 0);
}

#[test]
fn a_server_of_another_kind_is_named_and_passed_over() {
    let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).expect("some port is free");
    let web = listener.local_addr().expect("it is bound");
    std::thread::spawn(move || {
        // One connection for each of the stations below.
        for _ in 0..2 {
            let (mut taken, _) = listener.accept().expect("a station");
            taken.write_all(b"HTTP/1.1 400 Bad Request\r\n\r\n").expect("writes");
            let _ = io::copy(&mut taken, &mut io::sink());
        }
    });
    let (clock, mut host) = (Clock::new(), Host::new());
    let mut station = host.station(&[web]);
    host.meet(&clock, &mut station);
    assert_eq!(station.address(), Some(host.address));
    let addresses = vec![place(&web)];
    let mut station =
        TlsStationStream::new(addresses, host.identity.fingerprint(), Seal::Aead).expect("a ticket");
    station.connect(clock.now());
    let why = failure(&clock, &mut station, None);
    assert!(why.starts_with(&format!("no host reached: {web}: what answers is no host")), "{why}");
}

#[test]
fn one_that_takes_the_connection_and_says_nothing_is_passed_over_after_a_while() {
    // The system takes the connection for a program that never does.
    let silent = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).expect("some port is free");
    let address = silent.local_addr().expect("it is bound");
    let (clock, mut host) = (Clock::new(), Host::new());
    let mut station = host.station(&[address]);
    station.connect(clock.now());
    let begun = clock.now();
    while clock.now().since(begun) < NEXT_AFTER + SimTime::from_millis(100) {
        host.work(clock.now());
        assert_eq!(station.work(clock.now()), StreamState::Connecting);
        std::thread::sleep(Duration::from_millis(1));
    }
    assert_eq!(host.streams.counts().accepted, 0, "the first that took the connection goes on");
    clock.jump(HANDSHAKE_PATIENCE);
    clock.wait("a stream", |now| {
        host.work(now);
        (station.work(now) == StreamState::Open).then_some(())
    });
    assert_eq!(station.address(), Some(host.address));
    // And alone it is given up in time.
    let mut station = TlsStationStream::new(vec![place(&address)], host.identity.fingerprint(), Seal::Aead)
        .expect("a ticket");
    station.connect(clock.now());
    let begun = clock.now();
    while clock.now().since(begun) < SimTime::from_millis(50) {
        assert_eq!(station.work(clock.now()), StreamState::Connecting);
    }
    clock.jump(DIAL_TIME_MAX);
    let why = failure(&clock, &mut station, None);
    assert_eq!(why, format!("no host reached: {address}: it took the connection and said nothing"));
}

#[test]
fn a_name_is_looked_up_and_its_addresses_are_tried_in_turn() {
    // Nobody listens at the first address of the name; the host is at the second.
    fn two(place: &HostPlace, port: u16) -> io::Result<Vec<SocketAddr>> {
        assert_eq!(*place, HostPlace::Name("theatre.example".into()));
        Ok(vec![loopback(77, port), loopback(1, port)])
    }
    let (clock, mut host) = (Clock::new(), Host::new());
    let name = format!("theatre.example:{}", host.address.port());
    let mut station = named(&[&name], host.identity.fingerprint(), two);
    host.meet(&clock, &mut station);
    assert_eq!(station.address(), Some(host.address));
    let name = format!("localhost:{}", host.address.port());
    let addresses = vec![name.parse().expect("an address")];
    let mut station =
        TlsStationStream::new(addresses, host.identity.fingerprint(), Seal::Aead).expect("a ticket");
    host.meet(&clock, &mut station);
}

#[test]
fn a_name_that_does_not_resolve_is_told_and_other_addresses_do_not_wait_for_it() {
    let clock = Clock::new();
    let addresses = vec!["nobody.invalid:7417".parse().expect("an address")];
    let mut station =
        TlsStationStream::new(addresses, Fingerprint::from_bytes([1; 32]), Seal::Aead).expect("a ticket");
    station.connect(clock.now());
    // By the system. Without any name service it may say nothing for long, which is told, too.
    let why = failure(&clock, &mut station, None);
    assert!(why.starts_with("no host reached: nobody.invalid:7417: the name "), "{why}");
    assert!(why.contains("does not resolve") || why.contains("no answer"), "{why}");
    let mut host = Host::new();
    let own = host.address.to_string();
    fn unknown(_: &HostPlace, _: u16) -> io::Result<Vec<SocketAddr>> {
        Err(io::Error::other("failed to lookup address information: Name or service not known"))
    }
    let mut station = named(&["nobody.example:1", &own], host.identity.fingerprint(), unknown);
    host.meet(&clock, &mut station);
    let nobody = Nobody::new();
    let refused = nobody.address;
    let mut station =
        named(&["nobody.example:1", &refused.to_string()], host.identity.fingerprint(), unknown);
    station.connect(clock.now());
    let expected = format!(
        "no host reached: {refused}: refused, nobody listens there; nobody.example:1: the name does not resolve \
         (Name or service not known)"
    );
    assert_eq!(failure(&clock, &mut station, None), expected);
    fn empty(_: &HostPlace, _: u16) -> io::Result<Vec<SocketAddr>> {
        Ok(Vec::new())
    }
    let mut station = named(&["nobody.example:1"], host.identity.fingerprint(), empty);
    station.connect(clock.now());
    let why = failure(&clock, &mut station, None);
    assert_eq!(why, "no host reached: nobody.example:1: the name does not resolve (no address)");
}

#[test]
fn a_name_service_that_never_answers_is_told_and_has_one_thread_for_all_tries() {
    static ASKED: AtomicUsize = AtomicUsize::new(0);
    static PORT: AtomicUsize = AtomicUsize::new(0);
    static ANSWERS: AtomicUsize = AtomicUsize::new(0);
    fn stuck(_: &HostPlace, _: u16) -> io::Result<Vec<SocketAddr>> {
        ASKED.fetch_add(1, Ordering::SeqCst);
        while ANSWERS.load(Ordering::SeqCst) == 0 {
            std::thread::sleep(Duration::from_millis(1));
        }
        Ok(vec![loopback(1, PORT.load(Ordering::SeqCst) as u16)])
    }
    let (clock, mut host) = (Clock::new(), Host::new());
    PORT.store(usize::from(host.address.port()), Ordering::SeqCst);
    let mut station = named(&["slow.example:1"], host.identity.fingerprint(), stuck);
    for _ in 0..3 {
        station.connect(clock.now());
        assert_eq!(station.work(clock.now()), StreamState::Connecting);
        clock.jump(DIAL_TIME_MAX);
        let why = failure(&clock, &mut station, None);
        assert_eq!(why, "no host reached: slow.example:1: the name service gives no answer");
    }
    ANSWERS.store(1, Ordering::SeqCst);
    host.meet(&clock, &mut station);
    assert_eq!((station.address(), ASKED.load(Ordering::SeqCst)), (Some(host.address), 1));
}

#[test]
fn without_protection_a_name_of_another_machine_is_not_tried() {
    fn elsewhere(_: &HostPlace, port: u16) -> io::Result<Vec<SocketAddr>> {
        Ok(vec![(Ipv4Addr::new(192, 0, 2, 1), port).into()])
    }
    let clock = Clock::new();
    let addresses = vec!["theatre.localhost:7".parse().expect("an address")];
    let mut station = TlsStationStream::with_resolver(
        addresses,
        Fingerprint::from_bytes([1; 32]),
        Seal::Checksum,
        elsewhere,
    )
    .expect("by its name, of this machine");
    station.connect(clock.now());
    let why = failure(&clock, &mut station, None);
    assert!(why.starts_with("no host reached: 192.0.2.1:7: not on this machine"), "{why}");
}

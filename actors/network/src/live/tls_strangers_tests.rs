//! Strangers at a host's port: slow ones, wrong ones, and very many.

use std::io::{ErrorKind, Read, Write};
use std::net::{Shutdown, TcpStream};
use std::time::{Duration, Instant};

use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};
use rustix::time::{ClockId, clock_gettime};
use rustls::ClientConnection;
use trocar_scene::SimTime;
use trocar_scene::random::SplitMix64;

use super::tls;
use super::tls_host_streams::{OPENERS_MAX, OPENING_TIME_MAX, STREAMS_MAX};
use super::tls_station_stream::TlsStationStream;
use super::tls_testing::{Clock, Host};
use crate::streams::{HostStreams, StationStream, StreamState};

/// Files that this process needs besides the connections of one test.
const OTHER_FILES: u64 = 1_500;

/// As many connections as the process may have both ends of, at most `wanted`.
fn connections(wanted: u64) -> u64 {
    let limit = getrlimit(Resource::Nofile);
    let needed = 2 * wanted + OTHER_FILES;
    let possible = limit.maximum.map_or(needed, |most| most.min(needed));
    if limit.current.is_some_and(|current| current < possible) {
        let more = Rlimit { current: Some(possible), maximum: limit.maximum };
        setrlimit(Resource::Nofile, more).expect("it is below the hard limit");
    }
    let files = getrlimit(Resource::Nofile).current.unwrap_or(needed);
    let connections = wanted.min(files.saturating_sub(OTHER_FILES) / 2);
    if connections < wanted {
        eprintln!("{connections} connections instead of {wanted}: this process may have {files} files open");
    }
    connections
}

/// The first bytes of a station.
fn hello(host: &Host) -> Vec<u8> {
    let config = tls::client(host.identity.fingerprint()).expect("a client");
    let mut tls = ClientConnection::new(config, tls::name()).expect("a client");
    let mut bytes = Vec::new();
    tls.write_tls(&mut bytes).expect("memory");
    bytes
}

/// Connects while the host takes connections.
fn strangers(host: &mut Host, clock: &Clock, count: u64) -> Vec<TcpStream> {
    let mut strangers = Vec::new();
    for _ in 0..count {
        strangers.push(TcpStream::connect(host.address).expect("the system takes it"));
        host.work(clock.now());
    }
    strangers
}

/// Processor time of one `work` of a host that works a thousand times a second \[µs\].
fn work_time(host: &mut Host, clock: &Clock) -> f64 {
    let used = || Duration::try_from(clock_gettime(ClockId::ThreadCPUTime)).expect("a span");
    let begun = used();
    for _ in 0..500 {
        host.work(clock.now());
        clock.jump(SimTime::from_millis(1));
    }
    (used() - begun).as_secs_f64() / 500.0 * 1e6
}

#[test]
fn a_thousand_slow_openers_do_not_keep_a_station_out() {
    let count = connections(1_000);
    let (clock, mut host) = (Clock::new(), Host::new());
    let alone = work_time(&mut host, &clock);
    let hello = hello(&host);
    let mut slow = strangers(&mut host, &clock, count);
    host.work(clock.now());
    let idle = work_time(&mut host, &clock);
    eprintln!(
        "at a thousand calls a second, one takes {alone:.1} µs alone and {idle:.1} µs with {} idle openers",
        host.streams.openers()
    );
    // A third says nothing, a third has said half a hello, a third says it byte by byte.
    for stranger in slow.iter_mut().skip(1).step_by(3) {
        stranger.write_all(&hello[..hello.len() / 2]).expect("writes");
    }
    let (mut said, mut next_byte) = (0, clock.now());
    let mut station = host.station(&[]);
    let begun = Instant::now();
    station.connect(clock.now());
    host.opened.clear();
    let stream = clock.wait("a stream", |now| {
        if now >= next_byte {
            for stranger in slow.iter_mut().skip(2).step_by(3) {
                stranger.write_all(&hello[said..=said]).expect("writes");
            }
            said += usize::from(said + 2 < hello.len());
            next_byte = now + SimTime::from_millis(5);
        }
        host.work(now);
        (station.work(now) == StreamState::Open).then(|| host.opened.pop()).flatten()
    });
    let mut read = Vec::new();
    assert_eq!(station.send(clock.now(), b"here"), Ok(4));
    clock.wait("bytes", |now| {
        host.work(now);
        host.streams.receive(stream, now, 10, &mut read).expect("it is open");
        (read == b"here").then_some(())
    });
    let joined = begun.elapsed();
    eprintln!("the station was in after {:.1} ms", joined.as_secs_f64() * 1e3);
    assert!(joined < Duration::from_secs(2), "{joined:?}");
    assert!(host.streams.counts().accepted > count);
    drop(slow);
}

#[test]
fn the_oldest_opener_makes_room_and_a_slow_one_is_dropped_in_time() {
    let beyond = 40;
    let count = connections(OPENERS_MAX as u64 + beyond);
    let most = getrlimit(Resource::Nofile).current.map_or(OPENERS_MAX, |files| files as usize / 4);
    let (clock, mut host) = (Clock::new(), Host::new());
    let slow = strangers(&mut host, &clock, count);
    clock.wait("all are taken", |now| {
        host.work(now);
        (host.streams.counts().accepted == count).then_some(())
    });
    let counts = host.streams.counts();
    assert!(host.streams.openers() <= most.min(OPENERS_MAX));
    assert_eq!(host.streams.openers() as u64 + counts.crowded_out + counts.too_slow, count);
    if count == OPENERS_MAX as u64 + beyond {
        assert_eq!((host.streams.openers(), counts.crowded_out), (OPENERS_MAX, beyond));
        let is_closed = |stranger: &TcpStream| {
            stranger.set_nonblocking(true).expect("a socket");
            !matches!((&mut &*stranger).read(&mut [0]), Err(error) if error.kind() == ErrorKind::WouldBlock)
        };
        assert!(slow[..beyond as usize].iter().all(is_closed), "the oldest");
        assert!(!slow[beyond as usize..].iter().any(is_closed), "the others");
    }
    clock.jump(OPENING_TIME_MAX);
    host.work(clock.now());
    assert_eq!(host.streams.openers(), 0);
    assert!(host.streams.counts().too_slow > 0);
}

#[test]
fn an_opener_that_goes_on_talking_has_no_more_time_than_a_silent_one() {
    let (clock, mut host) = (Clock::new(), Host::new());
    let hello = hello(&host);
    let mut stranger = strangers(&mut host, &clock, 1).remove(0);
    for byte in &hello[..20] {
        stranger.write_all(&[*byte]).expect("writes");
        clock.jump(SimTime::from_millis(200));
        host.work(clock.now());
        assert_eq!(host.streams.openers(), 1);
    }
    clock.jump(SimTime::from_millis(1_000));
    host.work(clock.now());
    assert_eq!((host.streams.openers(), host.streams.counts().too_slow), (0, 1));
}

#[test]
fn what_is_not_the_handshake_of_a_station_ends_at_once() {
    let mut random = SplitMix64::new(8);
    let noise: Vec<u8> = (0..4_000).flat_map(|_| random.next_u64().to_le_bytes()).collect();
    let (clock, mut host) = (Clock::new(), Host::new());
    let hello = hello(&host);
    let mut damaged = hello.clone();
    damaged[5] ^= 0x40;
    let mut other_protocol = hello.clone();
    let at = hello.windows(8).position(|part| part == b"trocar/1").expect("its protocol");
    other_protocol[at + 7] = b'9';
    let wrong: [&[u8]; 8] = [
        b"GET / HTTP/1.1\r\nHost: theatre\r\n\r\n",
        b"SSH-2.0-OpenSSH_9.6\r\n",
        &[0; 100],
        &noise,
        // A record of more bytes than TLS allows, and a message of 16 MiB.
        &[&[22, 3, 1, 0xFF, 0xFF][..], &noise].concat(),
        &[&[22, 3, 1, 0x40, 0, 1, 0xFF, 0xFF, 0xFF][..], &noise].concat(),
        &damaged,
        &other_protocol,
    ];
    for (number, bytes) in wrong.iter().enumerate() {
        let mut stranger = TcpStream::connect(host.address).expect("connects");
        stranger.set_read_timeout(Some(Duration::from_secs(60))).expect("a limit");
        // The host may close before all is written.
        let _ = stranger.write_all(bytes);
        clock.wait("an end", |now| {
            host.work(now);
            (host.streams.counts().failed == number as u64 + 1).then_some(())
        });
        let mut answer = Vec::new();
        let _ = stranger.read_to_end(&mut answer);
        // An alert at most; whose protocol is wrong alone has been answered before that is found.
        let most = if number + 1 == wrong.len() { 256 } else { 7 };
        assert!(answer.len() <= most, "{number}: {answer:?}");
    }
    assert_eq!((host.streams.openers(), host.streams.streams()), (0, 0));
    let mut station = host.station(&[]);
    host.meet(&clock, &mut station);
}

#[test]
fn openers_that_hang_up_in_the_middle_are_forgotten_at_once() {
    let (clock, mut host) = (Clock::new(), Host::new());
    let hello = hello(&host);
    let mut strangers = strangers(&mut host, &clock, 4);
    host.work(clock.now());
    strangers[0].shutdown(Shutdown::Write).expect("it is open");
    strangers[1].write_all(&hello[..hello.len() / 2]).expect("writes");
    strangers[1].shutdown(Shutdown::Write).expect("it is open");
    strangers[2].write_all(&hello).expect("writes");
    strangers[2].shutdown(Shutdown::Write).expect("it is open");
    clock.wait("three ends", |now| {
        host.work(now);
        (host.streams.openers() == 1).then_some(())
    });
    assert_eq!(host.streams.counts().failed, 3);
    drop(strangers);
    clock.wait("the last end", |now| {
        host.work(now);
        (host.streams.openers() == 0).then_some(())
    });
}

#[test]
fn a_stranger_makes_room_for_a_new_stream_and_who_is_known_does_not() {
    let count = connections(STREAMS_MAX as u64 + 2);
    if count < STREAMS_MAX as u64 + 2 {
        eprintln!("too few files for the streams of this test");
        return;
    }
    let (clock, mut host) = (Clock::new(), Host::new());
    let mut stations: Vec<TlsStationStream> = (0..STREAMS_MAX).map(|_| host.station(&[])).collect();
    let streams: Vec<_> = stations.iter_mut().map(|station| host.meet(&clock, station)).collect();
    for (number, stream) in streams.iter().enumerate() {
        if number != 7 {
            assert_eq!(host.streams.send(*stream, clock.now(), b"x"), Ok(1));
        }
    }
    let mut newest = host.station(&[]);
    let stream = host.meet(&clock, &mut newest);
    assert_eq!((host.streams.streams(), host.streams.counts().crowded_out), (STREAMS_MAX, 1));
    let told = host.streams.receive(streams[7], clock.now(), 10, &mut Vec::new()).expect_err("it made room");
    assert!(told.0.contains("room"), "{told:?}");
    let told = clock.wait("an end", |now| {
        host.work(now);
        stations[7].receive(now, 10, &mut Vec::new()).err()
    });
    assert_eq!(told.0, "the other side closed the stream");
    assert_eq!(host.streams.send(stream, clock.now(), b"x"), Ok(1));
    let mut late = host.station(&[]);
    late.connect(clock.now());
    let told = clock.wait("an end", |now| {
        host.work(now);
        late.work(now);
        late.receive(now, 10, &mut Vec::new()).err().filter(|told| !told.0.contains("not open"))
    });
    assert_eq!(told.0, "the other side closed the stream");
    assert_eq!((host.streams.streams(), host.streams.counts().no_room), (STREAMS_MAX, 1));
    host.streams.close(streams[0]);
    host.meet(&clock, &mut late);
}

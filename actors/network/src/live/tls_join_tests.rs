//! Whole joins: both machines of the control channel over real sockets.

use trocar_scene::SimTime;

use super::tls_station_stream::TlsStationStream;
use super::tls_testing::{Clock, Host};
use crate::control::session_testing::{Pair, TestSession, ticket, wish};
use crate::control::{ClientState, HostControl, StreamWish};
use crate::datagram::{DATAGRAM_MAX, Kind, Opener, Sealer, Side};
use crate::streams::{HostStreams, StationStream, StreamId, StreamState};

/// Bytes that one turn asks a stream for.
const PIECE: usize = 64 << 10;

/// A session and one station, with sockets between them.
struct Joined {
    clock: Clock,
    host: Host,
    station: TlsStationStream,
    stream: Option<StreamId>,
    pair: Pair,
}

impl Joined {
    fn new(entities: usize) -> Self {
        let host = Host::new();
        let pair = Pair::new(TestSession::new(entities), ticket(1), wish("Ana", &["left"]));
        Self { clock: Clock::new(), station: host.station(&[]), host, stream: None, pair }
    }

    /// One turn of the station's driver, and one of the host's.
    fn step(&mut self, now: SimTime) {
        self.pair.now = now;
        self.turn_station(now);
        self.turn_host(now);
    }

    fn turn_station(&mut self, now: SimTime) {
        match self.pair.client.poll(now).stream {
            StreamWish::Keep => {}
            StreamWish::None | StreamWish::Over => self.station.close(),
            StreamWish::Connect => self.station.connect(now),
        }
        match self.station.work(now) {
            StreamState::None | StreamState::Connecting => return,
            StreamState::Closed(why) => {
                self.pair.client.broke(&why, now);
                return;
            }
            StreamState::Open if self.pair.client.state() == ClientState::Connecting => {
                self.pair.client.connected(self.pair.held, now).expect("it asked for a stream");
            }
            StreamState::Open => {}
        }
        let mut bytes = Vec::new();
        match self.station.receive(now, PIECE, &mut bytes) {
            Ok(()) => self.pair.deliver(&bytes),
            Err(closed) => self.pair.client.broke(&closed.0, now),
        }
        self.pair.client.poll(now);
        if let Ok(taken) = self.station.send(now, self.pair.client.outgoing()) {
            self.pair.client.advance(taken, now);
        }
    }

    fn turn_host(&mut self, now: SimTime) {
        self.host.work(now);
        for stream in std::mem::take(&mut self.host.opened) {
            self.drop_stream("another one came", now);
            self.pair.host = Some(HostControl::new(self.pair.facts.clone(), now));
            self.stream = Some(stream);
            self.pair.connections += 1;
        }
        let (Some(stream), Some(host)) = (self.stream, &mut self.pair.host) else { return };
        let mut bytes = Vec::new();
        if let Err(closed) = self.host.streams.receive(stream, now, PIECE, &mut bytes) {
            return self.drop_stream(&closed.0, now);
        }
        host.receive(&bytes, now, &mut self.pair.session);
        host.poll(now);
        if let Ok(taken) = self.host.streams.send(stream, now, host.outgoing()) {
            host.advance(taken, now);
        }
        if host.poll(now).is_over {
            self.drop_stream("it is over", now);
        }
    }

    /// The host's end of a connection is over.
    fn drop_stream(&mut self, why: &str, now: SimTime) {
        if let Some(stream) = self.stream.take() {
            self.host.streams.close(stream);
        }
        if let Some(mut host) = self.pair.host.take() {
            host.broke(why, now);
            self.pair.host_errors.extend(host.error().cloned());
            if let Some(admitted) = host.admitted() {
                self.pair.session.roster.break_off(admitted.station, admitted.connection, now);
            }
        }
    }

    fn run_until(&mut self, what: &str, is_done: impl Fn(&Self) -> bool) {
        // The clock is lent out while the rest works.
        let clock = std::mem::replace(&mut self.clock, Clock::new());
        clock.wait(what, |now| {
            self.step(now);
            is_done(self).then_some(())
        });
        self.clock = clock;
    }

    fn connection(&self) -> u32 {
        self.pair.client.welcome().expect("a welcome").connection
    }
}

#[test]
fn a_station_joins_with_a_scene_of_megabytes_and_both_ends_seal_datagrams() {
    let mut joined = Joined::new(1 << 20);
    let begun = std::time::Instant::now();
    joined.run_until("a join", |joined| joined.pair.is_running());
    let seconds = begun.elapsed().as_secs_f64();
    eprintln!("a join with {} bytes of scene took {:.1} ms", joined.pair.scene.len(), seconds * 1e3);
    assert!(joined.pair.scene == joined.pair.session.scene);
    assert_eq!((joined.pair.connections, joined.pair.session.redeemed), (1, 1));
    // Changes, rows, and keys of the connection that the welcome names.
    let now = joined.clock.now();
    joined.pair.host().send_delta(&[1, 2, 3], now).expect("it runs");
    joined.pair.client.write(&[9, 9], now).expect("it runs");
    joined.run_until("messages", |joined| {
        joined.pair.deltas == [1, 2, 3] && joined.pair.session.written == [9, 9]
    });
    let (connection, stream) = (joined.connection(), joined.stream.expect("a stream"));
    let ours = joined.station.keys(connection, 0).expect("keys").split(Side::Client);
    let theirs = joined.host.streams.keys(stream, connection, 0).expect("keys").split(Side::Server);
    let grace = SimTime::from_millis(100);
    for (send, receive) in [(ours.0, theirs.1), (theirs.0, ours.1)] {
        let (mut sealer, mut opener) = (Sealer::new(send), Opener::new(receive, grace));
        let mut out = [0; DATAGRAM_MAX];
        let length = sealer.seal(Kind::Rows, 0, now, b"rows", &mut out).expect("it fits");
        let (header, payload) = opener.open(now, &mut out[..length]).expect("the keys fit");
        assert_eq!((header.connection, payload), (connection, &b"rows"[..]));
    }
    // The station leaves with a word.
    let now = joined.clock.now();
    joined.pair.client.leave(now);
    joined.run_until("the end", |joined| !joined.pair.host_errors.is_empty());
    let told = joined.pair.host_errors[0].to_string();
    assert!(matches!(joined.pair.host_errors[0], crate::control::ControlError::Goodbye(_)), "{told}");
}

#[test]
fn a_station_whose_stream_breaks_comes_back_with_what_it_has() {
    let mut joined = Joined::new(10_000);
    joined.run_until("a join", |joined| joined.pair.is_running());
    let first = joined.connection();
    let now = joined.clock.now();
    joined.pair.session.grow(500);
    joined.drop_stream("a cable was pulled", now);
    joined.run_until("a second join", |joined| joined.pair.is_running() && joined.pair.connections == 2);
    assert!(joined.pair.scene == joined.pair.session.scene);
    assert_ne!(joined.connection(), first);
    assert_eq!(joined.pair.session.redeemed, 1, "it comes back with its secret");
}

#[test]
fn a_station_that_is_refused_hears_why_over_the_wire() {
    let mut joined = Joined::new(10);
    joined.pair.session.tickets.clear();
    joined.run_until("an end", |joined| joined.pair.client.state() == ClientState::Ended);
    let error = joined.pair.client.error().expect("an error").clone();
    assert!(matches!(error, crate::control::ControlError::Refused { .. }), "{error}");
}

//! Tests of faulty links: each kind at its target alone, in both directions.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Arc, Mutex};

use trocar_kernel::spec::{FaultKind, FaultOrder, FaultSink};
use trocar_scene::SimTime;

use super::board::LinkBoard;
use super::hands::FaultyHands;
use super::streams::{FaultyHostStreams, FaultyStationStream};
use crate::datagram::{DATAGRAM_MAX, Header, Keys, Kind, Sealer, Side};
use crate::hands_link::HandsLink;
use crate::impairments::Impairments;
use crate::lockstep::{Wire, WireHostStreams, WireStationStream, Wires};
use crate::streams::{HostStreams, StationStream, StreamId, StreamState};

const MS: fn(u64) -> SimTime = SimTime::from_millis;

fn order(target: &str, kind: FaultKind, begins: bool) -> FaultOrder {
    let template = Impairments { loss: 1.0, ..Impairments::default() }.orders(5).remove(0);
    FaultOrder { target: target.to_owned(), kind, begins, span: MS(50), ..template }
}

fn datagram(connection: u32) -> Vec<u8> {
    let mut out = [0; DATAGRAM_MAX];
    let mut sealer = Sealer::new(Keys::unprotected(connection, 0).split(Side::Client).0);
    let length = sealer.seal(Kind::RowAcks, 0, MS(0), b"acks", &mut out).expect("sealed");
    out[..length].to_vec()
}

/// A link of the connections 7 and 8 that sends a datagram over each at every tick.
struct Chatty(Arc<Mutex<Vec<u32>>>);

impl HandsLink<char> for Chatty {
    fn receive(&mut self, _: SimTime, _: char, bytes: &mut [u8], _: &mut dyn FnMut(char, &[u8]) -> bool) {
        let connection = Header::decode(bytes).expect("a header").connection;
        self.0.lock().expect("one thread").push(connection);
    }
    fn tick(&mut self, _: SimTime, send: &mut dyn FnMut(char, &[u8]) -> bool) {
        assert!(send('a', &datagram(7)) && send('b', &datagram(8)));
    }
    fn is_idle(&self) -> bool {
        false
    }
}

/// What has come in and gone out, by connection, from one millisecond to another.
fn chat(hands: &mut FaultyHands<char>, came: &Mutex<Vec<u32>>, span: std::ops::Range<u64>) -> [usize; 4] {
    came.lock().expect("one thread").clear();
    let mut went = Vec::new();
    for ms in span {
        let mut send = |_: char, bytes: &[u8]| {
            went.push(Header::decode(bytes).expect("a header").connection);
            true
        };
        for connection in [7, 8] {
            hands.receive(MS(ms), 'x', &mut datagram(connection), &mut send);
        }
        hands.tick(MS(ms), &mut send);
    }
    let came = came.lock().expect("one thread");
    let count = |list: &[u32], of: u32| list.iter().filter(|connection| **connection == of).count();
    [count(&came, 7), count(&went, 7), count(&came, 8), count(&went, 8)]
}

#[test]
fn a_fault_strikes_the_datagrams_of_its_station_in_both_directions_and_no_others() {
    let board = Arc::new(LinkBoard::host());
    let came = Arc::new(Mutex::new(Vec::new()));
    let mut hands = FaultyHands::new(Box::new(Chatty(came.clone())), board.clone());
    board.admit(7, 1, "Ana");
    board.admit(8, 2, "Bo");
    assert_eq!(chat(&mut hands, &came, 0..100), [100; 4]);
    assert_eq!(board.is_target_sound("link.Ana"), Some(true));
    board.fault(&order("link.Ana", FaultKind::Partition, true));
    // The order is seen at a tick: one datagram came before it.
    assert_eq!(chat(&mut hands, &came, 100..300), [1, 0, 200, 200]);
    assert_eq!(
        (board.is_target_sound("link.1"), board.is_target_sound("link.Bo")),
        (Some(false), Some(true))
    );
    board.fault(&order("link.Ana", FaultKind::Partition, false));
    assert_eq!(chat(&mut hands, &came, 300..400), [99, 100, 100, 100]);
    board.fault(&order("link.2", FaultKind::Delay, true));
    assert_eq!(chat(&mut hands, &came, 400..500), [100, 100, 50, 50]);
    assert_eq!(board.is_target_sound("link.Cy"), None, "nobody of that name is there");
}

#[test]
fn a_station_that_comes_during_a_fault_meets_it_too() {
    let board = Arc::new(LinkBoard::host());
    let came = Arc::new(Mutex::new(Vec::new()));
    let mut hands = FaultyHands::new(Box::new(Chatty(came.clone())), board.clone());
    board.fault(&order("link.Ana", FaultKind::Partition, true));
    board.admit(7, 1, "Ana");
    let [came_of_ana, went_of_ana, ..] = chat(&mut hands, &came, 0..100);
    assert_eq!((came_of_ana, went_of_ana), (1, 0));
}

/// A host's stream and a station's, which are one, open.
struct Pair {
    host: FaultyHostStreams,
    station: FaultyStationStream<usize>,
    stream: StreamId,
    now: SimTime,
}

impl Pair {
    fn new(host: &Arc<LinkBoard>, station: &Arc<LinkBoard>) -> Self {
        let wires = Wires::default();
        let wire = Wire::new(&Impairments::default(), 1);
        wires.add(wire.clone());
        let mut host = FaultyHostStreams::new(Box::new(WireHostStreams::new(wires)), host.clone());
        let inner = Box::new(WireStationStream::new(wire, 0, SimTime::ZERO));
        let mut station = FaultyStationStream::new(inner, station.clone());
        station.connect(MS(0));
        assert_eq!(station.work(MS(0)), StreamState::Open);
        let mut opened = Vec::new();
        host.work(MS(0), &mut opened);
        host.admitted(opened[0], 7, 1, "Ana");
        Self { host, station, stream: opened[0], now: MS(0) }
    }

    /// Sends a byte each way every millisecond for so long; returns what came at the host and at the station.
    fn chat(&mut self, millis: u64) -> (Vec<u8>, Vec<u8>) {
        let (mut at_host, mut at_station) = (Vec::new(), Vec::new());
        for _ in 0..millis {
            self.now += MS(1);
            let byte = [(self.now.as_nanos() / 1_000_000) as u8];
            self.host.work(self.now, &mut Vec::new());
            assert_eq!(self.station.work(self.now), StreamState::Open);
            assert_eq!(self.host.send(self.stream, self.now, &byte), Ok(1));
            assert_eq!(self.station.send(self.now, &byte), Ok(1));
            self.host.receive(self.stream, self.now, 1 << 16, &mut at_host).expect("it is open");
            self.station.receive(self.now, 1 << 16, &mut at_station).expect("it is open");
        }
        (at_host, at_station)
    }
}

#[test]
fn a_stream_stands_still_during_a_partition_and_everything_comes_in_order_after_it() {
    let boards = [Arc::new(LinkBoard::host()), Arc::new(LinkBoard::station())];
    for (board, target) in boards.iter().zip(["link.Ana", "link"]) {
        let mut pair = Pair::new(&boards[0], &boards[1]);
        let (mut at_host, mut at_station) = pair.chat(100);
        board.fault(&order(target, FaultKind::Partition, true));
        let (host, station) = pair.chat(500);
        assert!(host.len() <= 2 && station.len() <= 2, "{target}: {host:?}, {station:?}");
        at_host.extend(host);
        at_station.extend(station);
        board.fault(&order(target, FaultKind::Partition, false));
        let (host, station) = pair.chat(500);
        at_host.extend(host);
        at_station.extend(station);
        for came in [at_host, at_station] {
            assert!(came.len() >= 1_090, "{target}: {} of 1,100", came.len());
            assert!(came.iter().zip(1_u64..).all(|(byte, ms)| *byte == ms as u8), "{target}: in order");
        }
    }
}

#[test]
fn a_link_that_is_killed_ends_once_and_the_next_connection_lives() {
    let boards = [Arc::new(LinkBoard::host()), Arc::new(LinkBoard::station())];
    let mut pair = Pair::new(&boards[0], &boards[1]);
    pair.chat(10);
    boards[0].fault(&order("link.Ana", FaultKind::Kill, true));
    pair.host.work(MS(20), &mut Vec::new());
    let closed = pair.host.receive(pair.stream, MS(20), 100, &mut Vec::new()).expect_err("it is cut");
    assert!(closed.0.contains("fault"), "{closed:?}");
    let mut pair = Pair::new(&boards[0], &boards[1]);
    assert_eq!(pair.chat(10).0.len(), 10);
    boards[1].fault(&order("link", FaultKind::Kill, true));
    assert!(matches!(pair.station.work(MS(20)), StreamState::Closed(_)));
    pair.station.connect(MS(30));
    assert_eq!(pair.station.work(MS(30)), StreamState::Open);
}

#[test]
fn a_link_that_was_cut_is_sound_once_its_station_has_come_back_and_was_heard() {
    for target in ["link.Ana", "links"] {
        let board = Arc::new(LinkBoard::host());
        let came = Arc::new(Mutex::new(Vec::new()));
        let mut hands = FaultyHands::new(Box::new(Chatty(came.clone())), board.clone());
        board.admit(7, 1, "Ana");
        board.admit(8, 2, "Bo");
        chat(&mut hands, &came, 0..50);
        let sound = || [board.is_target_sound("link.Ana"), board.is_target_sound("link.Bo")];
        assert_eq!(sound(), [Some(true); 2]);
        board.fault(&order(target, FaultKind::Kill, true));
        // Datagrams come for a while after the stream was cut.
        chat(&mut hands, &came, 50..60);
        let others = Some(target != "links");
        assert_eq!((sound(), board.is_sound()), ([Some(false), others], Some(false)), "{target}");
        board.admit(7, 1, "Ana");
        board.admit(8, 2, "Bo");
        assert_eq!(sound(), [Some(false); 2], "nothing was heard yet");
        chat(&mut hands, &came, 60..70);
        assert_eq!((sound(), board.is_sound()), ([Some(true); 2], Some(true)), "{target}");
    }
}

#[test]
fn a_network_that_is_killed_dies_at_work_and_once() {
    let boards = [Arc::new(LinkBoard::host()), Arc::new(LinkBoard::station())];
    let mut pair = Pair::new(&boards[0], &boards[1]);
    boards[0].fault(&order("links", FaultKind::Kill, true));
    let died = catch_unwind(AssertUnwindSafe(|| pair.host.work(MS(1), &mut Vec::new())));
    assert!(died.is_err());
    pair.host.work(MS(2), &mut Vec::new());
}

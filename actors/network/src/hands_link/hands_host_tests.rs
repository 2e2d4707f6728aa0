//! Tests of a host's hands link with a station whose address changes, one at rest behind a router, and strangers.

use std::collections::VecDeque;

use trocar_devices::{VirtualHand, VirtualHandConfig};
use trocar_scene::SimTime;
use trocar_scene::random::SplitMix64;

use super::*;
use crate::datagram::{HEADER_BYTES, Keys, Kind, Side};
use crate::hands_link::hands_channel;
use crate::haptic::SenderConfig;
use crate::remote_hand::{DoorLimits, RemoteHand};

const MS: fn(u64) -> SimTime = SimTime::from_millis;
/// Number of the connection.
const ID: u32 = 7;
/// Where the station is.
const STATION: char = 's';
/// Time after which a router forgets who sent through it.
const ROUTER_FORGETS: SimTime = SimTime::from_millis(30_000);

fn keys() -> Keys {
    let made = Keys::from_exporter(ID, 0, |_, _, out: &mut [u8]| {
        out.iter_mut().zip(0_u8..).for_each(|(byte, number)| *byte = number);
        Ok::<(), ()>(())
    });
    made.expect("keys")
}

fn end(side: Side, hands: &[u8]) -> Connection<char> {
    Connection::new(ID, keys(), side, hands, &SenderConfig::default(), 3).expect("a hand")
}

fn hand(x: f64) -> HandSample {
    let mut sample = HandSample::unknown(0);
    sample.state.connected = true;
    sample.state.pose_in_device.translation.vector.x = x;
    sample
}

/// A host with a station that serves a hand, and a path between them.
struct Bench {
    now: SimTime,
    host: HandsHost<char>,
    station: Connection<char>,
    /// Where the station sends from.
    address: char,
    delay: SimTime,
    to_host: VecDeque<(SimTime, char, Vec<u8>)>,
    to_station: VecDeque<(SimTime, char, Vec<u8>)>,
    /// Datagrams of the station, and those that the host sent to anybody else.
    sent: u64,
    to_others: u64,
    /// When each end heard the other one last, and the longest silence since the first word.
    heard: [Option<SimTime>; 2],
    silence_max: [SimTime; 2],
}

impl Bench {
    fn new(delay: SimTime) -> Self {
        let local = Box::new(VirtualHand::new(VirtualHandConfig::default()).expect("a hand"));
        let (_, hand_end) = RemoteHand::over(0, DoorLimits::default(), local).expect("valid limits");
        let (controller, link) = hands_channel();
        let mut host = HandsHost::new(vec![HostHand { number: 0, end: hand_end, playout: None }], link);
        let connection = Box::new(end(Side::Server, &[]));
        assert!(controller.order(HandsOrder::Open { station: 1, connection, peer: None }));
        assert!(controller.order(HandsOrder::Serve { connection: ID, hands: HandNumbers::new([0]) }));
        host.tick(SimTime::ZERO, &mut |_, _| panic!("nobody is known yet"));
        Self {
            now: SimTime::ZERO,
            host,
            station: end(Side::Client, &[0]),
            address: STATION,
            delay,
            to_host: VecDeque::new(),
            to_station: VecDeque::new(),
            sent: 0,
            to_others: 0,
            heard: [None; 2],
            silence_max: [SimTime::ZERO; 2],
        }
    }

    /// A millisecond: what is due arrives, and both ends send what they have to, of a hand that is there.
    fn step(&mut self, x: f64) {
        self.now += MS(1);
        let Self { now, host, station, address, to_host, to_station, delay, to_others, .. } = self;
        let now = *now;
        let mut heard = [false; 2];
        let mut send = |to: char, bytes: &[u8]| {
            *to_others += u64::from(to != *address);
            to_station.push_back((now + *delay, to, bytes.to_vec()));
            true
        };
        while to_host.front().is_some_and(|(due, ..)| *due <= now) {
            let Some((_, from, mut bytes)) = to_host.pop_front() else { break };
            host.receive(now, from, &mut bytes, &mut send);
            heard[0] = true;
        }
        host.tick(now, &mut send);
        let mut out = [0; DATAGRAM_MAX];
        let mut post = |from: char, bytes: &[u8]| to_host.push_back((now + *delay, from, bytes.to_vec()));
        while to_station.front().is_some_and(|(due, ..)| *due <= now) {
            let Some((_, to, mut bytes)) = to_station.pop_front() else { break };
            if to != *address {
                continue;
            }
            let (_, reply) = station.receive(now, 'h', &mut bytes).expect("the host sealed it");
            heard[1] = true;
            if let Some(reply) = reply
                && let Some(length) = station.seal(reply.kind, &reply.payload, now, &mut out)
            {
                self.sent += 1;
                post(*address, &out[..length]);
            }
        }
        if let Some(length) = station.tick(&[hand(x)], now, &mut out) {
            station.sent(&[hand(x)], length, true, now);
            self.sent += 1;
            post(*address, &out[..length]);
        }
        for (end, _) in heard.iter().enumerate().filter(|(_, heard)| **heard) {
            let silence = self.heard[end].map_or(SimTime::ZERO, |before| now.since(before));
            self.silence_max[end] = self.silence_max[end].max(silence);
            self.heard[end] = Some(now);
        }
    }

    fn opened(&self) -> u64 {
        self.host.links[0].connection.opener().counts().opened
    }
}

/// What a stranger may send: nonsense, headers of this connection and of others with numbers far ahead, a copy of what the
/// station sent with a bit that is another one.
fn of_a_stranger(number: u64, copy: &[u8], random: &mut SplitMix64) -> Vec<u8> {
    let mut bytes: Vec<u8> = (0..random.below(300)).map(|_| random.next_u64() as u8).collect();
    let kind = Kind::ALL[random.below(Kind::ALL.len() as u64) as usize];
    let connection = if number.is_multiple_of(2) { ID } else { random.next_u64() as u32 };
    let sequence = (1 << 40) + number;
    let header = Header { kind, phase: 0, hands: 0, connection, sequence, sent_at: SimTime(number) }.encode();
    match number % 4 {
        0 | 1 => {
            bytes.resize(bytes.len().max(HEADER_BYTES), 0);
            bytes[..HEADER_BYTES].copy_from_slice(&header);
        }
        2 if !copy.is_empty() => {
            bytes = copy.to_vec();
            let bit = random.below(8 * bytes.len() as u64) as usize;
            bytes[bit / 8] ^= 1 << (bit % 8);
        }
        _ => {}
    }
    bytes
}

#[test]
fn a_flood_of_strangers_gets_no_byte_back_and_costs_a_station_nothing() {
    let (mut bench, mut random) = (Bench::new(MS(5)), SplitMix64::new(22));
    let (mut copy, mut number) = (Vec::new(), 0);
    for ms in 0..1_000_u64 {
        if let Some((_, _, bytes)) = bench.to_host.back() {
            copy.clone_from(bytes);
        }
        bench.step(0.02 * (ms as f64 * 6e-3).sin());
        for stranger in 0..100_u32 {
            number += 1;
            let mut bytes = of_a_stranger(number, &copy, &mut random);
            let from = char::from_u32(0x4e00 + stranger).expect("a letter");
            let mut send = |_: char, _: &[u8]| panic!("an answer to a stranger");
            bench.host.receive(bench.now, from, &mut bytes, &mut send);
        }
    }
    for _ in 0..20 {
        bench.step(0.0);
    }
    let strangers = *bench.host.strangers();
    assert_eq!(strangers.unknown + strangers.refused, 100_000, "each is counted");
    assert!(strangers.refused > 25_000, "{strangers:?}");
    assert_eq!(bench.to_others, 0);
    // What was sent in the last milliseconds is under way.
    let under_way = bench.to_host.len() as u64;
    assert_eq!(bench.opened(), bench.sent - under_way, "all of the station has come");
    assert!(bench.sent > 200 && bench.silence_max[0] <= MS(25), "{} {}", bench.sent, bench.silence_max[0]);
}

#[test]
fn after_a_change_of_address_a_station_hears_its_host_again_within_two_round_trips() {
    for (way, most) in [(20, 200), (75, 350)] {
        let mut bench = Bench::new(MS(way));
        for ms in 0..2_000_u64 {
            bench.step(1e-5 * ms as f64);
        }
        assert_eq!(bench.host.links[0].connection.address(), Some(STATION));
        (bench.address, bench.to_others) = ('n', 0);
        bench.silence_max = [SimTime::ZERO; 2];
        for ms in 2_000..3_000_u64 {
            bench.step(1e-5 * ms as f64);
        }
        let [of_host, of_station] = bench.silence_max;
        println!("{way} ms each way: the station heard nothing for {of_station}");
        assert!(of_host <= MS(25), "its hand comes from everywhere: {of_host}");
        assert!(of_station <= MS(most), "{of_station}");
        assert_eq!(bench.host.links[0].connection.address(), Some('n'));
        assert!(bench.opened() >= bench.sent - 2 * way, "none is lost");
    }
}

#[test]
fn a_hand_that_rests_for_forty_seconds_keeps_a_router_that_forgets_after_thirty() {
    let mut bench = Bench::new(MS(20));
    for _ in 0..40_000 {
        bench.step(0.01);
    }
    assert!(bench.silence_max.iter().all(|silence| *silence <= MS(100) && *silence < ROUTER_FORGETS));
    assert_eq!(bench.host.links[0].connection.address(), Some(STATION));
    assert!(bench.sent < 40 * 70, "{} datagrams: it rests", bench.sent);
}

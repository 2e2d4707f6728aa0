//! The round trip through the hands links of a station and its host, beside that of bare datagrams of the same length.
//!
//! The host answers a path challenge at once, as an echo does: sealed, opened and looked at like any datagram of hands, on
//! the thread of the hands link. Beside it stands the round trip of hands themselves, by four time stamps and without the time
//! for which the host holds a sample until its next tick. Each way of it wakes a thread that has slept for long, where an echo
//! comes back to one that has only just gone to sleep.

use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use trocar::network::datagram::{DATAGRAM_MAX, HEADER_BYTES, Hands, Kind, Opener, Sealer, Side, TAG_BYTES};
use trocar::network::hands_link::{CHALLENGE_BYTES, HandsLink};
use trocar::network::haptic::{Rate, SenderConfig};
use trocar::network::live::hands_thread::HandsThread;
use trocar::network::live::sockets;
use trocar::summary::{BenchResult, Better};
use trocar_kernel::bench::median_and_spread;
use trocar_kernel::runtime::{AtomicHistogram, Clock};
use trocar_scene::SimTime;

use super::Rows;
use super::link::{LiveHost, connection_of, first_hand, hands_at, keys};
use super::raw::{RawEcho, round_trips};
use super::veth::Place;
use crate::failure::Failure;

/// Length of a block, and how many there are of each kind.
const SPAN: Duration = Duration::from_millis(2_500);
const BLOCKS: usize = 5;
/// Bar on the ratio to the floor.
const RATIO_MAX: f64 = 1.2;
/// Bytes of a challenge, and of the answer.
const BYTES: usize = HEADER_BYTES + CHALLENGE_BYTES + TAG_BYTES;

/// What a station sends at every tick.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Question {
    /// A challenge, which is answered at once.
    Challenge,
    /// Its hands.
    Hands,
}

/// A station that asks at every tick, and measures.
struct Asker {
    question: Question,
    host: SocketAddr,
    sealer: Sealer,
    opener: Opener,
    hands: Hands,
    /// When the newest question was sent, and the newest that was answered.
    asked_at: SimTime,
    answered: SimTime,
    round_trips: Arc<AtomicHistogram>,
    out: [u8; DATAGRAM_MAX],
}

impl Asker {
    /// The round trip that a datagram tells, for the first time.
    fn told(&mut self, now: SimTime, datagram: &mut [u8]) -> Option<SimTime> {
        let (header, payload) = self.opener.open(now, datagram).ok()?;
        let (sent_at, held) = match (self.question, header.kind) {
            (Question::Hands, Kind::Hands) => {
                self.hands.decode(header.hands, payload).ok()?;
                let echo = self.hands.echo()?;
                (echo.sent_at, echo.held)
            }
            (Question::Challenge, Kind::PathResponse) => {
                (SimTime(u64::from_le_bytes(payload.try_into().ok()?)), SimTime::ZERO)
            }
            _ => return None,
        };
        if sent_at <= self.answered || sent_at > self.asked_at {
            return None;
        }
        self.answered = sent_at;
        Some(now.since(sent_at).since(held))
    }
}

impl HandsLink<SocketAddr> for Asker {
    fn receive(
        &mut self,
        now: SimTime,
        _: SocketAddr,
        datagram: &mut [u8],
        _: &mut dyn FnMut(SocketAddr, &[u8]) -> bool,
    ) {
        if let Some(round_trip) = self.told(now, datagram) {
            self.round_trips.record(round_trip.as_nanos());
        }
    }

    fn tick(&mut self, now: SimTime, send: &mut dyn FnMut(SocketAddr, &[u8]) -> bool) {
        self.asked_at = now;
        let Self { question, sealer, out, .. } = self;
        let sealed = match question {
            Question::Hands => sealer.seal_hands(now, None, &hands_at(first_hand(0), now), out),
            Question::Challenge => {
                sealer.seal(Kind::PathChallenge, 0, now, &now.as_nanos().to_le_bytes(), out)
            }
        };
        if let Ok(length) = sealed {
            send(self.host, &self.out[..length]);
        }
    }

    fn is_idle(&self) -> bool {
        false
    }
}

/// Round trips through both hands links \[ns\].
pub(super) fn through_links(
    place: &Place,
    question: Question,
    span: Duration,
) -> Result<Arc<AtomicHistogram>, Failure> {
    let clock = Clock::start();
    let config = match question {
        Question::Hands => SenderConfig { top: Rate::Hz1000, deadband: None },
        // The host has nothing to tell meanwhile.
        Question::Challenge => SenderConfig::default(),
    };
    let (at_host, host) = place.host()?;
    let running = LiveHost::start(1, &config, at_host.udp, &clock, 0.0)?;
    let (send, receive) = keys(connection_of(0)).split(Side::Client);
    let measured = Arc::new(AtomicHistogram::default());
    let asker = Asker {
        question,
        host,
        sealer: Sealer::new(send),
        opener: Opener::new(receive, SimTime::ZERO),
        hands: Hands::default(),
        asked_at: SimTime::ZERO,
        answered: SimTime::ZERO,
        round_trips: measured.clone(),
        out: [0; DATAGRAM_MAX],
    };
    let socket = sockets::station(&host).map_err(Failure::internal)?;
    let station = HandsThread::spawn(socket, Box::new(asker), clock).map_err(Failure::internal)?;
    std::thread::sleep(span);
    drop(station);
    running.close()?;
    if measured.count() == 0 {
        return Err(Failure::internal(format!("no answer came: {question:?}")));
    }
    Ok(measured)
}

/// Medians and 99th percentiles of the blocks \[µs\].
#[derive(Default)]
struct Blocks([Vec<f64>; 2]);

impl Blocks {
    fn note(&mut self, histogram: &AtomicHistogram) {
        let quantiles = histogram.quantiles();
        self.0[0].push(quantiles.p50);
        self.0[1].push(quantiles.p99);
    }
}

/// Round trips through hands links and of bare datagrams, in turns.
pub fn round_trip() -> Rows {
    let place = Place::new();
    let (mut bare, mut ours, mut hands) = (Blocks::default(), Blocks::default(), Blocks::default());
    for _ in 0..BLOCKS {
        let (sockets, address) = place.host()?;
        let echo = RawEcho::start(sockets.udp).map_err(Failure::internal)?;
        bare.note(&round_trips(address, BYTES, SPAN)?);
        drop(echo);
        ours.note(&*through_links(&place, Question::Challenge, SPAN)?);
        hands.note(&*through_links(&place, Question::Hands, SPAN)?);
    }
    let row = |what: &str, blocks: &Blocks, at: usize, bar| {
        let quantile = ["p50", "p99"][at];
        let name = format!("network_{what}_{quantile}_{}", place.name());
        let floor = median_and_spread(&bare.0[at]).0;
        BenchResult::on_ratio(name, "us", median_and_spread(&blocks.0[at]), floor, bar, Better::Lower)
    };
    Ok(vec![
        row("round_trip", &ours, 0, None),
        row("round_trip", &ours, 1, Some(RATIO_MAX)),
        row("round_trip_of_hands", &hands, 0, None),
        row("round_trip_of_hands", &hands, 1, None),
    ])
}

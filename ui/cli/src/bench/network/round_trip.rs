//! The round trip of hands beside that of bare datagrams: sealed and opened at both ends, without the time for which the
//! host holds a sample until its next tick.

use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use trocar::network::datagram::{
    DATAGRAM_MAX, HAND_BYTES, HEADER_BYTES, Hands, Opener, Sealer, Side, TAG_BYTES,
};
use trocar::network::hands_link::HandsLink;
use trocar::network::haptic::{Rate, SenderConfig};
use trocar::network::live::hands_thread::HandsThread;
use trocar::network::live::sockets;
use trocar::summary::{BenchResult, Better};
use trocar_kernel::bench::median_and_spread;
use trocar_kernel::runtime::{AtomicHistogram, Clock};
use trocar_scene::SimTime;

use super::Rows;
use super::link::{HANDS, LiveHost, connection_of, first_hand, hands_at, keys};
use super::raw::{RawEcho, round_trips};
use super::veth::Place;
use crate::failure::Failure;

/// Length of a block, and how many there are of each kind.
const SPAN: Duration = Duration::from_millis(2_500);
const BLOCKS: usize = 5;
/// Bar on the ratio to the floor.
const RATIO_MAX: f64 = 1.2;
/// Bytes of a clock echo in a payload.
const ECHO_BYTES: usize = 12;
/// Bytes of a datagram of two hands.
const BYTES: usize = HEADER_BYTES + ECHO_BYTES + HANDS * HAND_BYTES + TAG_BYTES;

/// A station that sends its hands at every tick, and measures.
struct Asker {
    host: SocketAddr,
    sealer: Sealer,
    opener: Opener,
    hands: Hands,
    newest: SimTime,
    round_trips: Arc<AtomicHistogram>,
    out: [u8; DATAGRAM_MAX],
}

impl HandsLink<SocketAddr> for Asker {
    fn receive(
        &mut self,
        now: SimTime,
        _: SocketAddr,
        datagram: &mut [u8],
        _: &mut dyn FnMut(SocketAddr, &[u8]) -> bool,
    ) {
        let Ok((header, payload)) = self.opener.open(now, datagram) else { return };
        if self.hands.decode(header.hands, payload).is_err() {
            return;
        }
        // The first echo of each of our datagrams is its round trip.
        if let Some(echo) = self.hands.echo().filter(|echo| echo.sent_at > self.newest) {
            self.newest = echo.sent_at;
            self.round_trips.record(now.since(echo.sent_at).since(echo.held).as_nanos());
        }
    }

    fn tick(&mut self, now: SimTime, send: &mut dyn FnMut(SocketAddr, &[u8]) -> bool) {
        let samples = hands_at(first_hand(0), now);
        if let Ok(length) = self.sealer.seal_hands(now, None, &samples, &mut self.out) {
            send(self.host, &self.out[..length]);
        }
    }

    fn is_idle(&self) -> bool {
        false
    }
}

pub(super) fn of_hands(place: &Place, span: Duration) -> Result<Arc<AtomicHistogram>, Failure> {
    let clock = Clock::start();
    let config = SenderConfig { top: Rate::Hz1000, deadband: None };
    let (at_host, host) = place.host()?;
    let running = LiveHost::start(1, &config, at_host.udp, &clock, 0.0)?;
    let (send, receive) = keys(connection_of(0)).split(Side::Client);
    let measured = Arc::new(AtomicHistogram::default());
    let asker = Asker {
        host,
        sealer: Sealer::new(send),
        opener: Opener::new(receive, SimTime::ZERO),
        hands: Hands::default(),
        newest: SimTime::ZERO,
        round_trips: measured.clone(),
        out: [0; DATAGRAM_MAX],
    };
    let socket = sockets::station(&host).map_err(Failure::internal)?;
    let station = HandsThread::spawn(socket, Box::new(asker), clock).map_err(Failure::internal)?;
    std::thread::sleep(span);
    drop(station);
    running.close()?;
    if measured.count() == 0 {
        return Err(Failure::internal("no hand came back"));
    }
    Ok(measured)
}

/// Round trips of hands and of bare datagrams in turns.
pub fn round_trip() -> Rows {
    let place = Place::new();
    let (mut ours, mut bare) = ([Vec::new(), Vec::new()], [Vec::new(), Vec::new()]);
    let note = |into: &mut [Vec<f64>; 2], histogram: &AtomicHistogram| {
        let quantiles = histogram.quantiles();
        into[0].push(quantiles.p50);
        into[1].push(quantiles.p99);
    };
    for _ in 0..BLOCKS {
        let (sockets, address) = place.host()?;
        let echo = RawEcho::start(sockets.udp).map_err(Failure::internal)?;
        note(&mut bare, &round_trips(address, BYTES, SPAN)?);
        drop(echo);
        note(&mut ours, &*of_hands(&place, SPAN)?);
    }
    let row = |quantile: &str, at: usize, bar| {
        let name = format!("network_round_trip_{quantile}_{}", place.name());
        let floor = median_and_spread(&bare[at]).0;
        BenchResult::on_ratio(name, "us", median_and_spread(&ours[at]), floor, bar, Better::Lower)
    };
    Ok(vec![row("p50", 0, None), row("p99", 1, Some(RATIO_MAX))])
}

//! A stranger's flood at the host's port: what is lost of a station's hands, and how late the hands of the host are, beside
//! the same flood at a port that nobody has to do with.

use std::net::{Ipv4Addr, SocketAddr, UdpSocket};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use trocar::network::datagram::{Header, Kind};
use trocar::network::haptic::{Rate, SenderConfig};
use trocar::network::live::sockets::HostSockets;
use trocar::summary::{BenchResult, Better};
use trocar_kernel::bench::{bare_rates, median_and_spread};
use trocar_kernel::runtime::Clock;
use trocar_scene::SimTime;

use super::Rows;
use super::link::{HANDS, LiveHost, connection_of};
use super::load::Load;
use crate::failure::Failure;

/// Datagrams of the flood a second, and in one go.
const FLOOD: f64 = 100_000.0;
const AT_ONCE: u32 = 50;
/// Bytes of one: as long as those of two hands.
const BYTES: usize = 252;
const WARM: Duration = Duration::from_millis(500);
const SPAN: Duration = Duration::from_millis(2_500);
const BLOCKS: usize = 5;
/// Bars on the flood itself, which else would show less than it should; on what is lost of a station's hands; and on the
/// lateness beside that with the flood elsewhere.
const FLOOD_MIN: f64 = 0.95 * FLOOD;
const LOST_MAX: f64 = 0.01;
const LATENESS_MAX: f64 = 2.0;

/// A stranger on a thread; dropping it ends the flood.
struct Flood {
    stop: Arc<AtomicBool>,
    sent: Arc<AtomicU64>,
    thread: Option<JoinHandle<()>>,
}

impl Flood {
    fn start(target: SocketAddr) -> Result<Self, Failure> {
        let socket = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).map_err(Failure::internal)?;
        let (stop, sent) = (Arc::new(AtomicBool::new(false)), Arc::new(AtomicU64::new(0)));
        let (ending, counting) = (stop.clone(), sent.clone());
        let thread = std::thread::Builder::new()
            .name("bench.flood".into())
            .spawn(move || flood_from(&socket, target, &ending, &counting))
            .map_err(Failure::internal)?;
        Ok(Self { stop, sent, thread: Some(thread) })
    }
}

impl Drop for Flood {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Release);
        if let Some(thread) = self.thread.take() {
            // Its panic was told by the panic hook.
            let _ = thread.join();
        }
    }
}

/// Half of it names no connection; the other half names that of the station, with a number far ahead and a seal that is
/// none, so that the host has to look at it.
fn flood_from(socket: &UdpSocket, target: SocketAddr, stop: &AtomicBool, sent: &AtomicU64) {
    let (begun, mut number) = (Instant::now(), 0_u64);
    let mut datagram = [0x5a; BYTES];
    while !stop.load(Ordering::Acquire) {
        let due = (begun.elapsed().as_secs_f64() * FLOOD) as u64;
        if number >= due {
            std::thread::sleep(Duration::from_micros(200));
            continue;
        }
        for _ in 0..AT_ONCE {
            number += 1;
            let connection = if number.is_multiple_of(2) { connection_of(0) } else { 0xdead_beef };
            let header = Header {
                kind: Kind::Hands,
                phase: 0,
                hands: HANDS as u8,
                connection,
                sequence: (1 << 40) + number,
                sent_at: SimTime::from_millis(number),
            };
            let header = header.encode();
            datagram[..header.len()].copy_from_slice(&header);
            if socket.send_to(&datagram, target).is_ok() {
                sent.fetch_add(1, Ordering::Relaxed);
            }
        }
    }
}

/// What one block has shown.
pub(super) struct Block {
    /// Share of the station's datagrams that did not reach its connection.
    pub lost: f64,
    /// Lateness of hands at 1 kHz beside it, p99 \[µs\].
    pub hands: f64,
    /// Lateness of the hands link, p99 \[µs\].
    pub link: f64,
    /// Datagrams of the flood a second.
    pub flood: f64,
}

pub(super) fn block(at_host: bool, span: Duration) -> Result<Block, Failure> {
    let config = SenderConfig { top: Rate::Hz1000, deadband: None };
    let clock = Clock::start();
    let here = Ipv4Addr::LOCALHOST;
    let sockets = HostSockets::bind(Some(here.into()), 0).map_err(Failure::internal)?;
    let address = SocketAddr::new(here.into(), sockets.port);
    let sink = UdpSocket::bind((here, 0)).map_err(Failure::internal)?;
    let elsewhere = sink.local_addr().map_err(Failure::internal)?;
    let host = LiveHost::start(1, &config, sockets.udp, &clock, 0.0)?;
    let load = Load::start(1, &config, address, &clock)?;
    let flood = Flood::start(if at_host { address } else { elsewhere })?;
    std::thread::sleep(WARM);
    let (begun, before) = (Instant::now(), flood.sent.load(Ordering::Relaxed));
    // Two hands of the host itself, each on the thread of its controller.
    let hands = bare_rates(HANDS, 1_000.0, span);
    let flooded = (flood.sent.load(Ordering::Relaxed) - before) as f64 / begun.elapsed().as_secs_f64();
    let link = host.watch.lateness.quantiles().p99;
    drop(flood);
    let counts = load.counts.clone();
    load.end();
    let closed = host.close()?;
    let sent = counts.sent.load(Ordering::Relaxed) as f64;
    let came: u64 = closed.iter().map(|connection| connection.receiver().counts().received).sum();
    Ok(Block {
        lost: (1.0 - came as f64 / sent.max(1.0)).max(0.0),
        hands: hands.lateness_us.p99,
        link,
        flood: flooded,
    })
}

/// All figures of a flood.
pub fn flood() -> Rows {
    let (mut beside, mut under) = (Vec::new(), Vec::new());
    for _ in 0..BLOCKS {
        beside.push(block(false, SPAN)?);
        under.push(block(true, SPAN)?);
    }
    let of = |blocks: &[Block], value: fn(&Block) -> f64| {
        median_and_spread(&blocks.iter().map(value).collect::<Vec<f64>>())
    };
    let ratio = |name: &str, value: fn(&Block) -> f64, bar| {
        BenchResult::on_ratio(name, "us", of(&under, value), of(&beside, value).0, bar, Better::Lower)
    };
    Ok(vec![
        BenchResult::on_value(
            "network_flood",
            "datagrams/s",
            of(&under, |block| block.flood),
            Some(FLOOD_MIN),
            Better::Higher,
        ),
        BenchResult::on_value(
            "network_lost_under_a_flood",
            "share",
            of(&under, |block| block.lost),
            Some(LOST_MAX),
            Better::Lower,
        ),
        ratio("network_hands_lateness_p99_under_a_flood", |block| block.hands, Some(LATENESS_MAX)),
        ratio("network_hands_link_lateness_p99_under_a_flood", |block| block.link, None),
    ])
}

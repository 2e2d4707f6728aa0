//! One host and 1, 4 and 16 stations with two hands each: what a hand costs the host, and how many bytes it takes.

use std::net::Ipv4Addr;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use trocar::network::haptic::{Rate, SenderConfig};
use trocar::network::live::sockets::HostSockets;
use trocar::summary::{BenchResult, Better};
use trocar_kernel::bench::median_and_spread;
use trocar_kernel::runtime::Clock;

use super::Rows;
use super::link::{HANDS, LiveHost};
use super::load::Load;
use crate::failure::Failure;

const STATIONS: [usize; 3] = [1, 4, 16];
/// Stations of which bytes are counted.
const COUNTED: usize = 4;
/// Time for everything to be warm, and length of a block.
const WARM: Duration = Duration::from_millis(700);
const SPAN: Duration = Duration::from_millis(2_500);
const BLOCKS: usize = 3;
/// Bars on what a hand costs among 16 stations beside one among 4, and on the share of datagrams that come.
const COST_MAX: f64 = 1.3;
const DELIVERED_MIN: f64 = 0.99;

/// What one block has shown.
pub(super) struct Block {
    /// CPU time of the host's thread for each hand \[ms per s\].
    pub cpu: f64,
    /// The same of the thread of all stations.
    pub load_cpu: f64,
    /// Share of the datagrams that came, of the worse direction.
    pub delivered: f64,
    /// Bytes that stations sent for each hand [B/s].
    pub bytes: f64,
}

/// Every hand at every tick.
pub(super) const ALL: SenderConfig = SenderConfig { top: Rate::Hz1000, deadband: None };

pub(super) fn block(stations: usize, config: &SenderConfig, span: Duration) -> Result<Block, Failure> {
    let clock = Clock::start();
    let sockets = HostSockets::bind(Some(Ipv4Addr::LOCALHOST.into()), 0).map_err(Failure::internal)?;
    let address = (Ipv4Addr::LOCALHOST, sockets.port).into();
    let host = LiveHost::start(stations, config, sockets.udp, &clock, 0.0)?;
    let load = Load::start(stations, config, address, &clock)?;
    std::thread::sleep(WARM);
    let look = || {
        let (came, went) = host.datagrams();
        let of = |count: &std::sync::atomic::AtomicU64| count.load(Ordering::Relaxed);
        let counts = &load.counts;
        (
            host.watch.cpu(),
            counts.cpu(),
            came,
            went,
            of(&counts.sent),
            of(&counts.received),
            of(&counts.bytes),
        )
    };
    let (begun, before) = (Instant::now(), look());
    std::thread::sleep(span);
    let (secs, after) = (begun.elapsed().as_secs_f64(), look());
    load.end();
    host.close()?;
    let hands = (stations * HANDS) as f64;
    let share = |came: u64, went: u64| came as f64 / (went as f64).max(1.0);
    let there = share(after.2 - before.2, after.4 - before.4);
    let back = share(after.5 - before.5, after.3 - before.3);
    Ok(Block {
        cpu: 1e3 * (after.0 - before.0).as_secs_f64() / secs / hands,
        load_cpu: 1e3 * (after.1 - before.1).as_secs_f64() / secs / hands,
        // What is under way at both looks moves a share by a few datagrams.
        delivered: there.min(back).min(1.0),
        bytes: (after.6 - before.6) as f64 / secs / hands,
    })
}

/// All figures of hands at one host.
pub fn stations() -> Rows {
    let mut blocks: Vec<Vec<Block>> = STATIONS.iter().map(|_| Vec::new()).collect();
    let mut saving = Vec::new();
    for _ in 0..BLOCKS {
        for (stations, blocks) in STATIONS.iter().zip(&mut blocks) {
            blocks.push(block(*stations, &ALL, SPAN)?);
        }
        saving.push(block(COUNTED, &SenderConfig::default(), SPAN)?);
    }
    let of = |blocks: &[Block], value: fn(&Block) -> f64| {
        median_and_spread(&blocks.iter().map(value).collect::<Vec<f64>>())
    };
    let mut rows = Vec::new();
    let cpu_at = |stations: usize| {
        let at = STATIONS.iter().position(|known| *known == stations);
        at.map_or((f64::NAN, 0.0), |at| of(&blocks[at], |block| block.cpu))
    };
    for (stations, blocks) in STATIONS.iter().zip(&blocks) {
        let name = format!("network_cpu_per_hand_{stations}_stations");
        let cpu = of(blocks, |block| block.cpu);
        rows.push(match stations {
            16 => BenchResult::on_ratio(name, "ms/s", cpu, cpu_at(4).0, Some(COST_MAX), Better::Lower),
            _ => BenchResult::on_value(name, "ms/s", cpu, None, Better::Lower),
        });
        let name = format!("network_load_cpu_per_hand_{stations}_stations");
        let load = of(blocks, |block| block.load_cpu);
        rows.push(BenchResult::on_value(name, "ms/s", load, None, Better::Lower));
        let name = format!("network_delivered_{stations}_stations");
        let delivered = of(blocks, |block| block.delivered);
        rows.push(BenchResult::on_value(name, "share", delivered, Some(DELIVERED_MIN), Better::Higher));
    }
    let counted = STATIONS.iter().position(|known| *known == COUNTED).unwrap_or_default();
    let whole = of(&blocks[counted], |block| block.bytes);
    rows.push(BenchResult::on_value("network_bytes_per_hand", "B/s", whole, None, Better::Lower));
    rows.push(BenchResult::on_ratio(
        "network_bytes_per_hand_with_deadband",
        "B/s",
        of(&saving, |block| block.bytes),
        whole.0,
        None,
        Better::Lower,
    ));
    Ok(rows)
}

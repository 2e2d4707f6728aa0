//! What the sender of hands adds on a path that loses a fifth of what it carries, both ways: it never queues, so that a
//! sample goes at its tick or not at all.

use std::net::Ipv4Addr;
use std::sync::atomic::Ordering;
use std::time::Duration;

use trocar::network::haptic::SenderConfig;
use trocar::network::live::sockets::HostSockets;
use trocar::summary::{BenchResult, Better};
use trocar_kernel::bench::median_and_spread;
use trocar_kernel::runtime::Clock;

use super::Rows;
use super::link::LiveHost;
use super::load::Load;
use crate::failure::Failure;

const LOSS: f64 = 0.2;
const SPAN: Duration = Duration::from_secs(4);
const BLOCKS: usize = 3;
/// Bar on what is added \[ms\].
const ADDED_MAX_MS: f64 = 1.0;

/// From when a tick is due until the system has its datagram, at a host whose datagrams get lost.
pub fn lossy_sender() -> Rows {
    let mut added = Vec::new();
    for _ in 0..BLOCKS {
        let clock = Clock::start();
        // The deadband and its guesses of what was lost are at work, as in a session.
        let config = SenderConfig::default();
        let sockets = HostSockets::bind(Some(Ipv4Addr::LOCALHOST.into()), 0).map_err(Failure::internal)?;
        let address = (Ipv4Addr::LOCALHOST, sockets.port).into();
        let host = LiveHost::start(1, &config, sockets.udp, &clock, LOSS)?;
        let load = Load::start(1, &config, address, &clock)?;
        std::thread::sleep(SPAN);
        load.end();
        if host.watch.offered.load(Ordering::Relaxed) == 0 {
            return Err(Failure::internal("the sender sent nothing"));
        }
        added.push(host.watch.added.quantiles().p99 * 1e-3);
        host.close()?;
    }
    let row = BenchResult::on_value(
        "network_sender_adds_at_20_percent_loss_p99",
        "ms",
        median_and_spread(&added),
        Some(ADDED_MAX_MS),
        Better::Lower,
    );
    Ok(vec![row])
}

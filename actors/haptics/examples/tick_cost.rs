//! What a haptic tick costs: `cargo run --release -p trocar-haptics --example tick_cost`.

#[path = "../tests/support/mod.rs"]
mod bench;

use std::time::Instant;

use bench::{Bench, Mount, Wall, handle, start_tip};
use nalgebra::Vector3;
use trocar_devices::VirtualHandConfig;
use trocar_haptics::HapticsConfig;
use trocar_haptics::renderer::{ProxyConfig, RendererConfig, VirtualCouplingConfig};

fn main() {
    for renderer in [
        RendererConfig::ZeroOrderHold,
        RendererConfig::VirtualCoupling(VirtualCouplingConfig::default()),
        RendererConfig::Proxy(ProxyConfig::default()),
    ] {
        let hand =
            VirtualHandConfig { start_in_device: handle(0.002, 0.0, 0.0), ..VirtualHandConfig::default() };
        let wall = Wall {
            friction: 0.3,
            base_force: Vector3::new(0.0, 0.0, -0.05),
            ..Wall::plane(start_tip(Mount::SealedPort), -Vector3::x(), 500)
        };
        let config = HapticsConfig { renderer, ..HapticsConfig::default() };
        let mut bench = Bench::new(hand, config, Mount::SealedPort, wall);
        bench.aim(Vector3::new(-0.004, 0.001, 0.001));
        bench.run(1000);
        let mut nanos: Vec<u64> = (0..20_000)
            .map(|_| {
                bench.step_with(|tick| {
                    let start = Instant::now();
                    tick();
                    start.elapsed().as_nanos() as u64
                })
            })
            .collect();
        nanos.sort_unstable();
        let at = |share: f64| nanos[((nanos.len() - 1) as f64 * share) as usize];
        println!(
            "{:>17}: p50 {} ns, p99 {} ns, p99.9 {} ns per tick in contact",
            bench.controller.renderer_name(),
            at(0.5),
            at(0.99),
            at(0.999)
        );
    }
}

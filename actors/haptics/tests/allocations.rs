//! A warmed haptic tick allocates nothing and frees nothing: counted by the allocator itself.

use crate::support::{Bench, Mount, Wall, handle, start_tip};
use nalgebra::Vector3;
use trocar_devices::VirtualHandConfig;
use trocar_haptics::HapticsConfig;
use trocar_haptics::renderer::{ProxyConfig, RendererConfig, VirtualCouplingConfig};
use trocar_test_support::allocations::counted;

#[test]
fn the_counter_counts() {
    assert_eq!(counted(|| drop(std::hint::black_box(vec![1u8; 100]))), (1, 1));
}

#[test]
fn a_warmed_tick_allocates_and_frees_nothing() {
    for renderer in [
        RendererConfig::Proxy(ProxyConfig::default()),
        RendererConfig::VirtualCoupling(VirtualCouplingConfig::default()),
        RendererConfig::ZeroOrderHold,
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
        bench.run(200);
        let mut total = (0, 0);
        for tick in 0..1000 {
            if tick % 100 == 0 {
                bench.aim(Vector3::new(-0.004, 0.002 * f64::from(tick % 200 / 100), 0.001));
            }
            let (allocations, frees) = bench.step_with(|tick| counted(tick));
            total = (total.0 + allocations, total.1 + frees);
        }
        assert_eq!(total, (0, 0), "{renderer:?}");
        assert!(bench.felt().1.norm() > 0.3, "the tick must have had work to do");
    }
}

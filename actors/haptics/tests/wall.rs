//! Physics at 10, 100 and 500 Hz under the hand at 1 kHz, with the arm's impedance on and off: what is felt.

mod bench;

use bench::{Bench, Mount, Wall, handle, start_tip};
use nalgebra::Vector3;
use trocar_devices::VirtualHandConfig;
use trocar_haptics::HapticsConfig;
use trocar_haptics::renderer::{ProxyConfig, RendererConfig, VirtualCouplingConfig};

/// What one press on the wall showed.
#[derive(Debug)]
struct Press {
    position: f64,
    force: f64,
    speed_rms: f64,
    energy_min: f64,
    dissipated: f64,
    felt: f64,
}

#[derive(Clone, Copy, Debug)]
struct Case {
    renderer: RendererConfig,
    rate: u64,
    impedance: bool,
    mount: Mount,
    passivity: bool,
}

/// A wall that the hand meets 2 mm from its start, when it moves along −x of the device.
fn press(case: Case, strength: f64) -> Press {
    // Sideways through a port the tip goes the other way.
    let away = if case.mount == Mount::Free { Vector3::x() } else { -Vector3::x() };
    let lever = if case.mount == Mount::Free { 1.0 } else { 0.17 / 0.16 };
    let hand = VirtualHandConfig {
        impedance: case.impedance,
        push: if case.impedance { Vector3::zeros() } else { Vector3::new(-strength, 0.0, 0.0) },
        start_in_device: handle(0.002, 0.0, 0.0),
        friction: 0.0,
        ..VirtualHandConfig::default()
    };
    let wall = Wall {
        point_in_world: start_tip(case.mount),
        normal_in_world: away,
        friction: 0.0,
        rate: case.rate,
        base_force: Vector3::zeros(),
    };
    let config =
        HapticsConfig { renderer: case.renderer, passivity: case.passivity, ..HapticsConfig::default() };
    let mut bench = Bench::new(hand, config, case.mount, wall);
    if case.impedance {
        bench.aim(Vector3::new(-strength / 500.0, 0.0, 0.0));
    }
    let _ = lever;
    let mut felt = 0.0f64;
    for _ in 0..2500 {
        bench.step();
        felt = felt.max(bench.status().felt_stiffness);
    }
    let speed_rms = bench.speed_rms(500);
    let (position, force) = bench.felt();
    let status = bench.status();
    Press {
        position: position.x,
        force: force.x,
        speed_rms,
        energy_min: status.energy_min,
        dissipated: status.dissipated,
        felt,
    }
}

#[test]
fn explore() {
    for renderer in [
        RendererConfig::Proxy(ProxyConfig::default()),
        RendererConfig::VirtualCoupling(VirtualCouplingConfig::default()),
        RendererConfig::Held,
    ] {
        for mount in [Mount::Free, Mount::Port, Mount::SealedPort] {
            for rate in [10, 100, 500, 1000] {
                for impedance in [true, false] {
                    for passivity in [true, false] {
                        let case = Case { renderer, rate, impedance, mount, passivity };
                        let (light, firm) = (press(case, 0.8), press(case, 1.8));
                        let stiffness = -(firm.force - light.force) / (firm.position - light.position);
                        println!(
                            "{:>16} {:?} {rate:4} Hz arm {} pc {} K {stiffness:7.1} felt {:7.1} rms {:.2e} {:.2e} Emin {:.2e} {:.2e} diss {:.2e} x {:.5} F {:.3}",
                            renderer.build().name(), mount, impedance as u8, passivity as u8, firm.felt, light.speed_rms, firm.speed_rms,
                            light.energy_min, firm.energy_min, firm.dissipated, firm.position, firm.force
                        );
                    }
                }
            }
        }
    }
}

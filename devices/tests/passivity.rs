//! Whatever a controller asks for, a hand gets no energy out of the port that it has not paid or been lent.

use crate::support::Bench;
use nalgebra::Vector3;
use proptest::prelude::*;
use trocar_devices::{
    Capabilities, DeviceCommand, DeviceError, DeviceState, HandIntent, HapticDevice, PassivityConfig,
    PortEnergy, VirtualHand, VirtualHandConfig, Wrench,
};

/// A hand whose maker states another mass than it has.
struct Misstated {
    hand: VirtualHand,
    capabilities: Capabilities,
}

impl HapticDevice for Misstated {
    fn capabilities(&self) -> &Capabilities {
        &self.capabilities
    }
    fn open(&mut self, now_ns: u64) -> Result<(), DeviceError> {
        self.hand.open(now_ns)
    }
    fn read(&mut self, now_ns: u64) -> Result<DeviceState, DeviceError> {
        self.hand.read(now_ns)
    }
    fn write(&mut self, now_ns: u64, wrench: &Wrench) -> Result<(), DeviceError> {
        self.hand.write(now_ns, wrench)
    }
    fn set_intent(&mut self, now_ns: u64, intent: &HandIntent) {
        self.hand.set_intent(now_ns, intent);
    }
    fn close(&mut self) {
        self.hand.close();
    }
}

/// What a hand is and what it is asked to feel.
#[derive(Clone, Copy, Debug)]
struct Case {
    /// True mass of the device [kg], and the stated one as a multiple of it.
    mass: f64,
    stated: f64,
    friction: f64,
    impedance: bool,
    /// Push of the human [N].
    push: f64,
    /// Resolution of the position [m].
    resolution: f64,
    /// Wall from x = 2 mm on [N/m], [N·s/m]; negative damping makes it active.
    stiffness: f64,
    damping: f64,
    /// Whether the wall holds on both sides, like a spring.
    spring: bool,
    /// A force [N] that comes and goes with this period [ms]; 0 for never.
    jump: f64,
    jump_period_ms: u64,
}

/// Runs for two seconds; the port at the end, the least of what was available, and the speed at the end.
fn run(case: &Case, passivity: bool) -> (PortEnergy, f64, f64) {
    let hand = VirtualHand::new(VirtualHandConfig {
        device_mass: case.mass,
        friction: case.friction,
        impedance: case.impedance,
        push: Vector3::new(case.push, 0.0, 0.0),
        stops: false,
        resolution: case.resolution,
        ..VirtualHandConfig::default()
    })
    .unwrap();
    let mut capabilities = hand.capabilities().clone();
    capabilities.apparent_mass *= case.stated;
    let mut bench = Bench::new(Misstated { hand, capabilities });
    let mut link = bench.slot.take(1).unwrap();
    let mut least = f64::INFINITY;
    let mut speed = 0.0;
    for step in 0..2_000_u64 {
        let sample = bench.step();
        least = least.min(sample.energy.available);
        speed = sample.state.linear_velocity.norm();
        let depth = sample.state.pose_in_device.translation.x - 0.002;
        let mut force = 0.0;
        if depth > 0.0 || case.spring {
            force = -case.stiffness * depth - case.damping * sample.state.linear_velocity.x;
        }
        if case.jump_period_ms > 0 && (step / case.jump_period_ms) % 2 == 1 {
            force += case.jump;
        }
        let wrench = Wrench::from_force(Vector3::new(force, 0.0, 0.0));
        link.command(DeviceCommand { epoch: 1, time_ns: bench.now_ns, wrench, passivity, intent: None });
    }
    (bench.monitor.sample().energy, least, speed)
}

fn case() -> impl Strategy<Value = Case> {
    (
        (0.03..0.2_f64, 0.8..1.25_f64, 0.0..0.25_f64, any::<bool>(), -2.0..2.0_f64),
        (0.0..1020.0_f64, -5.0..5.0_f64, any::<bool>()),
        (-3.3..3.3_f64, prop_oneof![Just(0_u64), 1..300_u64]),
    )
        .prop_map(
            |(
                (mass, stated, friction, impedance, push),
                (stiffness, damping, spring),
                (jump, jump_period_ms),
            )| Case {
                mass,
                stated,
                friction,
                impedance,
                push,
                resolution: 0.0,
                stiffness,
                damping,
                spring,
                jump,
                jump_period_ms,
            },
        )
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(128))]

    #[test]
    fn the_port_gives_no_more_than_was_paid_and_lent(case in case()) {
        let (port, least, _) = run(&case, true);
        // The reserve covers what a step cannot foresee, a mass that is stated wrongly included. What is left is the
        // capital of a hand at rest.
        prop_assert!(least >= -PassivityConfig::default().capital, "{:e} J available, {:?}", least, port);
    }
}

#[test]
fn an_active_wall_shakes_a_free_hand_and_passivity_stops_it() {
    let active = Case {
        mass: 0.045,
        stated: 1.0,
        friction: 0.1,
        impedance: false,
        push: 1.0,
        resolution: 0.0,
        stiffness: 1000.0,
        damping: -2.0,
        spring: false,
        jump: 0.0,
        jump_period_ms: 0,
    };
    let (port, _, speed) = run(&active, false);
    assert!(port.energy_min < -0.05 && speed > 0.1, "it must be active: {port:?}, {speed} m/s");
    let (port, _, speed) = run(&active, true);
    assert!(port.energy_min >= 0.0 && port.dissipated > 0.0, "{port:?}");
    assert_eq!(speed, 0.0);
    // A step's reserve knows nothing of the sensor's steps: one of them at a tenth of a newton may slip through.
    let quantised = Case { resolution: VirtualHandConfig::OMNI_RESOLUTION, ..active };
    let (port, _, speed) = run(&quantised, true);
    assert!(port.energy_min >= -0.1 * quantised.resolution, "{port:?}");
    assert_eq!(speed, 0.0);
}

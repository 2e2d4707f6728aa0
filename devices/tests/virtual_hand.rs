//! The virtual hand against closed forms.

use crate::support::{Bench, MS, force};
use nalgebra::{Isometry3, UnitQuaternion, Vector3};
use trocar_devices::{
    ArmImpedance, DeviceState, Dofs, HandIntent, HapticDevice, VirtualHand, VirtualHandConfig, Wrench,
};

/// Without friction, so that closed forms hold.
fn frictionless() -> VirtualHandConfig {
    VirtualHandConfig { friction: 0.0, ..VirtualHandConfig::default() }
}

fn open(config: VirtualHandConfig) -> VirtualHand {
    let mut hand = VirtualHand::new(config).unwrap();
    hand.open(0).unwrap();
    hand
}

/// Steps at 1 kHz; the state at the end.
fn run(hand: &mut VirtualHand, from_ns: u64, to_ns: u64) -> DeviceState {
    let mut now_ns = from_ns;
    while now_ns < to_ns {
        now_ns += MS;
        hand.read(now_ns).unwrap();
    }
    hand.read(to_ns).unwrap()
}

fn x_of(state: &DeviceState) -> f64 {
    state.pose_in_device.translation.x
}

fn aim(x: f64) -> HandIntent {
    HandIntent::at(Isometry3::translation(x, 0.0, 0.0), 0.0)
}

#[test]
fn a_constant_force_deflects_the_arm_by_f_over_k() {
    for stiffness in [100.0, 500.0, 2000.0] {
        let mut config = frictionless();
        config.arm.stiffness = stiffness;
        config.stops = false;
        let mut hand = open(config);
        hand.write(0, &Wrench::from_force(Vector3::new(1.5, -0.5, 0.0))).unwrap();
        let state = run(&mut hand, 0, 5_000 * MS);
        let expected = Vector3::new(1.5, -0.5, 0.0) / stiffness;
        assert!((state.pose_in_device.translation.vector - expected).norm() < 1e-9);
        assert!(state.linear_velocity.norm() < 1e-9);
    }
}

#[test]
fn a_step_of_the_aim_is_answered_as_a_second_order_system() {
    let config = frictionless();
    let ArmImpedance { mass, damping, stiffness } = config.arm;
    let (m, b) = (mass + config.device_mass, damping + config.device_damping);
    let sigma = b / (2.0 * m);
    let omega = (stiffness / m - sigma * sigma).sqrt();
    let mut hand = open(config);
    hand.set_intent(0, &aim(0.02));
    for ms in 1..=300_u64 {
        let t = ms as f64 * 1e-3;
        let decay = (-sigma * t).exp();
        let expected = 0.02 * (1.0 - decay * ((omega * t).cos() + sigma / omega * (omega * t).sin()));
        let x = x_of(&hand.read(ms * MS).unwrap());
        assert!((x - expected).abs() < 1e-12, "{ms} ms: {x} instead of {expected}");
    }
}

#[test]
fn without_the_arm_the_handle_accelerates_by_f_over_m() {
    let config = VirtualHandConfig { impedance: false, device_damping: 0.0, stops: false, ..frictionless() };
    let mass = config.device_mass;
    let mut hand = open(config);
    hand.set_intent(0, &aim(-1.0));
    hand.write(0, &Wrench::from_force(Vector3::new(0.9, 0.0, 0.0))).unwrap();
    let state = run(&mut hand, 0, 200 * MS);
    let expected = 0.5 * 0.9 / mass * 0.2 * 0.2;
    assert!((x_of(&state) - expected).abs() < 1e-12);
    // The measured velocity lags by the filter's time constant.
    let lag = 1.0 / (2.0 * std::f64::consts::PI * 100.0);
    let velocity = 0.9 / mass * (0.2 - lag);
    assert!((state.linear_velocity.x - velocity).abs() < 0.01 * velocity);
}

#[test]
fn the_impedance_can_be_switched_while_it_runs() {
    let mut hand = open(VirtualHandConfig { stops: false, ..frictionless() });
    hand.set_intent(0, &aim(0.01));
    run(&mut hand, 0, 2_000 * MS);
    hand.set_impedance(false);
    hand.set_intent(2_000 * MS, &aim(0.0));
    let free = run(&mut hand, 2_000 * MS, 3_000 * MS);
    assert!((x_of(&free) - 0.01).abs() < 1e-6);
    hand.set_impedance(true);
    assert!(x_of(&run(&mut hand, 3_000 * MS, 5_000 * MS)).abs() < 1e-9);
}

#[test]
fn friction_holds_the_hand_up_to_its_force_and_not_beyond() {
    let mut hand = open(VirtualHandConfig { impedance: false, ..VirtualHandConfig::default() });
    hand.write(0, &Wrench::from_force(Vector3::new(0.15, 0.2, 0.0))).unwrap();
    let state = run(&mut hand, 0, 10_000 * MS);
    assert!(state.pose_in_device.translation.vector.norm() < 1e-9, "a hand at rest does not creep");
    hand.write(0, &Wrench::from_force(Vector3::new(0.36, 0.0, 0.0))).unwrap();
    let before = x_of(&state);
    let state = run(&mut hand, 10_000 * MS, 10_050 * MS);
    // 0.1 N is left to accelerate 45 g against 0.2 N·s/m.
    let (tau, terminal) = (0.045 / 0.2, 0.1 / 0.2);
    let expected = terminal * (0.05 - tau * (1.0 - (-0.05_f64 / tau).exp()));
    assert!((x_of(&state) - before - expected).abs() < 1e-6, "{} {expected}", x_of(&state) - before);
}

#[test]
fn friction_and_damping_bring_a_pushed_handle_to_rest() {
    let mut hand = open(VirtualHandConfig { impedance: false, ..VirtualHandConfig::default() });
    hand.write(0, &Wrench::from_force(Vector3::new(1.0, 0.5, 0.0))).unwrap();
    run(&mut hand, 0, 30 * MS);
    hand.write(0, &Wrench::ZERO).unwrap();
    let rest = run(&mut hand, 30 * MS, 1_000 * MS);
    let later = run(&mut hand, 1_000 * MS, 2_000 * MS);
    assert_eq!(rest.pose_in_device, later.pose_in_device);
    assert!(later.linear_velocity.norm() < 1e-9);
}

#[test]
fn a_constant_push_of_the_human_is_balanced_by_an_equal_force() {
    let config = VirtualHandConfig { impedance: false, push: Vector3::new(0.0, 0.0, -1.0), ..frictionless() };
    let mut hand = open(config);
    hand.write(0, &Wrench::from_force(Vector3::new(0.0, 0.0, 1.0))).unwrap();
    assert_eq!(run(&mut hand, 0, 100 * MS).pose_in_device.translation.z, 0.0);
}

#[test]
fn the_stops_hold_the_handle_in_the_workspace() {
    for impedance in [true, false] {
        let mut hand = open(VirtualHandConfig { impedance, ..VirtualHandConfig::default() });
        hand.set_intent(0, &aim(0.1));
        hand.write(0, &Wrench::from_force(Vector3::new(2.0, 0.0, 0.0))).unwrap();
        let state = run(&mut hand, 0, 3_000 * MS);
        // Arm (500 N/m from 100 mm, or none) and 2 N against 1,000 N/m from 80 mm; friction holds some of it.
        let expected = if impedance { (2.0 + 50.0 + 80.0) / 1_500.0 } else { 0.082 };
        assert!((x_of(&state) - expected).abs() < 0.3e-3, "{}", x_of(&state));
        assert!(state.linear_velocity.norm() < 1e-6);
    }
}

#[test]
fn the_orientation_follows_the_aim_without_overshoot_even_from_half_a_turn() {
    for angle in [0.5, 2.0, 3.1] {
        let mut hand = open(VirtualHandConfig::default());
        let target = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), angle);
        let pose = Isometry3::from_parts(Vector3::zeros().into(), target);
        hand.set_intent(0, &HandIntent::at(pose, 0.0));
        let mut left = angle;
        for ms in 1..=1_500_u64 {
            let state = hand.read(ms * MS).unwrap();
            let error = state.pose_in_device.rotation.angle_to(&target);
            assert!(error <= left + 1e-9, "no overshoot");
            assert!((state.pose_in_device.rotation.coords.norm() - 1.0).abs() < 1e-12);
            left = error;
        }
        assert!(left < 1e-6, "{left}");
    }
}

#[test]
fn torque_turns_a_hand_of_six_outputs_only() {
    for (output_dofs, turns) in [(Dofs::Three, false), (Dofs::Six, true)] {
        let mut hand = open(VirtualHandConfig { output_dofs, ..VirtualHandConfig::default() });
        let torque = Vector3::new(0.0, 0.0, 0.02);
        hand.write(0, &Wrench { force: Vector3::zeros(), torque }).unwrap();
        let state = run(&mut hand, 0, 1_000 * MS);
        let angle = state.pose_in_device.rotation.scaled_axis().z;
        // Statics: inertia · (2π · 6 Hz)² · 2 sin(θ/2) = torque.
        let rate = 2.0 * std::f64::consts::PI * 6.0;
        let expected = 2.0 * (0.02 / (8.4e-5 * rate * rate) / 2.0).asin();
        assert!((angle - if turns { expected } else { 0.0 }).abs() < 1e-6, "{angle} {expected}");
    }
}

#[test]
fn the_gripper_closes_at_the_speed_of_fingers() {
    let mut hand = open(VirtualHandConfig::default());
    hand.set_intent(0, &HandIntent { gripper: 1.0, ..aim(0.0) });
    let mut before = 0.0;
    for ms in 1..=400_u64 {
        let gripper = hand.read(ms * MS).unwrap().gripper;
        assert!(gripper >= before && gripper - before <= 6.0e-3 + 1e-12);
        before = gripper;
    }
    assert!((before - 1.0).abs() < 0.01);
}

#[test]
fn measured_positions_are_quantised_if_asked() {
    let resolution = VirtualHandConfig::OMNI_RESOLUTION;
    let mut hand = open(VirtualHandConfig { resolution, ..VirtualHandConfig::default() });
    hand.set_intent(0, &aim(0.03));
    for ms in 1..=200_u64 {
        let steps = x_of(&hand.read(ms * MS).unwrap()) / resolution;
        assert!((steps - steps.round()).abs() < 1e-6);
    }
}

#[test]
fn time_that_stands_still_or_jumps_does_no_harm() {
    let mut hand = open(VirtualHandConfig::default());
    hand.set_intent(0, &aim(0.05));
    let state = hand.read(MS).unwrap();
    assert_eq!(hand.read(MS).unwrap(), state);
    assert_eq!(hand.read(0).unwrap(), state);
    let later = hand.read(u64::MAX).unwrap();
    assert!(later.is_valid() && x_of(&later) < 0.1);
}

#[test]
fn the_same_steps_give_the_same_bits() {
    let play = || {
        let mut hand = open(VirtualHandConfig::default());
        (1..=2_000_u64)
            .map(|ms| {
                let t = ms as f64 * 1e-3;
                hand.set_intent(ms * MS, &aim(0.03 * t * (1.0 - t * 0.5)));
                hand.write(ms * MS, &Wrench::from_force(Vector3::new(-0.5 * t, 0.1, 0.0))).unwrap();
                let state = hand.read(ms * MS).unwrap();
                [x_of(&state).to_bits(), state.linear_velocity.y.to_bits()]
            })
            .collect::<Vec<_>>()
    };
    assert_eq!(play(), play());
}

/// Force trace of a stroke into a wall of 500 N/m at 10 mm, through the driver; a change of feel fails here.
#[test]
fn a_stroke_into_a_virtual_wall_feels_as_it_always_did() {
    let mut bench = Bench::new(VirtualHand::new(VirtualHandConfig::default()).unwrap());
    let mut link = bench.slot.take(1).unwrap();
    let mut trace: Vec<[f64; 3]> = Vec::new();
    for ms in 1..=400_u64 {
        let sample = *link.sample();
        let x = x_of(&sample.state);
        let share = (ms as f64 / 200.0).min(1.0);
        let mut command = force(1, bench.now_ns + MS, -500.0 * (x - 0.010).max(0.0));
        command.intent = Some(aim(0.02 * share * share * (3.0 - 2.0 * share)));
        link.command(command);
        let sample = bench.step();
        if ms % 20 == 0 {
            trace.push([ms as f64, x_of(&sample.state) * 1e3, sample.applied.force.x]);
        }
    }
    let end = bench.monitor.sample();
    // Two springs of 500 N/m in series between 10 and 20 mm meet half-way, within friction.
    assert!((x_of(&end.state) - 0.015).abs() < 0.26 / 1_000.0 + 1e-6, "{}", x_of(&end.state));
    let golden = include_str!("golden/wall_stroke.csv")
        .lines()
        .skip(1)
        .map(|line| line.split(',').map(|cell| cell.parse::<f64>().unwrap()).collect::<Vec<_>>());
    assert_eq!(trace.len(), golden.clone().count());
    for (felt, golden) in trace.iter().zip(golden) {
        for (felt, golden) in felt.iter().zip(golden) {
            // Half of the last digit, in ms, mm and N.
            assert!((felt - golden).abs() <= 0.5001e-4, "{felt} instead of {golden}: {trace:?}");
        }
    }
}

//! A warmed driver step allocates nothing and frees nothing, on either end of the link.

use nalgebra::{Isometry3, Vector3};
use trocar_devices::{
    DeviceCommand, DeviceFaults, DriverConfig, DriverCore, HandIntent, HapticDevice, ReplayHand, Trajectory,
    TrajectoryPoint, VirtualHand, VirtualHandConfig, Wrench, link,
};
use trocar_test_support::allocations::touches;

/// Steps driver and controller; allocator calls during the steps after the first ten. Faults come and go.
fn calls_while_stepping(mut device: impl HapticDevice) -> u64 {
    let (end, slot, monitor) = link();
    let faults = DeviceFaults::new();
    let mut core = DriverCore::new(DriverConfig::default(), &device, end, faults.clone());
    let mut controller = slot.take(1).unwrap();
    let mut zombie = slot.take(1).unwrap();
    std::mem::swap(&mut controller, &mut zombie);
    let mut before = 0;
    for step in 1..=5_000_u64 {
        if step == 11 {
            before = touches();
        }
        let now_ns = step * 1_000_000 + step % 7;
        match step {
            1_000 => faults.unplug_until(now_ns + 300_000_000),
            2_000 => faults.nan_until(now_ns + 10_000_000),
            2_500 => faults.delay_until(5_000_000, now_ns + 100_000_000),
            _ => {}
        }
        core.step(now_ns, &mut device);
        let sample = controller.sample();
        let force = -200.0 * sample.state.pose_in_device.translation.vector;
        let x = 0.01 * (step as f64 * 0.01).sin();
        let intent = HandIntent::at(Isometry3::translation(x, 0.0, 0.0), x);
        let command = DeviceCommand {
            epoch: 1,
            time_ns: now_ns,
            wrench: Wrench::from_force(force),
            passivity: true,
            intent: Some(intent),
        };
        controller.command(command);
        zombie.command(DeviceCommand { time_ns: now_ns + 1, ..command });
    }
    let counted = touches() - before;
    // Otherwise nothing was tried.
    let statistics = monitor.sample().statistics;
    assert!(statistics.accepted > 4_000 && statistics.force_newtons_max > 0.01, "{statistics:?}");
    assert!(statistics.unplugs == 1 && statistics.readings_refused > 0 && statistics.refused_epoch > 4_000);
    counted
}

#[test]
fn a_warmed_driver_step_allocates_and_frees_nothing() {
    let hand = VirtualHand::new(VirtualHandConfig::default()).unwrap();
    assert_eq!(calls_while_stepping(hand.clone()), 0);

    let points = (0..200_u64)
        .map(|n| {
            let mut state = trocar_devices::DeviceState::unknown();
            state.pose_in_device.translation.vector = Vector3::new(0.0, 1e-4 * n as f64, 0.0);
            state.connected = true;
            TrajectoryPoint { time_ns: n * 33_000_000, state }
        })
        .collect();
    let replay = ReplayHand::new(Trajectory::with_differentiated_velocities(points).unwrap());
    assert_eq!(calls_while_stepping(replay.clone()), 0);
    assert_eq!(calls_while_stepping(replay.with_force(hand.config().clone()).unwrap()), 0);

    let before = touches();
    drop(std::hint::black_box(vec![1_u8]));
    assert_eq!(touches() - before, 2, "the counter counts");
}

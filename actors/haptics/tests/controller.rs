//! The controller in its place: between driver and scene, unplugged, pressed, restarted, edited live.

use crate::support::{Bench, HAND, INSTRUMENT, Mount, PORT, Wall, handle, start_tip};
use nalgebra::{UnitQuaternion, Vector3};
use trocar_devices::{DeviceFaults, VirtualHandConfig};
use trocar_haptics::HapticsConfig;
use trocar_haptics::renderer::RendererConfig;
use trocar_scene::{
    Commands, DeviceForce, DeviceState, EntityAllocator, Hand, InstrumentTarget, Pose, SimTime, Velocity,
};

fn wall(mount: Mount, rate: u64) -> Wall {
    let away = if mount == Mount::Free { Vector3::x() } else { -Vector3::x() };
    Wall::plane(start_tip(mount), away, rate)
}

fn bench(mount: Mount) -> Bench {
    let hand = VirtualHandConfig { start_in_device: handle(0.002, 0.0, 0.0), ..VirtualHandConfig::default() };
    Bench::new(hand, HapticsConfig::default(), mount, wall(mount, 500))
}

/// Leans on the wall and waits for rest.
fn leaning(mount: Mount) -> Bench {
    let mut bench = bench(mount);
    bench.aim(Vector3::new(-0.003, 0.0, 0.0));
    bench.run(1000);
    assert!(bench.felt().1.x > 0.5, "{:?}", bench.felt());
    bench
}

#[test]
fn the_instrument_follows_the_hand_through_its_port() {
    let mut bench = bench(Mount::Port);
    bench.aim(Vector3::new(0.01, 0.0, 0.01));
    bench.run(1500);
    let state = *bench.store.view().get::<DeviceState>(HAND).unwrap();
    let target = bench.target();
    assert!(state.connected && (state.handle_in_device.translation.x - 0.01).abs() < 2e-3);
    // The handle moved to +x, so the tip went to −x; device +z is world −z: deeper.
    assert!(target.tip_in_world.translation.x < -0.005, "{target:?}");
    assert!(target.tip_in_world.translation.z < -0.005, "{target:?}");
    assert!((target.jaw_angle - 0.3).abs() < 1e-3, "{target:?}");
    let shaft = target.tip_in_world.rotation * Vector3::z();
    let to_port = Vector3::new(0.0, 0.0, 0.17) - target.tip_in_world.translation;
    assert!(shaft.cross(&to_port).norm() < 1e-12, "the shaft must pass the port");
    assert_eq!(target.sampled_at, state.sampled_at);
}

#[test]
fn the_target_velocity_is_the_derivative_of_the_target_pose() {
    let mut bench = bench(Mount::Port);
    bench.aim(Vector3::new(0.02, 0.01, 0.005));
    bench.run(60);
    let before = bench.target();
    bench.step();
    let after = bench.target();
    let numeric = (after.tip_in_world.translation - before.tip_in_world.translation) / 1e-3;
    let stated = 0.5 * (before.velocity_in_world.linear + after.velocity_in_world.linear);
    assert!(stated.norm() > 0.02, "{stated:?}");
    // The device filters its velocity at 100 Hz.
    assert!((numeric - stated).norm() < 0.2 * stated.norm() + 5e-3, "{numeric:?} {stated:?}");
}

#[test]
fn an_unplugged_device_is_asked_for_nothing_and_its_instrument_stays() {
    let mut bench = leaning(Mount::Port);
    bench.aim(Vector3::new(0.02, 0.0, 0.0));
    bench.run(20);
    assert!(bench.target().velocity_in_world.linear.norm() > 1e-3, "the hand must be moving");
    bench.faults.unplug_until(DeviceFaults::FOREVER);
    bench.run(2);
    let frozen = bench.target();
    assert_eq!(frozen.velocity_in_world, Velocity::default());
    bench.run(300);
    assert_eq!(bench.target(), frozen);
    let scene = bench.store.view();
    assert!(!scene.get::<DeviceState>(HAND).unwrap().connected);
    assert_eq!(scene.get::<DeviceForce>(HAND).unwrap().force, Vector3::zeros());
    bench.faults.heal();
    bench.aim(Vector3::new(-0.003, 0.0, 0.0));
    bench.run(1500);
    assert!(bench.felt().1.x > 0.5, "force must come back: {:?}", bench.felt());
}

#[test]
fn a_restarted_controller_continues_from_the_scene() {
    let mut bench = leaning(Mount::Port);
    let (before, status) = (bench.felt(), bench.status());
    let target = bench.target();
    assert!(status.energy > 0.0);
    bench.restart_controller();
    bench.run(15);
    let after = bench.status();
    assert!(after.energy > 0.0 && (after.energy - status.energy).abs() < 2e-3, "{status:?} {after:?}");
    assert_eq!(after.energy_min, status.energy_min);
    assert!(after.force_max >= status.force_max && after.stale_samples >= status.stale_samples);
    let moved = (bench.target().tip_in_world.translation - target.tip_in_world.translation).norm();
    assert!(moved < 1.5e-3, "the instrument jumped by {moved} m");
    let mut last = bench.felt().1;
    for _ in 0..500 {
        bench.step();
        let force = bench.felt().1;
        assert!((force - last).norm() < 0.1, "the force jumped from {last:?} to {force:?}");
        last = force;
    }
    assert!((bench.felt().1 - before.1).norm() < 0.05, "{before:?} {:?}", bench.felt());
}

#[test]
fn a_controller_of_an_older_generation_is_not_obeyed() {
    let mut bench = leaning(Mount::Free);
    bench.slot.fence().raise(7);
    bench.run(25);
    assert_eq!(bench.felt().1, Vector3::zeros(), "a fenced controller's force must be gone after 20 ms");
}

#[test]
fn the_port_moves_with_the_wall_and_a_rig_that_does_not_fit_is_refused() {
    let mut bench = bench(Mount::Port);
    bench.run(100);
    let before = bench.target().tip_in_world;
    let mut edit = Commands::new(bench.store.view().registry().clone(), EntityAllocator::new(0, 0));
    edit.put(PORT, Pose::at(0.005, 0.0, 0.17));
    bench.store.apply(&mut edit, bench.now);
    edit.clear();
    bench.run(100);
    let moved = bench.target().tip_in_world.translation - before.translation;
    assert!(moved.x > 0.005, "{moved:?}");
    let hand = bench.store.view().get::<Hand>(HAND).unwrap().clone();
    edit.put(HAND, Hand { instrument: PORT, ..hand });
    bench.store.apply(&mut edit, bench.now);
    bench.run(10);
    assert!(bench.store.view().events().since(0).any(|(_, event)| event.name == "hand_rig_refused"));
    let kept = bench.target();
    assert_eq!(kept.sampled_at + SimTime::from_millis(1), bench.now, "the old rig must go on: {kept:?}");
}

#[test]
fn the_weight_that_no_plane_explains_is_felt() {
    let mut bench = bench(Mount::Free);
    bench.wall.base_force = Vector3::new(0.0, 0.0, -0.3);
    bench.wall.point_in_world.x = -1.0;
    bench.run(500);
    let force = bench.felt().1;
    assert!((force - Vector3::new(0.0, 0.0, -0.3)).norm() < 1e-3, "{force:?}");
}

#[test]
fn forces_stay_within_the_device_and_outputs_within_its_degrees_of_freedom() {
    let mut bench = bench(Mount::Free);
    bench.aim(Vector3::new(-0.06, 0.0, 0.0));
    let mut asked = 0.0f64;
    for _ in 0..1000 {
        bench.step();
        let wanted = *bench.store.view().get::<DeviceForce>(HAND).unwrap();
        asked = asked.max(wanted.force.norm());
        assert_eq!(wanted.torque, Vector3::zeros(), "a device with three outputs renders no torque");
    }
    assert!((3.0..=3.3 + 1e-12).contains(&asked), "{asked}");
    assert_eq!(bench.status().force_max, asked);
}

#[test]
fn targets_are_unit_rotations_however_long_it_runs() {
    let mut bench = bench(Mount::SealedPort);
    for step in 0..40 {
        let side = if step % 2 == 0 { 0.02 } else { -0.02 };
        bench.aim(Vector3::new(side, -side, 0.5 * side));
        bench.run(50);
        let target: InstrumentTarget = bench.target();
        let rotation: UnitQuaternion<f64> = target.tip_in_world.rotation;
        assert!((rotation.norm() - 1.0).abs() < 1e-15);
    }
    assert!(bench.store.view().get::<InstrumentTarget>(INSTRUMENT).is_some());
}

/// The force \[N\] that is asked for so many milliseconds after a simulation last said 1 N, with a time stamp by its own
/// clock.
fn asked_for(remote_scene: bool, stamp: SimTime, after_millis: u64) -> f64 {
    let config =
        HapticsConfig { renderer: RendererConfig::ZeroOrderHold, remote_scene, ..HapticsConfig::default() };
    let hand = VirtualHandConfig { start_in_device: handle(0.002, 0.0, 0.0), ..VirtualHandConfig::default() };
    // The bench's own simulation runs at 1 Hz: at 0 s, and not again in these tests.
    let mut bench = Bench::new(hand, config, Mount::Free, wall(Mount::Free, 1));
    bench.run(100);
    bench.put_force(Vector3::x(), stamp);
    // The first of the ticks sees it.
    bench.run(after_millis + 1);
    bench.store.view().get::<DeviceForce>(HAND).unwrap().force.x
}

#[test]
fn a_force_of_another_station_is_full_until_50_ms_and_zero_from_100_ms() {
    let now = SimTime::from_millis(100);
    assert_eq!([0, 50, 100, 400].map(|age| asked_for(true, now, age)), [1.0, 1.0, 0.0, 0.0]);
    assert!((asked_for(true, now, 75) - 0.5).abs() < 1e-9);
    assert_eq!(asked_for(false, now, 100), 1.0, "a simulation here may run at 10 Hz");
}

#[test]
fn how_long_a_force_was_under_way_is_no_reason_to_fade() {
    // Its stamp is 100 ms old when it is first seen.
    assert_eq!([0, 50, 100].map(|age| asked_for(true, SimTime::ZERO, age)), [1.0, 1.0, 0.0]);
}

#[test]
fn a_force_stamped_by_a_clock_that_is_ahead_fades_all_the_same() {
    let ahead = SimTime::from_millis(3_600_000);
    assert_eq!([50, 100].map(|age| asked_for(true, ahead, age)), [1.0, 0.0]);
    assert_eq!([250, 500].map(|age| asked_for(false, ahead, age)), [1.0, 0.0]);
}

//! A hand is never hurt: every promise of the driver core, in virtual time.

use crate::support::{Bench, MS, ScriptedDevice, force};
use nalgebra::{Isometry3, Vector3};
use proptest::prelude::*;
use trocar_devices::{DeviceCommand, DeviceError, HandIntent, Wrench};

fn bench() -> Bench<ScriptedDevice> {
    Bench::new(ScriptedDevice::new())
}

#[test]
fn force_is_clamped_to_the_limits_of_the_device_and_torque_needs_motors() {
    let mut bench = bench();
    let mut link = bench.slot.take(1).unwrap();
    for _ in 0..100 {
        let wrench = Wrench { force: Vector3::new(60.0, -80.0, 0.0), torque: Vector3::new(5.0, 0.0, 0.0) };
        link.command(DeviceCommand {
            epoch: 1,
            time_ns: bench.now_ns + MS,
            wrench,
            passivity: true,
            intent: None,
        });
        let sample = bench.step();
        assert!(bench.device.rendered.force.norm() <= 3.3);
        assert_eq!(bench.device.rendered.torque, Vector3::zeros());
        assert_eq!(sample.applied, bench.device.rendered.rounded());
    }
    let statistics = bench.monitor.sample().statistics;
    assert!((bench.device.rendered.force - Vector3::new(1.98, -2.64, 0.0)).norm() < 1e-9);
    assert!(statistics.force_newtons_max <= 3.3 && statistics.force_newtons_max > 3.3 - 1e-9);
    assert_eq!(statistics.clamped, 100);
}

#[test]
fn force_lets_go_at_once_and_grows_by_at_most_two_newtons_per_millisecond() {
    let mut bench = bench();
    let mut link = bench.slot.take(1).unwrap();
    bench.push(&mut link, 3.0, 100 * MS);
    assert!((bench.device.rendered.force.x - 3.0).abs() < 1e-12);
    bench.push(&mut link, 1.0, MS);
    assert!((bench.device.rendered.force.x - 1.0).abs() < 1e-12);
    let mut before = 0.0;
    for _ in 0..2 {
        let mut command = force(1, bench.now_ns + MS, -3.0);
        command.passivity = false;
        link.command(command);
        let now = bench.step().applied.force.x;
        assert!((before - now - 2.0).abs() < 1e-9 || (now + 3.0).abs() < 1e-9, "{before} N to {now} N");
        before = now;
    }
    assert!((before + 3.0).abs() < 1e-9);
}

#[test]
fn nothing_is_rendered_while_time_stands_still_whoever_wakes_up_and_commands_it() {
    let mut bench = bench();
    let mut link = bench.slot.take(1).unwrap();
    bench.push(&mut link, 3.0, 100 * MS);
    assert!((bench.device.rendered.force.x - 3.0).abs() < 1e-12);
    let now_ns = bench.now_ns;
    for awake in 0..50 {
        // Every one of them is younger than the one before, and as young as can be.
        link.command(force(1, now_ns + awake, 3.0));
        let sample = bench.rest();
        assert_eq!((bench.device.rendered, sample.applied), (Wrench::ZERO, Wrench::ZERO));
        assert_eq!(sample.published_at_ns, now_ns);
    }
    assert_eq!(bench.monitor.sample().statistics.refused_stale, 50);
    // Time goes on: force grows from nothing.
    bench.push(&mut link, 3.0, 2 * MS);
    assert!(bench.device.rendered.force.norm() < 0.5, "{:?}", bench.device.rendered);
    bench.push(&mut link, 3.0, 100 * MS);
    assert!((bench.device.rendered.force.x - 3.0).abs() < 1e-12);
}

#[test]
fn a_force_that_is_not_renewed_fades_from_5_ms_and_is_zero_at_20_ms() {
    let mut bench = bench();
    bench.period_ns = MS / 10;
    let mut link = bench.slot.take(1).unwrap();
    bench.push(&mut link, 2.0, 100 * MS);
    let last_command_ns = bench.now_ns;
    for _ in 0..250 {
        bench.step();
        let age_ms = (bench.now_ns - last_command_ns) as f64 / MS as f64;
        let expected = 2.0 * ((20.0 - age_ms) / 15.0).clamp(0.0, 1.0);
        let rendered = bench.device.rendered.force.x;
        assert!((rendered - expected).abs() < 1e-9, "{age_ms} ms: {rendered} N instead of {expected} N");
        if age_ms >= 20.0 {
            assert_eq!(bench.device.rendered, Wrench::ZERO);
        }
    }
    assert_eq!(bench.monitor.sample().statistics.since_command_ns, 25 * MS);
}

#[test]
fn the_driver_measures_for_how_long_a_force_was_held_and_it_is_at_most_20_ms() {
    // Commands of any phase within the driver's period.
    for offset_ns in [0, 1, MS / 4, MS / 2, 3 * MS / 4, MS - 1] {
        let mut bench = bench();
        let mut link = bench.slot.take(1).unwrap();
        for _ in 0..100 {
            link.command(force(1, bench.now_ns + MS - offset_ns, 2.0));
            bench.step();
        }
        assert_eq!(bench.monitor.sample().statistics.force_age_max_ns, offset_ns + MS);
        assert_eq!(bench.monitor.sample().statistics.releases, 0);
        let last_command_ns = bench.now_ns - offset_ns;
        let mut held_until_ns = 0;
        for _ in 0..40 {
            let held = bench.device.rendered != Wrench::ZERO;
            bench.step();
            if held {
                held_until_ns = bench.now_ns;
            }
        }
        let statistics = bench.monitor.sample().statistics;
        let age_ns = held_until_ns - last_command_ns;
        assert!(age_ns <= 20 * MS && age_ns > 18 * MS, "{offset_ns}: {age_ns} ns");
        assert_eq!((statistics.force_age_max_ns, statistics.release_age_ns), (age_ns, age_ns));
        assert_eq!(statistics.releases, 1);
    }
}

#[test]
fn force_ramps_in_at_the_start_and_after_an_interruption() {
    let mut bench = bench();
    let mut link = bench.slot.take(1).unwrap();
    for round in 1..=2 {
        bench.push(&mut link, 2.0, MS);
        assert_eq!(bench.device.rendered, Wrench::ZERO);
        bench.push(&mut link, 2.0, 25 * MS);
        assert!((bench.device.rendered.force.x - 1.0).abs() < 1e-9);
        bench.push(&mut link, 2.0, 25 * MS);
        assert!((bench.device.rendered.force.x - 2.0).abs() < 1e-9);
        assert_eq!(bench.monitor.sample().statistics.ramps, round);
        bench.idle(30 * MS);
    }
}

#[test]
fn an_old_or_repeated_or_future_command_does_not_renew_a_force() {
    let mut bench = bench();
    let mut link = bench.slot.take(1).unwrap();
    bench.push(&mut link, 2.0, 100 * MS);
    let last = bench.now_ns;
    for step in 0..30 {
        let time_ns = match step % 3 {
            0 => last,
            1 => last - 50 * MS,
            _ => bench.now_ns + 21 * MS + MS,
        };
        link.command(force(1, time_ns, 2.0));
        bench.step();
    }
    assert_eq!(bench.device.rendered, Wrench::ZERO);
    assert_eq!(bench.monitor.sample().statistics.refused_stale, 30);
}

#[test]
fn a_fenced_controller_fades_at_once_and_is_refused() {
    let mut bench = bench();
    let mut link = bench.slot.take(1).unwrap();
    bench.push(&mut link, 3.0, 100 * MS);
    bench.slot.fence().raise(2);
    let mut before = bench.device.rendered.force.x;
    for step in 1..=16 {
        // It goes on as if nothing had happened.
        let sample = bench.push(&mut link, 3.0, MS);
        let now = sample.applied.force.x;
        assert!(now < before || step == 1 || now == 0.0, "step {step}: {before} N to {now} N");
        before = now;
    }
    assert_eq!(bench.device.rendered, Wrench::ZERO);
    assert_eq!(bench.monitor.sample().statistics.refused_epoch, 16);
}

#[test]
fn a_zombie_with_100_newtons_is_refused_while_its_successor_ramps_in() {
    let mut bench = bench();
    let mut zombie = bench.slot.take(1).unwrap();
    bench.push(&mut zombie, 0.5, 100 * MS);
    bench.slot.fence().raise(2);
    let mut successor = bench.slot.take(2).unwrap();
    let start = bench.now_ns;
    for step in 1..=200 {
        let time_ns = bench.now_ns + MS;
        // With its own epoch, with its successor's, with the highest.
        zombie.command(force([1, 2, u32::MAX][step % 3], time_ns, 100.0));
        successor.command(force(2, time_ns, 1.0));
        bench.step();
        let rendered = bench.device.rendered.force.x;
        assert!(rendered <= 1.0 + 1e-12, "{rendered} N");
        if bench.now_ns - start <= 51 * MS {
            assert!(rendered <= 0.5f64.max((bench.now_ns - start) as f64 / (50 * MS) as f64));
        }
    }
    assert!((bench.device.rendered.force.x - 1.0).abs() < 1e-12);
    let sample = bench.monitor.sample();
    assert_eq!((sample.statistics.refused_epoch, sample.epoch), (200, 2));
}

#[test]
fn a_link_whose_commands_state_an_earlier_epoch_than_the_last_obeyed_is_refused() {
    let mut bench = bench();
    let mut link = bench.slot.take(3).unwrap();
    bench.push(&mut link, 1.0, 100 * MS);
    link.command(force(2, bench.now_ns + MS, 1.0));
    bench.step();
    assert_eq!(bench.monitor.sample().statistics.refused_epoch, 1);
}

#[test]
fn nan_and_infinity_are_refused_and_the_last_force_fades() {
    let mut bench = bench();
    let mut link = bench.slot.take(1).unwrap();
    bench.push(&mut link, 2.0, 100 * MS);
    let bad_pose = Isometry3::translation(f64::NAN, 0.0, 0.0);
    for step in 0..20 {
        let mut command = force(1, bench.now_ns + MS, [f64::NAN, f64::INFINITY, 2.0, 2.0][step % 4]);
        match step % 4 {
            2 => command.intent = Some(HandIntent::at(bad_pose, 0.0)),
            3 => command.wrench.torque.z = f64::NEG_INFINITY,
            _ => {}
        }
        link.command(command);
        bench.step();
        assert!(bench.device.rendered.is_finite());
    }
    assert_eq!(bench.device.rendered, Wrench::ZERO);
    assert_eq!(bench.monitor.sample().statistics.refused_invalid, 20);
    assert_eq!(bench.device.intent, None);
}

#[test]
fn an_emergency_stops_all_force_at_the_next_step_and_for_good() {
    let mut bench = bench();
    let mut link = bench.slot.take(1).unwrap();
    bench.push(&mut link, 3.0, 100 * MS);
    let fence = bench.core.fence().clone();
    std::thread::spawn(move || fence.zero_all_forces()).join().unwrap();
    bench.push(&mut link, 3.0, MS);
    assert_eq!(bench.device.rendered, Wrench::ZERO);
    bench.push(&mut link, 3.0, 100 * MS);
    assert_eq!(bench.device.rendered, Wrench::ZERO);
    assert!(bench.slot.take(u32::MAX).is_err());
}

#[test]
fn an_unplugged_device_feels_nothing_and_ramps_in_when_it_is_back() {
    let mut bench = bench();
    let mut link = bench.slot.take(1).unwrap();
    bench.device.state.linear_velocity = Vector3::new(0.1, 0.0, 0.0);
    bench.push(&mut link, 2.0, 100 * MS);
    bench.device.read_error = Some(DeviceError::Disconnected);
    bench.device.open_error = Some(DeviceError::Disconnected);
    let sample = bench.push(&mut link, 2.0, MS);
    assert_eq!((bench.device.rendered, sample.applied), (Wrench::ZERO, Wrench::ZERO));
    assert!(!sample.state.connected && sample.state.linear_velocity == Vector3::zeros());

    bench.push(&mut link, 2.0, 1_000 * MS);
    // Once at the start, then every 100 ms.
    assert!((9..=12).contains(&bench.device.opens), "{} attempts", bench.device.opens);

    bench.device.read_error = None;
    bench.device.open_error = None;
    let mut back_at = None;
    for _ in 0..101 {
        let sample = bench.push(&mut link, 2.0, MS);
        if sample.state.connected {
            back_at.get_or_insert(bench.now_ns);
            assert_eq!(bench.device.rendered, Wrench::ZERO);
            break;
        }
    }
    assert!(back_at.is_some());
    let sample = bench.push(&mut link, 2.0, 25 * MS);
    assert!((sample.applied.force.x - 0.99).abs() < 1e-7, "{}", sample.applied.force.x);
    assert_eq!((sample.statistics.unplugs, sample.statistics.reopens), (1, 1));
}

#[test]
fn a_device_that_is_lost_while_writing_is_unplugged_too() {
    let mut bench = bench();
    let mut link = bench.slot.take(1).unwrap();
    bench.push(&mut link, 2.0, 100 * MS);
    bench.device.write_error = Some(DeviceError::Disconnected);
    let sample = bench.push(&mut link, 2.0, MS);
    assert!(!sample.state.connected && sample.applied == Wrench::ZERO);
}

#[test]
fn the_unplug_fault_looks_like_the_real_thing_and_heals() {
    let mut bench = bench();
    let mut link = bench.slot.take(1).unwrap();
    bench.push(&mut link, 2.0, 100 * MS);
    bench.faults.unplug_until(bench.now_ns + 300 * MS);
    let sample = bench.push(&mut link, 2.0, 200 * MS);
    assert!(!sample.state.connected && bench.device.rendered == Wrench::ZERO);
    let sample = bench.push(&mut link, 2.0, 300 * MS);
    assert!(sample.state.connected);
    assert!((bench.device.rendered.force.x - 2.0).abs() < 1e-12);
}

#[test]
fn readings_of_nan_are_refused_and_the_force_fades_with_their_age() {
    let mut bench = bench();
    let mut link = bench.slot.take(1).unwrap();
    bench.device.state.gripper = 0.4;
    bench.push(&mut link, 2.0, 100 * MS);
    let sampled_at_ns = bench.monitor.sample().sampled_at_ns;
    bench.faults.nan_until(bench.now_ns + 30 * MS);
    let sample = bench.push(&mut link, 2.0, 12 * MS);
    assert!(sample.state.is_valid() && (sample.state.gripper - 0.4).abs() < 1e-9);
    assert_eq!(sample.sampled_at_ns, sampled_at_ns);
    assert!((sample.applied.force.x - 2.0 * 8.0 / 15.0).abs() < 1e-7);
    let sample = bench.push(&mut link, 2.0, 8 * MS);
    assert_eq!((sample.applied, sample.statistics.readings_refused), (Wrench::ZERO, 20));
    let sample = bench.push(&mut link, 2.0, 70 * MS);
    assert!((sample.applied.force.x - 2.0).abs() < 1e-12);
}

#[test]
fn a_reading_that_fails_now_and_then_is_bridged() {
    let mut bench = bench();
    let mut link = bench.slot.take(1).unwrap();
    bench.push(&mut link, 2.0, 100 * MS);
    for step in 0..60 {
        bench.device.read_error = (step % 3 != 0).then_some(DeviceError::Transfer(5));
        let sample = bench.push(&mut link, 2.0, MS);
        assert!(sample.state.connected && (sample.applied.force.x - 2.0).abs() < 1e-12);
    }
    assert_eq!(bench.monitor.sample().statistics.device_errors, 40);
}

#[test]
fn a_device_that_gives_no_reading_for_200_ms_counts_as_unplugged() {
    let mut bench = bench();
    let mut link = bench.slot.take(1).unwrap();
    bench.push(&mut link, 2.0, 100 * MS);
    bench.device.read_error = Some(DeviceError::Fault("warm motors"));
    assert!(bench.push(&mut link, 2.0, 199 * MS).state.connected);
    assert!(!bench.push(&mut link, 2.0, MS).state.connected);
}

#[test]
fn held_and_delayed_readings_state_their_age() {
    let mut bench = bench();
    let move_to = |bench: &mut Bench<ScriptedDevice>| {
        let x = (bench.now_ns + MS) as f64 * 1e-9;
        bench.device.state.pose_in_device.translation.vector.x = x;
        bench.step()
    };
    for _ in 0..100 {
        let sample = move_to(&mut bench);
        assert_eq!(sample.sampled_at_ns, bench.now_ns);
    }
    bench.faults.delay_until(7 * MS, 150 * MS);
    for _ in 0..49 {
        let sample = move_to(&mut bench);
        assert_eq!(sample.sampled_at_ns, bench.now_ns - 7 * MS);
        let off = sample.state.pose_in_device.translation.x - sample.sampled_at_ns as f64 * 1e-9;
        assert!(off.abs() < 1e-12, "{off} m");
    }
    assert_eq!(move_to(&mut bench).sampled_at_ns, 150 * MS);
    bench.faults.hold_until(170 * MS);
    for _ in 0..19 {
        let sample = move_to(&mut bench);
        assert_eq!(sample.sampled_at_ns, 150 * MS);
        assert!((sample.state.pose_in_device.translation.x - 0.15).abs() < 1e-12);
    }
    assert_eq!(move_to(&mut bench).sampled_at_ns, 170 * MS);
}

#[test]
fn a_delay_longer_than_the_memory_gives_the_oldest_reading_kept() {
    let mut bench = bench();
    bench.idle(3_000 * MS);
    bench.faults.delay_until(10_000 * MS, u64::MAX);
    assert_eq!(bench.step().sampled_at_ns, bench.now_ns - 1_023 * MS);
}

#[test]
fn shutting_down_leaves_the_device_closed_and_without_force() {
    let mut bench = bench();
    let mut link = bench.slot.take(1).unwrap();
    bench.push(&mut link, 2.0, 100 * MS);
    bench.core.shut_down(bench.now_ns + MS, &mut bench.device);
    assert!(bench.device.closed && bench.device.rendered == Wrench::ZERO);
    assert!(!link.sample().state.connected);
    let opens = bench.device.opens;
    bench.push(&mut link, 2.0, 500 * MS);
    assert_eq!((bench.device.rendered, bench.device.opens), (Wrench::ZERO, opens));
}

#[derive(Clone, Debug)]
enum Happening {
    Command { link: usize, epoch: u32, time_offset_ms: i64, force: [f64; 3] },
    Fence(u32),
    Take(u32),
    Unplug(u64),
    Nan(u64),
    ReadError(bool),
    WriteError(bool),
    Pass(u64),
}

fn newtons() -> impl Strategy<Value = f64> {
    prop_oneof![4 => -10.0..10.0, 1 => Just(f64::NAN), 1 => Just(1e308), 1 => Just(f64::NEG_INFINITY)]
}

fn happening() -> impl Strategy<Value = Happening> {
    prop_oneof![
        8 => (0..4_usize, 0..6_u32, -30..30_i64, [newtons(), newtons(), newtons()]).prop_map(
            |(link, epoch, time_offset_ms, force)| Happening::Command { link, epoch, time_offset_ms, force }
        ),
        1 => (0..6_u32).prop_map(Happening::Fence),
        2 => (0..6_u32).prop_map(Happening::Take),
        1 => (0..40_u64).prop_map(Happening::Unplug),
        1 => (0..40_u64).prop_map(Happening::Nan),
        1 => any::<bool>().prop_map(Happening::ReadError),
        1 => any::<bool>().prop_map(Happening::WriteError),
        8 => (0..30_000_u64).prop_map(Happening::Pass),
    ]
}

proptest! {
    #[test]
    fn whatever_happens_the_wrench_is_finite_within_limits_and_smooth(
        happenings in prop::collection::vec(happening(), 0..300)
    ) {
        let mut bench = bench();
        let mut links = vec![bench.slot.take(0).unwrap()];
        for happening in happenings {
            let before = bench.device.rendered;
            match happening {
                Happening::Command { link, epoch, time_offset_ms, force } => {
                    let time_ns = bench.now_ns.saturating_add_signed(time_offset_ms * MS as i64);
                    let wrench = Wrench::from_force(Vector3::from(force));
                    let count = links.len();
                    links[link % count].command(DeviceCommand { epoch, time_ns, wrench, passivity: true, intent: None });
                }
                Happening::Fence(epoch) => bench.slot.fence().raise(epoch),
                Happening::Take(epoch) => {
                    if let Ok(link) = bench.slot.take(epoch) { links.push(link) }
                    if links.len() > 5 { links.remove(0); }
                }
                Happening::Unplug(ms) => bench.faults.unplug_until(bench.now_ns + ms * MS),
                Happening::Nan(ms) => bench.faults.nan_until(bench.now_ns + ms * MS),
                Happening::ReadError(on) => bench.device.read_error = on.then_some(DeviceError::Transfer(1)),
                Happening::WriteError(on) => bench.device.write_error = on.then_some(DeviceError::Disconnected),
                Happening::Pass(micros) => bench.now_ns += micros * 1_000,
            }
            let step_ns = bench.now_ns - bench.monitor.sample().published_at_ns;
            bench.core.step(bench.now_ns, &mut bench.device);
            let now = bench.device.rendered;
            prop_assert!(now.is_finite() && now.force.norm() <= 3.3 && now.torque == Vector3::zeros());
            // What is left of a force may be any part of it; from there it grows and turns slowly.
            let along = before.force.dot(&now.force) / before.force.norm_squared().max(1e-300);
            let change = (now.force - before.force * along.clamp(0.0, 1.0)).norm();
            let allowed = 2_000.0 * step_ns.min(2 * MS) as f64 * 1e-9 + 1e-12;
            prop_assert!(change <= allowed, "{} N in {} ns", change, step_ns);
            let sample = bench.monitor.sample();
            prop_assert!(sample.state.is_valid());
        }
    }
}

//! What the door guarantees, whatever arrives.

use nalgebra::{Isometry3, Quaternion, UnitQuaternion, Vector3};
use proptest::prelude::*;
use trocar_devices::{Capabilities, DeviceState, Dofs, Pedals, Workspace, Wrench};
use trocar_scene::SimTime;

use super::*;
use crate::hand_sample::HandSample;

const HAND: u8 = 1;
const MS: u64 = 1_000_000;

pub(super) fn capabilities() -> Capabilities {
    Capabilities {
        name: "bench".into(),
        workspace: Workspace::centred(Vector3::new(0.16, 0.12, 0.07)),
        max_force_newtons: 3.3,
        max_torque: 0.1,
        max_stiffness: 1000.0,
        input_dofs: Dofs::Six,
        output_dofs: Dofs::Six,
        apparent_mass: 0.05,
    }
}

pub(super) fn sample_at(position: [f64; 3]) -> HandSample {
    let pose_in_device = Isometry3::translation(position[0], position[1], position[2]);
    let state = DeviceState { pose_in_device, connected: true, ..DeviceState::unknown() };
    HandSample { state, ..HandSample::unknown(HAND) }
}

fn pressed(buttons: u32) -> HandSample {
    let mut sample = sample_at([0.0; 3]);
    sample.state.buttons = buttons;
    sample
}

/// A door, fed and stepped each millisecond.
struct Bench {
    door: Door,
    now_ns: u64,
}

impl Bench {
    fn new() -> Self {
        Self { door: Door::new(HAND, DoorLimits::default(), &capabilities()).unwrap(), now_ns: 0 }
    }

    fn now(&self) -> SimTime {
        SimTime(self.now_ns)
    }

    fn feed(&mut self, sample: &HandSample) -> DeviceState {
        self.now_ns += MS;
        let _ = self.door.admit(self.now(), self.now(), sample);
        self.door.step(self.now())
    }

    fn feed_for(&mut self, millis: u64, sample: &HandSample) -> DeviceState {
        (0..millis).map(|_| self.feed(sample)).last().unwrap()
    }

    fn wait(&mut self, millis: u64) -> DeviceState {
        (0..millis)
            .map(|_| {
                self.now_ns += MS;
                self.door.step(self.now())
            })
            .last()
            .unwrap()
    }
}

fn x(state: &DeviceState) -> f64 {
    state.pose_in_device.translation.vector.x
}

#[test]
fn a_hand_at_a_kilohertz_is_passed_without_delay() {
    let mut bench = Bench::new();
    for step in 0..500_u32 {
        let at = [0.05 * (f64::from(step) * 0.01).sin(), 0.0, 0.0];
        let state = bench.feed(&sample_at(at));
        assert!((x(&state) - at[0]).abs() < 1e-15, "step {step}");
    }
    assert_eq!(bench.door.statistics().speed_limited, 0);
    assert_eq!(bench.door.statistics().admitted, 500);
}

#[test]
fn a_slow_stream_is_spread_and_does_not_hammer() {
    let mut bench = Bench::new();
    let mut fastest: f64 = 0.0;
    let mut before = 0.0;
    for step in 0..2_000_u64 {
        // 0.1 m/s, at 62.5 Hz.
        let at = [1e-4 * (step % 700) as f64 - 0.035, 0.0, 0.0];
        let state = if step % 16 == 0 { bench.feed(&sample_at(at)) } else { bench.wait(1) };
        if step % 700 > 200 {
            fastest = fastest.max((x(&state) - before) / 1e-3);
        }
        before = x(&state);
    }
    assert!(fastest < 0.101, "a hand of 0.1 m/s moved at {fastest} m/s");
}

#[test]
fn nan_is_refused_and_counted_and_the_hand_stays() {
    let mut bench = Bench::new();
    let before = bench.feed_for(10, &sample_at([0.01, 0.0, 0.0]));
    let good = sample_at([0.01, 0.0, 0.0]);
    let mut bad = [good; 5];
    bad[0].state.pose_in_device.translation.vector.y = f64::NAN;
    bad[1].state.angular_velocity.z = f64::INFINITY;
    bad[2].state.gripper = f64::NAN;
    bad[3].wrench.force.x = f64::NAN;
    bad[4].state.pose_in_device.rotation = UnitQuaternion::new_unchecked(Quaternion::new(0.0, 0.0, 0.0, 0.0));
    for sample in &bad {
        assert_eq!(bench.door.admit(bench.now(), bench.now(), sample), Err(Refusal::Invalid { hand: HAND }));
    }
    assert_eq!(bench.door.statistics().refused_invalid, 5);
    assert_eq!(bench.wait(1).pose_in_device, before.pose_in_device);
}

#[test]
fn a_station_that_sends_only_nonsense_falls_silent() {
    let mut bench = Bench::new();
    bench.feed_for(10, &sample_at([0.0; 3]));
    let mut bad = sample_at([0.0; 3]);
    bad.state.gripper = f64::NAN;
    bench.feed_for(100, &bad);
    assert_eq!(bench.door.standing(), Standing::Silent);
}

#[test]
fn a_kilonewton_is_clamped_to_the_device_and_counted() {
    let mut bench = Bench::new();
    let wrench = Wrench { force: Vector3::new(0.0, 1_000.0, 0.0), torque: Vector3::new(50.0, 0.0, 0.0) };
    bench.feed(&HandSample { wrench, ..sample_at([0.0; 3]) });
    let passed = bench.door.wrench(bench.now());
    assert!((passed.force.norm() - 3.3).abs() < 1e-12 && (passed.torque.norm() - 0.1).abs() < 1e-12);
    assert_eq!(bench.door.statistics().clamped_wrench, 1);
    let three = Capabilities { output_dofs: Dofs::Three, ..capabilities() };
    let mut door = Door::new(HAND, DoorLimits::default(), &three).unwrap();
    door.admit(SimTime::ZERO, SimTime::ZERO, &HandSample { wrench, ..sample_at([0.0; 3]) }).unwrap();
    assert_eq!(door.wrench(SimTime::ZERO).torque, Vector3::zeros());
}

#[test]
fn a_jump_of_a_metre_becomes_an_approach_within_the_workspace() {
    let mut bench = Bench::new();
    bench.feed_for(10, &sample_at([0.0; 3]));
    let mut before = 0.0;
    for _ in 0..200 {
        let state = bench.feed(&sample_at([1.0, 0.0, 0.0]));
        assert!(x(&state) - before <= 1e-3 + 1e-12 && x(&state) <= 0.08);
        before = x(&state);
    }
    assert_eq!(before, 0.08);
    let counted = bench.door.statistics();
    assert_eq!(counted.clamped_workspace, 200);
    assert!((79..=81).contains(&counted.speed_limited), "{counted:?}");
}

#[test]
fn one_sample_that_jumps_moves_the_hand_by_a_millimetre_at_most() {
    let mut bench = Bench::new();
    bench.feed_for(10, &sample_at([0.0; 3]));
    let jumped = bench.feed(&sample_at([0.07, 0.0, 0.0]));
    assert!(x(&jumped) <= 1e-3 + 1e-12);
    assert_eq!(x(&bench.feed_for(2, &sample_at([0.0; 3]))), 0.0);
}

#[test]
fn a_claimed_velocity_is_not_believed() {
    let mut bench = Bench::new();
    let mut sample = sample_at([0.01, 0.0, 0.0]);
    sample.state.linear_velocity = Vector3::new(1e6, 0.0, 0.0);
    let state = bench.feed_for(100, &sample);
    assert_eq!(state.linear_velocity, Vector3::zeros());
}

#[test]
fn samples_of_other_hands_and_of_the_past_are_refused() {
    let mut bench = Bench::new();
    bench.feed_for(200, &sample_at([0.0; 3]));
    let other = HandSample { hand: 7, ..sample_at([0.05, 0.0, 0.0]) };
    let refused = bench.door.admit(bench.now(), bench.now(), &other).unwrap_err();
    assert_eq!(refused.to_string(), "the sample is of hand 7, and this door admits hand 1");
    let earlier = SimTime(bench.now_ns - MS);
    let refused = bench.door.admit(bench.now(), earlier, &sample_at([0.05, 0.0, 0.0]));
    assert_eq!(refused, Err(Refusal::Older { hand: HAND }));
    assert_eq!(x(&bench.wait(1)), 0.0);
}

#[test]
fn an_arrival_in_the_future_does_not_keep_a_dead_station_alive() {
    let mut bench = Bench::new();
    bench.door.admit(SimTime(MS), SimTime(u64::MAX), &sample_at([0.0; 3])).unwrap();
    bench.now_ns = MS;
    bench.wait(99);
    assert_eq!(bench.door.standing(), Standing::Live);
    bench.wait(1);
    assert_eq!(bench.door.standing(), Standing::Silent);
}

#[test]
fn a_force_is_full_until_50_ms_and_zero_from_100_ms_after_the_last_arrival() {
    let mut bench = Bench::new();
    let wrench = Wrench::from_force(Vector3::new(0.0, 0.0, 2.0));
    bench.feed(&HandSample { wrench, ..sample_at([0.0; 3]) });
    let force = |bench: &Bench| bench.door.wrench(bench.now()).force.z;
    bench.wait(50);
    assert_eq!(force(&bench), 2.0);
    bench.wait(25);
    assert!((force(&bench) - 1.0).abs() < 1e-9);
    bench.wait(25);
    assert_eq!(force(&bench), 0.0);
}

#[test]
fn a_path_of_a_second_is_no_staleness() {
    let mut bench = Bench::new();
    let wrench = Wrench::from_force(Vector3::new(0.0, 0.0, 2.0));
    let late = HandSample { wrench, age_us: 1_000_000, ..sample_at([0.0; 3]) };
    bench.feed_for(300, &late);
    assert_eq!(bench.door.wrench(bench.now()).force.z, 2.0);
    assert_eq!(bench.door.standing(), Standing::Live);
}

#[test]
fn silence_releases_the_pedal_holds_the_jaws_and_stops_the_motion() {
    let mut bench = Bench::new();
    let mut sample = sample_at([0.0; 3]);
    sample.state.gripper = 0.4;
    bench.feed_for(10, &sample);
    sample.state.buttons = 1;
    assert_eq!(bench.feed(&sample).buttons, 1);
    let before = bench.wait(99);
    assert_eq!((before.buttons, bench.door.standing()), (1, Standing::Live));
    let silent = bench.wait(1);
    assert_eq!((silent.buttons, silent.gripper, silent.connected), (0, 0.4, true));
    assert_eq!(bench.door.standing(), Standing::Silent);
    assert_eq!(bench.wait(500).gripper, 0.4);
    assert_eq!(bench.door.statistics().silences, 1);
}

#[test]
fn silence_releases_the_foot_pedal_and_it_counts_once_it_has_been_released() {
    let mut bench = Bench::new();
    let asked = |pedals: Pedals| pressed(pedals.buttons());
    let pedals = |state: DeviceState| Pedals::of(state.buttons);
    assert_eq!(
        pedals(bench.feed_for(10, &asked(Pedals::Coagulate))),
        Pedals::Released,
        "pressed from the start"
    );
    assert_eq!(pedals(bench.feed(&asked(Pedals::Released))), Pedals::Released);
    assert_eq!(pedals(bench.feed(&asked(Pedals::Coagulate))), Pedals::Coagulate);
    assert_eq!(pedals(bench.wait(99)), Pedals::Coagulate);
    // It has pedals still, so that nobody else's script switches its instrument.
    assert_eq!(pedals(bench.wait(1)), Pedals::Released);
    assert_eq!(pedals(bench.feed_for(10, &asked(Pedals::Coagulate))), Pedals::Released);
    bench.feed(&asked(Pedals::Released));
    assert_eq!(pedals(bench.feed(&asked(Pedals::Energy))), Pedals::Energy);
    // Another owner, without pedals.
    let now = bench.now();
    bench.door.open(now, None);
    assert_eq!(pedals(bench.feed_for(10, &pressed(0))), Pedals::None);
}

#[test]
fn a_motion_that_silence_stops_slows_down_smoothly_and_never_passes_its_goal() {
    // A wide workspace, so that the approach is still going on when the station falls silent.
    let wide = Capabilities { workspace: Workspace::centred(Vector3::repeat(2.0)), ..capabilities() };
    let mut bench = Bench { door: Door::new(HAND, DoorLimits::default(), &wide).unwrap(), now_ns: 0 };
    bench.feed_for(10, &sample_at([0.0; 3]));
    bench.feed(&sample_at([0.13, 0.0, 0.0]));
    let mut state = bench.wait(99);
    assert!((x(&state) - 0.1).abs() < 1e-9 && (state.linear_velocity.x - 1.0).abs() < 1e-9);
    let (mut speed, mut silent_for) = (1.0 + 1e-9, 0);
    while state.linear_velocity.x > 1e-6 {
        let after = bench.wait(1);
        silent_for += 1;
        // The low pass follows the 20 m/s² of the motion.
        assert!((0.0..=0.021).contains(&(speed - after.linear_velocity.x)), "{silent_for} ms");
        assert!(x(&after) >= x(&state) && x(&after) <= 0.13);
        speed = after.linear_velocity.x;
        state = after;
    }
    assert!((40..100).contains(&silent_for), "{silent_for} ms");
    assert!(x(&state) > 0.12 && x(&state) < 0.126);
    assert_eq!(bench.wait(100).pose_in_device, state.pose_in_device);
}

#[test]
fn a_return_after_silence_moves_nothing_and_continues_by_the_clutch() {
    let mut bench = Bench::new();
    bench.feed_for(10, &sample_at([0.0; 3]));
    let before = bench.wait(150);
    let mut away = sample_at([0.06, -0.02, 0.01]);
    away.state.pose_in_device.rotation = UnitQuaternion::from_scaled_axis(Vector3::new(0.5, -1.0, 2.0));
    let back = bench.feed(&away);
    let moved = (back.pose_in_device.translation.vector - before.pose_in_device.translation.vector).norm();
    assert!(moved < 1e-15, "{moved} m");
    assert!(back.pose_in_device.rotation.angle_to(&before.pose_in_device.rotation) < 1e-7);
    away.state.pose_in_device.translation.vector.x += 5e-4;
    assert!((x(&bench.feed(&away)) - x(&before) - 5e-4).abs() < 1e-12);
    assert_eq!(bench.door.statistics().returns, 1);
}

#[test]
fn a_hand_that_its_station_offers_anew_is_taken_up_from_where_the_instrument_is_without_a_silence() {
    let mut bench = Bench::new();
    bench.feed_for(10, &sample_at([0.0; 3]));
    bench.wait(150);
    // Back after a silence, 20 mm from where the instrument is.
    bench.feed_for(50, &sample_at([0.02, 0.0, 0.0]));
    assert_eq!((bench.door.statistics().clutches, x(&bench.door.state())), (2, 0.0));
    // The station brings its hand to the instrument, and offers it there sooner than it would have fallen silent.
    bench.wait(60);
    let offered = HandSample { clutch: 1, ..sample_at([0.0; 3]) };
    assert!(x(&bench.feed_for(50, &offered)).abs() < 1e-15, "nothing moves by it");
    assert_eq!(bench.door.statistics().clutches, 3);
    let moved = HandSample { clutch: 1, ..sample_at([0.01, 0.0, 0.0]) };
    assert!((x(&bench.feed_for(50, &moved)) - 0.01).abs() < 1e-15, "both are at one place");
    assert_eq!((bench.door.statistics().clutches, bench.door.statistics().silences), (3, 1));
    // For a station's own hand, which goes where the host has it, the host's count is no offer.
    let mut mirror = Bench::new();
    mirror.door.set_mirroring(true);
    for clutch in 0..5 {
        mirror.feed_for(50, &HandSample { clutch, ..sample_at([0.01, 0.0, 0.0]) });
    }
    assert_eq!(mirror.door.statistics().clutches, 1);
}

#[test]
fn a_pedal_held_through_silence_must_be_released_and_pressed_again() {
    let mut bench = Bench::new();
    bench.feed_for(5, &pressed(0));
    assert_eq!(bench.feed(&pressed(0b101)).buttons, 0b101);
    bench.wait(150);
    assert_eq!(bench.feed_for(50, &pressed(0b101)).buttons, 0);
    assert_eq!(bench.feed(&pressed(0b001)).buttons, 0);
    assert_eq!(bench.feed(&pressed(0b101)).buttons, 0b100, "button 0 is still the press from before");
    assert_eq!(bench.feed(&pressed(0)).buttons, 0);
    assert_eq!(bench.feed(&pressed(0b001)).buttons, 0b001);
}

#[test]
fn a_pedal_that_is_down_when_the_station_comes_does_not_count() {
    let mut bench = Bench::new();
    assert_eq!(bench.feed_for(20, &pressed(1)).buttons, 0);
    bench.feed(&pressed(0));
    assert_eq!(bench.feed(&pressed(1)).buttons, 1);
    assert_eq!(bench.feed(&pressed(0xdea8_0001)).buttons, 1, "a sample has 16 buttons, and pedals");
}

#[test]
fn jaws_that_hold_something_wait_for_the_fingers_after_a_return() {
    let mut bench = Bench::new();
    let fingers = |gripper: f64| {
        let mut sample = sample_at([0.0; 3]);
        sample.state.gripper = gripper;
        sample
    };
    bench.door.set_holding(true);
    bench.feed_for(10, &fingers(0.2));
    bench.wait(150);
    assert_eq!(bench.feed_for(300, &fingers(1.0)).gripper, 0.2);
    bench.feed(&fingers(0.25));
    assert!(bench.feed_for(300, &fingers(1.0)).gripper > 0.99);
    let wide = bench.feed_for(300, &fingers(40.0)).gripper;
    assert_eq!(wide, DoorLimits::default().gripper_max);
    assert!(bench.door.statistics().clamped_gripper >= 300 && bench.door.statistics().gripper_limited > 0);
}

#[test]
fn an_unplugged_device_at_the_station_is_shown_as_unplugged_and_returns_by_the_clutch() {
    let mut bench = Bench::new();
    bench.feed_for(10, &pressed(0));
    bench.feed(&pressed(1));
    let mut gone = sample_at([0.05, 0.0, 0.0]);
    gone.state.connected = false;
    let state = bench.feed(&gone);
    assert_eq!((state.connected, state.buttons, bench.door.standing()), (false, 0, Standing::Unplugged));
    assert_eq!(x(&state), 0.0);
    let state = bench.feed(&sample_at([0.05, 0.0, 0.0]));
    assert!(state.connected && x(&state).abs() < 1e-15);
}

#[test]
fn a_workspace_that_is_no_box_is_refused() {
    let mut bad = capabilities();
    bad.workspace.min_in_device.x = 1.0;
    let error = Door::new(HAND, DoorLimits::default(), &bad).unwrap_err();
    assert!(error.to_string().contains("\"bench\""), "{error}");
}

/// Numbers as a hostile station would choose them.
fn number() -> impl Strategy<Value = f64> {
    prop_oneof![
        6 => -0.2..0.2,
        2 => -5.0..5.0,
        1 => any::<f64>(),
        1 => prop::sample::select(vec![f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 1e308, -1e308, 0.0, -0.0]),
    ]
}

fn vector() -> impl Strategy<Value = Vector3<f64>> {
    prop::array::uniform3(number()).prop_map(Vector3::from)
}

fn rotation() -> impl Strategy<Value = UnitQuaternion<f64>> {
    prop_oneof![
        4 => prop::array::uniform3(-4.0..4.0_f64)
            .prop_map(|turn| UnitQuaternion::from_scaled_axis(Vector3::from(turn))),
        1 => prop::array::uniform4(number())
            .prop_map(|q| UnitQuaternion::new_unchecked(Quaternion::new(q[0], q[1], q[2], q[3]))),
    ]
}

fn any_sample() -> impl Strategy<Value = HandSample> {
    let state =
        (vector(), rotation(), vector(), vector(), number(), any::<u32>(), prop::bool::weighted(0.95));
    (prop::sample::select(vec![HAND, HAND, HAND, HAND, 0]), state, vector(), vector()).prop_map(
        |(
            hand,
            (at, rotation, linear_velocity, angular_velocity, gripper, buttons, connected),
            force,
            torque,
        )| {
            let pose_in_device = Isometry3::from_parts(at.into(), rotation);
            let state = DeviceState {
                pose_in_device,
                linear_velocity,
                angular_velocity,
                gripper,
                buttons,
                connected,
            };
            HandSample { state, wrench: Wrench { force, torque }, ..HandSample::unknown(hand) }
        },
    )
}

/// A sample or none, and the time to the next step \[µs\].
fn stream() -> impl Strategy<Value = Vec<(Option<HandSample>, u64)>> {
    let step_us = prop_oneof![8 => 1_000_u64..1_001, 3 => 0_u64..20_000, 1 => 50_000_u64..400_000];
    prop::collection::vec((prop::option::weighted(0.7, any_sample()), step_us), 1..120)
}

fn run(stream: &[(Option<HandSample>, u64)], mut check: impl FnMut(f64, &DeviceState, &Wrench)) {
    let mut door = Door::new(HAND, DoorLimits::default(), &capabilities()).unwrap();
    let mut now_ns = 0;
    for (sample, step_us) in stream {
        now_ns += step_us * 1_000;
        let now = SimTime(now_ns);
        if let Some(sample) = sample {
            let _ = door.admit(now, now, sample);
        }
        let state = door.step(now);
        check(*step_us as f64 * 1e-6, &state, &door.wrench(now));
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 400, ..ProptestConfig::default() })]

    #[test]
    fn whatever_arrives_the_hand_is_finite_in_its_workspace_and_within_every_limit(stream in stream()) {
        let limits = DoorLimits::default();
        let workspace = capabilities().workspace;
        let mut before: Option<DeviceState> = None;
        run(&stream, |step_secs, state, wrench| {
            assert!(state.is_valid(), "{state:?}");
            assert_eq!(workspace.excess(&state.pose_in_device.translation.vector), Vector3::zeros());
            assert!(state.linear_velocity.norm() <= limits.linear_speed * (1.0 + 1e-9));
            assert!(state.angular_velocity.norm() <= limits.angular_speed * (1.0 + 1e-9));
            assert!((0.0..=limits.gripper_max).contains(&state.gripper));
            assert!(state.buttons <= 0x7_ffff);
            assert!(wrench.is_finite());
            assert!(wrench.force.norm() <= 3.3 * (1.0 + 1e-12));
            assert!(wrench.torque.norm() <= 0.1 * (1.0 + 1e-12));
            // The first state with a place has nothing to jump from.
            if let Some(before) = before.filter(|before| *before != DeviceState::unknown()) {
                let (from, to) = (before.pose_in_device, state.pose_in_device);
                let moved = (to.translation.vector - from.translation.vector).norm();
                assert!(moved <= limits.linear_speed * step_secs + 1e-12, "{moved} m in {step_secs} s");
                let turned = from.rotation.angle_to(&to.rotation);
                assert!(turned <= limits.angular_speed * step_secs + 1e-7, "{turned} rad in {step_secs} s");
                let closed = (state.gripper - before.gripper).abs();
                assert!(closed <= limits.gripper_speed * step_secs + 1e-12);
            }
            before = Some(*state);
        });
    }

    #[test]
    fn the_same_stream_gives_the_same_bits(stream in stream()) {
        let [mut first, mut second] = [vec![], vec![]];
        for out in [&mut first, &mut second] {
            run(&stream, |_, state, wrench| out.push((*state, *wrench)));
        }
        prop_assert_eq!(first, second);
    }
}

//! Tests of a reflected hand over a virtual hand, its link and a reflector.

use nalgebra::Vector3;
use trocar_devices::{Pedals, VirtualHand, VirtualHandConfig};
use trocar_kernel::spec::Peer;
use trocar_scene::SlaveState;

use super::super::reflected_link::ReflectedLink;
use super::*;
use crate::impairments::Impairments;
use crate::lockstep::ReflectedPeer;
use crate::reflector::Reflector;

/// A virtual hand behind a path of 80 ms, which follows this target along x \[m\] by the time \[s\]. Returns what the device
/// showed each millisecond, and the last report.
fn run(
    config: SlaveConfig,
    ms: u64,
    target: impl Fn(f64) -> f64,
    force: Vector3<f64>,
) -> (Vec<DeviceState>, Vec<SlaveReport>) {
    let master = VirtualHand::new(VirtualHandConfig::default()).expect("the defaults are valid");
    let (mut hand, linked, mut watched) =
        ReflectedHand::new(0, config, Box::new(master)).expect("it is valid");
    let (link, _watch) = ReflectedLink::new((), vec![linked], None).expect("a key");
    let path = Impairments::delay(SimTime::from_millis(80));
    let mut peer = ReflectedPeer::new("path", link, Reflector::new(&path, 1));
    hand.open(0).expect("a virtual hand is there");
    let (mut shown, mut reports) = (Vec::new(), Vec::new());
    for step in 0..ms {
        let now_ns = step * 1_000_000;
        let pose_in_device = Isometry3::translation(target(step as f64 * 1e-3), 0.0, 0.0);
        hand.set_intent(now_ns, &HandIntent::at(pose_in_device, 0.2));
        shown.push(hand.read(now_ns).expect("it is read"));
        hand.write(now_ns, &Wrench::from_force(force)).expect("it is there");
        peer.step(SimTime(now_ns));
        reports.push(watched.reports.read().expect("it reports"));
    }
    (shown, reports)
}

fn swing(secs: f64) -> f64 {
    0.03 * (3.0 * secs).sin()
}

#[test]
fn the_shown_pose_is_the_masters_of_a_round_trip_ago() {
    let (shown, reports) = run(SlaveConfig::default(), 3_000, swing, Vector3::zeros());
    // Nothing is shown before the first packet is back: 80 ms, and the next step.
    let first = shown.iter().position(|state| state.connected).expect("it arrives");
    assert_eq!(first, 81);
    for ms in 200..3_000 {
        let master = reports[ms - 81].master_in_device.translation.x;
        assert!((shown[ms].pose_in_device.translation.x - master).abs() < 1e-8, "at {ms} ms");
    }
    let last = reports.last().expect("reports");
    assert_eq!((last.state, last.limited), (SlaveState::Following, 0));
    assert_eq!(last.applied, Some(SimTime::from_millis(2_999 - 81)));
    let (count, _, largest) = last.errors;
    assert!(count > 2_900 && largest < 1e-8, "{largest}");
    assert!(shown[2_999].gripper > 0.19);
}

#[test]
fn a_force_pushes_the_slave_and_not_the_master() {
    let push = Vector3::new(-2.0, 0.0, 0.0);
    let config = SlaveConfig { force_max: 1.0, ..SlaveConfig::default() };
    let (pushed, reports) = run(config, 500, |_| 0.0, push);
    let (free, others) = run(config, 500, |_| 0.0, Vector3::zeros());
    assert_eq!(reports[499].master_in_device, others[499].master_in_device);
    // A newton too much, for 0.42 s.
    let moved = free[499].pose_in_device.translation.x - pushed[499].pose_in_device.translation.x;
    assert!((moved - 0.021).abs() < 0.001, "{moved}");
    assert!(reports[499].limited > 400 && others[499].limited == 0);
}

#[test]
fn the_tremor_of_the_master_does_not_reach_the_slave() {
    let shaking = |secs: f64| 0.001 * (2.0 * std::f64::consts::PI * 10.0 * secs).sin();
    let swing_of = |config| {
        let (shown, _) = run(config, 2_000, shaking, Vector3::zeros());
        let late = shown[1_000..].iter().map(|state| state.pose_in_device.translation.x);
        late.clone().fold(0.0, f64::max) - late.fold(0.0, f64::min)
    };
    let (open, filtered) = (
        swing_of(SlaveConfig::default()),
        swing_of(SlaveConfig { tremor_cutoff_hz: Some(2.5), ..SlaveConfig::default() }),
    );
    assert!(filtered < 0.1 * open && open > 1e-5, "{filtered} of {open}");
}

#[test]
fn an_unplugged_master_is_told_and_its_slave_stands() {
    let master = VirtualHand::new(VirtualHandConfig::default()).expect("the defaults are valid");
    let (mut hand, _linked, _watched) =
        ReflectedHand::new(0, SlaveConfig::default(), Box::new(master)).expect("it is valid");
    assert_eq!(hand.read(0), Err(DeviceError::NotOpen));
    assert_eq!(hand.write(0, &Wrench::ZERO), Err(DeviceError::NotOpen));
    hand.open(0).expect("it is there");
    assert!(!hand.read(1_000_000).expect("it is read").connected);
}

#[test]
fn a_copy_goes_on_as_the_original_would_with_what_is_under_way() {
    let master = VirtualHand::new(VirtualHandConfig::default()).expect("the defaults are valid");
    let (mut hand, linked, mut watched) =
        ReflectedHand::new(0, SlaveConfig::default(), Box::new(master)).expect("it is valid");
    let (link, _watch) = ReflectedLink::new((), vec![linked], None).expect("a key");
    let path =
        Impairments { delay: SimTime::from_millis(80), loss: 0.1, reorder: 0.1, ..Impairments::default() };
    let mut peer = ReflectedPeer::new("path", link, Reflector::new(&path, 1));
    hand.open(0).expect("a virtual hand is there");
    let step = |hand: &mut dyn HapticDevice, peer: &mut ReflectedPeer, ms: u64| {
        let now_ns = ms * 1_000_000;
        let pose_in_device = Isometry3::translation(swing(ms as f64 * 1e-3), 0.0, 0.0);
        // The foot goes up and down.
        let pedals = if (ms / 50).is_multiple_of(2) { Pedals::Released } else { Pedals::Energy };
        let buttons = pedals.buttons();
        hand.set_intent(now_ns, &HandIntent { buttons, ..HandIntent::at(pose_in_device, 0.2) });
        let shown = hand.read(now_ns).expect("it is read");
        peer.step(SimTime(now_ns));
        shown
    };
    (0..500).for_each(|ms| _ = step(&mut hand, &mut peer, ms));
    let mut copy = hand.fork().expect("its master can be copied");
    let ends =
        copy.as_any().and_then(|any| any.downcast_mut::<ReflectedHand>()).map(ReflectedHand::take_ends);
    let (linked, mut copy_watched) = ends.flatten().expect("its ends are free");
    let (mut copy_peer, _watch) = peer.fork(vec![linked]).expect("a key");
    let mut energised = 0;
    for ms in 500..1_000 {
        let (one, other) = (step(&mut hand, &mut peer, ms), step(&mut *copy, &mut copy_peer, ms));
        assert_eq!(one, other, "at {ms} ms");
        energised += u32::from(Pedals::of(one.buttons) == Pedals::Energy);
        assert_eq!(watched.reports.read(), copy_watched.reports.read(), "at {ms} ms");
    }
    assert!((200..300).contains(&energised), "{energised} ms");
}

#[test]
fn what_goes_on_from_a_state_stands_a_round_trip_and_then_goes_to_its_master_without_a_jump() {
    let master = VirtualHand::new(VirtualHandConfig::default()).expect("the defaults are valid");
    let (mut hand, linked, _watched) =
        ReflectedHand::new(0, SlaveConfig::default(), Box::new(master)).expect("it is valid");
    let (link, _watch) = ReflectedLink::new((), vec![linked], None).expect("a key");
    let path = Impairments::delay(SimTime::from_millis(80));
    let mut peer = ReflectedPeer::new("path", link, Reflector::new(&path, 1));
    let shown = DeviceState {
        pose_in_device: Isometry3::translation(0.01, 0.0, 0.0),
        connected: true,
        ..DeviceState::unknown()
    };
    let intent = HandIntent::at(Isometry3::translation(0.03, 0.0, 0.0), 0.2);
    hand.resume(0, &shown, &intent);
    hand.open(0).expect("it is there");
    let mut before = 0.01;
    for ms in 1..200 {
        let x = hand.read(ms * 1_000_000).expect("it is read").pose_in_device.translation.x;
        peer.step(SimTime::from_millis(ms));
        assert!(ms > 81 || (x - 0.01).abs() < 1e-9, "{x} at {ms} ms");
        assert!((x - before).abs() < 1.1e-3, "a meter a second at most: {x} after {before}");
        before = x;
    }
    assert!((before - 0.03).abs() < 1e-4, "{before}");
}

//! Tests of the slave, one for each of its guarantees.

use nalgebra::UnitQuaternion;
use trocar_devices::{HapticDevice, PEDAL_COAGULATE, PEDAL_ENERGY, VirtualHand, VirtualHandConfig};

use super::*;

const PEDAL: u32 = 1;

fn device() -> Capabilities {
    VirtualHand::new(VirtualHandConfig::default()).expect("the defaults are valid").capabilities().clone()
}

fn pedalled() -> SlaveConfig {
    SlaveConfig { pedal: Some(0), ..SlaveConfig::default() }
}

/// A slave with its clock.
struct Bench {
    slave: Slave,
    ms: u64,
}

impl Bench {
    fn new(config: SlaveConfig) -> Self {
        Self { slave: Slave::new(0, config, &device()).expect("it is valid"), ms: 0 }
    }

    /// A millisecond in which the master is at this pose.
    fn step(&mut self, master: Isometry3<f64>, buttons: u32) -> DeviceState {
        self.ms += 1;
        let now = SimTime::from_millis(self.ms);
        let mut sample = HandSample::unknown(0);
        sample.state.pose_in_device = master;
        sample.state.connected = true;
        sample.state.buttons = buttons;
        self.slave
            .admit(now, &Arrival { sampled_at: now, sent_at: now, arrived_at: now, sample, coupled: None });
        self.slave.step(now)
    }

    /// A millisecond in which nothing arrives.
    fn silence(&mut self) -> DeviceState {
        self.ms += 1;
        self.slave.step(SimTime::from_millis(self.ms))
    }

    fn state(&self) -> SlaveState {
        self.slave.state(SimTime::from_millis(self.ms))
    }

    /// Leads the master to x \[m\] in steps of 0.2 mm.
    fn lead(&mut self, from: f64, to: f64, buttons: u32) -> f64 {
        let steps = ((to - from).abs() / 2e-4).round().max(1.0) as u32;
        let mut x = 0.0;
        for step in 1..=steps {
            let at = from + (to - from) * f64::from(step) / f64::from(steps);
            x = self.step(Isometry3::translation(at, 0.0, 0.0), buttons).pose_in_device.translation.x;
        }
        x
    }
}

#[test]
fn it_follows_only_while_the_pedal_is_down_and_a_clutch_takes_up_what_the_hands_do_meanwhile() {
    let mut bench = Bench::new(pedalled());
    assert_eq!(bench.state(), SlaveState::Waiting);
    assert!((bench.lead(0.0, 0.02, PEDAL) - 0.02).abs() < 1e-9);
    assert_eq!(bench.state(), SlaveState::Following);
    // The hands go back without the slave, turn, and go on.
    assert!((bench.lead(0.02, -0.03, 0) - 0.02).abs() < 1e-9);
    assert_eq!(bench.state(), SlaveState::PedalUp);
    let turned = Isometry3::from_parts(
        Vector3::new(-0.03, 0.0, 0.0).into(),
        UnitQuaternion::from_scaled_axis(Vector3::new(0.0, 0.0, 0.5)),
    );
    let pressed = bench.step(turned, PEDAL);
    assert!((pressed.pose_in_device.translation.x - 0.02).abs() < 1e-9, "the press is no motion");
    assert!(pressed.pose_in_device.rotation.angle() < 1e-9, "and no turn");
    assert!((bench.lead(-0.03, -0.01, PEDAL) - 0.04).abs() < 1e-9);
}

#[test]
fn an_emergency_stop_holds_it_at_once_until_the_pedal_was_released_and_pressed() {
    let mut bench = Bench::new(pedalled());
    bench.lead(0.0, 0.02, PEDAL);
    bench.slave.set_stop(SimTime::from_millis(bench.ms), true);
    assert!((bench.lead(0.02, 0.03, PEDAL) - 0.02).abs() < 1e-9);
    assert_eq!(bench.state(), SlaveState::Stopped);
    bench.slave.set_stop(SimTime::from_millis(bench.ms), false);
    assert!((bench.lead(0.03, 0.04, PEDAL) - 0.02).abs() < 1e-9, "a pedal that is still down moves nothing");
    assert_eq!(bench.state(), SlaveState::ReleasePedal);
    bench.lead(0.04, 0.04, 0);
    assert!((bench.lead(0.04, 0.05, PEDAL) - 0.03).abs() < 3e-4);
}

#[test]
fn after_silence_it_stands_until_the_pedal_was_released_and_pressed() {
    let mut bench = Bench::new(pedalled());
    bench.lead(0.0, 0.02, PEDAL);
    let stands = (0..300).map(|_| bench.silence().pose_in_device.translation.x).last().expect("steps");
    assert_eq!(bench.state(), SlaveState::Silent);
    assert!((stands - 0.02).abs() < 1e-4);
    assert!((bench.lead(0.05, 0.06, PEDAL) - stands).abs() < 1e-9);
    assert_eq!(bench.state(), SlaveState::ReleasePedal);
    bench.lead(0.06, 0.06, 0);
    let x = bench.lead(0.06, 0.07, PEDAL);
    assert!((x - stands - 0.01).abs() < 3e-4, "{x}");
}

#[test]
fn without_a_pedal_it_goes_on_after_silence_from_where_it_is() {
    let mut bench = Bench::new(SlaveConfig::default());
    bench.lead(0.0, 0.02, 0);
    let stands = (0..300).map(|_| bench.silence().pose_in_device.translation.x).last().expect("steps");
    let back = bench.step(Isometry3::translation(-0.05, 0.0, 0.0), 0).pose_in_device.translation.x;
    assert!((back - stands).abs() < 1e-9, "{back} after {stands}");
    assert_eq!(bench.state(), SlaveState::Following);
}

const HERE: u32 = HAS_PEDALS;
const CUT: u32 = HAS_PEDALS | PEDAL_ENERGY;
const BURN: u32 = HAS_PEDALS | PEDAL_COAGULATE;

/// The pedals that count in the next step, while the master presses these buttons.
fn counting(bench: &mut Bench, buttons: u32) -> Pedals {
    Pedals::of(bench.step(Isometry3::identity(), buttons).buttons)
}

#[test]
fn pedals_of_the_current_count_as_they_arrive_and_time_with_it_is_counted() {
    let mut bench = Bench::new(SlaveConfig::default());
    assert_eq!(counting(&mut bench, HERE), Pedals::Released);
    assert_eq!(counting(&mut bench, CUT), Pedals::Energy);
    for _ in 0..99 {
        assert_eq!(counting(&mut bench, BURN), Pedals::Coagulate);
    }
    assert_eq!(counting(&mut bench, HERE), Pedals::Released);
    let report = bench.slave.report(SimTime::from_millis(bench.ms), &DeviceState::unknown());
    assert!((report.energised_secs - 0.1).abs() < 1e-9, "{}", report.energised_secs);
    assert_eq!((report.stops, report.silences), (0, 0));
}

#[test]
fn silence_switches_the_current_off_and_its_pedal_must_be_released_and_pressed_again() {
    let mut bench = Bench::new(SlaveConfig::default());
    counting(&mut bench, HERE);
    counting(&mut bench, CUT);
    let off = (1..200).find(|_| Pedals::of(bench.silence().buttons) != Pedals::Energy).expect("it goes off");
    assert_eq!(off, 100, "milliseconds");
    assert_eq!(Pedals::of(bench.silence().buttons), Pedals::Released, "that it has pedals is still known");
    for _ in 0..50 {
        assert_eq!(counting(&mut bench, CUT), Pedals::Released);
    }
    assert_eq!(bench.slave.report(SimTime::from_millis(bench.ms), &DeviceState::unknown()).silences, 1);
    counting(&mut bench, HERE);
    assert_eq!(counting(&mut bench, CUT), Pedals::Energy);
}

#[test]
fn a_stop_and_the_clutch_switch_the_current_off_at_once_until_its_pedal_is_pressed_again() {
    let mut bench = Bench::new(pedalled());
    counting(&mut bench, HERE | PEDAL);
    assert_eq!(counting(&mut bench, CUT | PEDAL), Pedals::Energy);
    assert_eq!(counting(&mut bench, CUT), Pedals::Released, "the clutch");
    assert_eq!(counting(&mut bench, CUT | PEDAL), Pedals::Released);
    counting(&mut bench, HERE | PEDAL);
    assert_eq!(counting(&mut bench, CUT | PEDAL), Pedals::Energy);
    bench.slave.set_stop(SimTime::from_millis(bench.ms), true);
    assert_eq!(Pedals::of(bench.silence().buttons), Pedals::Released, "the stop");
    bench.slave.set_stop(SimTime::from_millis(bench.ms), false);
    counting(&mut bench, CUT);
    assert_eq!(counting(&mut bench, CUT | PEDAL), Pedals::Released, "it was not released meanwhile");
    counting(&mut bench, HERE | PEDAL);
    assert_eq!(counting(&mut bench, CUT | PEDAL), Pedals::Energy);
}

#[test]
fn motions_are_scaled_and_rotations_are_not() {
    let mut bench = Bench::new(SlaveConfig { scale: 0.2, ..SlaveConfig::default() });
    let turned = UnitQuaternion::from_scaled_axis(Vector3::new(0.0, 0.3, 0.0));
    let mut shown = DeviceState::unknown();
    for step in 0..=200 {
        let place = Vector3::new(2e-4 * f64::from(step), 0.0, 0.0);
        let turn = UnitQuaternion::identity().slerp(&turned, f64::from(step) / 200.0);
        shown = bench.step(Isometry3::from_parts(place.into(), turn), 0);
    }
    assert!((shown.pose_in_device.translation.x - 0.2 * 0.04).abs() < 1e-9);
    assert!(shown.pose_in_device.rotation.angle_to(&turned) < 1e-9);
}

#[test]
fn it_moves_no_faster_and_no_farther_than_its_limits() {
    let config = SlaveConfig { linear_speed: 0.1, workspace: Some([0.04; 3]), ..SlaveConfig::default() };
    let mut bench = Bench::new(config);
    bench.step(Isometry3::identity(), 0);
    let mut before = 0.0;
    for _ in 0..1_000 {
        let x = bench.step(Isometry3::translation(0.07, 0.0, 0.0), 0).pose_in_device.translation.x;
        assert!(x - before <= 1e-4 + 1e-12 && x <= 0.02, "{before} {x}");
        before = x;
    }
    assert!((before - 0.02).abs() < 1e-12);
    assert!(bench.slave.limited() > 190, "{}", bench.slave.limited());
    assert_eq!(
        bench.slave.wanted(&Isometry3::translation(0.07, 0.0, 0.0)).map(|pose| pose.translation.x),
        Some(0.07),
        "where it should be is told without its limits"
    );
}

#[test]
fn it_pushes_no_harder_than_its_limit() {
    // A wall at 5 mm, of 800 N/m, which the master goes 20 mm into.
    let mut bench = Bench::new(SlaveConfig { force_max: 1.0, ..SlaveConfig::default() });
    let mut force = 0.0;
    for step in 0..3_000 {
        let goal = (f64::from(step) * 5e-5).min(0.025);
        let x = bench.step(Isometry3::translation(goal, 0.0, 0.0), 0).pose_in_device.translation.x;
        force = 800.0 * (x - 0.005).max(0.0);
        assert!(force < 2.2, "{force} N at step {step}");
        bench.slave.feel(&Vector3::new(-force, 0.0, 0.0));
    }
    assert!((force - 1.0).abs() < 0.05, "{force} N at rest");
}

#[test]
fn a_step_that_follows_a_late_one_has_as_much_time_as_any_other() {
    let mut slave = Slave::new(0, SlaveConfig::default(), &device()).expect("it is valid");
    let mut x = 0.0;
    // A driver that is 0.9 ms late every other step; the master moves at 0.5 m/s.
    for step in 0..1_000_u64 {
        let now = SimTime::from_micros(1_000 * step + if step % 2 == 0 { 0 } else { 900 });
        let mut sample = HandSample::unknown(0);
        sample.state.connected = true;
        sample.state.pose_in_device.translation.x = (5e-4 * step as f64).min(0.07);
        slave.admit(now, &Arrival { sampled_at: now, sent_at: now, arrived_at: now, sample, coupled: None });
        x = slave.step(now).pose_in_device.translation.x;
    }
    assert!((x - 0.07).abs() < 1e-9);
    assert_eq!(slave.limited(), 0);
}

#[test]
fn figures_out_of_range_are_named_with_what_is_valid() {
    let refused =
        |config: SlaveConfig| Slave::new(0, config, &device()).expect_err("it is refused").to_string();
    let default = SlaveConfig::default();
    assert_eq!(
        refused(SlaveConfig { scale: f64::NAN, ..default }),
        "slave: scale = NaN is out of range (0.01 to 10)"
    );
    assert!(refused(SlaveConfig { pedal: Some(16), ..default }).contains("pedal = 16"));
    assert!(refused(SlaveConfig { force_max: 50.0, ..default }).contains("no more than it can render"));
    assert!(refused(SlaveConfig { tremor_cutoff_hz: Some(0.0), ..default }).contains("0.5 to 50 Hz"));
    assert!(refused(SlaveConfig { linear_speed: 0.0, ..default }).contains("linear_speed"));
}

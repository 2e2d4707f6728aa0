//! Hand-over between a local device and stations, through the same driver as any other device.

use std::sync::{Arc, Mutex};

use nalgebra::{Isometry3, UnitQuaternion, Vector3};
use trocar_devices::{
    Capabilities, DeviceCommand, DeviceError, DeviceFaults, DeviceLink, DeviceSample, DeviceState,
    DriverConfig, DriverCore, HandIntent, HapticDevice, Pedals, VirtualHand, VirtualHandConfig, Wrench, link,
};
use trocar_scene::SimTime;

use super::door_tests::capabilities;
use super::*;
use crate::hand_sample::HandSample;

const HAND: u8 = 2;
const MS: u64 = 1_000_000;
/// What an instrument may move by when its hand changes the owner \[m\].
const BUMP_MAX: f64 = 1e-4;

/// What a test knows of its bench device.
#[derive(Clone, Debug)]
struct Desk {
    state: DeviceState,
    present: bool,
    written: Wrench,
    intent: Option<HandIntent>,
}

/// A physical device on the test's desk.
struct BenchDevice {
    capabilities: Capabilities,
    desk: Arc<Mutex<Desk>>,
}

impl BenchDevice {
    fn on_a_desk() -> (Box<dyn HapticDevice>, Arc<Mutex<Desk>>) {
        let state = DeviceState { connected: true, ..DeviceState::unknown() };
        let desk = Desk { state, present: true, written: Wrench::ZERO, intent: None };
        let desk = Arc::new(Mutex::new(desk));
        (Box::new(Self { capabilities: capabilities(), desk: desk.clone() }), desk)
    }
}

impl HapticDevice for BenchDevice {
    fn capabilities(&self) -> &Capabilities {
        &self.capabilities
    }
    fn open(&mut self, _now_ns: u64) -> Result<(), DeviceError> {
        if self.desk.lock().unwrap().present { Ok(()) } else { Err(DeviceError::Disconnected) }
    }
    fn read(&mut self, now_ns: u64) -> Result<DeviceState, DeviceError> {
        self.open(now_ns).map(|()| self.desk.lock().unwrap().state)
    }
    fn write(&mut self, _now_ns: u64, wrench: &Wrench) -> Result<(), DeviceError> {
        self.desk.lock().unwrap().written = *wrench;
        Ok(())
    }
    fn set_intent(&mut self, _now_ns: u64, intent: &HandIntent) {
        self.desk.lock().unwrap().intent = Some(*intent);
    }
    fn close(&mut self) {}
}

fn pose(position: [f64; 3], turn: [f64; 3]) -> Isometry3<f64> {
    let rotation = UnitQuaternion::from_scaled_axis(Vector3::from(turn));
    Isometry3::from_parts(Vector3::from(position).into(), rotation)
}

fn sample(pose_in_device: Isometry3<f64>, gripper: f64, buttons: u32) -> HandSample {
    let state = DeviceState { pose_in_device, gripper, buttons, connected: true, ..DeviceState::unknown() };
    HandSample { state, ..HandSample::unknown(HAND) }
}

/// A remote hand below its driver, with a controller that always asks for the same force.
struct Bench {
    core: DriverCore,
    device: RemoteHand,
    end: StationEnd,
    link: DeviceLink,
    now_ns: u64,
    shown: DeviceSample,
    // Greatest motion \[m\] and turn \[rad\] of a step since the last `forget`.
    moved: f64,
    turned: f64,
}

impl Bench {
    fn new((device, end): (RemoteHand, StationEnd)) -> Self {
        let (driver_end, slot, _) = link();
        let core = DriverCore::new(DriverConfig::default(), &device, driver_end, DeviceFaults::new());
        let link = slot.take(1).unwrap();
        let shown = DeviceSample::unknown();
        Self { core, device, end, link, now_ns: 0, shown, moved: 0.0, turned: 0.0 }
    }

    fn over(local: Box<dyn HapticDevice>) -> Self {
        Self::new(RemoteHand::over(HAND, DoorLimits::default(), local).unwrap())
    }

    fn step(&mut self, post: Option<(u16, HandSample)>) {
        self.now_ns += MS;
        if let Some((station, sample)) = post {
            self.end.post(station, SimTime(self.now_ns), &sample);
        }
        self.link.command(DeviceCommand {
            epoch: 1,
            time_ns: self.now_ns,
            wrench: Wrench::from_force(Vector3::new(0.0, 0.0, 1.0)),
            passivity: false,
            intent: None,
        });
        self.core.step(self.now_ns, &mut self.device);
        let before = self.shown.state;
        self.shown = *self.link.sample();
        if before.connected {
            let (from, to) = (before.pose_in_device, self.shown.state.pose_in_device);
            self.moved = self.moved.max((to.translation.vector - from.translation.vector).norm());
            self.turned = self.turned.max(from.rotation.angle_to(&to.rotation));
        }
    }

    fn run(&mut self, millis: u64, post: Option<(u16, HandSample)>) {
        (0..millis).for_each(|_| self.step(post));
    }

    fn forget(&mut self) {
        (self.moved, self.turned) = (0.0, 0.0);
    }

    fn presence(&mut self) -> Presence {
        self.end.answer().presence
    }
}

#[test]
fn a_hand_that_nobody_takes_is_its_local_device_bit_for_bit() {
    let hand = || VirtualHand::new(VirtualHandConfig::default()).unwrap();
    let (mut bare, (mut remote, _end)) =
        (hand(), RemoteHand::over(HAND, DoorLimits::default(), Box::new(hand())).unwrap());
    bare.open(0).unwrap();
    remote.open(0).unwrap();
    for step in 1..500_u64 {
        let intent = HandIntent::at(pose([0.03, 0.01, 0.0], [0.0, 0.4, 0.0]), 0.5);
        let wrench = Wrench::from_force(Vector3::new(0.3, 0.0, -1.0));
        for device in [&mut bare as &mut dyn HapticDevice, &mut remote] {
            device.set_intent(step * MS, &intent);
            device.write(step * MS, &wrench).unwrap();
        }
        assert_eq!(bare.read(step * MS), remote.read(step * MS));
    }
}

#[test]
fn a_taken_hand_moves_by_less_than_a_tenth_of_a_millimetre_at_the_change() {
    let (local, desk) = BenchDevice::on_a_desk();
    desk.lock().unwrap().state.pose_in_device = pose([0.02, 0.01, -0.01], [0.3, 0.0, 0.0]);
    let mut bench = Bench::over(local);
    bench.run(10, None);
    bench.forget();
    bench.end.control().take(4);
    bench.step(None);
    assert_eq!(bench.presence(), Presence::Waiting(4));
    let far = sample(pose([-0.07, 0.05, 0.03], [-1.0, 2.0, 0.5]), 0.0, 0);
    bench.run(20, Some((4, far)));
    assert_eq!(bench.presence(), Presence::Live(4));
    assert!(bench.moved < BUMP_MAX && bench.turned < 1e-6, "{} m, {} rad", bench.moved, bench.turned);
    // From then on it follows the station's motion, along the same axes.
    let nearer = sample(pose([-0.07, 0.05, 0.02], [-1.0, 2.0, 0.5]), 0.0, 0);
    bench.run(50, Some((4, nearer)));
    let shown = bench.shown.state.pose_in_device.translation.vector;
    assert!((shown - Vector3::new(0.02, 0.01, -0.02)).norm() < 1e-9, "{shown}");
}

#[test]
fn a_hand_that_is_given_back_moves_by_less_than_a_tenth_of_a_millimetre() {
    let (local, desk) = BenchDevice::on_a_desk();
    let mut bench = Bench::over(local);
    bench.run(10, None);
    bench.end.control().take(4);
    bench.run(10, Some((4, sample(pose([0.0; 3], [0.0; 3]), 0.0, 0))));
    bench.run(100, Some((4, sample(pose([0.03, 0.0, 0.0], [0.0, 0.0, 1.0]), 0.0, 0))));
    // Meanwhile the local handle was laid down somewhere.
    desk.lock().unwrap().state.pose_in_device = pose([-0.05, -0.04, 0.0], [2.0, 0.0, 0.0]);
    bench.forget();
    bench.end.control().give_back();
    bench.run(50, None);
    assert_eq!(bench.presence(), Presence::Local);
    assert!(bench.moved < BUMP_MAX && bench.turned < 1e-6, "{} m, {} rad", bench.moved, bench.turned);
    desk.lock().unwrap().state.pose_in_device.translation.vector.y += 1e-3;
    bench.step(None);
    let shown = bench.shown.state.pose_in_device.translation.vector;
    assert!((shown - Vector3::new(0.03, 1e-3, 0.0)).norm() < 1e-9, "{shown}");
    // An intent is for the hand as it is shown.
    let at = bench.shown.state.pose_in_device;
    bench.device.set_intent(bench.now_ns, &HandIntent::at(at, 0.0));
    let Desk { state, intent, .. } = desk.lock().unwrap().clone();
    let apart = intent.unwrap().pose_in_device.translation.vector - state.pose_in_device.translation.vector;
    assert!(apart.norm() < 1e-9);
}

#[test]
fn a_station_that_dies_leaves_the_hand_where_it_is_and_the_local_device_takes_over() {
    let (local, desk) = BenchDevice::on_a_desk();
    let mut bench = Bench::over(local);
    bench.run(10, None);
    bench.end.control().take(4);
    bench.run(100, Some((4, sample(pose([0.01, 0.0, 0.0], [0.0; 3]), 0.0, 0))));
    desk.lock().unwrap().state.pose_in_device = pose([0.05, 0.0, 0.0], [0.0; 3]);
    bench.forget();
    bench.run(150, None);
    assert_eq!(bench.presence(), Presence::Silent(4));
    assert!(bench.shown.state.connected);
    bench.run(2_000, None);
    assert_eq!(bench.presence(), Presence::Local);
    assert_eq!((bench.end.answer().lost, bench.end.control().station()), (1, None));
    assert!(bench.moved < BUMP_MAX, "{} m", bench.moved);
    // The dead station's late samples move nothing.
    bench.run(10, Some((4, sample(pose([-0.05, 0.0, 0.0], [0.0; 3]), 0.0, 0))));
    assert!(bench.moved < BUMP_MAX);
}

#[test]
fn without_a_local_device_a_hand_that_is_given_back_is_held() {
    let mut bench = Bench::new(RemoteHand::alone(HAND, DoorLimits::default(), capabilities()).unwrap());
    bench.run(5, None);
    assert!(!bench.shown.state.connected);
    bench.end.control().take(1);
    let at = pose([0.02, 0.0, 0.0], [0.0; 3]);
    bench.run(50, Some((1, sample(at, 0.3, 0))));
    assert!(bench.shown.state.connected);
    assert!((bench.shown.state.pose_in_device.translation.vector.x - 0.02).abs() < 1e-9, "its first place");
    assert!((bench.shown.state.gripper - 0.3).abs() < 1e-8);
    bench.end.control().give_back_from(1);
    bench.run(3_000, None);
    assert_eq!(bench.presence(), Presence::Nobody);
    assert!(!bench.shown.state.connected);
    assert!((bench.shown.state.pose_in_device.translation.vector.x - 0.02).abs() < 1e-9);
    // The next station finds it there.
    bench.end.control().take(9);
    bench.run(50, Some((9, sample(pose([-0.06, 0.0, 0.0], [0.0; 3]), 0.3, 0))));
    assert!((bench.shown.state.pose_in_device.translation.vector.x - 0.02).abs() < 1e-9);
}

#[test]
fn forces_fade_out_at_one_end_and_in_at_the_other() {
    let (local, desk) = BenchDevice::on_a_desk();
    let mut bench = Bench::over(local);
    let written = |desk: &Arc<Mutex<Desk>>| desk.lock().unwrap().written.force.z;
    bench.run(100, None);
    assert!((written(&desk) - 1.0).abs() < 1e-6);
    assert_eq!(bench.end.answer().wrench.force.z, 0.0);
    bench.end.control().take(4);
    let (mut local_before, mut station_before) = (written(&desk), 0.0);
    for _ in 0..60 {
        bench.step(Some((4, sample(Isometry3::identity(), 0.0, 0))));
        let (local_now, station_now) = (written(&desk), bench.end.answer().wrench.force.z);
        assert!((0.0..=0.0201).contains(&(local_before - local_now)), "50 ms are 0.02 N a step");
        assert!((0.0..=0.0201).contains(&(station_now - station_before)));
        (local_before, station_before) = (local_now, station_now);
    }
    assert_eq!(local_before, 0.0);
    assert!((station_before - 1.0).abs() < 1e-6);
    // A station that is silent has no force waiting for it.
    bench.run(160, None);
    assert_eq!(bench.end.answer().wrench.force.z, 0.0);
    bench.end.control().give_back();
    bench.run(60, None);
    assert!((written(&desk) - 1.0).abs() < 1e-6);
}

#[test]
fn the_pedal_of_a_stations_own_device_is_seen_while_another_one_moves_the_hand() {
    let (local, desk) = BenchDevice::on_a_desk();
    let mut bench = Bench::over(local);
    let theirs = sample(Isometry3::identity(), 0.0, Pedals::Released.buttons());
    bench.step(None);
    bench.end.control().take(5);
    desk.lock().unwrap().state.buttons = Pedals::Energy.buttons() | 1;
    (0..50).for_each(|_| bench.step(Some((5, theirs))));
    assert_eq!(bench.shown.state.buttons, Pedals::Released.buttons(), "at a host it is of no consequence");
    bench.end.control().set_mirroring(true);
    (0..50).for_each(|_| bench.step(Some((5, theirs))));
    assert_eq!(bench.shown.state.buttons, Pedals::Energy.buttons(), "at a station it takes the hand back");
    desk.lock().unwrap().present = false;
    (0..50).for_each(|_| bench.step(Some((5, theirs))));
    assert_eq!(bench.shown.state.buttons, Pedals::Released.buttons());
}

#[test]
fn buttons_and_jaws_wait_for_their_new_owner() {
    let (local, desk) = BenchDevice::on_a_desk();
    desk.lock().unwrap().state.gripper = 0.2;
    let mut bench = Bench::over(local);
    bench.run(10, None);
    bench.end.control().set_holding(true);
    bench.end.control().take(4);
    bench.run(200, Some((4, sample(Isometry3::identity(), 1.0, 1))));
    assert_eq!(bench.shown.state.buttons, 0, "the pedal was down when the station came");
    assert!((bench.shown.state.gripper - 0.2).abs() < 1e-8, "the jaws hold");
    bench.run(5, Some((4, sample(Isometry3::identity(), 0.2, 0))));
    bench.run(200, Some((4, sample(Isometry3::identity(), 0.6, 1))));
    assert_eq!(bench.shown.state.buttons, 1);
    assert!((bench.shown.state.gripper - 0.6).abs() < 1e-8);
    // The trainee takes back by the pedal, with the fingers wide open.
    desk.lock().unwrap().state.buttons = 1;
    desk.lock().unwrap().state.gripper = 1.2;
    bench.end.control().give_back();
    bench.run(200, None);
    assert_eq!(bench.shown.state.buttons, 0);
    assert!((bench.shown.state.gripper - 0.6).abs() < 1e-8);
    desk.lock().unwrap().state.buttons = 0;
    desk.lock().unwrap().state.gripper = 0.5;
    bench.run(100, None);
    desk.lock().unwrap().state.buttons = 1;
    bench.step(None);
    assert_eq!(bench.shown.state.buttons, 1);
    assert!((bench.shown.state.gripper - 0.5).abs() < 1e-8);
}

#[test]
fn samples_of_a_station_that_does_not_have_the_hand_are_counted_and_move_nothing() {
    let (local, _desk) = BenchDevice::on_a_desk();
    let mut bench = Bench::over(local);
    bench.run(10, None);
    bench.end.control().take(4);
    bench.run(10, Some((4, sample(Isometry3::identity(), 0.0, 0))));
    bench.forget();
    bench.run(20, Some((5, sample(pose([0.05, 0.0, 0.0], [0.0; 3]), 0.0, 1))));
    assert_eq!(bench.moved, 0.0);
    assert_eq!(bench.end.answer().refused_station, 20);
}

#[test]
fn a_station_serves_a_hand_whose_local_device_is_unplugged() {
    let (local, desk) = BenchDevice::on_a_desk();
    let mut bench = Bench::over(local);
    bench.run(10, None);
    desk.lock().unwrap().present = false;
    bench.run(10, None);
    assert!(!bench.shown.state.connected);
    bench.end.control().take(4);
    // The driver opens an absent device every 100 ms.
    bench.run(150, Some((4, sample(pose([0.05, 0.0, 0.0], [0.0; 3]), 0.0, 0))));
    assert!(bench.shown.state.connected);
    desk.lock().unwrap().present = true;
    bench.run(150, Some((4, sample(pose([0.05, 0.0, 0.0], [0.0; 3]), 0.0, 0))));
    bench.forget();
    bench.end.control().give_back();
    bench.run(20, None);
    assert!(bench.shown.state.connected && bench.moved < BUMP_MAX);
}

#[test]
fn a_virtual_hand_that_gets_its_hand_back_continues_where_it_is_shown() {
    let local = VirtualHand::new(VirtualHandConfig::default()).unwrap();
    let mut bench = Bench::over(Box::new(local));
    bench.run(100, None);
    bench.end.control().take(4);
    bench.run(20, Some((4, sample(pose([0.0; 3], [0.0; 3]), 0.0, 0))));
    bench.run(200, Some((4, sample(pose([0.04, 0.02, 0.0], [0.0, 0.5, 0.0]), 0.0, 0))));
    let before = bench.shown.state.pose_in_device;
    bench.forget();
    bench.end.control().give_back();
    bench.step(None);
    assert!(bench.moved < BUMP_MAX, "{} m", bench.moved);
    // The force of the motors displaces it afterwards, as any held hand: 1 N against 500 N/m.
    bench.run(500, None);
    let apart = bench.shown.state.pose_in_device.translation.vector - before.translation.vector;
    assert!(apart.norm() < 2.5e-3, "{apart}");
}

#[test]
fn a_branch_gives_a_taken_hand_back_without_a_jump_and_a_physical_hand_has_no_branch() {
    let (local, _desk) = BenchDevice::on_a_desk();
    assert!(RemoteHand::over(HAND, DoorLimits::default(), local).unwrap().0.fork().is_none());
    let local = VirtualHand::new(VirtualHandConfig::default()).unwrap();
    let mut bench = Bench::over(Box::new(local));
    bench.end.control().take(4);
    bench.run(100, Some((4, sample(pose([0.03, 0.0, 0.0], [0.0; 3]), 0.0, 0))));
    let mut branch = bench.device.fork().unwrap();
    let at = bench.shown.state.pose_in_device.translation.vector;
    let state = branch.read(bench.now_ns + MS).unwrap();
    assert!((state.pose_in_device.translation.vector - at).norm() < BUMP_MAX);
    assert_eq!(bench.end.control().station(), Some(4), "the session's own hand is not touched");
}

#[test]
fn a_closed_hand_gives_no_reading_and_takes_no_force() {
    let (mut hand, _end) = RemoteHand::alone(HAND, DoorLimits::default(), capabilities()).unwrap();
    assert_eq!(hand.read(0), Err(DeviceError::NotOpen));
    assert_eq!(hand.write(0, &Wrench::ZERO), Err(DeviceError::NotOpen));
    hand.open(0).unwrap();
    assert!(!hand.read(0).unwrap().connected);
}

#[test]
fn the_pedals_of_a_local_device_are_known_while_a_station_has_the_hand_and_switch_nothing() {
    let (device, desk) = BenchDevice::on_a_desk();
    let mut bench = Bench::over(device);
    let control = bench.end.control().clone();
    let press = |pedals: Pedals| desk.lock().unwrap().state.buttons = pedals.buttons();
    bench.run(10, None);
    assert_eq!(control.local_pedals(), Pedals::None);
    press(Pedals::Energy);
    bench.run(10, None);
    assert_eq!(control.local_pedals(), Pedals::Energy);
    control.take(1);
    let theirs = sample(Isometry3::identity(), 0.0, Pedals::Released.buttons());
    for pedals in [Pedals::Energy, Pedals::Released, Pedals::Coagulate] {
        press(pedals);
        bench.run(10, Some((1, theirs)));
        assert_eq!(control.local_pedals(), pedals);
        assert_eq!(Pedals::of(bench.shown.state.buttons), Pedals::Released, "the station's own count");
    }
    desk.lock().unwrap().present = false;
    bench.run(10, Some((1, theirs)));
    assert_eq!(control.local_pedals(), Pedals::None, "unplugged");
}

//! A console and a robot of ITP, each with its own hand, over a path in virtual time.

use std::collections::VecDeque;

use trocar_devices::{VirtualHand, VirtualHandConfig};

use super::*;
use crate::hands_link::HandsLink;
use crate::itp::{ConsoleConfig, ConsoleLink, RobotConfig, RobotLink};
use crate::teleoperation::{ItpHand, SlaveConfig};

/// Each way takes so long.
const WAY_MS: u64 = 75;

/// Both ends, stepped every millisecond. Datagrams of a cut path are lost.
struct Bench {
    ms: u64,
    console: ConsoleLink<u8>,
    robot: RobotLink<u8>,
    master: ItpMaster,
    slave: ItpHand,
    at_console: WatchedHand,
    at_robot: WatchedHand,
    ways: [VecDeque<(u64, Vec<u8>)>; 2],
    is_cut: bool,
    aim: HandIntent,
}

impl Bench {
    fn new(pedal: Option<u8>) -> Self {
        let (console, [arm, _]) =
            ConsoleLink::new(ConsoleConfig::default(), 1, |_| true).expect("it makes sense");
        let (robot, [end, _]) =
            RobotLink::new(RobotConfig::default(), |_| true, |from| from).expect("it makes sense");
        let device = VirtualHand::new(VirtualHandConfig::default()).expect("the defaults are valid");
        let (mut master, at_console) = ItpMaster::new(Box::new(device), arm, 0, pedal);
        let mut slave = ItpHand::new(end, SlaveConfig::default()).expect("it is valid");
        let at_robot = slave.take_watched().expect("once");
        assert!(slave.take_watched().is_none());
        master.open(0).expect("it opens");
        slave.open(0).expect("it opens");
        let aim =
            HandIntent { buttons: Pedals::Released.buttons(), ..HandIntent::at(Isometry3::identity(), 0.0) };
        let (ways, is_cut) = (Default::default(), false);
        Self { ms: 0, console, robot, master, slave, at_console, at_robot, ways, is_cut, aim }
    }

    fn step(&mut self) -> DeviceState {
        self.ms += 1;
        let (now, ms) = (SimTime::from_millis(self.ms), self.ms);
        self.master.set_intent(now.as_nanos(), &self.aim);
        self.master.read(now.as_nanos()).expect("it is there");
        let (is_cut, [there, back]) = (self.is_cut, &mut self.ways);
        let queue = |way: &mut VecDeque<(u64, Vec<u8>)>, bytes: &[u8]| {
            if !is_cut {
                way.push_back((ms + WAY_MS, bytes.to_vec()));
            }
            true
        };
        self.console.tick(now, &mut |_, bytes| queue(there, bytes));
        while let Some((_, mut bytes)) = there.pop_front_if(|(due, _)| *due <= ms) {
            self.robot.receive(now, 1, &mut bytes, &mut |_, reply| queue(back, reply));
        }
        self.robot.tick(now, &mut |_, _| true);
        while let Some((_, mut bytes)) = back.pop_front_if(|(due, _)| *due <= ms) {
            self.console.receive(now, 1, &mut bytes, &mut |_, _| true);
        }
        self.slave.read(now.as_nanos()).expect("it is open")
    }

    fn run(&mut self, ms: u64) -> DeviceState {
        (0..ms).map(|_| self.step()).last().expect("some time")
    }

    fn press(&mut self, pedals: Pedals) {
        self.aim.buttons = (self.aim.buttons & !Pedals::MASK) | pedals.buttons();
    }

    fn states(&mut self) -> [SlaveState; 2] {
        [&mut self.at_console, &mut self.at_robot].map(|end| end.reports.read().expect("it is told").state)
    }

    /// Until the current is on or off at the robot; returns how long that took, in steps.
    fn until_energy(&mut self, on: bool) -> u64 {
        (1..2_000).find(|_| (Pedals::of(self.step().buttons) == Pedals::Energy) == on).expect("it comes")
    }
}

#[test]
fn a_virtual_hand_presses_once_the_robot_is_ready_and_motion_and_current_take_the_way() {
    let mut bench = Bench::new(None);
    bench.run(400);
    assert_eq!(bench.states(), [SlaveState::PedalUp, SlaveState::PedalUp]);
    bench.run(600);
    assert_eq!(bench.states(), [SlaveState::Following, SlaveState::Following]);
    bench.aim.pose_in_device.translation.x = 0.020;
    bench.run(WAY_MS - 1);
    let shown = bench.step();
    assert!(shown.pose_in_device.translation.x < 1e-4, "{}", shown.pose_in_device.translation.x);
    let shown = bench.run(1_500);
    let led = bench.at_console.reports.read().expect("it is told");
    let apart = led.master_in_device.translation.vector - shown.pose_in_device.translation.vector;
    assert!(apart.norm() < 2e-6 && shown.pose_in_device.translation.x > 0.015, "{apart}");
    // The round trip, and the steps in which both ends take what came.
    let trip = led.link.expect("it is known").newest;
    assert!((2 * WAY_MS..=2 * WAY_MS + 2).contains(&(trip.as_nanos() / 1_000_000)), "{trip:?}");

    bench.press(Pedals::Energy);
    assert!((WAY_MS..=WAY_MS + 3).contains(&bench.until_energy(true)));
    assert_eq!(bench.at_console.reports.read().expect("it is told").pedals, Pedals::Energy);
    assert!(bench.run(200).buttons & trocar_devices::PEDAL_ENERGY != 0);
    bench.press(Pedals::Released);
    assert!((WAY_MS..=WAY_MS + 3).contains(&bench.until_energy(false)));
    let secs = bench.at_robot.reports.read().expect("it is told").energised_secs;
    assert!((0.2..0.4).contains(&secs), "{secs} s");
    // What the slave feels is heard half a round trip later.
    bench.slave.write(0, &Wrench::from_force(Vector3::new(0.0, 0.5, 0.0))).expect("it is open");
    bench.run(2 * WAY_MS);
    assert_eq!(bench.at_console.reports.read().expect("it is told").force_in_device.y, 0.5);
}

#[test]
fn an_emergency_stop_holds_the_robot_tells_the_console_and_switches_its_current_off() {
    let mut bench = Bench::new(None);
    bench.run(1_000);
    bench.press(Pedals::Energy);
    bench.until_energy(true);
    bench.aim.pose_in_device.translation.x = 0.030;
    bench.run(200);
    bench.at_robot.control.set_stop(true);
    let stopped = bench.step();
    assert_eq!(Pedals::of(stopped.buttons), Pedals::Released, "at once");
    let later = bench.run(600);
    assert_eq!(stopped.pose_in_device, later.pose_in_device, "it stands where it was");
    assert_eq!(bench.states(), [SlaveState::Stopped, SlaveState::Stopped]);
    let told = bench.at_console.reports.read().expect("it is told");
    assert_eq!((told.stops, told.pedals), (1, Pedals::Released));
    assert_eq!(bench.at_robot.reports.read().expect("it is told").stops, 1);
    bench.at_robot.control.set_stop(false);
    bench.run(50);
    let still = bench.run(WAY_MS);
    assert_eq!(still.pose_in_device, later.pose_in_device, "the pedal has to be pressed again");
    bench.run(1_500);
    assert_eq!(bench.states(), [SlaveState::Following, SlaveState::Following]);
    // The foot is on the pedal of the current all the while.
    let shown = bench.step();
    assert_eq!(Pedals::of(shown.buttons), Pedals::Released);
    let moved = shown.pose_in_device.translation.x - later.pose_in_device.translation.x;
    assert!(moved.abs() < 1e-3, "what came in the millisecond of the stop: {moved}");
    bench.press(Pedals::Released);
    bench.run(10);
    bench.press(Pedals::Energy);
    assert!(bench.until_energy(true) <= WAY_MS + 3);
}

#[test]
fn a_path_that_falls_silent_switches_the_current_off_and_a_foot_has_to_press_again() {
    let mut bench = Bench::new(Some(0));
    bench.run(500);
    assert_eq!(bench.states(), [SlaveState::PedalUp; 2], "a foot has to press");
    bench.aim.buttons |= 1;
    bench.press(Pedals::Energy);
    bench.run(400);
    // Energy that was pressed before the robot followed has to be released first.
    assert_eq!(Pedals::of(bench.step().buttons), Pedals::Released);
    bench.press(Pedals::Released);
    bench.run(10);
    bench.press(Pedals::Energy);
    bench.until_energy(true);
    bench.run(200);
    bench.is_cut = true;
    let off = bench.until_energy(false);
    assert!((WAY_MS + 100..=WAY_MS + 105).contains(&off), "{off} ms");
    bench.run(300);
    assert_eq!(bench.states(), [SlaveState::Silent; 2]);
    let told = bench.at_robot.reports.read().expect("it is told");
    assert_eq!(told.silences, 1);
    bench.is_cut = false;
    bench.run(1_000);
    assert_eq!(bench.states(), [SlaveState::ReleasePedal, SlaveState::PedalUp], "both feet are still down");
    assert_eq!(Pedals::of(bench.step().buttons), Pedals::Released);
    bench.aim.buttons &= !1;
    bench.run(200);
    bench.aim.buttons |= 1;
    bench.run(400);
    assert_eq!(bench.states(), [SlaveState::Following; 2]);
    assert_eq!(Pedals::of(bench.step().buttons), Pedals::Released, "the current's pedal was never released");
    bench.press(Pedals::Released);
    bench.run(10);
    bench.press(Pedals::Energy);
    assert!(bench.until_energy(true) <= WAY_MS + 3);
}

//! The interoperability teleoperation protocol: packets to a robot and to a console, in every dialect.
#![no_main]

use libfuzzer_sys::fuzz_target;
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use trocar_fuzz::{Step, first, first_chunk, steps, touches};
use trocar_network::itp::packet::CONSOLE_MATRIX_BYTES;
use trocar_network::itp::robot::Condition;
use trocar_network::itp::{
    Console, ConsoleConfig, ConsoleHand, ConsolePacket, Dialect, GRASP_MAX_MRAD, GRASP_MIN_MRAD,
    GraspMeaning, Meaning, Robot, RobotConfig, RobotPacket, RotationLayout, Runlevel,
};
use trocar_scene::SimTime;

const REACH_UM: u32 = 500_000;
/// Bytes of a packet's checksum, which are its last.
const SUM_BYTES: usize = 4;

struct Link {
    now: SimTime,
    layout: RotationLayout,
    check: bool,
    robot: Robot,
    console: Console,
}

impl Link {
    /// A dialect and manners of a number.
    fn new(number: [u8; 2]) -> Self {
        let [dialect, manners] = number;
        let meaning = |bit: u8| if dialect & bit == 0 { Meaning::Increment } else { Meaning::Absolute };
        let layout = if dialect & 1 == 0 { RotationLayout::Quaternions } else { RotationLayout::Matrices };
        let grasp = match dialect >> 3 & 3 {
            0 => GraspMeaning::Torque,
            1 => GraspMeaning::Angle,
            _ => GraspMeaning::AngleIncrement,
        };
        let dialect = Dialect { layout, position: meaning(2), rotation: meaning(4), grasp };
        let check = manners & 1 == 1;
        let robot = RobotConfig {
            dialect,
            check_checksum: check,
            lenient: manners & 2 == 2,
            press_again: manners & 4 == 4,
            reach_um: REACH_UM,
            ..RobotConfig::default()
        };
        let console = ConsoleConfig { dialect, check_checksum: check, ..ConsoleConfig::default() };
        let mut robot = Robot::new(robot).expect("the limits are valid");
        if manners & 8 == 0 {
            robot.set_condition(Condition::Ready);
        }
        let console = Console::new(console).expect("the limits are valid");
        Self { now: SimTime::ZERO, layout, check, robot, console }
    }

    fn step(&mut self, step: Step<'_>) {
        self.now += SimTime(step.pause_ns);
        match step.what % 6 {
            0 => self.robot_hears(step.bytes),
            1 => self.robot_hears(&summed(step.bytes, self.layout)),
            2 => self.console_hears(step.bytes),
            3 => self.honest(step.bytes),
            4 => {
                let conditions = [Condition::Ready, Condition::Stopped, Condition::Initialising];
                self.robot.set_condition(conditions[usize::from(first(step.bytes).0) % 3]);
            }
            _ => self.robot.poll(self.now),
        }
        self.check_robot();
    }

    fn robot_hears(&mut self, bytes: &[u8]) {
        let decoded = ConsolePacket::decode(bytes, self.layout, self.check);
        if let Ok(packet) = &decoded {
            let mut out = [0; CONSOLE_MATRIX_BYTES];
            let written = packet.encode(&mut out);
            let same = bytes.len() - if self.check { 0 } else { SUM_BYTES };
            assert_eq!(written[..same], bytes[..same]);
        }
        let before = [0, 1].map(|arm| *self.robot.arm(arm));
        let (touched, received) = (touches(), self.robot.receive(bytes, self.now));
        assert_eq!(touches(), touched, "a robot allocates nothing");
        assert!(decoded.is_ok() || received.is_err());
        if received.is_err() {
            assert_eq!([0, 1].map(|arm| *self.robot.arm(arm)), before, "nothing of it was applied");
        }
    }

    fn console_hears(&mut self, bytes: &[u8]) {
        if let Ok(packet) = RobotPacket::decode(bytes, self.check) {
            let same = bytes.len() - if self.check { 0 } else { SUM_BYTES };
            assert_eq!(packet.encode()[..same], bytes[..same]);
        }
        // Taken, refused, or overtaken.
        let _ = self.console.receive(bytes, self.now);
        let forces = self.console.forces_in_robot(self.now);
        // The protocol's greatest number of millinewtons.
        assert!(forces.iter().flatten().all(|newton| newton.abs() <= 2_147_484.0), "{forces:?}");
    }

    /// The console's own packet, to the robot, and its reply.
    fn honest(&mut self, bytes: &[u8]) {
        let (numbers, rest) = first_chunk::<16>(bytes);
        let number = |at: usize| f64::from_le_bytes(std::array::from_fn(|k| numbers[8 * at + k]));
        let (what, _) = first(rest);
        let rotation = UnitQuaternion::from_euler_angles(0.01 * f64::from(what), 0.0, 0.0);
        let pose_in_console = Isometry3::from_parts(Translation3::new(number(0), number(1), 0.0), rotation);
        let hand = ConsoleHand { pose_in_console, jaw: number(1), squeeze: number(0), buttons: 1 };
        let packet = self.console.command(&[hand, hand], what & 1 == 1);
        let mut out = [0; CONSOLE_MATRIX_BYTES];
        let bytes = packet.encode(&mut out);
        assert_eq!(ConsolePacket::decode(bytes, self.layout, true), Ok(packet));
        self.robot_hears(bytes);
        let forces = [Vector3::new(number(0), number(1), 1.0); 2];
        let reply = self.robot.reply(&forces, u32::from(what)).encode();
        self.console_hears(&reply);
    }

    /// Arms stay within reach, and nothing acts while the pedal is up.
    fn check_robot(&self) {
        for arm in 0..2 {
            let pose = self.robot.arm(arm);
            assert!(pose.position_um_in_robot.iter().all(|um| um.unsigned_abs() <= u64::from(REACH_UM)));
            assert!((pose.rotation_in_robot.norm() - 1.0).abs() < 1e-9, "{pose:?}");
            assert!((GRASP_MIN_MRAD..=GRASP_MAX_MRAD).contains(&pose.jaw_mrad));
            assert!(self.robot.torque(arm).abs() <= 1.0);
            let is_down = self.robot.runlevel() == Runlevel::PedalDown;
            assert!(is_down || (self.robot.torque(arm) == 0.0 && self.robot.buttons(arm) == 0));
        }
    }
}

/// The same with the checksum that it should have, if it is long enough for a packet.
fn summed(bytes: &[u8], layout: RotationLayout) -> Vec<u8> {
    let mut bytes = bytes.to_vec();
    bytes.resize(layout.bytes(), 0);
    let packet = ConsolePacket::decode(&bytes, layout, false).expect("it has the size");
    let sum = bytes.len() - SUM_BYTES;
    bytes[sum..].copy_from_slice(&packet.checksum().to_le_bytes());
    bytes
}

// The first two bytes say which dialect is spoken, and with which manners.
fuzz_target!(|bytes: &[u8]| {
    let (number, rest) = first_chunk(bytes);
    let mut link = Link::new(number);
    steps(rest).for_each(|step| link.step(step));
});

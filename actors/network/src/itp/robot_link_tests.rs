//! Tests of the robot's link.

use super::*;
use crate::itp::{Console, ConsoleConfig, ConsoleHand, packet::CONSOLE_MATRIX_BYTES};
use nalgebra::Isometry3;

const SPEED: f64 = 1e-4;

/// A console whose hands move along x by 0.1 mm a packet.
struct Surgeon {
    console: Console,
    step: u32,
}

impl Surgeon {
    fn new() -> Self {
        Self { console: Console::new(ConsoleConfig::default()).expect("it makes sense"), step: 0 }
    }

    fn packet(&mut self, pedal_down: bool) -> Vec<u8> {
        self.step += 1;
        let hand = ConsoleHand {
            pose_in_console: Isometry3::translation(SPEED * f64::from(self.step), 0.0, 0.0),
            jaw: 0.0,
            squeeze: 0.0,
            buttons: 1,
        };
        let mut out = [0; CONSOLE_MATRIX_BYTES];
        self.console.command(&[hand; 2], pedal_down).encode(&mut out).to_vec()
    }
}

fn link() -> (RobotLink<u8>, [ArmEnd; 2]) {
    RobotLink::new(RobotConfig::default(), |from| *from < 100, |from| from).expect("it makes sense")
}

#[test]
fn packets_move_the_arms_and_each_is_answered_with_their_forces() {
    let ((mut link, [mut left, _]), mut surgeon) = (link(), Surgeon::new());
    assert_eq!(left.post(), None);
    left.feel(&Vector3::new(0.0, 0.25, 0.0));
    let mut replies = Vec::new();
    for ms in 0..101 {
        let mut send = |to, reply: &[u8]| {
            replies.push((to, reply.to_vec()));
            true
        };
        link.receive(SimTime::from_millis(ms), 7, &mut surgeon.packet(ms > 0), &mut send);
    }
    let post = left.post().expect("it was heard");
    assert_eq!((post.number, post.follows, post.buttons), (100, true, 1));
    // The press is no motion.
    assert_eq!(post.pose.position_um_in_robot, [9_900, 0, 0]);
    assert_eq!(replies.len(), 101);
    for (to, reply) in &replies {
        surgeon.console.receive(reply, SimTime::from_millis(100)).expect("a reply");
        assert_eq!(*to, 7);
    }
    let forces = surgeon.console.forces_in_robot(SimTime::from_millis(100));
    assert_eq!(forces[0], Vector3::new(0.0, 0.25, 0.0));
}

#[test]
fn one_console_has_the_robot_and_strangers_and_nonsense_get_no_answer() {
    let ((mut link, [mut left, _]), mut surgeon) = (link(), Surgeon::new());
    let mut second = Surgeon::new();
    let mut answered = Vec::new();
    let mut hear = |link: &mut RobotLink<u8>, ms, from, mut bytes: Vec<u8>| {
        link.receive(SimTime::from_millis(ms), from, &mut bytes, &mut |to, _| {
            answered.push(to);
            true
        });
    };
    hear(&mut link, 0, 200, second.packet(false));
    assert!(link.is_idle() && left.post().is_none());
    hear(&mut link, 0, 7, vec![0; 17]);
    hear(&mut link, 1, 7, surgeon.packet(false));
    hear(&mut link, 2, 8, second.packet(false));
    hear(&mut link, 2_500, 8, second.packet(false));
    hear(&mut link, 2_501, 7, surgeon.packet(false));
    assert_eq!(answered, [7, 8]);
}

#[test]
fn a_console_that_falls_silent_no_longer_moves_the_arms_and_that_is_told() {
    let ((mut link, [mut left, _]), mut surgeon) = (link(), Surgeon::new());
    let nobody = &mut |_: u8, _: &[u8]| true;
    for ms in 0..10 {
        link.receive(SimTime::from_millis(ms), 7, &mut surgeon.packet(ms > 0), nobody);
    }
    assert!(left.post().expect("it was heard").follows);
    for ms in 10..300 {
        link.tick(SimTime::from_millis(ms), nobody);
    }
    let post = left.post().expect("it was heard");
    assert!(!post.follows && post.buttons == 0 && post.counts.silences == 1, "{post:?}");
}

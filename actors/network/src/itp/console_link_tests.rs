//! Tests of the console's link.

use super::*;
use crate::itp::{RobotPacket, Runlevel, packet::CONSOLE_BYTES};

fn link() -> (ConsoleLink<u8>, [ConsoleArm; ARMS]) {
    ConsoleLink::new(ConsoleConfig::default(), 9, |from| *from == 9).expect("it makes sense")
}

fn led(x: f64, buttons: u32, pedal_down: bool) -> Option<LedHand> {
    let pose_in_console = Isometry3::translation(x, 0.0, 0.0);
    let hand = ConsoleHand { pose_in_console, jaw: 0.0, squeeze: 0.0, buttons };
    Some(LedHand { hand, pedal_down })
}

/// The packet of a tick.
fn packet(link: &mut ConsoleLink<u8>, ms: u64) -> Vec<u8> {
    let mut sent = Vec::new();
    link.tick(SimTime::from_millis(ms), &mut |to, bytes| {
        assert_eq!(to, 9);
        sent = bytes.to_vec();
        true
    });
    assert_eq!(sent.len(), CONSOLE_BYTES);
    sent
}

fn reply(sequence: u32, last_sequence: u32) -> Vec<u8> {
    let runlevel = Runlevel::PedalDown.number();
    let force_mn = [[0; 3], [250, 0, 0]];
    let (packet_type, version, joint_flags) = (0, 0, 0);
    RobotPacket { sequence, last_sequence, packet_type, version, force_mn, runlevel, joint_flags }
        .encode()
        .to_vec()
}

fn pedal(packet: &[u8]) -> i32 {
    i32::from_le_bytes(packet[116..120].try_into().expect("four bytes"))
}

#[test]
fn the_pedal_is_down_while_all_hands_that_lead_say_so() {
    let (mut link, [mut left, mut right]) = link();
    assert_eq!(pedal(&packet(&mut link, 0)), 0, "nobody leads");
    left.lead(led(0.0, 0, true));
    assert_eq!(pedal(&packet(&mut link, 1)), 1);
    right.lead(led(0.0, 0, false));
    assert_eq!(pedal(&packet(&mut link, 2)), 0);
    right.lead(led(0.0, 0x2_0000, true));
    let both = packet(&mut link, 3);
    assert_eq!((pedal(&both), &both[104..108]), (1, &0x2_0000_i32.to_le_bytes()[..]));
    left.lead(None);
    right.lead(None);
    let none = packet(&mut link, 4);
    assert_eq!((pedal(&none), &none[104..108]), (0, &[0; 4][..]), "who leaves presses nothing");
}

#[test]
fn the_round_trip_is_that_of_the_packet_that_the_robot_applied_last() {
    let (mut link, [mut left, _]) = link();
    for ms in 0..200 {
        packet(&mut link, ms);
    }
    let nobody = &mut |_: u8, _: &[u8]| true;
    let mut hear = |ms, from, bytes: Vec<u8>| {
        let mut bytes = bytes;
        link.receive(SimTime::from_millis(ms), from, &mut bytes, nobody);
    };
    hear(200, 7, reply(1, 50));
    assert_eq!(left.report(), None, "a stranger's");
    // Number 50 went out at 49 ms.
    hear(200, 9, reply(1, 50));
    let report = left.report().expect("it came");
    assert_eq!(report.round_trip, Some(SimTime::from_millis(151)));
    assert_eq!((report.sent, report.received, report.refused), (200, 1, 0));
    assert_eq!(report.robot.forces_in_robot[1].x, 0.25);
    hear(201, 9, reply(1, 51));
    hear(201, 9, vec![0; 3]);
    // Of no packet that was ever sent, and of the question.
    for (number, last) in [(2, 5_000), (3, 0)] {
        hear(202, 9, reply(number, last));
        assert_eq!(left.report().expect("it came").round_trip, None);
    }
    assert_eq!(left.report().expect("it came").refused, 2);
}

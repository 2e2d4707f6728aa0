//! Tests of the packets, against those of an independent program.

use proptest::prelude::*;

use super::*;
use crate::itp::peer_tests::{bytes_of_hex, field, peer};

/// What `tests/peers/itp_peer.py emit` prints.
const GOLDEN: [(&str, &str); 7] = [
    (
        "rest",
        "0100000000000000000000000000000000000000000000000000000000000000000000000000000000000000\
         0000000000000000000000000000000000000000000000000000000000000000000000000000000000000000\
         0000f03f000000000000f03f000000000000000000000000000000000000000001000000",
    ),
    (
        "fields",
        "0403020105000000060000000b000000f4ffffff0d000000f2ffffff0f000000f0ffffff000000000000c03f\
         000000000000c0bf000000000000d03f000000000000d0bf000000000000d83f000000000000d8bf00000000\
         0000e03f000000000000e0bf110000001200000094f8ffffd00700000100000025030201",
    ),
    (
        "sum over the end",
        "ffffffff0000000000000000ffffff7fffffff7fffffff7f010000000200000003000000cd3b7f669ea0e63f\
         0000000000000000000000000000000000000000000000000000000000000000cd3b7f669ea0e6bfcd3b7f66\
         9ea0e63fcd3b7f669ea0e63fffffff7fffffffffff7f00000080ffff0100000001000000",
    ),
    (
        "sum below the start",
        "000000800000000000000000000000800000008000000080ffffffff00000080f9ffffff0000000000000000\
         0000000000000000000000000000000000000000000000000000000000000000000000000000000000000000\
         0000f03f000000000000f03f0000008000000000000000000000000000000000f8ffffff",
    ),
    (
        "matrices",
        "0700000008000000090000000100000002000000030000000400000005000000060000000000000000000000\
         000000000000f0bf0000000000000000000000000000f03f0000000000000000000000000000000000000000\
         000000000000000000000000000000000000f03f000000000000f03f00000000000000000000000000000000\
         00000000000000000000000000000000000000000000f0bf0000000000000000000000000000f03f00000000\
         000000000a000000140000001e00000028000000010000003b000000",
    ),
    (
        "reply",
        "1500000016000000170000001800000019000000e6ffffff1b000000e4ffffff1d000000e2ffffff03000000\
         018000005b800000",
    ),
    (
        "reply over the end",
        "fffffffffeffffff0000000000000000ffffff7fffffff7fffffff7f00000080010000000100000002000000\
         fffffffffdffffff",
    ),
];

const IDENTITY: [f64; 4] = [0.0, 0.0, 0.0, 1.0];

fn console(
    sequence: u32,
    position_um: [[i32; 3]; ARMS],
    rotations: Rotations,
    buttons: [i32; ARMS],
    grasp: [i32; ARMS],
    surgeon_mode: i32,
) -> ConsolePacket {
    ConsolePacket {
        sequence,
        packet_type: 0,
        version: 0,
        position_um,
        rotations,
        buttons,
        grasp,
        surgeon_mode,
    }
}

/// The console's golden packets, as their fields.
fn golden_console_packets() -> Vec<ConsolePacket> {
    let rest = Rotations::Quaternions([IDENTITY; ARMS]);
    let half = 0.5_f64.sqrt();
    let (max, min) = (i32::MAX, i32::MIN);
    let fields = Rotations::Quaternions([[0.125, 0.25, 0.375, 0.5], [-0.125, -0.25, -0.375, -0.5]]);
    let turned = Rotations::Quaternions([[half, 0.0, 0.0, half], [0.0, 0.0, -half, half]]);
    let matrices = Rotations::Matrices([
        [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]],
        [[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]],
    ]);
    let at = [[11, 13, 15], [-12, -14, -16]];
    vec![
        console(1, [[0; 3]; ARMS], rest, [0, 0], [0, 0], 0),
        ConsolePacket {
            packet_type: 5,
            version: 6,
            ..console(0x0102_0304, at, fields, [17, 18], [-1_900, 2_000], 1)
        },
        console(u32::MAX, [[max, max, 2], [max, 1, 3]], turned, [max, -1], [32_767, -32_768], 1),
        console(0x8000_0000, [[min, min, min], [min, -1, -7]], rest, [min, 0], [0, 0], 0),
        ConsolePacket {
            packet_type: 8,
            version: 9,
            ..console(7, [[1, 3, 5], [2, 4, 6]], matrices, [10, 20], [30, 40], 1)
        },
    ]
}

/// The robot's golden packets, as their fields.
fn golden_robot_packets() -> [RobotPacket; 2] {
    let (max, min) = (i32::MAX, i32::MIN);
    [
        RobotPacket {
            sequence: 21,
            last_sequence: 22,
            packet_type: 23,
            version: 24,
            force_mn: [[25, 27, 29], [-26, -28, -30]],
            runlevel: 3,
            joint_flags: 0x8001,
        },
        RobotPacket {
            sequence: u32::MAX,
            last_sequence: u32::MAX - 1,
            packet_type: 0,
            version: 0,
            force_mn: [[max, max, 1], [max, min, 1]],
            runlevel: 2,
            joint_flags: u32::MAX,
        },
    ]
}

#[test]
fn packets_are_those_of_an_independent_program_byte_for_byte() {
    let mut out = [0; CONSOLE_MATRIX_BYTES];
    let consoles = golden_console_packets();
    for (packet, (name, hex)) in consoles.iter().zip(GOLDEN) {
        let bytes = bytes_of_hex(hex);
        let layout = packet.rotations.layout();
        assert_eq!(bytes.len(), layout.bytes(), "{name}");
        assert_eq!(packet.encode(&mut out), bytes, "{name}");
        assert_eq!(ConsolePacket::decode(&bytes, layout, true), Ok(*packet), "{name}");
    }
    for (packet, (name, hex)) in golden_robot_packets().iter().zip(&GOLDEN[consoles.len()..]) {
        let bytes = bytes_of_hex(hex);
        assert_eq!(packet.encode().as_slice(), bytes, "{name}");
        assert_eq!(RobotPacket::decode(&bytes, true), Ok(*packet), "{name}");
    }
}

#[test]
fn the_independent_program_is_sound_and_still_sends_these_packets() {
    peer(&["selftest"], "");
    let printed = peer(&["emit"], "");
    let printed: Vec<(&str, &str)> =
        printed.lines().map(|line| (field(line, "name"), field(line, "hex"))).collect();
    assert_eq!(printed, GOLDEN);
}

#[test]
fn sizes_are_exact() {
    for layout in [RotationLayout::Quaternions, RotationLayout::Matrices] {
        for got in [0, 1, 51, 52, 123, 125, 203, 205, 65_535] {
            let refused = ConsolePacket::decode(&vec![0; got], layout, false);
            assert_eq!(refused, Err(PacketError::Size { got, expected: layout.bytes() }));
        }
    }
    assert_eq!(RobotPacket::decode(&[0; 124], false), Err(PacketError::Size { got: 124, expected: 52 }));
}

#[test]
fn a_wrong_checksum_is_refused_only_where_it_is_checked() {
    let mut bytes = bytes_of_hex(GOLDEN[1].1);
    bytes[12] ^= 1;
    let stated = 0x0102_0325;
    let refused = ConsolePacket::decode(&bytes, RotationLayout::Quaternions, true);
    assert_eq!(refused, Err(PacketError::Checksum { sequence: 0x0102_0304, stated, computed: stated - 1 }));
    let taken = ConsolePacket::decode(&bytes, RotationLayout::Quaternions, false).expect("it is not checked");
    assert_eq!(taken.position_um[0], [10, 13, 15]);
    // Neither rotations nor grasps are in the sum: a fault of the protocol.
    bytes[12] ^= 1;
    bytes[36] ^= 1;
    bytes[108] ^= 1;
    assert!(ConsolePacket::decode(&bytes, RotationLayout::Quaternions, true).is_ok());
    let mut bytes = golden_robot_packets()[0].encode();
    bytes[40] ^= 1;
    assert!(matches!(RobotPacket::decode(&bytes, true), Err(PacketError::Checksum { sequence: 21, .. })));
    assert!(RobotPacket::decode(&bytes, false).is_ok());
}

#[test]
fn every_byte_but_those_of_the_checksum_belongs_to_a_field() {
    for (packet, (name, hex)) in golden_console_packets().iter().zip(GOLDEN) {
        let layout = packet.rotations.layout();
        let mut bytes = bytes_of_hex(hex);
        for at in 0..bytes.len() {
            bytes[at] ^= 0x40;
            let read = ConsolePacket::decode(&bytes, layout, false).expect("it has the size");
            assert_eq!(read != *packet, at < bytes.len() - 4, "byte {at} of {name}");
            bytes[at] ^= 0x40;
        }
    }
}

#[test]
fn a_rotation_goes_through_both_layouts_and_what_is_none_is_told() {
    let rotations = [(0.3, -1.1, 2.9), (-3.0, 0.2, 0.4)]
        .map(|(roll, pitch, yaw)| UnitQuaternion::from_euler_angles(roll, pitch, yaw));
    for layout in [RotationLayout::Quaternions, RotationLayout::Matrices] {
        let written = Rotations::new(layout, &rotations);
        for (arm, rotation) in rotations.iter().enumerate() {
            let read = written.rotation(arm).expect("it is a rotation");
            assert!(read.angle_to(rotation) < 1e-7, "{layout:?}");
        }
        assert_eq!(written.rotation(ARMS), None);
    }
    let half = [[0.5, 0.0, 0.0], [0.0, 0.5, 0.0], [0.0, 0.0, 0.5]];
    let mirror = [[-1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    let sheared = [[1.0, 0.01, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    let broken = [[f64::NAN; 3]; 3];
    for matrix in [half, mirror, sheared, broken, [[f64::MAX; 3]; 3]] {
        assert_eq!(Rotations::Matrices([matrix; ARMS]).rotation(0), None, "{matrix:?}");
    }
    let nan = [0.0, 0.0, f64::NAN, 1.0];
    for quaternion in [[0.0; 4], nan, [0.0, 0.0, 0.0, 1.01], [f64::INFINITY; 4], [f64::MAX; 4]] {
        assert_eq!(Rotations::Quaternions([quaternion; ARMS]).rotation(1), None, "{quaternion:?}");
    }
}

proptest! {
    #[test]
    fn any_bytes_are_read_or_refused(bytes in proptest::collection::vec(any::<u8>(), 0..300), check: bool) {
        let _ = ConsolePacket::decode(&bytes, RotationLayout::Quaternions, check);
        let _ = ConsolePacket::decode(&bytes, RotationLayout::Matrices, check);
        let _ = RobotPacket::decode(&bytes, check);
    }

    #[test]
    fn bytes_of_the_right_size_come_back_as_they_were(
        bytes in proptest::collection::vec(any::<u8>(), CONSOLE_MATRIX_BYTES),
    ) {
        for layout in [RotationLayout::Quaternions, RotationLayout::Matrices] {
            let bytes = &bytes[..layout.bytes()];
            let packet = ConsolePacket::decode(bytes, layout, false).expect("it has the size");
            let mut out = [0; CONSOLE_MATRIX_BYTES];
            let again = packet.encode(&mut out);
            let end = bytes.len() - 4;
            prop_assert_eq!(&again[..end], &bytes[..end]);
            // A sum in numbers that do not overflow, cut to 32 bits.
            let positions = packet.position_um.iter().flatten().chain(&packet.buttons);
            let sum = positions.map(|number| i64::from(*number)).sum::<i64>()
                + i64::from(packet.surgeon_mode)
                + i64::from(packet.sequence);
            prop_assert_eq!(packet.checksum(), sum as i32);
            prop_assert_eq!(ConsolePacket::decode(again, layout, true).map(|read| read.sequence), Ok(packet.sequence));
        }
        let bytes = &bytes[..ROBOT_BYTES];
        let packet = RobotPacket::decode(bytes, false).expect("it has the size");
        prop_assert_eq!(&packet.encode()[..48], &bytes[..48]);
        prop_assert_eq!(RobotPacket::decode(&packet.encode(), true), Ok(packet));
    }
}

//! Packets of ITP as bytes: the console's `u_struct` and the robot's `v_struct`. Tables are in [the module's page](super).

use nalgebra::{Matrix3, Rotation3, UnitQuaternion};

use super::{ARMS, RotationLayout, UNIT_TOLERANCE, unit_rotation};

/// Bytes of a console's packet with quaternions.
pub const CONSOLE_BYTES: usize = 124;
/// Bytes of a console's packet with matrices.
pub const CONSOLE_MATRIX_BYTES: usize = 204;
/// Bytes of a robot's packet.
pub const ROBOT_BYTES: usize = 52;
/// `surgeon_mode` of a pressed pedal.
pub const SURGEON_ENGAGED: i32 = 1;
/// `surgeon_mode` of a pedal that is up.
pub const SURGEON_DISENGAGED: i32 = 0;

/// Where the three axes of the positions begin; arms follow each other within an axis.
const POSITION_AT: [usize; 3] = [12, 20, 28];
/// Where the rotations begin.
const ROTATIONS_AT: usize = 36;
/// Bytes from one component of the quaternions to the next.
const QUATERNION_STRIDE: usize = 16;
/// Bytes of a matrix.
const MATRIX_BYTES: usize = 72;
/// Where the three axes of the forces begin.
const FORCE_AT: [usize; 3] = [16, 24, 32];

/// Why bytes are no packet.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum PacketError {
    /// It has another size.
    #[error("a datagram of {got} bytes is no ITP packet of this dialect, which has {expected} bytes")]
    Size {
        /// Bytes that came.
        got: usize,
        /// Bytes of a packet.
        expected: usize,
    },
    /// The sum of its numbers is not what it says.
    #[error("the checksum of ITP packet {sequence} is {stated}; its numbers sum up to {computed}")]
    Checksum {
        /// Number of the packet.
        sequence: u32,
        /// What the packet says.
        stated: i32,
        /// What it should say.
        computed: i32,
    },
}

impl RotationLayout {
    /// Bytes of a console's packet in this layout.
    pub const fn bytes(self) -> usize {
        match self {
            Self::Quaternions => CONSOLE_BYTES,
            Self::Matrices => CONSOLE_MATRIX_BYTES,
        }
    }

    /// Where buttons, grasps, the pedal and the checksum begin.
    const fn tail_at(self) -> usize {
        self.bytes() - 24
    }
}

/// Rotations of both arms as they are on the wire: whatever numbers came, finite or not.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Rotations {
    /// Quaternions x, y, z, w.
    Quaternions([[f64; 4]; ARMS]),
    /// Matrices, row by row.
    Matrices([[[f64; 3]; 3]; ARMS]),
}

impl Rotations {
    /// Rotations written in this layout.
    pub fn new(layout: RotationLayout, rotations: &[UnitQuaternion<f64>; ARMS]) -> Self {
        match layout {
            RotationLayout::Quaternions => {
                Self::Quaternions(rotations.map(|rotation| rotation.into_inner().coords.into()))
            }
            RotationLayout::Matrices => Self::Matrices(rotations.map(|rotation| {
                let matrix = rotation.to_rotation_matrix();
                [0, 1, 2].map(|row| [0, 1, 2].map(|column| matrix[(row, column)]))
            })),
        }
    }

    /// How they are written.
    pub fn layout(&self) -> RotationLayout {
        match self {
            Self::Quaternions(_) => RotationLayout::Quaternions,
            Self::Matrices(_) => RotationLayout::Matrices,
        }
    }

    /// The rotation of an arm (0 or 1); `None` when its numbers are none of a rotation.
    pub fn rotation(&self, arm: usize) -> Option<UnitQuaternion<f64>> {
        match self {
            Self::Quaternions(quaternions) => unit_rotation(*quaternions.get(arm)?),
            Self::Matrices(matrices) => {
                let rows = matrices.get(arm)?;
                let matrix = Matrix3::from_fn(|row, column| rows[row][column]);
                let apart = (matrix * matrix.transpose() - Matrix3::identity()).norm();
                // A reflection is as orthogonal as a rotation.
                let is_rotation = apart <= 2.0 * UNIT_TOLERANCE && matrix.determinant() > 0.0;
                is_rotation.then(|| {
                    let rotation =
                        UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(matrix));
                    UnitQuaternion::new_normalize(rotation.into_inner())
                })
            }
        }
    }
}

/// What a console sends: `u_struct`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ConsolePacket {
    /// Number of the packet, from 1; 0 asks whether somebody is there.
    pub sequence: u32,
    /// `pactyp`: not looked at.
    pub packet_type: u32,
    /// Version of the protocol: not looked at.
    pub version: u32,
    /// Position of each arm, or its increment \[µm\], along x, y, z.
    pub position_um: [[i32; 3]; ARMS],
    /// Rotation of each arm, or its increment.
    pub rotations: Rotations,
    /// Buttons of each hand.
    pub buttons: [i32; ARMS],
    /// Torque, opening or its increment for the jaws of each arm.
    pub grasp: [i32; ARMS],
    /// 1 while the pedal is down.
    pub surgeon_mode: i32,
}

impl ConsolePacket {
    /// Sum of the pedal, the positions, the buttons and the sequence number, modulo 2³²; neither rotations nor grasps.
    pub fn checksum(&self) -> i32 {
        let positions = self.position_um.iter().flatten();
        positions
            .chain(&self.buttons)
            .fold(self.surgeon_mode.wrapping_add(self.sequence as i32), |sum, number| {
                sum.wrapping_add(*number)
            })
    }

    /// Whether the pedal is down. Only 1 says so: what is not understood moves nothing.
    pub fn pedal_is_down(&self) -> bool {
        self.surgeon_mode == SURGEON_ENGAGED
    }

    /// Writes the packet with its checksum into `out`; returns its bytes.
    pub fn encode<'out>(&self, out: &'out mut [u8; CONSOLE_MATRIX_BYTES]) -> &'out [u8] {
        let layout = self.rotations.layout();
        for (at, number) in [(0, self.sequence), (4, self.packet_type), (8, self.version)] {
            put(out, at, number.to_le_bytes());
        }
        for (axis, at) in POSITION_AT.into_iter().enumerate() {
            for arm in 0..ARMS {
                put(out, at + 4 * arm, self.position_um[arm][axis].to_le_bytes());
            }
        }
        match &self.rotations {
            Rotations::Quaternions(quaternions) => {
                for (arm, quaternion) in quaternions.iter().enumerate() {
                    for (component, number) in quaternion.iter().enumerate() {
                        put(out, quaternion_at(arm, component), number.to_le_bytes());
                    }
                }
            }
            Rotations::Matrices(matrices) => {
                for (arm, matrix) in matrices.iter().enumerate() {
                    for (cell, number) in matrix.iter().flatten().enumerate() {
                        put(out, matrix_at(arm, cell), number.to_le_bytes());
                    }
                }
            }
        }
        let tail = layout.tail_at();
        for arm in 0..ARMS {
            put(out, tail + 4 * arm, self.buttons[arm].to_le_bytes());
            put(out, tail + 8 + 4 * arm, self.grasp[arm].to_le_bytes());
        }
        put(out, tail + 16, self.surgeon_mode.to_le_bytes());
        put(out, tail + 20, self.checksum().to_le_bytes());
        &out[..layout.bytes()]
    }

    /// Reads a packet. Every number that fits into the bytes is taken as it is, NaN too; a wrong checksum is an error only
    /// when it is to be checked.
    pub fn decode(bytes: &[u8], layout: RotationLayout, check: bool) -> Result<Self, PacketError> {
        check_size(bytes, layout.bytes())?;
        let rotations = match layout {
            RotationLayout::Quaternions => Rotations::Quaternions([0, 1].map(|arm| {
                [0, 1, 2, 3].map(|component| f64::from_le_bytes(get(bytes, quaternion_at(arm, component))))
            })),
            RotationLayout::Matrices => Rotations::Matrices([0, 1].map(|arm| {
                [0, 1, 2].map(|row| {
                    [0, 1, 2].map(|column| f64::from_le_bytes(get(bytes, matrix_at(arm, 3 * row + column))))
                })
            })),
        };
        let tail = layout.tail_at();
        let packet = Self {
            sequence: u32::from_le_bytes(get(bytes, 0)),
            packet_type: u32::from_le_bytes(get(bytes, 4)),
            version: u32::from_le_bytes(get(bytes, 8)),
            position_um: [0, 1].map(|arm| POSITION_AT.map(|at| i32::from_le_bytes(get(bytes, at + 4 * arm)))),
            rotations,
            buttons: [0, 1].map(|arm| i32::from_le_bytes(get(bytes, tail + 4 * arm))),
            grasp: [0, 1].map(|arm| i32::from_le_bytes(get(bytes, tail + 8 + 4 * arm))),
            surgeon_mode: i32::from_le_bytes(get(bytes, tail + 16)),
        };
        let stated = i32::from_le_bytes(get(bytes, tail + 20));
        check_sum(check, packet.sequence, stated, packet.checksum())?;
        Ok(packet)
    }
}

/// What a robot replies: `v_struct`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RobotPacket {
    /// Number of the reply, from 1.
    pub sequence: u32,
    /// Number of the console's last packet that was applied; 0 before the first.
    pub last_sequence: u32,
    /// `pactyp`: not looked at.
    pub packet_type: u32,
    /// Version of the protocol: not looked at.
    pub version: u32,
    /// Force at each arm \[mN\], along x, y, z.
    pub force_mn: [[i32; 3]; ARMS],
    /// Number of the [`Runlevel`](super::Runlevel).
    pub runlevel: i32,
    /// Bit `n` is set while joint `n` is at a limit.
    pub joint_flags: u32,
}

impl RobotPacket {
    /// Sum of all other numbers of the packet, modulo 2³². The Raven states no rule for its replies; this one is ours, so a
    /// console checks it only where both ends are ours.
    pub fn checksum(&self) -> i32 {
        let words = [self.sequence, self.last_sequence, self.packet_type, self.version, self.joint_flags];
        let unsigned = words.into_iter().fold(self.runlevel, |sum, word| sum.wrapping_add(word as i32));
        self.force_mn.iter().flatten().fold(unsigned, |sum, force| sum.wrapping_add(*force))
    }

    /// The packet's bytes, with its checksum.
    pub fn encode(&self) -> [u8; ROBOT_BYTES] {
        let mut out = [0; ROBOT_BYTES];
        let head = [self.sequence, self.last_sequence, self.packet_type, self.version];
        for (word, number) in head.into_iter().enumerate() {
            put(&mut out, 4 * word, number.to_le_bytes());
        }
        for (axis, at) in FORCE_AT.into_iter().enumerate() {
            for arm in 0..ARMS {
                put(&mut out, at + 4 * arm, self.force_mn[arm][axis].to_le_bytes());
            }
        }
        put(&mut out, 40, self.runlevel.to_le_bytes());
        put(&mut out, 44, self.joint_flags.to_le_bytes());
        put(&mut out, 48, self.checksum().to_le_bytes());
        out
    }

    /// Reads a packet; a wrong checksum is an error only when it is to be checked.
    pub fn decode(bytes: &[u8], check: bool) -> Result<Self, PacketError> {
        check_size(bytes, ROBOT_BYTES)?;
        let packet = Self {
            sequence: u32::from_le_bytes(get(bytes, 0)),
            last_sequence: u32::from_le_bytes(get(bytes, 4)),
            packet_type: u32::from_le_bytes(get(bytes, 8)),
            version: u32::from_le_bytes(get(bytes, 12)),
            force_mn: [0, 1].map(|arm| FORCE_AT.map(|at| i32::from_le_bytes(get(bytes, at + 4 * arm)))),
            runlevel: i32::from_le_bytes(get(bytes, 40)),
            joint_flags: u32::from_le_bytes(get(bytes, 44)),
        };
        check_sum(check, packet.sequence, i32::from_le_bytes(get(bytes, 48)), packet.checksum())?;
        Ok(packet)
    }
}

/// Where a component (x, y, z, w) of an arm's quaternion is.
const fn quaternion_at(arm: usize, component: usize) -> usize {
    ROTATIONS_AT + QUATERNION_STRIDE * component + 8 * arm
}

/// Where a cell of an arm's matrix is, counted row by row.
const fn matrix_at(arm: usize, cell: usize) -> usize {
    ROTATIONS_AT + MATRIX_BYTES * arm + 8 * cell
}

fn check_size(bytes: &[u8], expected: usize) -> Result<(), PacketError> {
    if bytes.len() == expected { Ok(()) } else { Err(PacketError::Size { got: bytes.len(), expected }) }
}

fn check_sum(check: bool, sequence: u32, stated: i32, computed: i32) -> Result<(), PacketError> {
    if check && stated != computed {
        return Err(PacketError::Checksum { sequence, stated, computed });
    }
    Ok(())
}

fn put<const N: usize>(out: &mut [u8], at: usize, bytes: [u8; N]) {
    out[at..at + N].copy_from_slice(&bytes);
}

/// Bytes of a packet whose size was checked.
fn get<const N: usize>(bytes: &[u8], at: usize) -> [u8; N] {
    let mut taken = [0; N];
    taken.copy_from_slice(&bytes[at..at + N]);
    taken
}

#[cfg(test)]
#[path = "packet_tests.rs"]
mod tests;

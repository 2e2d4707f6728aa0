//! The wire protocol of the stylus.
//!
//! ```text
//! 0xA5 | kind | length | payload … | CRC-16 of kind, length and payload, low byte first
//! ```
//! Numbers are little-endian. A cable loses, flips and inserts bytes: the reader skips byte by byte until a frame
//! passes its check.

/// Time between two states of the device \[s\].
pub const PERIOD_SECS: f64 = 1e-3;
const START: u8 = 0xA5;
const STATE: u8 = b'S';
const FORCE: u8 = b'F';
/// Bytes of a frame besides its payload.
const AROUND: usize = 5;
const STATE_BYTES: usize = 17;
const FORCE_BYTES: usize = 6;
/// Capacity for incomplete frames \[bytes\]: about ten states.
const ROOM: usize = 256;

/// A state of the device.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StateFrame {
    /// Counts the states, one per [`PERIOD_SECS`].
    pub sequence: u16,
    /// Position of the handle \[µm\].
    pub position_um: [i32; 3],
    /// Opening of the gripper \[mrad\].
    pub gripper_mrad: u16,
    /// One bit per button.
    pub buttons: u8,
}

impl StateFrame {
    /// As bytes on the cable.
    pub fn encode(&self) -> [u8; STATE_BYTES + AROUND] {
        let mut payload = [0; STATE_BYTES];
        payload[0..2].copy_from_slice(&self.sequence.to_le_bytes());
        for (axis, position) in self.position_um.iter().enumerate() {
            payload[2 + 4 * axis..6 + 4 * axis].copy_from_slice(&position.to_le_bytes());
        }
        payload[14..16].copy_from_slice(&self.gripper_mrad.to_le_bytes());
        payload[16] = self.buttons;
        frame(STATE, &payload)
    }

    fn decode(payload: &[u8; STATE_BYTES]) -> Self {
        let axis =
            |at: usize| i32::from_le_bytes([payload[at], payload[at + 1], payload[at + 2], payload[at + 3]]);
        Self {
            sequence: u16::from_le_bytes([payload[0], payload[1]]),
            position_um: [axis(2), axis(6), axis(10)],
            gripper_mrad: u16::from_le_bytes([payload[14], payload[15]]),
            buttons: payload[16],
        }
    }
}

/// A command to the device.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ForceFrame {
    /// Force on the hand \[mN\].
    pub force_mn: [i16; 3],
}

impl ForceFrame {
    /// Rounded to millinewtons. Rust's conversion saturates, and turns NaN into 0.
    pub fn from_newtons(force: [f64; 3]) -> Self {
        Self { force_mn: force.map(|newtons| (newtons * 1e3).round() as i16) }
    }
    /// In newtons.
    pub fn newtons(&self) -> [f64; 3] {
        self.force_mn.map(|force| 1e-3 * f64::from(force))
    }
    /// As bytes on the cable.
    pub fn encode(&self) -> [u8; FORCE_BYTES + AROUND] {
        let mut payload = [0; FORCE_BYTES];
        for (axis, force) in self.force_mn.iter().enumerate() {
            payload[2 * axis..2 + 2 * axis].copy_from_slice(&force.to_le_bytes());
        }
        frame(FORCE, &payload)
    }
}

fn frame<const PAYLOAD: usize, const WHOLE: usize>(kind: u8, payload: &[u8; PAYLOAD]) -> [u8; WHOLE] {
    let mut bytes = [0; WHOLE];
    bytes[0..3].copy_from_slice(&[START, kind, PAYLOAD as u8]);
    bytes[3..3 + PAYLOAD].copy_from_slice(payload);
    let crc = crc16(&bytes[1..3 + PAYLOAD]);
    bytes[3 + PAYLOAD..].copy_from_slice(&crc.to_le_bytes());
    bytes
}

/// CRC-16/CCITT-FALSE.
fn crc16(bytes: &[u8]) -> u16 {
    bytes.iter().fold(0xFFFF, |crc, byte| {
        (0..8).fold(
            crc ^ u16::from(*byte) << 8,
            |crc, _| if crc & 0x8000 == 0 { crc << 1 } else { crc << 1 ^ 0x1021 },
        )
    })
}

/// Finds frames in a byte stream that arrives in pieces of any size. Allocates nothing.
pub struct FrameReader {
    bytes: [u8; ROOM],
    filled: usize,
}

impl Default for FrameReader {
    fn default() -> Self {
        Self::new()
    }
}

impl FrameReader {
    /// An empty reader.
    pub fn new() -> Self {
        Self { bytes: [0; ROOM], filled: 0 }
    }
    /// The buffer for the next bytes; never empty, since a frame is far smaller than the capacity.
    pub fn room(&mut self) -> &mut [u8] {
        if self.filled == ROOM {
            self.skip(ROOM / 2);
        }
        &mut self.bytes[self.filled..]
    }
    /// Marks so many bytes of the buffer as received.
    pub fn filled(&mut self, bytes: usize) {
        self.filled = (self.filled + bytes).min(ROOM);
    }
    /// The next complete state.
    pub fn next_state(&mut self) -> Option<StateFrame> {
        self.next_frame(STATE).map(|payload| StateFrame::decode(&payload))
    }
    /// The next complete force: the device's side of the cable.
    pub fn next_force(&mut self) -> Option<ForceFrame> {
        let payload: [u8; FORCE_BYTES] = self.next_frame(FORCE)?;
        let axis = |at: usize| i16::from_le_bytes([payload[at], payload[at + 1]]);
        Some(ForceFrame { force_mn: [axis(0), axis(2), axis(4)] })
    }

    fn next_frame<const PAYLOAD: usize>(&mut self, kind: u8) -> Option<[u8; PAYLOAD]> {
        let head = [START, kind, PAYLOAD as u8];
        loop {
            let start = self.bytes[..self.filled].iter().position(|byte| *byte == START);
            // Without a start byte all of it is noise.
            self.skip(start.unwrap_or(self.filled));
            let known = self.filled.min(head.len());
            if self.bytes[..known] != head[..known] {
                self.skip(1);
                continue;
            }
            if self.filled < PAYLOAD + AROUND {
                return None;
            }
            let crc = [self.bytes[3 + PAYLOAD], self.bytes[4 + PAYLOAD]];
            if crc16(&self.bytes[1..3 + PAYLOAD]) != u16::from_le_bytes(crc) {
                // The start byte may have been part of something else: continue after it, not after the frame.
                self.skip(1);
                continue;
            }
            let mut payload = [0; PAYLOAD];
            payload.copy_from_slice(&self.bytes[3..3 + PAYLOAD]);
            self.skip(PAYLOAD + AROUND);
            return Some(payload);
        }
    }

    fn skip(&mut self, count: usize) {
        self.bytes.copy_within(count..self.filled, 0);
        self.filled -= count;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn state(sequence: u16) -> StateFrame {
        // Positions that contain the start byte: the hardest case for a reader that searches for it.
        StateFrame { sequence, position_um: [-12_345, 0xA5A5, 165], gripper_mrad: 700, buttons: 0b101 }
    }

    /// All frames that a reader finds in bytes that arrive in pieces of `piece`.
    fn read(bytes: &[u8], piece: usize) -> Vec<StateFrame> {
        let (mut reader, mut found) = (FrameReader::new(), Vec::new());
        for piece in bytes.chunks(piece) {
            reader.room()[..piece.len()].copy_from_slice(piece);
            reader.filled(piece.len());
            found.extend(std::iter::from_fn(|| reader.next_state()));
        }
        found
    }

    #[test]
    fn frames_survive_the_cable_in_pieces_of_any_size() {
        assert_eq!(crc16(b"123456789"), 0x29B1, "the check value of CRC-16/CCITT-FALSE");
        let frames: Vec<StateFrame> = (0..20).map(state).collect();
        let bytes: Vec<u8> = frames.iter().flat_map(StateFrame::encode).collect();
        for piece in 1..=100 {
            assert_eq!(read(&bytes, piece), frames, "in pieces of {piece}");
        }
    }

    #[test]
    fn no_flipped_bit_gets_through_and_the_next_frame_does() {
        for bit in 0..8 * (STATE_BYTES + AROUND) {
            let mut bytes: Vec<u8> = [1, 2, 3].map(state).iter().flat_map(StateFrame::encode).collect();
            bytes[STATE_BYTES + AROUND + bit / 8] ^= 1 << (bit % 8);
            let found = read(&bytes, 7);
            assert!(found == [state(1), state(3)], "bit {bit}: {found:?}");
        }
    }

    #[test]
    fn noise_between_frames_costs_nothing_but_itself() {
        let mut bytes = vec![START, STATE, 200, START, START, STATE];
        bytes.extend(state(1).encode());
        bytes.extend([0x55; 1_000]);
        bytes.extend([START; 300]);
        bytes.extend(state(2).encode());
        assert_eq!(read(&bytes, 64), [state(1), state(2)]);
    }

    #[test]
    fn forces_are_rounded_saturated_and_read_back() {
        let force = ForceFrame::from_newtons([1.2345, -1e9, f64::NAN]);
        assert_eq!(force.force_mn, [1_235, i16::MIN, 0]);
        let mut reader = FrameReader::new();
        let bytes = force.encode();
        reader.room()[..bytes.len()].copy_from_slice(&bytes);
        reader.filled(bytes.len());
        assert_eq!(reader.next_force(), Some(force));
    }
}

//! Sealed datagrams: hands and positions over UDP, authenticated before anything is judged by them.
//!
//! A datagram is at most [`DATAGRAM_MAX`] bytes, so that it passes every path without being fragmented. All numbers are
//! little-endian. The header is readable, and authenticated together with the payload:
//!
//! | offset | bytes | field |
//! |---|---|---|
//! | 0 | 1 | wire version, [`WIRE_VERSION`] |
//! | 1 | 1 | [`Kind`]: 0 hands, 1 rows, 2 row acknowledgements, 3 path challenge, 4 path response, 5 link report, 6 echo, 7 sketch |
//! | 2 | 1 | key phase: the low byte of the number of the key |
//! | 3 | 1 | hand count; 0 unless the kind is hands |
//! | 4 | 4 | connection id |
//! | 8 | 8 | sequence, also the nonce: 1 to 2⁶⁴ − 2, never twice in a connection and a direction |
//! | 16 | 8 | sent at \[ns\], by the sender's session clock |
//! | 24 | n | payload, encrypted; at most [`PAYLOAD_MAX`] bytes |
//! | 24 + n | 16 or 4 | tag of ChaCha20-Poly1305 (RFC 8439), or the CRC-32 of an unprotected link |
//!
//! The payload of kind hands is a [`ClockEcho`] of 12 bytes, and 100 bytes for each of at most [`HANDS_MAX`] hands:
//!
//! | offset | bytes | field |
//! |---|---|---|
//! | 0 | 8 | sent at \[ns\] of the newest datagram received from the other side, by that side's clock |
//! | 8 | 4 | how long it was held \[µs\]; 2³² − 1 if there is none, and the field before is then 0 |
//! | 12 + 100 k | 1 | number of the hand |
//! | + 1 | 1 | flags: bit 0 connected, bit 1 grabbed, bits 2 to 5 count of clutches, bits 6 and 7 pedals: 0 none, 1 released, 2 energy, 3 coagulate |
//! | + 2 | 2 | buttons 0 to 15 |
//! | + 4 | 4 | age of the measurement \[µs\] |
//! | + 8 | 12 | position in the device's frame \[m\], 3 × f32 |
//! | + 20 | 16 | rotation in the device's frame, quaternion x y z w, 4 × f32 |
//! | + 36 | 12 | linear velocity [m/s], 3 × f32 |
//! | + 48 | 12 | angular velocity [rad/s], 3 × f32 |
//! | + 60 | 12 | force \[N\], 3 × f32 |
//! | + 72 | 12 | torque [N·m], 3 × f32 |
//! | + 84 | 4 | opening of the gripper \[rad\], f32 |
//! | + 88 | 8 | entity that is grabbed; 0 without flag 1 |
//! | + 96 | 4 | node of it; 0 without flag 1 |
//!
//! [`Sealer`] and [`Opener`] are the two ends of one direction. Both are sans-IO, and neither allocates after it was made.

mod hands;
mod header;
mod keys;
#[cfg(test)]
mod keys_testing;
mod little_endian;
mod open;
mod replay_window;
mod seal;

pub use hands::{
    COUPLED_HANDS_MAX, ClockEcho, HAND_BYTES, HANDS_MAX, Hands, HandsError, ROTATION_TOLERANCE, encode_hands,
    hands_bytes,
};
pub use header::{HEADER_BYTES, Header, HeaderError, Kind, WIRE_VERSION};
pub use keys::{CRC_BYTES, EXPORTER_LABEL, Keys, ReceiveKey, RekeyError, Seal, SendKey, Side, TAG_BYTES};
pub use open::{FORGERIES_WORN, Opener, RefusalCounts, Refused};
pub use replay_window::{REPLAY_WINDOW, ReplayWindow, Stale};
pub use seal::{SEALS_MAX, SEALS_WORN, SealError, Sealer};

/// Most bytes of a datagram, header and tag among them: less than the smallest MTU of IPv6, 1,280, allows.
pub const DATAGRAM_MAX: usize = 1_200;
/// Most bytes of a payload, the same for both seals.
pub const PAYLOAD_MAX: usize = DATAGRAM_MAX - HEADER_BYTES - TAG_BYTES;

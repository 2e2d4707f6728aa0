//! Header of a datagram: readable by everybody, and authenticated together with the payload.

use thiserror::Error;
use trocar_scene::SimTime;

use super::little_endian::{Reader, Writer};
use super::{COUPLED_HANDS_MAX, HANDS_MAX};

/// Bytes of a header.
pub const HEADER_BYTES: usize = 24;
/// Version of the datagrams' layout.
pub const WIRE_VERSION: u8 = 1;

/// What a datagram's payload is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
#[repr(u8)]
pub enum Kind {
    /// All hands of a station.
    Hands = 0,
    /// Rows of the scene, from the station that owns them.
    Rows = 1,
    /// Which rows have arrived.
    RowAcks = 2,
    /// Asks whether the other side receives at a new address.
    PathChallenge = 3,
    /// The answer, from that address.
    PathResponse = 4,
    /// What the receiver of a direction tells its sender, a few times a second.
    Report = 5,
    /// Comes back as it is: who asks for a diagnosis looks whether datagrams pass.
    Echo = 6,
    /// Sketches of an owner's bodies, among peers.
    Sketch = 7,
    /// Hands whose forces are compensated for the delay: samples as of kind hands, and both ends of each one's coupling.
    CoupledHands = 8,
}

impl Kind {
    /// All kinds, in the order of their codes.
    pub const ALL: [Self; 9] = [
        Self::Hands,
        Self::Rows,
        Self::RowAcks,
        Self::PathChallenge,
        Self::PathResponse,
        Self::Report,
        Self::Echo,
        Self::Sketch,
        Self::CoupledHands,
    ];

    /// The kind of a code on the wire.
    pub fn from_code(code: u8) -> Option<Self> {
        Self::ALL.get(usize::from(code)).copied()
    }

    /// Whether a datagram of this kind can carry that many hands.
    pub fn allows_hands(self, hands: u8) -> bool {
        let most = match self {
            Self::Hands => HANDS_MAX,
            Self::CoupledHands => COUPLED_HANDS_MAX,
            _ => 0,
        };
        usize::from(hands) <= most
    }
}

/// The first 24 bytes of a datagram. Nothing of it may be trusted before [`super::Opener::open`] has returned it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Header {
    /// What the payload is.
    pub kind: Kind,
    /// Low byte of the number of the key.
    pub phase: u8,
    /// How many hands the payload carries; 0 unless it is of a kind of hands.
    pub hands: u8,
    /// Which connection it belongs to.
    pub connection: u32,
    /// Number of the datagram in its connection and direction, from 1; also the nonce.
    pub sequence: u64,
    /// When it was sent, by the sender's session clock.
    pub sent_at: SimTime,
}

/// Why some bytes are no header.
#[derive(Clone, Copy, Debug, Error, PartialEq, Eq)]
pub enum HeaderError {
    /// It is shorter than a header.
    #[error("a datagram of {0} bytes is shorter than its header of {HEADER_BYTES}")]
    Short(usize),
    /// It is of another version.
    #[error("the datagram is of wire version {0}; this program reads version {WIRE_VERSION}")]
    Version(u8),
    /// The kind is unknown.
    #[error("the datagram is of kind {0}; kinds are 0 to 8")]
    Kind(u8),
    /// It has too many hands.
    #[error(
        "a datagram of kind {kind:?} announces {hands} hands; at most {HANDS_MAX} come with kind Hands, \
         {COUPLED_HANDS_MAX} with kind CoupledHands, else 0"
    )]
    Hands {
        /// Kind of the datagram.
        kind: Kind,
        /// The announced count.
        hands: u8,
    },
}

impl Header {
    /// The header as bytes.
    pub fn encode(&self) -> [u8; HEADER_BYTES] {
        let mut bytes = [0; HEADER_BYTES];
        Writer(&mut bytes)
            .u8(WIRE_VERSION)
            .u8(self.kind as u8)
            .u8(self.phase)
            .u8(self.hands)
            .u32(self.connection)
            .u64(self.sequence)
            .u64(self.sent_at.as_nanos());
        bytes
    }

    /// Reads the header of a datagram without believing it, such as to find its connection.
    ///
    /// # Errors
    /// When it is too short, of another version, of an unknown kind, or announces hands that it cannot carry.
    pub fn decode(datagram: &[u8]) -> Result<Self, HeaderError> {
        let mut fields = Reader(datagram);
        Self::read(&mut fields).unwrap_or(Err(HeaderError::Short(datagram.len())))
    }

    fn read(fields: &mut Reader<'_>) -> Option<Result<Self, HeaderError>> {
        let (version, code, phase, hands) = (fields.u8()?, fields.u8()?, fields.u8()?, fields.u8()?);
        let (connection, sequence, sent_at) = (fields.u32()?, fields.u64()?, SimTime(fields.u64()?));
        if version != WIRE_VERSION {
            return Some(Err(HeaderError::Version(version)));
        }
        let Some(kind) = Kind::from_code(code) else {
            return Some(Err(HeaderError::Kind(code)));
        };
        if !kind.allows_hands(hands) {
            return Some(Err(HeaderError::Hands { kind, hands }));
        }
        Some(Ok(Self { kind, phase, hands, connection, sequence, sent_at }))
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn fields_lie_where_the_table_says() {
        let header = Header {
            kind: Kind::Hands,
            phase: 0x22,
            hands: 3,
            connection: 0x4433_2211,
            sequence: 0x0807_0605_0403_0201,
            sent_at: SimTime(0x1817_1615_1413_1211),
        };
        let bytes = header.encode();
        assert_eq!(bytes.len(), 24);
        assert_eq!(bytes[..4], [1, 0, 0x22, 3]);
        assert_eq!(bytes[4..8], [0x11, 0x22, 0x33, 0x44]);
        assert_eq!(bytes[8..16], [1, 2, 3, 4, 5, 6, 7, 8]);
        assert_eq!(bytes[16..24], [0x11, 0x12, 0x13, 0x14, 0x15, 0x16, 0x17, 0x18]);
        let codes = Kind::ALL;
        for (code, kind) in codes.into_iter().enumerate() {
            assert_eq!(Header { kind, ..header }.encode()[1], code as u8);
        }
    }

    #[test]
    fn what_is_no_header_is_refused_with_its_reason() {
        let header = Header {
            kind: Kind::Rows,
            phase: 0,
            hands: 0,
            connection: 7,
            sequence: 1,
            sent_at: SimTime::ZERO,
        };
        let bytes = header.encode();
        for length in 0..24 {
            assert_eq!(Header::decode(&bytes[..length]), Err(HeaderError::Short(length)));
        }
        let with = |place: usize, value: u8| {
            let mut bytes = bytes;
            bytes[place] = value;
            Header::decode(&bytes)
        };
        assert_eq!(with(0, 2), Err(HeaderError::Version(2)));
        assert_eq!(with(1, 9), Err(HeaderError::Kind(9)));
        assert_eq!(with(3, 1), Err(HeaderError::Hands { kind: Kind::Rows, hands: 1 }));
        let mut hands = Header { kind: Kind::Hands, hands: 11, ..header }.encode();
        assert!(Header::decode(&hands).is_ok());
        hands[3] = 12;
        assert_eq!(Header::decode(&hands), Err(HeaderError::Hands { kind: Kind::Hands, hands: 12 }));
    }

    proptest! {
        #[test]
        fn any_bytes_are_a_header_that_encodes_to_them_or_an_error(
            mut bytes in prop::collection::vec(any::<u8>(), 0..64),
            likely in any::<bool>(),
        ) {
            if likely && bytes.len() >= 4 {
                bytes[0] = WIRE_VERSION;
                bytes[1] %= 6;
                bytes[3] %= 12;
            }
            if let Ok(header) = Header::decode(&bytes) {
                prop_assert_eq!(&header.encode()[..], &bytes[..24]);
            }
        }
    }
}

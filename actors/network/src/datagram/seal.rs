//! Sealer: the sending end of one direction.

use thiserror::Error;
use trocar_scene::SimTime;

use super::hands::{ClockEcho, HandsError, encode_hands};
use super::keys::{OneWay, RekeyError, SendKey};
use super::{DATAGRAM_MAX, HEADER_BYTES, Header, Kind, PAYLOAD_MAX, TAG_BYTES};
use crate::hand_sample::HandSample;

/// Datagrams under one key after which it asks to be replaced: 8,900 years at 1 kHz.
pub const SEALS_WORN: u64 = 1 << 48;
/// Most datagrams under one key: the limit of ChaCha20-Poly1305's confidentiality in QUIC (RFC 9001, 6.6).
pub const SEALS_MAX: u64 = 1 << 62;

/// Why a datagram was not sealed.
#[derive(Clone, Copy, Debug, Error, PartialEq)]
pub enum SealError {
    /// It does not fit.
    #[error("a payload of {0} bytes is too long; at most {PAYLOAD_MAX} fit into a datagram")]
    TooLong(usize),
    /// The header cannot announce so many hands.
    #[error("a datagram of kind {kind:?} cannot carry {hands} hands")]
    HandCount {
        /// Kind of the datagram.
        kind: Kind,
        /// The announced count.
        hands: u8,
    },
    /// The hands cannot be encoded.
    #[error(transparent)]
    Hands(#[from] HandsError),
    /// The key may not seal any more.
    #[error("the key has sealed {SEALS_MAX} datagrams; a key of the next phase is needed")]
    WornOut,
    /// The connection has no sequence number left.
    #[error("all sequence numbers of the connection are used; a new connection is needed")]
    Exhausted,
    /// The cipher has refused.
    #[error("the cipher refused to seal a payload of {0} bytes")]
    Cipher(usize),
}

/// Seals the datagrams of one direction, and numbers them. It cannot be copied: two would use the same nonces.
pub struct Sealer {
    key: OneWay,
    /// Number of the next datagram.
    sequence: u64,
    /// Number of the first datagram under this key.
    first: u64,
}

impl Sealer {
    /// A sealer that begins with sequence number 1.
    pub fn new(key: SendKey) -> Self {
        Self { key: key.0, sequence: 1, first: 1 }
    }

    /// A sealer that goes on where another one of the connection is, under a key of its own.
    pub fn going_on(key: SendKey, sequence: u64) -> Self {
        Self { key: key.0, sequence, first: sequence }
    }

    /// Seals under the next phase's key from now on. The other side must have been given it before; numbers go on.
    ///
    /// # Errors
    /// When the key is of another connection, not of the next phase, or of another kind of seal.
    pub fn rekey(&mut self, key: SendKey) -> Result<(), RekeyError> {
        self.key.check_successor(&key.0)?;
        (self.key, self.first) = (key.0, self.sequence);
        Ok(())
    }

    /// Makes a datagram of a payload, and returns its length in `out`.
    ///
    /// # Errors
    /// When the payload is too long, the kind cannot carry so many hands, or the numbers are used up.
    pub fn seal(
        &mut self,
        kind: Kind,
        hands: u8,
        sent_at: SimTime,
        payload: &[u8],
        out: &mut [u8; DATAGRAM_MAX],
    ) -> Result<usize, SealError> {
        if payload.len() > PAYLOAD_MAX {
            return Err(SealError::TooLong(payload.len()));
        }
        out[HEADER_BYTES..][..payload.len()].copy_from_slice(payload);
        self.close(kind, hands, sent_at, payload.len(), out)
    }

    /// Makes a datagram of all hands of a station, and returns its length in `out`.
    ///
    /// # Errors
    /// When [`encode_hands`] refuses the hands, or the numbers are used up.
    pub fn seal_hands(
        &mut self,
        sent_at: SimTime,
        echo: Option<ClockEcho>,
        samples: &[HandSample],
        out: &mut [u8; DATAGRAM_MAX],
    ) -> Result<usize, SealError> {
        let (_, rest) = out.split_at_mut(HEADER_BYTES);
        let payload = rest.first_chunk_mut().expect("a datagram has room for the longest payload");
        let length = encode_hands(echo, samples, payload)?;
        // No more than `HANDS_MAX` have been encoded.
        self.close(Kind::Hands, samples.len() as u8, sent_at, length, out)
    }

    /// Whether the key has sealed so much that it should be replaced; there is plenty of time to do so.
    pub fn is_worn(&self) -> bool {
        self.sequence - self.first >= SEALS_WORN
    }

    /// Whether strangers can neither read nor make its datagrams.
    pub fn is_protected(&self) -> bool {
        self.key.cipher.seal_kind().is_protected()
    }

    /// Number of the key.
    pub fn phase(&self) -> u32 {
        self.key.phase
    }

    /// Number that the next datagram gets.
    pub fn next_sequence(&self) -> u64 {
        self.sequence
    }

    /// Writes the header before the payload that lies in `out`, and the tag behind it.
    fn close(
        &mut self,
        kind: Kind,
        hands: u8,
        sent_at: SimTime,
        length: usize,
        out: &mut [u8; DATAGRAM_MAX],
    ) -> Result<usize, SealError> {
        if !kind.allows_hands(hands) {
            return Err(SealError::HandCount { kind, hands });
        }
        let sequence = self.sequence;
        if sequence == u64::MAX {
            return Err(SealError::Exhausted);
        }
        if sequence - self.first >= SEALS_MAX {
            return Err(SealError::WornOut);
        }
        // Before sealing: whatever becomes of this datagram, its nonce is used.
        self.sequence += 1;
        let OneWay { connection, .. } = self.key;
        let header = Header { kind, phase: self.key.phase_byte(), hands, connection, sequence, sent_at };
        let header = header.encode();
        let (head, rest) = out.split_at_mut(HEADER_BYTES);
        head.copy_from_slice(&header);
        let (payload, rest) = rest.split_at_mut(length);
        let tag: &mut [u8; TAG_BYTES] = rest.first_chunk_mut().ok_or(SealError::TooLong(length))?;
        self.key.cipher.seal(sequence, &header, payload, tag).ok_or(SealError::Cipher(length))?;
        Ok(HEADER_BYTES + length + self.key.cipher.seal_kind().tag_bytes())
    }

    /// Goes on at another number, as after so many datagrams; forwards only.
    #[cfg(test)]
    pub fn skip_to(&mut self, sequence: u64) {
        assert!(sequence >= self.sequence);
        self.sequence = sequence;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::datagram::keys_testing::{ends, keys};
    use crate::datagram::{Keys, Seal, Side};

    fn seal(sealer: &mut Sealer) -> Result<usize, SealError> {
        sealer.seal(Kind::Rows, 0, SimTime::ZERO, &[1; 10], &mut [0; DATAGRAM_MAX])
    }

    #[test]
    fn a_datagram_of_two_hands_has_252_bytes_and_240_with_a_checksum() {
        let hands = [HandSample::unknown(0), HandSample::unknown(1)];
        for (is_protected, bytes) in [(true, 252), (false, 240)] {
            let [mut client, _] = ends(is_protected);
            let length = client.sealer.seal_hands(SimTime::ZERO, None, &hands, &mut [0; DATAGRAM_MAX]);
            assert_eq!(length, Ok(bytes));
        }
    }

    #[test]
    fn the_longest_payload_fits_and_one_byte_more_is_refused() {
        for (is_protected, bytes) in [(true, 1_200), (false, 1_188)] {
            let [mut client, mut server] = ends(is_protected);
            let mut out = [0; DATAGRAM_MAX];
            let payload = [0x5a; PAYLOAD_MAX + 1];
            let error = client.sealer.seal(Kind::Rows, 0, SimTime::ZERO, &payload, &mut out);
            assert_eq!(error, Err(SealError::TooLong(1_161)));
            let length = client.sealer.seal(Kind::Rows, 0, SimTime(9), &payload[1..], &mut out);
            assert_eq!(length, Ok(bytes));
            let (header, opened) =
                server.opener.open(SimTime::ZERO, &mut out[..bytes]).expect("it is the first");
            // The refused one took no number.
            assert_eq!((header.sequence, header.sent_at, opened), (1, SimTime(9), &payload[1..]));
        }
    }

    #[test]
    fn hands_are_announced_only_where_they_fit() {
        let [mut client, _] = ends(true);
        let mut out = [0; DATAGRAM_MAX];
        for (kind, hands) in [(Kind::Rows, 1), (Kind::PathChallenge, 2), (Kind::Hands, 12)] {
            let error = client.sealer.seal(kind, hands, SimTime::ZERO, &[], &mut out);
            assert_eq!(error, Err(SealError::HandCount { kind, hands }));
        }
        let samples: Vec<_> = (0..12).map(HandSample::unknown).collect();
        let error = client.sealer.seal_hands(SimTime::ZERO, None, &samples, &mut out);
        assert_eq!(error, Err(SealError::Hands(HandsError::TooMany(12))));
        assert_eq!(client.sealer.next_sequence(), 1);
    }

    #[test]
    fn a_key_asks_to_be_replaced_and_then_stops() {
        let [mut client, _] = ends(true);
        let sealer = &mut client.sealer;
        sealer.skip_to(1 << 48);
        assert!(!sealer.is_worn());
        assert!(seal(sealer).is_ok() && sealer.is_worn());
        let (next, _) = keys(7, 1, 1).split(Side::Client);
        sealer.rekey(next).expect("it is the next");
        assert!(!sealer.is_worn() && sealer.next_sequence() == (1 << 48) + 1);
        sealer.skip_to((1 << 62) + (1 << 48));
        assert!(seal(sealer).is_ok());
        assert_eq!(seal(sealer), Err(SealError::WornOut));
        let (next, _) = keys(7, 2, 1).split(Side::Client);
        sealer.rekey(next).expect("it is the next");
        assert!(seal(sealer).is_ok());
    }

    #[test]
    fn the_last_number_is_never_sent() {
        let [mut client, _] = ends(true);
        let sealer = &mut client.sealer;
        sealer.skip_to(u64::MAX - 1);
        sealer.rekey(keys(7, 1, 1).split(Side::Client).0).expect("it is the next");
        assert!(seal(sealer).is_ok());
        for _ in 0..3 {
            assert_eq!(seal(sealer), Err(SealError::Exhausted));
        }
        // No key helps against that.
        sealer.rekey(keys(7, 2, 1).split(Side::Client).0).expect("it is the next");
        assert_eq!(seal(sealer), Err(SealError::Exhausted));
    }

    #[test]
    fn only_the_next_key_of_the_same_connection_and_seal_is_taken() {
        let [mut client, _] = ends(true);
        let mut rekey = |keys: Keys| client.sealer.rekey(keys.split(Side::Client).0);
        assert_eq!(rekey(keys(8, 1, 1)), Err(RekeyError::Connection { given: 8, expected: 7 }));
        for given in [0, 2, u32::MAX] {
            assert_eq!(rekey(keys(7, given, 1)), Err(RekeyError::Phase { given, expected: 1 }));
        }
        let error = RekeyError::Seal { given: Seal::Checksum, expected: Seal::Aead };
        assert_eq!(rekey(Keys::unprotected(7, 1)), Err(error));
        assert_eq!(rekey(keys(7, 1, 1)), Ok(()));
    }
}

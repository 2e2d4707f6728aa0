//! Keys of a connection: one for each direction and key phase, from the exporter of its TLS session (RFC 8446, 7.5).
//!
//! A nonce must never be used twice with a key. Three things see to that. Keys cannot be copied: [`Keys::split`] gives
//! each direction's key away once, and the sealer that takes it counts sequences from there. Sequences go on over a
//! change of keys. And the whole number of the phase goes into the exporter, not only the byte of it that a header has
//! room for, so that keys do not come again after 256 changes.

use std::fmt;

use ring::aead::{Aad, CHACHA20_POLY1305, LessSafeKey, NONCE_LEN, Nonce, UnboundKey};
use thiserror::Error;

use super::HEADER_BYTES;

/// Label under which the TLS session exports the keys.
pub const EXPORTER_LABEL: &[u8] = b"EXPORTER-trocar-datagrams";
/// Bytes of the authentication tag.
pub const TAG_BYTES: usize = 16;
/// Bytes of the checksum of an unprotected link.
pub const CRC_BYTES: usize = 4;
/// Bytes of a key.
const KEY_BYTES: usize = 32;
/// Bytes exported: key and initialisation vector, to the server and to the client.
const EXPORTED_BYTES: usize = 2 * (KEY_BYTES + NONCE_LEN);

/// Which end of the connection one is, as in its TLS handshake.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Side {
    /// The one that connected.
    Client,
    /// The one that listened.
    Server,
}

/// What closes a datagram.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Seal {
    /// ChaCha20-Poly1305 (RFC 8439): encrypted and authenticated.
    Aead,
    /// CRC-32: **unprotected**. It finds damage, not malice: everybody can read the datagrams and make valid ones. For
    /// `--insecure` on the loopback only.
    Checksum,
}

impl Seal {
    /// Whether strangers can neither read nor make datagrams.
    pub const fn is_protected(self) -> bool {
        matches!(self, Self::Aead)
    }

    /// Bytes behind the payload.
    pub const fn tag_bytes(self) -> usize {
        match self {
            Self::Aead => TAG_BYTES,
            Self::Checksum => CRC_BYTES,
        }
    }
}

/// Why a key cannot follow the present one.
#[derive(Clone, Copy, Debug, Error, PartialEq, Eq)]
pub enum RekeyError {
    /// It belongs to another connection.
    #[error("the key is for connection {given:#010x}, not for {expected:#010x}")]
    Connection {
        /// Connection of the key.
        given: u32,
        /// Connection of this end.
        expected: u32,
    },
    /// It is not the key of the next phase.
    #[error("the key is of phase {given}; the next phase is {expected}")]
    Phase {
        /// Phase of the key.
        given: u32,
        /// The phase after the newest that is known.
        expected: u32,
    },
    /// It protects more or less than the present one.
    #[error("the key is for seal {given:?}, but the connection began with {expected:?}, and keeps it")]
    Seal {
        /// Seal of the key.
        given: Seal,
        /// Seal of this end.
        expected: Seal,
    },
}

/// Keys of one connection and phase, for both directions. Never printed, never copied.
///
/// The exported bytes are overwritten as soon as the keys are made of them. What `ring` makes of them lives on the heap
/// until it is dropped, and is not overwritten then: `ring` has no way to do so. Initialisation vectors stay, too; without
/// their key they are no secret.
pub struct Keys {
    to_client: OneWay,
    to_server: OneWay,
}

impl fmt::Debug for Keys {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let OneWay { connection, phase, .. } = self.to_client;
        write!(f, "Keys {{ connection: {connection:#010x}, phase: {phase}, .. }}")
    }
}

impl Keys {
    /// Keys of a connection and phase. `export(label, context, out)` fills `out` from the TLS session's exporter; both
    /// ends of a session get the same bytes for the same label and context, and nobody else does.
    ///
    /// # Errors
    /// Those of `export`.
    pub fn from_exporter<E>(
        connection: u32,
        phase: u32,
        export: impl FnOnce(&[u8], &[u8], &mut [u8]) -> Result<(), E>,
    ) -> Result<Self, E> {
        let mut context = [0; 8];
        context[..4].copy_from_slice(&connection.to_le_bytes());
        context[4..].copy_from_slice(&phase.to_le_bytes());
        let mut exported = Exported([0; EXPORTED_BYTES]);
        export(EXPORTER_LABEL, &context, &mut exported.0)?;
        let (to_server, to_client) = exported.0.split_at(KEY_BYTES + NONCE_LEN);
        let one_way = |secret: &[u8]| OneWay { connection, phase, cipher: Cipher::aead(secret) };
        Ok(Self { to_server: one_way(to_server), to_client: one_way(to_client) })
    }

    /// No keys at all: checksums only, for `--insecure`. Anybody can make a valid datagram.
    pub fn unprotected(connection: u32, phase: u32) -> Self {
        let one_way = |direction| OneWay { connection, phase, cipher: Cipher::Checksum { direction } };
        Self { to_server: one_way(1), to_client: one_way(2) }
    }

    /// The key with which this side sends, and the one with which it receives.
    pub fn split(self, side: Side) -> (SendKey, ReceiveKey) {
        match side {
            Side::Client => (SendKey(self.to_server), ReceiveKey(self.to_client)),
            Side::Server => (SendKey(self.to_client), ReceiveKey(self.to_server)),
        }
    }
}

/// The key of the direction in which this side sends.
pub struct SendKey(pub(super) OneWay);

/// The key of the direction in which this side receives.
pub struct ReceiveKey(pub(super) OneWay);

impl fmt::Debug for SendKey {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("SendKey { .. }")
    }
}

impl fmt::Debug for ReceiveKey {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("ReceiveKey { .. }")
    }
}

/// Bytes that are overwritten when they are dropped.
struct Exported([u8; EXPORTED_BYTES]);

impl Drop for Exported {
    fn drop(&mut self) {
        self.0.fill(0);
        // The compiler must take it that somebody looks at the zeros.
        std::hint::black_box(&self.0);
    }
}

/// Key of one direction in one phase.
pub(super) struct OneWay {
    pub connection: u32,
    pub phase: u32,
    pub cipher: Cipher,
}

impl OneWay {
    /// The part of the phase's number that a header has room for.
    pub fn phase_byte(&self) -> u8 {
        self.phase as u8
    }

    /// A copy, for opening alone: two that seal would use the same nonces.
    pub fn copied_to_open(&self) -> Self {
        let cipher = match &self.cipher {
            Cipher::Aead { key, iv } => Cipher::Aead { key: key.clone(), iv: *iv },
            Cipher::Checksum { direction } => Cipher::Checksum { direction: *direction },
        };
        Self { cipher, ..*self }
    }

    /// Whether `next` may follow this one.
    pub fn check_successor(&self, next: &Self) -> Result<(), RekeyError> {
        if next.connection != self.connection {
            return Err(RekeyError::Connection { given: next.connection, expected: self.connection });
        }
        // After the last phase there is none: a connection that has had so many keys is to be made anew.
        if next.phase == 0 || next.phase - 1 != self.phase {
            return Err(RekeyError::Phase { given: next.phase, expected: self.phase.saturating_add(1) });
        }
        let (given, expected) = (next.cipher.seal_kind(), self.cipher.seal_kind());
        if given == expected { Ok(()) } else { Err(RekeyError::Seal { given, expected }) }
    }
}

/// What closes the datagrams of one direction.
pub(super) enum Cipher {
    /// On the heap, so that moving it leaves no copy of the key behind.
    Aead { key: Box<LessSafeKey>, iv: [u8; NONCE_LEN] },
    /// The checksum begins with the direction, so that a reflected datagram is damaged.
    Checksum { direction: u8 },
}

impl Cipher {
    /// From a key and an initialisation vector, one after the other.
    fn aead(secret: &[u8]) -> Self {
        let (key, rest) = secret.split_at(KEY_BYTES);
        let mut iv = [0; NONCE_LEN];
        iv.copy_from_slice(rest);
        let key = UnboundKey::new(&CHACHA20_POLY1305, key).expect("32 bytes are the length of its keys");
        Self::Aead { key: Box::new(LessSafeKey::new(key)), iv }
    }

    pub fn seal_kind(&self) -> Seal {
        match self {
            Self::Aead { .. } => Seal::Aead,
            Self::Checksum { .. } => Seal::Checksum,
        }
    }

    /// Encrypts the payload in place, and writes the tag behind it. `None` when `ring` refuses, which it does not below a
    /// payload of 256 GiB.
    #[must_use]
    pub fn seal(
        &self,
        sequence: u64,
        header: &[u8; HEADER_BYTES],
        payload: &mut [u8],
        tag: &mut [u8; TAG_BYTES],
    ) -> Option<()> {
        match self {
            Self::Aead { key, iv } => {
                let sealed =
                    key.seal_in_place_separate_tag(nonce(iv, sequence), Aad::from(header), payload).ok()?;
                tag.copy_from_slice(sealed.as_ref());
            }
            Self::Checksum { direction } => {
                let sum = checksum(*direction, header, payload);
                tag[..CRC_BYTES].copy_from_slice(&sum.to_le_bytes());
            }
        }
        Some(())
    }

    /// Checks payload and tag, and decrypts in place; `None` when they do not belong together.
    pub fn open<'a>(
        &self,
        sequence: u64,
        header: &[u8; HEADER_BYTES],
        sealed: &'a mut [u8],
    ) -> Option<&'a [u8]> {
        match self {
            Self::Aead { key, iv } => {
                let payload = key.open_in_place(nonce(iv, sequence), Aad::from(header), sealed).ok()?;
                Some(payload)
            }
            Self::Checksum { direction } => {
                let (payload, sum) = sealed.split_last_chunk::<CRC_BYTES>()?;
                (checksum(*direction, header, payload) == u32::from_le_bytes(*sum)).then_some(payload)
            }
        }
    }
}

/// The initialisation vector, changed by the sequence in its last eight bytes, as TLS 1.3 does it (RFC 8446, 5.3).
fn nonce(iv: &[u8; NONCE_LEN], sequence: u64) -> Nonce {
    let mut nonce = *iv;
    for (byte, changed) in nonce[4..].iter_mut().zip(sequence.to_be_bytes()) {
        *byte ^= changed;
    }
    Nonce::assume_unique_for_key(nonce)
}

fn checksum(direction: u8, header: &[u8], payload: &[u8]) -> u32 {
    let mut sum = crc32fast::Hasher::new();
    sum.update(&[direction]);
    sum.update(header);
    sum.update(payload);
    sum.finalize()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::datagram::keys_testing::{exporter, keys};

    #[test]
    fn no_secret_is_printed() {
        let keys = keys(7, 3, 2);
        assert_eq!(format!("{keys:?}"), "Keys { connection: 0x00000007, phase: 3, .. }");
        let (send, receive) = keys.split(Side::Client);
        assert_eq!(format!("{send:?} {receive:?}"), "SendKey { .. } ReceiveKey { .. }");
    }

    #[test]
    fn the_exporter_is_asked_with_label_connection_and_the_whole_phase() {
        let mut asked = Vec::new();
        for (connection, phase) in [(0x0403_0201, 0x0807_0605), (0x0403_0201, 0x0807_0705)] {
            let keys = Keys::from_exporter(connection, phase, |label, context, out| {
                assert_eq!(label, b"EXPORTER-trocar-datagrams");
                asked.push((context.to_vec(), out.len()));
                Ok::<(), ()>(())
            });
            assert!(keys.is_ok());
        }
        assert_eq!(asked, [(vec![1, 2, 3, 4, 5, 6, 7, 8], 88), (vec![1, 2, 3, 4, 5, 7, 7, 8], 88)]);
        assert_eq!(Keys::from_exporter(1, 0, |_, _, _| Err("no session")).err(), Some("no session"));
    }

    #[test]
    fn both_ends_of_a_session_have_keys_that_fit() {
        let end = |side| Keys::from_exporter(1, 0, exporter(9)).expect("it exports").split(side);
        let ((client_send, client_receive), (server_send, server_receive)) =
            (end(Side::Client), end(Side::Server));
        let header = [3; HEADER_BYTES];
        let opens = |send: &SendKey, receive: &ReceiveKey| {
            let mut sealed = [1; 8 + TAG_BYTES];
            let (payload, tag) = sealed.split_last_chunk_mut().expect("it is longer");
            send.0.cipher.seal(5, &header, payload, tag).expect("it is short");
            receive.0.cipher.open(5, &header, &mut sealed).is_some_and(|payload| *payload == [1; 8])
        };
        assert!(opens(&client_send, &server_receive) && opens(&server_send, &client_receive));
        assert!(!opens(&client_send, &client_receive) && !opens(&server_send, &server_receive));
    }

    #[test]
    fn an_unprotected_link_says_so() {
        assert!(Seal::Aead.is_protected() && !Seal::Checksum.is_protected());
        assert_eq!((Seal::Aead.tag_bytes(), Seal::Checksum.tag_bytes()), (16, 4));
    }
}

//! What a relay and its hosts tell each other: short messages on the host's line, and the datagrams between both.
//!
//! A message is its length (u8), its kind (u8) and its fields; numbers are little-endian. A datagram between host and relay is
//! a station's number (u32) and that station's datagram, or a [`Bind`].

use std::fmt;
use std::str::FromStr;

use data_encoding::HEXLOWER_PERMISSIVE;
use ring::rand::SecureRandom;
use thiserror::Error;

use crate::ticket::{NoRandomness, Secret};

/// First bytes of a relay's first message, and of a bind.
const MAGIC: [u8; 12] = *b"trocar-relay";
/// Version of these messages.
pub const RELAY_VERSION: u8 = 1;
/// Bytes of a nonce.
pub const NONCE_BYTES: usize = 16;
/// Bytes of a code.
const CODE_BYTES: usize = 32;
/// Longest message, without its length.
pub const MESSAGE_MAX: usize = 64;
/// Bytes of a bind: magic, version, port, number, code.
pub const BIND_BYTES: usize = MAGIC.len() + 1 + 2 + 8 + CODE_BYTES;
/// Bytes of a station's number before its datagram.
pub const NUMBER_BYTES: usize = 4;
/// Digits of a key in a file.
pub const KEY_TEXT_BYTES: usize = 64;

/// Names what a code is for, so that none of one kind is one of another.
const FOR_REGISTER: &[u8] = b"register";
const FOR_FETCH: &[u8] = b"fetch";
const FOR_BIND: &[u8] = b"bind";

/// What a relay asks a line with, once.
pub type Nonce = [u8; NONCE_BYTES];

/// What hosts of a relay have, and others have not: 256 random bits, in a file of mode 0600 as 64 hexadecimal digits.
#[derive(Clone, PartialEq, Eq)]
pub struct RelayKey(Secret<32>);

impl fmt::Debug for RelayKey {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("RelayKey(..)")
    }
}

/// A text that is no key.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[error(
    "no key of a relay: it is {KEY_TEXT_BYTES} hexadecimal digits, which the relay has written into its file"
)]
pub struct NoKey;

impl FromStr for RelayKey {
    type Err = NoKey;

    fn from_str(text: &str) -> Result<Self, NoKey> {
        let bytes = HEXLOWER_PERMISSIVE.decode(text.trim().as_bytes()).map_err(|_| NoKey)?;
        Ok(Self(Secret::from_bytes(bytes.try_into().map_err(|_| NoKey)?)))
    }
}

impl RelayKey {
    /// A new key.
    ///
    /// # Errors
    /// [`NoRandomness`].
    pub fn random(random: &dyn SecureRandom) -> Result<Self, NoRandomness> {
        Secret::random(random).map(Self)
    }

    /// The key as text, for its file and nowhere else.
    pub fn to_text(&self) -> String {
        HEXLOWER_PERMISSIVE.encode(self.0.as_bytes())
    }

    fn code(&self, what: &[u8], parts: &[&[u8]]) -> blake3::Hash {
        let mut hasher = blake3::Hasher::new_keyed(self.0.as_bytes());
        hasher.update(&[what.len() as u8]).update(what);
        // All parts have lengths that do not change.
        for part in parts {
            hasher.update(part);
        }
        hasher.finalize()
    }

    /// The answer of a host that wants a port, this one if it is free; 0 is any.
    pub fn register(&self, nonce: &Nonce, wish: u16) -> FromHost {
        FromHost::Register { wish, code: self.code(FOR_REGISTER, &[nonce, &wish.to_le_bytes()]).into() }
    }

    /// The answer of a host that comes for a stream.
    pub fn fetch(&self, nonce: &Nonce, stream: u64) -> FromHost {
        FromHost::Fetch { stream, code: self.code(FOR_FETCH, &[nonce, &stream.to_le_bytes()]).into() }
    }

    /// Whether an answer to this nonce is that of somebody who has the key. In constant time.
    pub fn accepts(&self, nonce: &Nonce, answer: &FromHost) -> bool {
        match answer {
            FromHost::Register { wish, code } => {
                self.code(FOR_REGISTER, &[nonce, &wish.to_le_bytes()]) == *code
            }
            FromHost::Fetch { stream, code } => {
                self.code(FOR_FETCH, &[nonce, &stream.to_le_bytes()]) == *code
            }
            FromHost::Pong => true,
        }
    }
}

/// Why a relay does not do what a host asks for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum RelayRefusal {
    /// The host has another key, or none.
    #[error("the relay does not know the key; ask its operator for the file")]
    Key,
    /// All ports are in use.
    #[error("all ports of the relay are in use; try again when another session is over")]
    Full,
    /// The stream is gone.
    #[error("the station has left before it was fetched")]
    Gone,
}

/// From a relay to a host.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FromRelay {
    /// The first: who are you?
    Challenge(Nonce),
    /// The session has this port.
    Registered(u16),
    /// It does not.
    Refused(RelayRefusal),
    /// A station has come, and its stream waits to be fetched by this number.
    Knock(u64),
    /// Are you there?
    Ping,
}

/// From a host to a relay.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FromHost {
    /// It wants a port.
    Register {
        /// The one that it had before, so that its tickets stay true; 0 is any.
        wish: u16,
        /// Of the key, the nonce and the wish.
        code: [u8; CODE_BYTES],
    },
    /// It comes for a stream; what follows on this line is the stream itself.
    Fetch {
        /// The stream's number.
        stream: u64,
        /// Of the key, the nonce and the number.
        code: [u8; CODE_BYTES],
    },
    /// It is there.
    Pong,
}

/// Bytes that are no message.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum WireError {
    /// It is longer than any.
    #[error("a message of {0} bytes; the longest has {MESSAGE_MAX}")]
    Long(u8),
    /// It is none that this program knows.
    #[error("no message of a relay of version {RELAY_VERSION}; use the same release at both ends")]
    Unknown,
}

fn framed(kind: u8, fields: &[&[u8]]) -> Vec<u8> {
    let length = 1 + fields.iter().map(|field| field.len()).sum::<usize>();
    // Every message is shorter than its limit.
    let mut bytes = vec![length as u8, kind];
    fields.iter().for_each(|field| bytes.extend_from_slice(field));
    bytes
}

impl FromRelay {
    /// The message as bytes of the line.
    pub fn encode(&self) -> Vec<u8> {
        match self {
            Self::Challenge(nonce) => framed(0, &[&MAGIC, &[RELAY_VERSION], nonce]),
            Self::Registered(port) => framed(1, &[&port.to_le_bytes()]),
            Self::Refused(refusal) => framed(2, &[&[*refusal as u8]]),
            Self::Knock(stream) => framed(3, &[&stream.to_le_bytes()]),
            Self::Ping => framed(4, &[]),
        }
    }

    /// Reads a message without its length.
    ///
    /// # Errors
    /// [`WireError::Unknown`].
    pub fn decode(bytes: &[u8]) -> Result<Self, WireError> {
        let message = match bytes {
            [0, rest @ ..] => {
                let nonce = rest.strip_prefix(&MAGIC).and_then(|rest| rest.strip_prefix(&[RELAY_VERSION]));
                nonce.and_then(|nonce| nonce.try_into().ok()).map(Self::Challenge)
            }
            [1, low, high] => Some(Self::Registered(u16::from_le_bytes([*low, *high]))),
            [2, 0] => Some(Self::Refused(RelayRefusal::Key)),
            [2, 1] => Some(Self::Refused(RelayRefusal::Full)),
            [2, 2] => Some(Self::Refused(RelayRefusal::Gone)),
            [3, stream @ ..] => stream.try_into().ok().map(|stream| Self::Knock(u64::from_le_bytes(stream))),
            [4] => Some(Self::Ping),
            _ => None,
        };
        message.ok_or(WireError::Unknown)
    }
}

impl FromHost {
    /// The message as bytes of the line.
    pub fn encode(&self) -> Vec<u8> {
        match self {
            Self::Register { wish, code } => framed(16, &[&wish.to_le_bytes(), code]),
            Self::Fetch { stream, code } => framed(17, &[&stream.to_le_bytes(), code]),
            Self::Pong => framed(18, &[]),
        }
    }

    /// Reads a message without its length.
    ///
    /// # Errors
    /// [`WireError::Unknown`].
    pub fn decode(bytes: &[u8]) -> Result<Self, WireError> {
        let message = match bytes {
            [16, low, high, code @ ..] => {
                let wish = u16::from_le_bytes([*low, *high]);
                code.try_into().ok().map(|code| Self::Register { wish, code })
            }
            [17, rest @ ..] => rest.split_first_chunk().and_then(|(stream, code)| {
                let stream = u64::from_le_bytes(*stream);
                code.try_into().ok().map(|code| Self::Fetch { stream, code })
            }),
            [18] => Some(Self::Pong),
            _ => None,
        };
        message.ok_or(WireError::Unknown)
    }
}

/// Takes messages out of a line, in any pieces.
#[derive(Clone, Debug, Default)]
pub struct LineDecoder {
    bytes: Vec<u8>,
}

impl LineDecoder {
    /// The next message without its length, when it is whole; of `input` no more is taken than belongs to it.
    ///
    /// # Errors
    /// [`WireError::Long`].
    pub fn next(&mut self, input: &mut &[u8]) -> Result<Option<Vec<u8>>, WireError> {
        loop {
            let wanted = match self.bytes.first() {
                Some(length) if usize::from(*length) > MESSAGE_MAX => return Err(WireError::Long(*length)),
                Some(length) => 1 + usize::from(*length),
                None => 1,
            };
            if self.bytes.len() == wanted && wanted > 1 {
                return Ok(Some(std::mem::take(&mut self.bytes).split_off(1)));
            }
            if self.bytes.len() == wanted {
                // A message without even a kind.
                self.bytes.clear();
                return Err(WireError::Unknown);
            }
            let count = input.len().min(wanted - self.bytes.len());
            if count == 0 {
                return Ok(None);
            }
            let (taken, rest) = input.split_at(count);
            self.bytes.extend_from_slice(taken);
            *input = rest;
        }
    }
}

/// Says from where a host's datagrams come, and where its stations' go: sent again and again, so that routers keep the way.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Bind {
    /// The session's port.
    pub port: u16,
    /// Rises with every bind.
    pub number: u64,
}

impl Bind {
    fn head(&self) -> [u8; BIND_BYTES - CODE_BYTES] {
        let mut head = [0; BIND_BYTES - CODE_BYTES];
        let fields = [&MAGIC[..], &[RELAY_VERSION], &self.port.to_le_bytes(), &self.number.to_le_bytes()];
        fields.iter().fold(0, |at, field| {
            head[at..at + field.len()].copy_from_slice(field);
            at + field.len()
        });
        head
    }

    /// The datagram. `nonce` is that with which the host registered, so that a bind is of one session only.
    pub fn encode(&self, key: &RelayKey, nonce: &Nonce) -> [u8; BIND_BYTES] {
        let mut bytes = [0; BIND_BYTES];
        let head = self.head();
        bytes[..head.len()].copy_from_slice(&head);
        bytes[head.len()..].copy_from_slice(key.code(FOR_BIND, &[nonce, &head]).as_bytes());
        bytes
    }

    /// Reads a datagram that is as long as a bind and begins like one, without believing it; `None` if it is none.
    pub fn read(bytes: &[u8]) -> Option<Self> {
        let rest = bytes.strip_prefix(&MAGIC)?.strip_prefix(&[RELAY_VERSION])?;
        let (port, rest) = rest.split_first_chunk()?;
        let (number, code) = rest.split_first_chunk()?;
        (code.len() == CODE_BYTES)
            .then(|| Self { port: u16::from_le_bytes(*port), number: u64::from_le_bytes(*number) })
    }

    /// Whether the datagram is that of somebody who has the key and registered with this nonce. In constant time.
    pub fn is_authentic(&self, bytes: &[u8], key: &RelayKey, nonce: &Nonce) -> bool {
        let head = self.head();
        let code = bytes.strip_prefix(&head).and_then(|code| <[u8; CODE_BYTES]>::try_from(code).ok());
        code.is_some_and(|code| key.code(FOR_BIND, &[nonce, &head]) == code)
    }
}

/// A station's datagram with its number before it, as host and relay send it to each other; `into` is overwritten.
pub fn numbered(number: u32, datagram: &[u8], into: &mut Vec<u8>) {
    into.clear();
    into.extend_from_slice(&number.to_le_bytes());
    into.extend_from_slice(datagram);
}

/// A station's number, and its datagram.
pub fn split_number(bytes: &[u8]) -> Option<(u32, &[u8])> {
    let (number, datagram) = bytes.split_first_chunk::<NUMBER_BYTES>()?;
    Some((u32::from_le_bytes(*number), datagram))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn key(byte: u8) -> RelayKey {
        RelayKey(Secret::from_bytes([byte; 32]))
    }

    #[test]
    fn every_message_comes_over_the_line_whole_however_it_is_cut() {
        let to_host = [
            FromRelay::Challenge([7; 16]),
            FromRelay::Registered(7_500),
            FromRelay::Refused(RelayRefusal::Key),
            FromRelay::Refused(RelayRefusal::Full),
            FromRelay::Refused(RelayRefusal::Gone),
            FromRelay::Knock(u64::MAX - 1),
            FromRelay::Ping,
        ];
        let line: Vec<u8> = to_host.iter().flat_map(FromRelay::encode).collect();
        for piece in [1, 2, 5, 100] {
            let (mut decoder, mut heard) = (LineDecoder::default(), Vec::new());
            for mut bytes in line.chunks(piece) {
                while let Some(message) = decoder.next(&mut bytes).expect("messages") {
                    heard.push(FromRelay::decode(&message).expect("a message"));
                }
            }
            assert_eq!(heard, to_host);
        }
        for message in [key(1).register(&[3; 16], 7_500), key(1).fetch(&[3; 16], 9), FromHost::Pong] {
            assert_eq!(FromHost::decode(&message.encode()[1..]), Ok(message));
        }
    }

    #[test]
    fn a_code_is_of_one_key_one_nonce_and_one_purpose() {
        let (nonce, other) = ([3; 16], [4; 16]);
        let register = key(1).register(&nonce, 0);
        assert!(key(1).accepts(&nonce, &register));
        assert!(!key(2).accepts(&nonce, &register) && !key(1).accepts(&other, &register));
        let FromHost::Register { code, .. } = register else { panic!("it is one") };
        assert!(!key(1).accepts(&nonce, &FromHost::Fetch { stream: 0, code }));
        assert!(!key(1).accepts(&nonce, &FromHost::Register { wish: 1, code }));
        let FromHost::Fetch { code, .. } = key(1).fetch(&nonce, 5) else { panic!("it is one") };
        assert!(key(1).accepts(&nonce, &FromHost::Fetch { stream: 5, code }));
        assert!(!key(1).accepts(&nonce, &FromHost::Fetch { stream: 6, code }));
        let bind = Bind { port: 7_500, number: 8 };
        let bytes = bind.encode(&key(1), &nonce);
        assert_eq!(Bind::read(&bytes), Some(bind));
        assert!(bind.is_authentic(&bytes, &key(1), &nonce));
        assert!(!bind.is_authentic(&bytes, &key(2), &nonce) && !bind.is_authentic(&bytes, &key(1), &other));
        assert!(!Bind { number: 9, ..bind }.is_authentic(&bytes, &key(1), &nonce));
    }

    #[test]
    fn a_key_is_read_as_it_was_written_and_its_debug_text_has_none_of_it() {
        let text = key(0xab).to_text();
        assert_eq!(text.len(), KEY_TEXT_BYTES);
        assert_eq!(format!("{text}\n").parse(), Ok(key(0xab)));
        assert_eq!("ab".parse::<RelayKey>(), Err(NoKey));
        assert!(!format!("{:?}", key(0xab)).contains("ab"));
    }

    proptest! {
        #[test]
        fn no_bytes_panic_a_decoder(bytes in prop::collection::vec(any::<u8>(), 0..200)) {
            let (mut decoder, mut rest) = (LineDecoder::default(), bytes.as_slice());
            while let Ok(Some(message)) = decoder.next(&mut rest) {
                prop_assert!(message.len() <= MESSAGE_MAX);
                let _ = (FromRelay::decode(&message), FromHost::decode(&message));
            }
            let _ = (Bind::read(&bytes), split_number(&bytes));
        }
    }
}

//! Opener: the receiving end of one direction. It authenticates first, and only then judges the sequence.
//!
//! A datagram with a forged sequence far ahead must not move the replay window, or all honest ones after it would be
//! refused (Bonaci et al., "To make a robot secure", arXiv 1504.04339, 2015).

use thiserror::Error;
use trocar_scene::SimTime;

use super::keys::{OneWay, ReceiveKey, RekeyError};
use super::replay_window::{ReplayWindow, Stale};
use super::{DATAGRAM_MAX, HEADER_BYTES, Header, HeaderError};

/// Forgeries under one key after which it asks to be replaced: half of what ChaCha20-Poly1305 bears in QUIC (RFC 9001,
/// 6.6), four days of 100,000 a second.
pub const FORGERIES_WORN: u64 = 1 << 35;

/// Why a datagram was refused.
#[derive(Clone, Copy, Debug, Error, PartialEq, Eq)]
pub enum Refused {
    /// It is too short for a header and a tag, or longer than any datagram.
    #[error("a datagram of {bytes} bytes cannot be one; {min} to {DATAGRAM_MAX} are valid")]
    Length {
        /// Its bytes.
        bytes: usize,
        /// Fewest bytes.
        min: usize,
    },
    /// Its header is not valid.
    #[error(transparent)]
    Header(#[from] HeaderError),
    /// It belongs to another connection.
    #[error("the datagram is for connection {given:#010x}, not for {expected:#010x}")]
    Connection {
        /// Connection of the datagram.
        given: u32,
        /// Connection of this end.
        expected: u32,
    },
    /// No key of that phase is known, or not any more.
    #[error("the datagram is of key phase {given}; the present one is {current} (low bytes)")]
    Phase {
        /// Phase of the datagram.
        given: u8,
        /// Phase of the present key.
        current: u8,
    },
    /// It was not sealed with the key, or not as it is.
    #[error("the datagram's seal is broken")]
    Forged,
    /// It is authentic, but has come before, or too late to tell.
    #[error(transparent)]
    Stale(#[from] Stale),
}

/// How many datagrams were opened, and how many refused for which reason.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RefusalCounts {
    /// Opened.
    pub opened: u64,
    /// Too short or too long.
    pub length: u64,
    /// Of another wire version.
    pub version: u64,
    /// Of an unknown kind, or with too many hands.
    pub header: u64,
    /// Of another connection.
    pub connection: u64,
    /// Of a phase without a key.
    pub phase: u64,
    /// With a broken seal.
    pub forged: u64,
    /// Opened before.
    pub replayed: u64,
    /// Authentic, but behind the replay window, or with a number that is never sent.
    pub too_old: u64,
}

impl RefusalCounts {
    /// How many were refused.
    pub fn refused(&self) -> u64 {
        let Self { opened: _, length, version, header, connection, phase, forged, replayed, too_old } = self;
        length + version + header + connection + phase + forged + replayed + too_old
    }

    fn count(&mut self, refused: &Refused) {
        *match refused {
            Refused::Length { .. } | Refused::Header(HeaderError::Short(_)) => &mut self.length,
            Refused::Header(HeaderError::Version(_)) => &mut self.version,
            Refused::Header(_) => &mut self.header,
            Refused::Connection { .. } => &mut self.connection,
            Refused::Phase { .. } => &mut self.phase,
            Refused::Forged => &mut self.forged,
            Refused::Stale(Stale::Replayed(_)) => &mut self.replayed,
            Refused::Stale(_) => &mut self.too_old,
        } += 1;
    }
}

/// Opens the datagrams of one direction, each once.
///
/// It knows up to three keys: the present one, the next one from [`Opener::rekey`] until the sender first uses it, and
/// the previous one for a grace time after that, since datagrams overtake each other. Keys are freed by
/// [`Opener::rekey`] alone, which no real-time path calls.
pub struct Opener {
    current: OneWay,
    next: Option<OneWay>,
    /// With the time until which it opens.
    previous: Option<(OneWay, SimTime)>,
    /// One that opens nothing any more, until it is freed.
    retired: Option<OneWay>,
    grace: SimTime,
    window: ReplayWindow,
    counts: RefusalCounts,
    /// Forgeries under the present key.
    forgeries: u64,
}

impl Opener {
    /// An opener that has accepted nothing yet. A key is known for `grace` after the sender has left it.
    pub fn new(key: ReceiveKey, grace: SimTime) -> Self {
        Self {
            current: key.0,
            next: None,
            previous: None,
            retired: None,
            grace,
            window: ReplayWindow::default(),
            counts: RefusalCounts::default(),
            forgeries: 0,
        }
    }

    /// A copy that opens what this one would, for a session that is copied with all that is under way. Its sender goes on
    /// under a key of its own.
    pub fn copied(&self) -> Self {
        let key = |key: &Option<OneWay>| key.as_ref().map(OneWay::copied_to_open);
        Self {
            current: self.current.copied_to_open(),
            next: key(&self.next),
            previous: self.previous.as_ref().map(|(key, until)| (key.copied_to_open(), *until)),
            retired: None,
            grace: self.grace,
            window: self.window.clone(),
            counts: self.counts,
            forgeries: self.forgeries,
        }
    }

    /// Knows the next phase's key from now on. If one was waiting to be used, that one becomes the present key: both
    /// sides agree on a further key only after the sender has taken the one before.
    ///
    /// # Errors
    /// When the key is of another connection, not of the next phase, or of another kind of seal.
    pub fn rekey(&mut self, now: SimTime, key: ReceiveKey) -> Result<(), RekeyError> {
        self.next.as_ref().unwrap_or(&self.current).check_successor(&key.0)?;
        self.advance(now);
        self.retired = None;
        self.next = Some(key.0);
        Ok(())
    }

    /// Checks a datagram that arrived at `now`, decrypts it in place, and returns its header and payload. What a refused
    /// datagram then contains is of no use.
    ///
    /// # Errors
    /// Why it was refused. Nothing is to be answered to it.
    pub fn open<'a>(&mut self, now: SimTime, datagram: &'a mut [u8]) -> Result<(Header, &'a [u8]), Refused> {
        let opened = self.judge(now, datagram);
        match &opened {
            Ok(_) => self.counts.opened += 1,
            Err(refused) => self.counts.count(refused),
        }
        opened
    }

    fn judge<'a>(&mut self, now: SimTime, datagram: &'a mut [u8]) -> Result<(Header, &'a [u8]), Refused> {
        let bytes = datagram.len();
        let min = HEADER_BYTES + self.current.cipher.seal_kind().tag_bytes();
        if !(min..=DATAGRAM_MAX).contains(&bytes) {
            return Err(Refused::Length { bytes, min });
        }
        let header = Header::decode(datagram)?;
        if header.connection != self.current.connection {
            let (given, expected) = (header.connection, self.current.connection);
            return Err(Refused::Connection { given, expected });
        }
        let key = self.key_of(now, header.phase)?;
        let Some((head, sealed)) = datagram.split_first_chunk_mut() else {
            return Err(Refused::Length { bytes, min });
        };
        let Some(payload) = key.cipher.open(header.sequence, head, sealed) else {
            self.forgeries = self.forgeries.saturating_add(1);
            return Err(Refused::Forged);
        };
        if self.next.as_ref().is_some_and(|next| next.phase_byte() == header.phase) {
            self.advance(now);
        }
        self.window.accept(header.sequence)?;
        Ok((header, payload))
    }

    fn key_of(&self, now: SimTime, phase: u8) -> Result<&OneWay, Refused> {
        let previous = self.previous.as_ref().filter(|(_, until)| now <= *until).map(|(key, _)| key);
        // The three have numbers in a row, so their low bytes differ.
        let mut known = [Some(&self.current), self.next.as_ref(), previous].into_iter().flatten();
        let current = self.current.phase_byte();
        known.find(|key| key.phase_byte() == phase).ok_or(Refused::Phase { given: phase, current })
    }

    /// The next key becomes the present one, if there is one.
    fn advance(&mut self, now: SimTime) {
        if let Some(next) = self.next.take() {
            let left = std::mem::replace(&mut self.current, next);
            let previous = self.previous.replace((left, now + self.grace));
            self.retired = previous.map(|(key, _)| key);
            self.forgeries = 0;
        }
    }

    /// Whether so many forgeries came that the key should be replaced.
    pub fn is_worn(&self) -> bool {
        self.forgeries >= FORGERIES_WORN
    }

    /// Whether strangers can neither read nor make the datagrams that it opens.
    pub fn is_protected(&self) -> bool {
        self.current.cipher.seal_kind().is_protected()
    }

    /// Number of the present key.
    pub fn phase(&self) -> u32 {
        self.current.phase
    }

    /// How many datagrams were opened and refused.
    pub fn counts(&self) -> &RefusalCounts {
        &self.counts
    }

    /// Number of the newest datagram opened; 0 before the first.
    pub fn newest_sequence(&self) -> u64 {
        self.window.newest()
    }
}

#[cfg(test)]
#[path = "attack_tests.rs"]
mod attacks;
#[cfg(test)]
#[path = "open_tests.rs"]
mod tests;

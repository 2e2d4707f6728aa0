//! The host's end of a diagnosis: datagrams go back as they came.

use trocar_scene::SimTime;

use crate::control::EchoCounts;
use crate::datagram::{DATAGRAM_MAX, Keys, Kind, Opener, PAYLOAD_MAX, Sealer, Side};

/// Most answers of one diagnosis.
pub const ECHOES_MAX: u32 = 256;
/// Least time between two counts that the asker is told.
pub const NEWS_EVERY: SimTime = SimTime::from_millis(100);

/// Echoes the datagrams of one connection. Does not allocate after it was made.
pub struct EchoEnd {
    id: u32,
    sealer: Sealer,
    opener: Opener,
    counts: EchoCounts,
    told: EchoCounts,
    told_at: Option<SimTime>,
}

impl EchoEnd {
    /// Of the connection of this number, with its keys.
    pub fn new(id: u32, keys: Keys) -> Self {
        let (send, receive) = keys.split(Side::Server);
        Self {
            id,
            sealer: Sealer::new(send),
            // No other key follows.
            opener: Opener::new(receive, SimTime::ZERO),
            counts: EchoCounts::default(),
            told: EchoCounts::default(),
            told_at: None,
        }
    }

    /// Number of its connection.
    pub fn id(&self) -> u32 {
        self.id
    }

    /// The answer to a datagram, which is decrypted in place; its length in `out`. `None` where there is none: to what is
    /// not authentic, comes again, is no echo, or is one too many.
    pub fn answer(
        &mut self,
        now: SimTime,
        datagram: &mut [u8],
        out: &mut [u8; DATAGRAM_MAX],
    ) -> Option<usize> {
        let (header, payload) = self.opener.open(now, datagram).ok()?;
        if header.kind != Kind::Echo || self.counts.short + self.counts.long >= ECHOES_MAX {
            return None;
        }
        let length = self.sealer.seal(Kind::Echo, 0, now, payload, out).ok()?;
        if payload.len() == PAYLOAD_MAX {
            self.counts.long += 1;
        } else {
            self.counts.short += 1;
        }
        Some(length)
    }

    /// What has come, if it is more than was told last, and that was a while ago.
    pub fn news(&mut self, now: SimTime) -> Option<EchoCounts> {
        let is_early = self.told_at.is_some_and(|at| now.since(at) < NEWS_EVERY);
        if is_early || self.counts == self.told {
            return None;
        }
        (self.told, self.told_at) = (self.counts, Some(now));
        Some(self.counts)
    }
}

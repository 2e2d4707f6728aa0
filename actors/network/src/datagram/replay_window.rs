//! Replay window: accepts every sequence number once, without a bit being shifted (Zhang and Tsou, RFC 6479, 2012).
//!
//! The bits of the newest numbers lie in a ring of words. A newer number clears the words between, so the work is
//! bounded by the ring's length, whatever the distance. Only authenticated numbers may be shown to the window: a forged
//! one would move it past all that are still to come.

use thiserror::Error;

/// Bits of a word of the ring.
const WORD_BITS: u64 = u64::BITS as u64;
/// How far behind the newest number one may be: four seconds of datagrams at 1 kHz.
pub const REPLAY_WINDOW: u64 = 4_096;
/// Words of the ring: one more than the window has, since the newest word is only begun.
const WORDS: u64 = REPLAY_WINDOW / WORD_BITS + 1;

/// Why a sequence number is not accepted.
#[derive(Clone, Copy, Debug, Error, PartialEq, Eq)]
pub enum Stale {
    /// It has been accepted before.
    #[error("sequence number {0} has been accepted before")]
    Replayed(u64),
    /// It is too far behind the newest to tell.
    #[error("sequence number {sequence} is {REPLAY_WINDOW} or more behind the newest, {newest}")]
    TooOld {
        /// The number.
        sequence: u64,
        /// The newest number accepted.
        newest: u64,
    },
    /// No sender uses it.
    #[error("sequence number {0} is never sent; numbers are 1 to {max}", max = u64::MAX - 1)]
    NeverSent(u64),
}

/// Which sequence numbers have been accepted: of the newest 4,096 each by itself, and of older ones all.
#[derive(Clone, Debug)]
pub struct ReplayWindow {
    /// 0 before the first number.
    newest: u64,
    /// Bit `n % 64` of word `n / 64 % WORDS` is set once number `n` has been accepted.
    words: [u64; WORDS as usize],
}

impl Default for ReplayWindow {
    fn default() -> Self {
        Self { newest: 0, words: [0; WORDS as usize] }
    }
}

impl ReplayWindow {
    /// The newest number accepted; 0 if there is none.
    pub fn newest(&self) -> u64 {
        self.newest
    }

    /// Accepts an authenticated number, once.
    ///
    /// # Errors
    /// When it has been accepted before, may have been, or is 0 or `u64::MAX`, which no sender uses.
    pub fn accept(&mut self, sequence: u64) -> Result<(), Stale> {
        if sequence == 0 || sequence == u64::MAX {
            return Err(Stale::NeverSent(sequence));
        }
        let (block, newest_block) = (sequence / WORD_BITS, self.newest / WORD_BITS);
        if sequence > self.newest {
            // Of a longer step the last `WORDS` blocks cover the ring, each once.
            let first = (newest_block + 1).max((block + 1).saturating_sub(WORDS));
            for fresh in first..=block {
                self.words[(fresh % WORDS) as usize] = 0;
            }
            self.newest = sequence;
        } else if self.newest - sequence >= REPLAY_WINDOW {
            return Err(Stale::TooOld { sequence, newest: self.newest });
        }
        let (word, bit) = (&mut self.words[(block % WORDS) as usize], 1 << (sequence % WORD_BITS));
        if *word & bit != 0 {
            return Err(Stale::Replayed(sequence));
        }
        *word |= bit;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use trocar_scene::random::SplitMix64;

    use super::*;

    #[test]
    fn the_window_ends_after_exactly_4_096_numbers() {
        for newest in [4_096_u64, 4_097, 5_000, 1 << 16, 1 << 32, 1 << 48, u64::MAX - 1] {
            let mut window = ReplayWindow::default();
            window.accept(newest).expect("the first is new");
            if newest > 4_096 {
                let sequence = newest - 4_096;
                assert_eq!(window.accept(sequence), Err(Stale::TooOld { sequence, newest }));
            }
            for back in (1..4_096).rev() {
                assert_eq!(window.accept(newest - back), Ok(()), "{back} behind {newest}");
            }
            for back in 0..4_096 {
                assert_eq!(window.accept(newest - back), Err(Stale::Replayed(newest - back)));
            }
        }
    }

    #[test]
    fn numbers_that_are_never_sent_leave_the_window_where_it_is() {
        let mut window = ReplayWindow::default();
        for sequence in [0, u64::MAX] {
            assert_eq!(window.accept(sequence), Err(Stale::NeverSent(sequence)));
        }
        assert_eq!(window.newest(), 0);
        assert_eq!(window.accept(1), Ok(()));
        assert_eq!(window.accept(u64::MAX - 1), Ok(()));
        assert_eq!(window.accept(u64::MAX), Err(Stale::NeverSent(u64::MAX)));
        assert_eq!(window.newest(), u64::MAX - 1);
    }

    #[test]
    fn a_window_accepts_what_a_set_of_all_numbers_would() {
        // Steps of all lengths, forwards and back, around the powers of two.
        for (seed, start) in [1, 1 << 16, 1 << 32, 1 << 48, u64::MAX - 60_000].into_iter().enumerate() {
            let mut random = SplitMix64::new(seed as u64);
            let (mut window, mut accepted) = (ReplayWindow::default(), BTreeSet::new());
            let (mut newest, mut tally) = (0, [0_u32; 3]);
            for _ in 0..50_000 {
                let range = [8, 70, 5_000, 9_000][random.below(4) as usize];
                let around = if newest == 0 { start } else { newest };
                let sequence =
                    around.saturating_add(random.below(range) / 8).saturating_sub(random.below(range));
                if sequence == 0 || sequence == u64::MAX {
                    continue;
                }
                let expected = if sequence <= newest && newest - sequence >= 4_096 {
                    Err(Stale::TooOld { sequence, newest })
                } else if accepted.insert(sequence) {
                    newest = newest.max(sequence);
                    Ok(())
                } else {
                    Err(Stale::Replayed(sequence))
                };
                tally[match expected {
                    Ok(()) => 0,
                    Err(Stale::Replayed(_)) => 1,
                    Err(_) => 2,
                }] += 1;
                assert_eq!(window.accept(sequence), expected);
                assert_eq!(window.newest(), newest);
            }
            assert!(tally.iter().all(|count| *count > 500), "{tally:?} from {start}");
        }
    }
}

//! Acknowledgements of datagrams: the newest sequence number and a bit for each of the 256 before it.
//!
//! Each acknowledgement repeats the earlier ones, so that a lost one costs nothing. It also says up to which revision
//! the reliable part has been applied.

use trocar_scene::Revision;

use super::ReplicationError;
use super::wire_reader::WireReader;

/// How many datagrams before the newest an acknowledgement covers.
pub const WINDOW: u64 = 256;
/// Bytes of an acknowledgement: newest, mask, revision.
pub const ACKNOWLEDGEMENT_BYTES: usize = 8 + 32 + 8;

/// Which datagrams have been taken.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct RowWindow {
    /// The newest one.
    newest: Option<u64>,
    /// Bit k of word k/64: the datagram k + 1 before the newest.
    before: [u64; 4],
}

impl RowWindow {
    /// Whether a datagram has been taken, as far as is known.
    pub fn has(&self, sequence: u64) -> bool {
        match self.newest {
            Some(newest) if sequence == newest => true,
            Some(newest) if sequence < newest => {
                let k = newest - sequence - 1;
                k < WINDOW && self.before[(k / 64) as usize] >> (k % 64) & 1 == 1
            }
            _ => false,
        }
    }

    /// The newest one taken.
    pub fn newest(&self) -> Option<u64> {
        self.newest
    }

    /// A datagram has been taken. One that is older than the window stays unacknowledged.
    pub fn take(&mut self, sequence: u64) {
        let Some(newest) = self.newest else {
            self.newest = Some(sequence);
            return;
        };
        if sequence > newest {
            self.shift(sequence - newest);
            self.newest = Some(sequence);
        } else if sequence < newest {
            let k = newest - sequence - 1;
            if k < WINDOW {
                self.before[(k / 64) as usize] |= 1 << (k % 64);
            }
        }
    }

    /// Moves the bits away from the newest, and that one with them.
    fn shift(&mut self, by: u64) {
        if by > WINDOW {
            self.before = [0; 4];
            return;
        }
        let (words, bits) = (((by - 1) / 64) as usize, (by - 1) % 64);
        let mut moved = [0; 4];
        // First by all but one, then by one with the bit of what was the newest.
        for k in (words..4).rev() {
            moved[k] = self.before[k - words] << bits;
            if bits > 0 && k > words {
                moved[k] |= self.before[k - words - 1] >> (64 - bits);
            }
        }
        // Now `moved` is shifted by `by − 1`; the last place and the former newest follow.
        let mut carry = 0;
        for word in &mut moved {
            let next = *word >> 63;
            *word = *word << 1 | carry;
            carry = next;
        }
        let k = by - 1;
        moved[(k / 64) as usize] |= 1 << (k % 64);
        self.before = moved;
    }

    /// Appends the acknowledgement; nothing before the first datagram has been taken, but for the revision.
    pub fn write(&self, applied: Revision, out: &mut Vec<u8>) {
        // No datagram has the number u64::MAX: a sender ends long before.
        out.extend_from_slice(&self.newest.unwrap_or(u64::MAX).to_le_bytes());
        self.before.iter().for_each(|word| out.extend_from_slice(&word.to_le_bytes()));
        out.extend_from_slice(&applied.0.to_le_bytes());
    }

    /// Reads an acknowledgement: which datagrams were taken, and the revision applied.
    ///
    /// # Errors
    /// When it has another length.
    pub fn read(bytes: &[u8]) -> Result<(Self, Revision), ReplicationError> {
        let mut reader = WireReader::new("an acknowledgement", bytes);
        let newest = reader.word()?;
        let mut before = [0; 4];
        for word in &mut before {
            *word = reader.word()?;
        }
        let applied = Revision(reader.word()?);
        if !reader.is_empty() {
            return Err(reader.refuse(bytes.len() as u64, "48 bytes"));
        }
        Ok((Self { newest: (newest != u64::MAX).then_some(newest), before }, applied))
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn the_window_holds_what_a_set_of_numbers_holds(steps in prop::collection::vec((any::<bool>(), 0_u64..400), 1..60)) {
            let (mut window, mut taken, mut at) = (RowWindow::default(), BTreeSet::new(), 1_000_u64);
            for (ahead, by) in steps {
                let sequence = if ahead { at + by } else { at.saturating_sub(by) };
                let is_in_window = at.saturating_sub(sequence) <= WINDOW || taken.is_empty();
                at = if taken.is_empty() { sequence } else { at.max(sequence) };
                window.take(sequence);
                if is_in_window {
                    taken.insert(sequence);
                }
            }
            prop_assert_eq!(window.newest(), Some(at));
            for sequence in at.saturating_sub(WINDOW)..=at + 3 {
                prop_assert_eq!(window.has(sequence), taken.contains(&sequence), "{} of {}", sequence, at);
            }
            prop_assert!(!window.has(at.saturating_sub(WINDOW + 1)));
            let mut bytes = Vec::new();
            window.write(Revision(5), &mut bytes);
            prop_assert_eq!(bytes.len(), ACKNOWLEDGEMENT_BYTES);
            prop_assert_eq!(RowWindow::read(&bytes), Ok((window, Revision(5))));
        }

        #[test]
        fn any_bytes_are_read_or_refused(bytes in prop::collection::vec(any::<u8>(), 0..60), sequence in any::<u64>()) {
            if let Ok((mut window, _)) = RowWindow::read(&bytes) {
                window.take(sequence);
                let _ = window.has(sequence.wrapping_sub(1));
            }
        }
    }
}

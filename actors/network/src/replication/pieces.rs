//! Long messages in pieces of at most 256 KiB, so that nothing else on the control channel waits long behind one.
//!
//! A piece states the length of the whole message and where in it the piece belongs. The receiver takes pieces in
//! order only, and reserves no memory before bytes have come.

use super::ReplicationError;
use super::delta::DELTA_BYTES_MAX;
use super::wire_reader::WireReader;

/// Most bytes of a piece, its head included.
pub const PIECE_BYTES_MAX: usize = 256 * 1024;
/// Bytes of a piece's head: the message's length and the place in it.
const HEAD_BYTES: usize = 8 + 8;

/// The pieces of a message.
pub fn split(message: &[u8]) -> impl ExactSizeIterator<Item = Vec<u8>> {
    const BODY: usize = PIECE_BYTES_MAX - HEAD_BYTES;
    let count = message.len().div_ceil(BODY).max(1);
    (0..count).map(move |piece| {
        let begin = piece * BODY;
        let body = &message[begin..(begin + BODY).min(message.len())];
        let mut bytes = Vec::with_capacity(HEAD_BYTES + body.len());
        bytes.extend_from_slice(&(message.len() as u64).to_le_bytes());
        bytes.extend_from_slice(&(begin as u64).to_le_bytes());
        bytes.extend_from_slice(body);
        bytes
    })
}

/// Joins the pieces of messages.
#[derive(Debug, Default)]
pub struct Pieces {
    message: Vec<u8>,
    whole: usize,
}

impl Pieces {
    /// Forgets a message of which pieces are missing, because the channel broke.
    pub fn clear(&mut self) {
        *self = Self::default();
    }

    /// How much of a message has come and how long it is \[bytes\]: progress of a join.
    pub fn progress(&self) -> (usize, usize) {
        (self.message.len(), self.whole)
    }

    /// Takes a piece; returns the message when it was the last one.
    ///
    /// # Errors
    /// When the piece is not the next one, or the message is longer than [`DELTA_BYTES_MAX`].
    pub fn take(&mut self, piece: &[u8]) -> Result<Option<Vec<u8>>, ReplicationError> {
        let mut reader = WireReader::new("a piece of a delta", piece);
        let whole = reader.word()?;
        let Some(length) = usize::try_from(whole).ok().filter(|whole| *whole <= DELTA_BYTES_MAX) else {
            return Err(reader.refuse(whole, "a length up to 256 MiB"));
        };
        if !self.message.is_empty() && length != self.whole {
            return Err(reader.refuse(whole, "the length that the first piece stated"));
        }
        let begin = reader.word()?;
        if begin != self.message.len() as u64 {
            return Err(reader.refuse(begin, "the place of the next piece"));
        }
        let body = reader.rest();
        if body.len() > PIECE_BYTES_MAX || self.message.len() + body.len() > length {
            return Err(reader.refuse(body.len() as u64, "a body that fits"));
        }
        if body.is_empty() && length > 0 {
            return Err(reader.refuse(0, "a body with bytes"));
        }
        self.whole = length;
        self.message.extend_from_slice(body);
        if self.message.len() < length {
            return Ok(None);
        }
        self.whole = 0;
        Ok(Some(std::mem::take(&mut self.message)))
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn messages_come_together_from_pieces_in_order_only() {
        let mut pieces = Pieces::default();
        for length in [0, 1, PIECE_BYTES_MAX, PIECE_BYTES_MAX - HEAD_BYTES, 1_000_000] {
            let message: Vec<u8> = (0..length).map(|k| (k * 7) as u8).collect();
            let parts: Vec<Vec<u8>> = split(&message).collect();
            assert!(parts.iter().all(|part| part.len() <= PIECE_BYTES_MAX));
            if parts.len() > 1 {
                assert!(pieces.take(&parts[1]).is_err(), "the first one is missing");
            }
            let (last, before) = parts.split_last().expect("at least one");
            for part in before {
                assert_eq!(pieces.take(part), Ok(None));
                assert!(pieces.take(part).is_err(), "it comes twice");
            }
            assert_eq!(pieces.take(last), Ok(Some(message)));
            assert_eq!(pieces.progress(), (0, 0));
        }
        let mut long = (DELTA_BYTES_MAX as u64 + 1).to_le_bytes().to_vec();
        long.extend([0; 9]);
        assert!(pieces.take(&long).is_err());
    }

    proptest! {
        #[test]
        fn arbitrary_pieces_hold_no_more_than_came(parts in prop::collection::vec(prop::collection::vec(any::<u8>(), 0..40), 0..9)) {
            let mut pieces = Pieces::default();
            let mut came = 0;
            for part in parts {
                came += part.len();
                let _ = pieces.take(&part);
                prop_assert!(pieces.progress().0 <= came);
            }
        }
    }
}

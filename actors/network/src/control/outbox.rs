//! Messages that wait until the stream takes them: bounded, so that a station too slow to follow is told and dropped.

use serde::Serialize;
use thiserror::Error;
use trocar_scene::SimTime;

use super::frame::{FRAME_MAX, LENGTH_BYTES, preamble};

/// Most bytes that wait for a station \[bytes\]: a second at 128 Mbit/s. Who is further behind does not catch up.
pub const WAITING_MAX: usize = 16 << 20;
/// Longest time in which the stream takes nothing although bytes wait.
pub const STALLED_MAX: SimTime = SimTime::from_millis(5_000);
/// Memory that an empty outbox keeps \[bytes\].
const KEPT_BYTES: usize = 256 << 10;

/// Why a message is not sent.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum OutboxError {
    /// The station is too slow to follow.
    #[error("{waiting} bytes wait to be sent; at most {WAITING_MAX} may")]
    Full {
        /// Bytes that wait, the message among them.
        waiting: usize,
    },
    /// The message is too long.
    #[error("a message has {0} bytes; at most {FRAME_MAX} are valid")]
    TooLong(usize),
    /// The message cannot be encoded.
    #[error("a message cannot be encoded: {0}")]
    Encoding(postcard::Error),
}

/// Encoded frames in the order in which they go out.
#[derive(Debug, Default)]
pub struct Outbox {
    bytes: Vec<u8>,
    /// What of `bytes` is gone.
    sent: usize,
    /// Where the frame begins of which the byte at `sent` is a part, or which comes next.
    frame_begins: usize,
    /// Where the newest urgent frame begins.
    urgent_begins: Option<usize>,
    /// When the stream last took something, or when it had nothing to take.
    moved_at: SimTime,
}

impl Outbox {
    /// Appends a message as a frame; as an opening with the preamble.
    ///
    /// # Errors
    /// [`OutboxError`]; then nothing of the message is in the outbox.
    pub fn push(
        &mut self,
        message: &impl Serialize,
        is_opening: bool,
        now: SimTime,
    ) -> Result<(), OutboxError> {
        if self.is_empty() {
            self.moved_at = now;
        }
        let begin = self.bytes.len();
        let mut bytes = std::mem::take(&mut self.bytes);
        bytes.extend_from_slice(&[0; LENGTH_BYTES]);
        if is_opening {
            bytes.extend_from_slice(&preamble());
        }
        let encoded = postcard::serialize_with_flavor(message, Appending(&mut bytes));
        let length = bytes.len() - begin - LENGTH_BYTES;
        let waiting = bytes.len() - self.sent;
        let result = match encoded {
            Err(error) => Err(OutboxError::Encoding(error)),
            Ok(()) if length > FRAME_MAX => Err(OutboxError::TooLong(length)),
            Ok(()) if waiting > WAITING_MAX => Err(OutboxError::Full { waiting }),
            Ok(()) => Ok(()),
        };
        match result {
            Ok(()) => {
                bytes[begin..begin + LENGTH_BYTES].copy_from_slice(&(length as u32).to_le_bytes());
            }
            Err(_) => bytes.truncate(begin),
        }
        self.bytes = bytes;
        result
    }

    /// Puts a message ahead of all that waits, behind the frame that is under way: for what is worth nothing when it is
    /// late. It returns false, and does nothing, while an earlier one waits.
    ///
    /// # Errors
    /// As [`Self::push`].
    pub fn push_urgent(&mut self, message: &impl Serialize, now: SimTime) -> Result<bool, OutboxError> {
        if self.has_urgent() {
            return Ok(false);
        }
        let end = self.bytes.len();
        self.push(message, false, now)?;
        let is_within_frame = self.sent > self.frame_begins;
        let begin = if is_within_frame { self.frame_ends().unwrap_or(end) } else { self.sent };
        let length = self.bytes.len() - end;
        self.bytes[begin..].rotate_right(length);
        self.urgent_begins = Some(begin);
        Ok(true)
    }

    /// Whether an urgent message waits of which nothing has gone.
    pub fn has_urgent(&self) -> bool {
        self.urgent_begins.is_some_and(|begin| begin >= self.sent && begin < self.bytes.len())
    }

    /// Appends an opening with nothing behind its preamble: it tells a program of another version what this one is.
    pub fn push_bare_opening(&mut self, now: SimTime) {
        if self.is_empty() {
            self.moved_at = now;
        }
        let preamble = preamble();
        self.bytes.extend_from_slice(&(preamble.len() as u32).to_le_bytes());
        self.bytes.extend_from_slice(&preamble);
    }

    /// What waits.
    pub fn waiting(&self) -> &[u8] {
        &self.bytes[self.sent..]
    }

    /// Whether nothing waits.
    pub fn is_empty(&self) -> bool {
        self.sent == self.bytes.len()
    }

    /// The stream has taken the first `count` bytes of what waits.
    pub fn advance(&mut self, count: usize, now: SimTime) {
        self.sent = self.bytes.len().min(self.sent.saturating_add(count));
        if count > 0 {
            self.moved_at = now;
        }
        while let Some(end) = self.frame_ends().filter(|end| *end <= self.sent) {
            self.frame_begins = end;
        }
        if self.is_empty() {
            self.clear();
        } else if self.frame_begins > self.bytes.len() / 2 {
            // Every byte is moved at most once for each byte that has gone.
            self.bytes.drain(..self.frame_begins);
            self.sent -= self.frame_begins;
            self.urgent_begins = self.urgent_begins.and_then(|begin| begin.checked_sub(self.frame_begins));
            self.frame_begins = 0;
        }
    }

    /// Where the frame at `frame_begins` ends; `None` behind the last one.
    fn frame_ends(&self) -> Option<usize> {
        let length = self.bytes.get(self.frame_begins..)?.first_chunk::<LENGTH_BYTES>()?;
        Some(self.frame_begins + LENGTH_BYTES + u32::from_le_bytes(*length) as usize)
    }

    /// Forgets what waits, except for the rest of a frame that has begun: the other side can read what comes then.
    pub fn drop_waiting(&mut self) {
        let is_within_frame = self.sent > self.frame_begins;
        let keep = if is_within_frame { self.frame_ends().unwrap_or(self.sent) } else { self.sent };
        self.bytes.truncate(keep);
        self.urgent_begins = self.urgent_begins.filter(|begin| *begin < keep);
    }

    /// Forgets what waits.
    pub fn clear(&mut self) {
        self.bytes.clear();
        self.bytes.shrink_to(KEPT_BYTES);
        (self.sent, self.frame_begins, self.urgent_begins) = (0, 0, None);
    }

    /// When the stream will have taken nothing for too long; `None` when nothing waits.
    pub fn stalls_at(&self) -> Option<SimTime> {
        (!self.is_empty()).then(|| self.moved_at + STALLED_MAX)
    }
}

/// Postcard appends to a vector that stays with its owner, also when the encoding fails.
struct Appending<'a>(&'a mut Vec<u8>);

impl postcard::ser_flavors::Flavor for Appending<'_> {
    type Output = ();

    fn try_push(&mut self, byte: u8) -> postcard::Result<()> {
        self.0.push(byte);
        Ok(())
    }

    fn try_extend(&mut self, bytes: &[u8]) -> postcard::Result<()> {
        self.0.extend_from_slice(bytes);
        Ok(())
    }

    fn finalize(self) -> postcard::Result<()> {
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::control::blob::Blob;
    use crate::control::frame::FrameDecoder;

    const NOW: SimTime = SimTime::from_millis(1);

    #[test]
    fn what_is_pushed_comes_out_in_order_whatever_the_stream_takes_at_once() {
        let (mut outbox, mut decoder) = (Outbox::default(), FrameDecoder::new(FRAME_MAX));
        let (mut next, mut seen) = (0_u32, 0_u32);
        for step in 0..3_000 {
            if step % 3 != 2 && next < 1_500 {
                outbox.push(&next, false, NOW).expect("room");
                next += 1;
            }
            let count = outbox.waiting().len().min(step % 17);
            let mut taken = &outbox.waiting()[..count];
            while let Some(frame) = decoder.next_frame(&mut taken).expect("frames") {
                assert_eq!(postcard::from_bytes(frame), Ok(seen));
                seen += 1;
            }
            outbox.advance(count, NOW);
        }
        assert!(outbox.is_empty() && seen == next && seen > 500, "{seen} of {next}");
    }

    #[test]
    fn an_urgent_message_overtakes_what_waits_and_leaves_every_frame_whole() {
        let frame = LENGTH_BYTES + 2 + 200;
        for taken in 0..3 * frame {
            let (mut outbox, mut decoder) = (Outbox::default(), FrameDecoder::new(FRAME_MAX));
            for byte in 1..=3 {
                outbox.push(&Blob::from(vec![byte; 200]), false, NOW).expect("room");
            }
            let mut stream = outbox.waiting()[..taken].to_vec();
            outbox.advance(taken, NOW);
            assert_eq!(outbox.push_urgent(&Blob::from(vec![9; 30]), NOW), Ok(true));
            assert_eq!(outbox.push_urgent(&Blob::from(vec![8; 30]), NOW), Ok(false), "one waits");
            // Whatever the stream takes at once.
            while !outbox.is_empty() {
                let count = outbox.waiting().len().min(17);
                stream.extend_from_slice(&outbox.waiting()[..count]);
                outbox.advance(count, NOW);
            }
            assert!(!outbox.has_urgent());
            let (mut input, mut seen) = (stream.as_slice(), Vec::new());
            while let Some(frame) = decoder.next_frame(&mut input).expect("frames") {
                seen.push(*frame.last().expect("a byte"));
            }
            let before = taken.div_ceil(frame) as u8;
            let expected: Vec<u8> = (1..=before).chain([9]).chain(before + 1..=3).collect();
            assert_eq!(seen, expected, "after {taken} bytes");
        }
    }

    #[test]
    fn a_full_outbox_says_so_and_keeps_whole_frames_only() {
        let mut outbox = Outbox::default();
        let part = Blob::from(&[5; 65_000][..]);
        let full = loop {
            if let Err(error) = outbox.push(&part, false, NOW) {
                break error;
            }
        };
        assert!(matches!(full, OutboxError::Full { waiting } if waiting > WAITING_MAX), "{full}");
        assert!(outbox.waiting().len() <= WAITING_MAX);
        assert_eq!(outbox.waiting().len() % (LENGTH_BYTES + 3 + 65_000), 0);
        let long = Blob::from(vec![0; FRAME_MAX]);
        let mut outbox = Outbox::default();
        assert!(matches!(outbox.push(&long, false, NOW), Err(OutboxError::TooLong(_))));
        assert!(outbox.is_empty());
    }

    #[test]
    fn what_waits_is_dropped_at_the_end_of_a_frame_wherever_the_stream_has_stopped() {
        let frame = LENGTH_BYTES + 2 + 200;
        for taken in 0..3 * frame {
            let (mut outbox, mut decoder) = (Outbox::default(), FrameDecoder::new(FRAME_MAX));
            for byte in 1..=3 {
                outbox.push(&Blob::from(vec![byte; 200]), false, NOW).expect("room");
            }
            let mut stream = outbox.waiting()[..taken].to_vec();
            outbox.advance(taken, NOW);
            outbox.drop_waiting();
            outbox.push(&Blob::from(vec![9; 200]), false, NOW).expect("room");
            stream.extend(outbox.waiting());
            let (mut input, mut seen) = (stream.as_slice(), Vec::new());
            while let Some(frame) = decoder.next_frame(&mut input).expect("frames") {
                seen.push(*frame.last().expect("a byte"));
            }
            let whole = taken.div_ceil(frame);
            let expected: Vec<u8> = (1..=whole as u8).chain([9]).collect();
            assert_eq!(seen, expected, "after {taken} bytes");
            assert!(!decoder.is_within_frame());
        }
    }

    #[test]
    fn an_outbox_stalls_only_while_something_waits() {
        let mut outbox = Outbox::default();
        assert_eq!(outbox.stalls_at(), None);
        outbox.push(&7_u64, false, SimTime::from_millis(100)).expect("room");
        outbox.push(&7_u64, false, SimTime::from_millis(900)).expect("room");
        assert_eq!(outbox.stalls_at(), Some(SimTime::from_millis(100) + STALLED_MAX));
        outbox.advance(1, SimTime::from_millis(2_000));
        assert_eq!(outbox.stalls_at(), Some(SimTime::from_millis(2_000) + STALLED_MAX));
        outbox.advance(100, SimTime::from_millis(2_001));
        assert_eq!(outbox.stalls_at(), None);
    }
}

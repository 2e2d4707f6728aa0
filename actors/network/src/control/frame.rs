//! Frames: how messages are told apart in a stream of bytes.
//!
//! A frame is its length as a little-endian u32, and then as many bytes. The first frame of each direction is the
//! *opening*, whose beginning never changes, so that programs of all versions can tell each other what they are:
//!
//! | offset | bytes | field |
//! |---|---|---|
//! | 0 | 4 | length of what follows, 1 to [`FRAME_MAX`]; at most [`OPENING_MAX`] from a stranger |
//! | 4 | 6 | `trocar`, in the opening only |
//! | 10 | 2 | wire version, in the opening only |
//! | 4 or 12 | n | message, in postcard |

use thiserror::Error;

/// Version of the messages. Two programs understand each other only if it is the same.
pub const WIRE_VERSION: u16 = 1;
/// Longest frame between stations that know each other \[bytes\].
pub const FRAME_MAX: usize = 1 << 20;
/// Longest frame that a host takes from a station that it has not admitted yet \[bytes\].
pub const OPENING_MAX: usize = 16 << 10;
/// Bytes of a frame's length.
pub const LENGTH_BYTES: usize = 4;
/// Bytes of an opening that every version can read.
pub const PREAMBLE_BYTES: usize = 8;

const MAGIC: [u8; 6] = *b"trocar";

/// What a stream has that no frame of ours has.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum FrameError {
    /// Nothing in it.
    #[error("a frame is empty; frames have 1 to {FRAME_MAX} bytes")]
    Empty,
    /// Longer than is allowed at this point.
    #[error("a frame announces {length} bytes; at most {most} are valid here")]
    TooLong {
        /// The announced length.
        length: u32,
        /// The limit.
        most: usize,
    },
    /// Another protocol.
    #[error("the other side does not speak trocar's protocol; is the port that of another program?")]
    NotTrocar,
    /// Another version of the protocol.
    #[error(
        "the other side speaks wire version {theirs} and this program version {ours}; use the same release of trocar at \
         both ends (the {} one is older)",
        older(*theirs, *ours)
    )]
    OtherVersion {
        /// Version of the other side.
        theirs: u16,
        /// Version of this program.
        ours: u16,
    },
}

fn older(theirs: u16, ours: u16) -> &'static str {
    if theirs < ours { "other" } else { "local" }
}

/// Puts frames together from bytes that come in pieces of any size.
///
/// It holds at most one frame, and no more memory than has arrived of it, rounded up by the growth of a vector: who only
/// announces costs nothing.
#[derive(Debug)]
pub struct FrameDecoder {
    most: usize,
    length: [u8; LENGTH_BYTES],
    length_has: usize,
    body: Vec<u8>,
    is_complete: bool,
}

impl FrameDecoder {
    /// One that takes frames of at most `most` bytes, and never more than [`FRAME_MAX`].
    pub fn new(most: usize) -> Self {
        let most = most.min(FRAME_MAX);
        Self { most, length: [0; LENGTH_BYTES], length_has: 0, body: Vec::new(), is_complete: false }
    }

    /// Takes frames of up to [`FRAME_MAX`] bytes from now on.
    pub fn trust(&mut self) {
        self.most = FRAME_MAX;
    }

    /// Moves bytes from the front of `input` until a frame is complete, and returns that. `None`: `input` is used up, and
    /// the frame goes on.
    ///
    /// # Errors
    /// [`FrameError::Empty`] and [`FrameError::TooLong`]; the stream cannot be read any further.
    pub fn next_frame(&mut self, input: &mut &[u8]) -> Result<Option<&[u8]>, FrameError> {
        if std::mem::take(&mut self.is_complete) {
            self.body.clear();
            self.length_has = 0;
        }
        if self.length_has < LENGTH_BYTES {
            let taken = take(input, LENGTH_BYTES - self.length_has);
            self.length[self.length_has..self.length_has + taken.len()].copy_from_slice(taken);
            self.length_has += taken.len();
            if self.length_has < LENGTH_BYTES {
                return Ok(None);
            }
        }
        let length = u32::from_le_bytes(self.length);
        let announced = usize::try_from(length).unwrap_or(usize::MAX);
        if announced == 0 {
            return Err(FrameError::Empty);
        }
        if announced > self.most {
            return Err(FrameError::TooLong { length, most: self.most });
        }
        let taken = take(input, announced - self.body.len());
        self.body.extend_from_slice(taken);
        self.is_complete = self.body.len() == announced;
        Ok(self.is_complete.then_some(self.body.as_slice()))
    }

    /// Whether a frame has begun and is not complete.
    pub fn is_within_frame(&self) -> bool {
        self.length_has > 0 && !self.is_complete
    }
}

fn take<'a>(input: &mut &'a [u8], most: usize) -> &'a [u8] {
    let (taken, rest) = input.split_at(most.min(input.len()));
    *input = rest;
    taken
}

/// The first bytes of this program's opening.
pub fn preamble() -> [u8; PREAMBLE_BYTES] {
    preamble_of(WIRE_VERSION)
}

pub(super) fn preamble_of(version: u16) -> [u8; PREAMBLE_BYTES] {
    let mut bytes = [0; PREAMBLE_BYTES];
    bytes[..MAGIC.len()].copy_from_slice(&MAGIC);
    bytes[MAGIC.len()..].copy_from_slice(&version.to_le_bytes());
    bytes
}

/// Checks the preamble of an opening, and returns what follows it.
///
/// # Errors
/// [`FrameError::NotTrocar`] and [`FrameError::OtherVersion`].
pub fn after_preamble(opening: &[u8]) -> Result<&[u8], FrameError> {
    let (preamble, rest) = opening.split_at_checked(PREAMBLE_BYTES).ok_or(FrameError::NotTrocar)?;
    let (magic, version) = preamble.split_at(MAGIC.len());
    if magic != MAGIC {
        return Err(FrameError::NotTrocar);
    }
    let theirs = u16::from_le_bytes([version[0], version[1]]);
    if theirs != WIRE_VERSION {
        return Err(FrameError::OtherVersion { theirs, ours: WIRE_VERSION });
    }
    Ok(rest)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn framed(body: &[u8]) -> Vec<u8> {
        let mut bytes = (body.len() as u32).to_le_bytes().to_vec();
        bytes.extend_from_slice(body);
        bytes
    }

    fn decoded(decoder: &mut FrameDecoder, mut input: &[u8]) -> Result<Vec<Vec<u8>>, FrameError> {
        let mut frames = Vec::new();
        while let Some(frame) = decoder.next_frame(&mut input)? {
            frames.push(frame.to_vec());
        }
        Ok(frames)
    }

    #[test]
    fn who_announces_a_frame_and_sends_little_of_it_costs_little_memory() {
        let mut decoder = FrameDecoder::new(FRAME_MAX);
        let mut input = (FRAME_MAX as u32).to_le_bytes().to_vec();
        input.extend([7; 10]);
        assert_eq!(decoded(&mut decoder, &input), Ok(vec![]));
        assert!(decoder.is_within_frame());
        assert!(decoder.body.capacity() < 1_000, "{} bytes", decoder.body.capacity());
    }

    #[test]
    fn a_frame_of_just_the_limit_is_taken_and_one_byte_more_is_refused_at_its_length() {
        let mut decoder = FrameDecoder::new(OPENING_MAX);
        let body = vec![1; OPENING_MAX];
        assert_eq!(decoded(&mut decoder, &framed(&body)), Ok(vec![body]));
        let length = OPENING_MAX as u32 + 1;
        let refused = decoded(&mut decoder, &length.to_le_bytes());
        assert_eq!(refused, Err(FrameError::TooLong { length, most: OPENING_MAX }));
        let mut decoder = FrameDecoder::new(usize::MAX);
        assert!(decoded(&mut decoder, &u32::MAX.to_le_bytes()).is_err());
        let mut decoder = FrameDecoder::new(FRAME_MAX);
        assert_eq!(decoded(&mut decoder, &[0; 4]), Err(FrameError::Empty));
    }

    #[test]
    fn an_opening_of_another_version_is_told_from_another_protocol() {
        let mut opening = preamble().to_vec();
        opening.push(9);
        assert_eq!(after_preamble(&opening), Ok(&[9][..]));
        let newer = after_preamble(&preamble_of(WIRE_VERSION + 1)).expect_err("another version");
        assert_eq!(newer, FrameError::OtherVersion { theirs: WIRE_VERSION + 1, ours: WIRE_VERSION });
        assert!(newer.to_string().contains("the local one is older"), "{newer}");
        for other in [&b"GET / HTTP/1.1"[..], b"", b"troca", b"trocar\x01"] {
            assert_eq!(after_preamble(other), Err(FrameError::NotTrocar));
        }
    }

    proptest! {
        #[test]
        fn frames_are_the_same_however_the_stream_is_split(
            bodies in prop::collection::vec(prop::collection::vec(any::<u8>(), 1..300), 0..8),
            cuts in prop::collection::vec(1_usize..50, 1..40),
        ) {
            let stream: Vec<u8> = bodies.iter().flat_map(|body| framed(body)).collect();
            let mut decoder = FrameDecoder::new(FRAME_MAX);
            let (mut frames, mut rest) = (Vec::new(), stream.as_slice());
            for cut in cuts.iter().cycle() {
                let (piece, after) = rest.split_at((*cut).min(rest.len()));
                frames.extend(decoded(&mut decoder, piece).expect("all are valid"));
                rest = after;
                if rest.is_empty() {
                    break;
                }
            }
            prop_assert_eq!(frames, bodies);
            prop_assert!(!decoder.is_within_frame());
        }

        #[test]
        fn no_bytes_make_the_decoder_hold_more_than_a_frame(bytes in prop::collection::vec(any::<u8>(), 0..4_000)) {
            let mut decoder = FrameDecoder::new(64);
            let _ = decoded(&mut decoder, &bytes);
            prop_assert!(decoder.body.len() <= 64);
        }
    }
}

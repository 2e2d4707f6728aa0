//! Inputs of targets that have a state: a list of steps, each with the time before it.

/// Bytes of a step before its own.
const HEAD_BYTES: usize = 4;

/// What an input does next.
#[derive(Clone, Copy, Debug)]
pub struct Step<'a> {
    /// What is done; each target has its own numbers.
    pub what: u8,
    /// Time that passes before it \[ns\]: 0, or 8 ns to 32 s in steps that grow.
    pub pause_ns: u64,
    /// What it is done with.
    pub bytes: &'a [u8],
}

/// Reads an input: for each step what, pause, length of its bytes (u16, little-endian), and these. Every input is a list of
/// steps: a length beyond the end means the rest.
pub fn steps(mut input: &[u8]) -> impl Iterator<Item = Step<'_>> {
    std::iter::from_fn(move || {
        let (head, rest) = input.split_first_chunk::<HEAD_BYTES>()?;
        let [what, pause, low, high] = *head;
        let (bytes, rest) = rest.split_at(usize::from(u16::from_le_bytes([low, high])).min(rest.len()));
        input = rest;
        Some(Step { what, pause_ns: pause_ns(pause), bytes })
    })
}

/// Appends a step to an input.
///
/// # Panics
/// When it has more than 65,535 bytes.
pub fn push_step(input: &mut Vec<u8>, what: u8, pause: u8, bytes: &[u8]) {
    let length = u16::try_from(bytes.len()).expect("a step has at most 65,535 bytes");
    input.extend([what, pause]);
    input.extend(length.to_le_bytes());
    input.extend(bytes);
}

fn pause_ns(pause: u8) -> u64 {
    if pause == 0 { 0 } else { u64::from(8 + pause % 8) << (pause / 8) }
}

/// The pause of a step that is as long as this, or a little shorter.
pub fn pause_of(nanos: u64) -> u8 {
    (0..=u8::MAX).rev().find(|pause| pause_ns(*pause) <= nanos).unwrap_or(0)
}

/// The first byte of some bytes, 0 if there is none, and the others.
pub fn first(bytes: &[u8]) -> (u8, &[u8]) {
    bytes.split_first().map_or((0, bytes), |(first, rest)| (*first, rest))
}

/// The first bytes of some, with zeros where there are none, and the others.
pub fn first_chunk<const N: usize>(bytes: &[u8]) -> ([u8; N], &[u8]) {
    let (taken, rest) = bytes.split_at(N.min(bytes.len()));
    let mut chunk = [0; N];
    chunk[..taken.len()].copy_from_slice(taken);
    (chunk, rest)
}

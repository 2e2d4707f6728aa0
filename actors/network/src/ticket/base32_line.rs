//! Bytes as one line that a person can copy, read out or type: `trocar1`, then base32 (RFC 4648) in lower case.
//!
//! | offset | bytes | field |
//! |---|---|---|
//! | 0 | 2 | count n of the bytes of the content, little-endian |
//! | 2 | n | content |
//! | 2 + n | 4 | CRC-32 of everything before, little-endian |
//!
//! The digit behind `trocar` is the version of the whole encoding. The length tells a line that was cut off from one with a
//! typing error. The CRC finds every wrong character and every exchange of neighbours, since it finds all damage
//! within 32 bits. Spaces, line breaks and upper case do not matter.

use data_encoding::BASE32_NOPAD;
use thiserror::Error;

/// Most bytes of a text that is looked at.
pub const LINE_MAX: usize = 8_192;
/// What every version of the encoding begins with.
const PREFIX: &str = "trocar";
const VERSION: char = '1';
const LENGTH_BYTES: usize = 2;
const CRC_BYTES: usize = 4;
/// Most bytes of the content; their line is shorter than [`LINE_MAX`].
pub(super) const CONTENT_MAX: usize = 4_096;
/// Longest line in which the place of a typing error is searched for \[characters\]. The time that it takes grows with the
/// square of the length: measured 0.6 ms for a ticket with one address, and 32 ms for this length.
const SEARCHED_MAX: usize = 768;
/// The characters of base32, by their value.
const ALPHABET: &[u8; 32] = b"abcdefghijklmnopqrstuvwxyz234567";

/// Why a text is no line. Places count the characters that are no white space, from 1.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum LineError {
    /// It does not begin with `trocar` and a digit, or is longer than [`LINE_MAX`].
    #[error("this is not a ticket; a ticket begins with 'trocar1' and has letters and digits only")]
    NotATicket,
    /// A version that this program does not know.
    #[error("the ticket has version {0}, and this program reads version 1; update this program")]
    NewerVersion(char),
    /// The end is missing.
    #[error("the ticket is cut off: it has {characters} of its {needed} characters; copy all of it")]
    CutOff {
        /// Characters that are there.
        characters: usize,
        /// Characters that a whole one has.
        needed: usize,
    },
    /// There is more than the ticket.
    #[error("the ticket has {characters} characters instead of {needed}; copy the ticket alone")]
    Overlong {
        /// Characters that are there.
        characters: usize,
        /// Characters that a whole one has.
        needed: usize,
    },
    /// A character is wrong, at a place that is known.
    #[error("the ticket has a typing error: character {0} is wrong")]
    TypoAt(usize),
    /// Some characters are wrong.
    #[error("the ticket has a typing error; copy it again")]
    Typo,
}

/// The line of a content of at most [`CONTENT_MAX`] bytes; a longer one is cut, and its line refused by [`read`].
pub(super) fn write(content: &[u8]) -> String {
    let mut bytes = Vec::with_capacity(LENGTH_BYTES + content.len() + CRC_BYTES);
    bytes.extend((content.len() as u16).to_le_bytes());
    bytes.extend(content);
    bytes.extend(crc32fast::hash(&bytes).to_le_bytes());
    format!("{PREFIX}{VERSION}{}", BASE32_NOPAD.encode(&bytes).to_ascii_lowercase())
}

/// Characters of the line of a content.
fn characters_of(content: usize) -> usize {
    PREFIX.len() + 1 + ((LENGTH_BYTES + content + CRC_BYTES) * 8).div_ceil(5)
}

/// The content of a line.
///
/// # Errors
/// [`LineError`].
pub(super) fn read(text: &str) -> Result<Vec<u8>, LineError> {
    if text.len() > LINE_MAX {
        return Err(LineError::NotATicket);
    }
    let line: Vec<char> =
        text.chars().filter(|c| !c.is_whitespace()).map(|c| c.to_ascii_lowercase()).collect();
    let begins = line.iter().zip(PREFIX.chars()).all(|(have, wanted)| *have == wanted);
    if line.is_empty() || !begins {
        return Err(LineError::NotATicket);
    }
    let Some(version) = line.get(PREFIX.len()) else {
        return Err(LineError::CutOff { characters: line.len(), needed: characters_of(0) });
    };
    if !version.is_ascii_digit() {
        return Err(LineError::NotATicket);
    }
    let content = read_symbols(&line[PREFIX.len() + 1..]);
    match (*version, content) {
        (VERSION, content) => content,
        // Everything else fits this version, so the digit is a typing error.
        (_, Ok(_)) => Err(LineError::TypoAt(PREFIX.len() + 1)),
        (newer, Err(_)) => Err(LineError::NewerVersion(newer)),
    }
}

fn read_symbols(line: &[char]) -> Result<Vec<u8>, LineError> {
    let before = PREFIX.len() + 1;
    let mut symbols = Vec::with_capacity(line.len());
    for (at, character) in line.iter().enumerate() {
        let value = ALPHABET.iter().position(|known| char::from(*known) == *character);
        symbols.push(value.ok_or(LineError::TypoAt(before + at + 1))? as u8);
    }
    let bytes = bytes_of(&symbols);
    if let Some(content) = content_of(&symbols, &bytes) {
        return Ok(content.to_vec());
    }
    // The length may be what is wrong, so a typing error is looked for before the length is believed.
    if let Some(at) = place_of_typo(&symbols) {
        return Err(LineError::TypoAt(before + at + 1));
    }
    let characters = before + symbols.len();
    let Some([low, high]) = bytes.first_chunk::<LENGTH_BYTES>() else {
        return Err(LineError::CutOff { characters, needed: characters_of(0) });
    };
    let needed = characters_of(u16::from_le_bytes([*low, *high]).into());
    match characters {
        _ if needed > characters_of(CONTENT_MAX) => Err(LineError::Typo),
        _ if characters < needed => Err(LineError::CutOff { characters, needed }),
        _ if characters > needed => Err(LineError::Overlong { characters, needed }),
        _ => Err(LineError::Typo),
    }
}

/// Five bits of each symbol, eight to a byte; what is left over at the end is not taken.
fn bytes_of(symbols: &[u8]) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(symbols.len() * 5 / 8);
    let (mut bits, mut count) = (0_u16, 0);
    for symbol in symbols {
        bits = bits << 5 | u16::from(*symbol);
        count += 5;
        if count >= 8 {
            count -= 8;
            bytes.push((bits >> count) as u8);
            bits &= (1 << count) - 1;
        }
    }
    bytes
}

/// The content when length, checksum and the bits left over at the end are right.
fn content_of<'a>(symbols: &[u8], bytes: &'a [u8]) -> Option<&'a [u8]> {
    let (checked, crc) = bytes.split_last_chunk::<CRC_BYTES>()?;
    let (length, content) = checked.split_first_chunk::<LENGTH_BYTES>()?;
    let left_over = symbols.len() * 5 % 8;
    let is_whole = usize::from(u16::from_le_bytes(*length)) == content.len()
        && content.len() <= CONTENT_MAX
        && left_over < 5
        && symbols.last()? & ((1 << left_over) - 1) == 0
        && crc32fast::hash(checked) == u32::from_le_bytes(*crc);
    is_whole.then_some(content)
}

/// The one symbol with which the line would be right if it were another one. A CRC-32 tells all such places apart in
/// lines of this length, but for a chance of 1 in 10⁵ with several errors.
fn place_of_typo(symbols: &[u8]) -> Option<usize> {
    if symbols.len() > SEARCHED_MAX {
        return None;
    }
    let mut tried = symbols.to_vec();
    for at in 0..symbols.len() {
        for value in (0..32).filter(|value| *value != symbols[at]) {
            tried[at] = value;
            if content_of(&tried, &bytes_of(&tried)).is_some() {
                return Some(at);
            }
        }
        tried[at] = symbols[at];
    }
    None
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn line() -> (Vec<u8>, String) {
        let content: Vec<u8> = (0..90_u8).map(|k| k.wrapping_mul(37)).collect();
        let line = write(&content);
        (content, line)
    }

    #[test]
    fn a_line_is_base32_as_others_write_it() {
        // Of Python: base64.b32encode(b'\x02\x00hi' + struct.pack('<I', zlib.crc32(b'\x02\x00hi'))).
        assert_eq!(write(b"hi"), "trocar1aiagq2oef4dre");
        for count in 0..40 {
            let content: Vec<u8> = (0..count).map(|k: u8| k.wrapping_mul(91)).collect();
            let line = write(&content);
            assert_eq!(line.len(), characters_of(content.len()));
            assert_eq!(read(&line), Ok(content));
        }
    }

    #[test]
    fn spaces_line_breaks_and_upper_case_do_not_matter() {
        let (content, line) = line();
        let spaced: String = line.to_uppercase().chars().flat_map(|c| [c, ' ']).collect();
        assert_eq!(read(&spaced), Ok(content.clone()));
        let (one, two) = line.split_at(60);
        assert_eq!(read(&format!("\n  {one}\r\n\t{two}\u{a0}\n")), Ok(content));
    }

    #[test]
    fn every_wrong_character_is_found_and_its_place_named() {
        let (_, line) = line();
        for at in PREFIX.len() + 1..line.len() {
            for wrong in ALPHABET.iter().chain(b"018-").filter(|wrong| **wrong != line.as_bytes()[at]) {
                // A place in 7 of the alphabet's letters is enough for the search; all are tried at the first and last.
                if !at.is_multiple_of(16) && at + 1 < line.len() && !wrong.is_multiple_of(7) {
                    continue;
                }
                let mut typed = line.clone().into_bytes();
                typed[at] = *wrong;
                let typed = String::from_utf8(typed).expect("it is ASCII");
                assert_eq!(read(&typed), Err(LineError::TypoAt(at + 1)), "{} at {at}", char::from(*wrong));
            }
        }
        assert_eq!(read(&line.replacen('1', "2", 1)), Err(LineError::TypoAt(7)), "the version");
        assert_eq!(read(&line.replacen('t', "r", 1)), Err(LineError::NotATicket));
    }

    #[test]
    fn exchanged_lost_and_doubled_characters_are_found() {
        let (_, line) = line();
        for at in PREFIX.len() + 1..line.len() - 1 {
            let mut typed = line.clone().into_bytes();
            typed.swap(at, at + 1);
            let typed = String::from_utf8(typed).expect("it is ASCII");
            assert!(typed == line || read(&typed).is_err(), "exchanged at {at}");
            let lost = [&line[..at], &line[at + 1..]].concat();
            assert!(read(&lost).is_err(), "lost at {at}");
            let doubled = [&line[..=at], &line[at..]].concat();
            assert!(read(&doubled).is_err(), "doubled at {at}");
        }
    }

    #[test]
    fn a_line_that_is_cut_off_is_told_from_one_with_a_typing_error() {
        let (_, line) = line();
        let needed = line.len();
        for characters in PREFIX.len() + 5..needed {
            assert_eq!(read(&line[..characters]), Err(LineError::CutOff { characters, needed }));
        }
        for characters in 1..PREFIX.len() + 5 {
            let cut = read(&line[..characters]);
            assert!(matches!(cut, Err(LineError::CutOff { .. })), "{characters}: {cut:?}");
        }
        assert_eq!(
            read(&format!("{line} thanks")),
            Err(LineError::Overlong { characters: needed + 6, needed })
        );
    }

    #[test]
    fn what_is_no_ticket_or_a_newer_one_is_said_so() {
        for text in
            ["", " ", "hello", "https://example.org", "trocarx", "tr0car1abc", &"trocar1".repeat(2_000)]
        {
            assert_eq!(read(text), Err(LineError::NotATicket), "{text}");
        }
        assert_eq!(read("trocar2zzzz234567"), Err(LineError::NewerVersion('2')));
        assert_eq!(read("trocar9"), Err(LineError::NewerVersion('9')));
    }

    proptest! {
        #[test]
        fn no_text_makes_it_fail(text in any::<String>(), tail in "trocar[0-9][a-z2-7]{0,200}") {
            let _ = read(&text);
            let _ = read(&tail);
        }

        #[test]
        fn every_content_comes_back(content in proptest::collection::vec(any::<u8>(), 0..300)) {
            prop_assert_eq!(read(&write(&content)), Ok(content));
        }
    }
}

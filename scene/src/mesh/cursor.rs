//! Cursor over a file's bytes: tokens and lines of text, binary numbers, and errors with their position.

use std::fmt::Display;
use std::path::Path;
use std::str::FromStr;

use super::error::{FilePosition, MeshError};
use super::limits::Limits;

/// Longest token or line that is quoted in a message \[characters\].
const QUOTED: usize = 40;

/// Byte order of a binary file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Order {
    Little,
    Big,
}

/// A position, converted to a line number only when a message needs it (lines are counted from the start).
#[derive(Clone, Copy, Debug)]
pub(super) enum LazyPosition {
    Known(FilePosition),
    LineOfByte(usize),
}

#[derive(Clone)]
pub(super) struct Cursor<'a> {
    pub file: &'a Path,
    pub limits: &'a Limits,
    bytes: &'a [u8],
    at: usize,
    /// Whether the first line ends in a carriage return alone; then a line feed after one is not skipped, since it may be
    /// the first byte of a binary section.
    lone_returns: bool,
}

impl<'a> Cursor<'a> {
    pub fn new(file: &'a Path, bytes: &'a [u8], limits: &'a Limits) -> Self {
        let first_end = bytes.iter().position(|b| matches!(b, b'\n' | b'\r'));
        let lone_returns =
            first_end.is_some_and(|end| bytes[end] == b'\r' && bytes.get(end + 1) != Some(&b'\n'));
        Self { file, limits, bytes, at: 0, lone_returns }
    }

    /// A cursor behind the byte order mark of a file that begins with text.
    ///
    /// # Errors
    /// When the text is UTF-16 or UTF-32.
    pub fn of_text(file: &'a Path, bytes: &'a [u8], limits: &'a Limits) -> Result<Self, MeshError> {
        let mut cursor = Self::new(file, bytes, limits);
        if bytes.starts_with(UTF_8_MARK) {
            cursor.at = UTF_8_MARK.len();
        }
        match wide_text(bytes) {
            None => Ok(cursor),
            Some(encoding) => {
                let reason = format!("{encoding}: save the file as UTF-8");
                Err(cursor.malformed(LazyPosition::Known(FilePosition::Whole), reason))
            }
        }
    }

    /// The same cursor over a file that ends at `end`.
    pub fn ending_at(mut self, end: usize) -> Self {
        self.bytes = &self.bytes[..end.min(self.bytes.len())];
        self
    }

    pub fn position(&self) -> usize {
        self.at
    }
    pub fn seek(&mut self, at: usize) {
        self.at = at.min(self.bytes.len());
    }
    pub fn remaining(&self) -> &'a [u8] {
        &self.bytes[self.at..]
    }

    /// The line of the next byte.
    pub fn line(&self) -> LazyPosition {
        LazyPosition::LineOfByte(self.at)
    }
    pub fn byte(&self) -> LazyPosition {
        LazyPosition::Known(FilePosition::Byte(self.at))
    }
    fn place(&self, at: LazyPosition) -> FilePosition {
        match at {
            LazyPosition::Known(place) => place,
            LazyPosition::LineOfByte(at) => {
                let before = &self.bytes[..at.min(self.bytes.len())];
                let ends = before.iter().enumerate().filter(|&(k, &b)| {
                    // Of a carriage return and a line feed only the latter counts.
                    b == b'\n' || b == b'\r' && self.bytes.get(k + 1) != Some(&b'\n')
                });
                FilePosition::Line(1 + ends.count())
            }
        }
    }

    pub fn malformed(&self, at: LazyPosition, reason: impl Display) -> MeshError {
        MeshError::Malformed { file: self.file.into(), place: self.place(at), reason: reason.to_string() }
    }
    pub fn unsupported(&self, at: LazyPosition, what: impl Display, supported: &'static str) -> MeshError {
        let (file, place) = (self.file.into(), self.place(at));
        MeshError::Unsupported { file, place, what: what.to_string(), supported }
    }
    pub fn too_large(&self, at: LazyPosition, what: &'static str, count: u64, limit: u64) -> MeshError {
        MeshError::TooLarge { file: self.file.into(), place: self.place(at), what, count, limit }
    }
    pub fn out_of_range(
        &self,
        at: LazyPosition,
        element: &'static str,
        index: usize,
        vertex: i64,
        vertices: usize,
    ) -> MeshError {
        let (file, place) = (self.file.into(), self.place(at));
        MeshError::IndexOutOfRange { file, place, element, index, vertex, vertices }
    }

    /// Everything up to the end of the line, which is skipped: a line feed, a carriage return, or both; `None` at the end
    /// of the file.
    pub fn next_line(&mut self) -> Option<&'a [u8]> {
        let rest = self.remaining();
        if rest.is_empty() {
            return None;
        }
        let length = rest.iter().position(|b| matches!(b, b'\n' | b'\r')).unwrap_or(rest.len());
        let end = match &rest[length..] {
            [b'\r', b'\n', ..] if !self.lone_returns => 2,
            _ => 1,
        };
        self.at += (length + end).min(rest.len());
        Some(&rest[..length])
    }

    /// The next line as text without surrounding white space.
    pub fn next_text_line(&mut self, expected: &str) -> Result<&'a str, MeshError> {
        let place = self.line();
        let line = self
            .next_line()
            .ok_or_else(|| self.malformed(place, format!("the file ends where {expected} is expected")))?;
        std::str::from_utf8(line)
            .map(str::trim)
            .map_err(|_| self.malformed(place, format!("{expected} is expected, but the line is not text")))
    }

    pub fn skip_space(&mut self) {
        let rest = self.remaining();
        self.at += rest.iter().position(|b| !b.is_ascii_whitespace()).unwrap_or(rest.len());
    }

    /// The next run of characters that are no white space; empty at the end of the file.
    pub fn token(&mut self) -> &'a [u8] {
        self.skip_space();
        let rest = self.remaining();
        let length = rest.iter().position(|b| b.is_ascii_whitespace()).unwrap_or(rest.len());
        self.at += length;
        &rest[..length]
    }

    /// Parses the next token; `what` names it in the error.
    pub fn parse<T: FromStr>(&mut self, what: &str) -> Result<T, MeshError> {
        let token = self.token();
        let number = std::str::from_utf8(token).ok().and_then(|text| text.parse().ok());
        number.ok_or_else(|| {
            let found = if token.is_empty() { "the end of the file".into() } else { quoted(token) };
            self.malformed(self.line(), format!("{what} is expected, found {found}"))
        })
    }

    /// Parses three coordinates, which must be finite.
    pub fn parse_point(&mut self, what: &'static str, index: usize) -> Result<[f64; 3], MeshError> {
        let mut point = [0.0; 3];
        for (coordinate, name) in point.iter_mut().zip(["x", "y", "z"]) {
            *coordinate = self.parse(name)?;
        }
        self.finite(self.line(), what, index, &point)?;
        Ok(point)
    }

    pub fn finite(
        &self,
        at: LazyPosition,
        what: &'static str,
        index: usize,
        numbers: &[f64],
    ) -> Result<(), MeshError> {
        match numbers.iter().find(|x| !x.is_finite()) {
            None => Ok(()),
            Some(&value) => {
                let (file, place) = (self.file.into(), self.place(at));
                Err(MeshError::NotFinite { file, place, what, index, value })
            }
        }
    }

    /// Checks a declared count against the caller's limit and the rest of the file, given the minimum number of bytes
    /// per item.
    pub fn count(
        &self,
        at: LazyPosition,
        what: &'static str,
        declared: u64,
        least_bytes: u64,
        limit: u64,
    ) -> Result<usize, MeshError> {
        if declared > limit {
            return Err(self.too_large(at, what, declared, limit));
        }
        let possible = self.remaining().len() as u64 / least_bytes.max(1) + 1;
        if declared > possible {
            let (file, place) = (self.file.into(), self.place(at));
            return Err(MeshError::Truncated { file, place, what, declared, possible });
        }
        Ok(declared as usize)
    }

    /// The next `length` bytes.
    pub fn take(&mut self, length: usize, what: &str) -> Result<&'a [u8], MeshError> {
        let rest = self.remaining();
        if length > rest.len() {
            let reason = format!("{what} takes {length} bytes, but the file ends after {}", rest.len());
            return Err(self.malformed(self.byte(), reason));
        }
        self.at += length;
        Ok(&rest[..length])
    }

    fn array<const N: usize>(&mut self, order: Order, what: &str) -> Result<[u8; N], MeshError> {
        let mut bytes = [0u8; N];
        bytes.copy_from_slice(self.take(N, what)?);
        if order == Order::Big {
            bytes.reverse();
        }
        Ok(bytes)
    }
    pub fn u32(&mut self, order: Order, what: &str) -> Result<u32, MeshError> {
        self.array(order, what).map(u32::from_le_bytes)
    }
    pub fn i32(&mut self, order: Order, what: &str) -> Result<i32, MeshError> {
        self.array(order, what).map(i32::from_le_bytes)
    }
    pub fn u64(&mut self, order: Order, what: &str) -> Result<u64, MeshError> {
        self.array(order, what).map(u64::from_le_bytes)
    }
    pub fn f32(&mut self, order: Order, what: &str) -> Result<f32, MeshError> {
        self.array(order, what).map(f32::from_le_bytes)
    }
    pub fn f64(&mut self, order: Order, what: &str) -> Result<f64, MeshError> {
        self.array(order, what).map(f64::from_le_bytes)
    }
    /// Three 64-bit coordinates, which must be finite.
    pub fn point(&mut self, order: Order, what: &'static str, index: usize) -> Result<[f64; 3], MeshError> {
        let place = self.byte();
        let point = [self.f64(order, what)?, self.f64(order, what)?, self.f64(order, what)?];
        self.finite(place, what, index, &point)?;
        Ok(point)
    }
}

const UTF_8_MARK: &[u8] = b"\xef\xbb\xbf";

/// The encoding of a text whose characters have two or four bytes, by its byte order mark or by the zeros between its
/// first letters.
pub(super) fn wide_text(bytes: &[u8]) -> Option<&'static str> {
    let letter = |b: u8| b.is_ascii_graphic() || b.is_ascii_whitespace();
    match bytes {
        [0xff, 0xfe, 0, 0, ..] | [0, 0, 0xfe, 0xff, ..] => Some("UTF-32"),
        [0xff, 0xfe, ..] | [0xfe, 0xff, ..] => Some("UTF-16"),
        [a, 0, 0, 0, b, 0, 0, 0, ..] | [0, 0, 0, a, 0, 0, 0, b, ..] if letter(*a) && letter(*b) => {
            Some("UTF-32")
        }
        [a, 0, b, 0, c, 0, ..] | [0, a, 0, b, 0, c, ..] if [*a, *b, *c].into_iter().all(letter) => {
            Some("UTF-16")
        }
        _ => None,
    }
}

/// Whether a word is a keyword, in any capitals.
pub(super) fn is_word(word: &[u8], keyword: &str) -> bool {
    word.eq_ignore_ascii_case(keyword.as_bytes())
}

/// Quotes a part of the file for a message: short, and without control characters.
pub(super) fn quoted(bytes: &[u8]) -> String {
    let text = String::from_utf8_lossy(&bytes[..bytes.len().min(4 * QUOTED)]);
    let shown: String = text.chars().take(QUOTED).flat_map(char::escape_default).collect();
    let dots = if text.chars().count() > QUOTED { "…" } else { "" };
    format!("'{shown}{dots}'")
}

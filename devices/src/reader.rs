//! Shared parts of the readers of recorded hand motion: limits, errors, number parsing.

use std::fs::File;
use std::io;
use std::path::Path;

use nalgebra::Vector3;
use thiserror::Error;

use crate::trajectory::TrajectoryError;

/// Largest file that is read \[bytes\].
pub const MAX_FILE_BYTES: u64 = 512 << 20;
/// Most rows that are read: 67 minutes at 1 kHz.
pub const MAX_ROWS: usize = 4_000_000;

/// Largest distance of a hand from the origin \[m\]; beyond it a file is probably in millimetres.
const POSITION_MAX: f64 = 10.0;
/// Longest quotation of a file in a message \[characters\].
const QUOTE_MAX: usize = 40;

/// Meaning of the first time in a file.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum StartTime {
    /// The first row is at the start of the session, whatever its time.
    #[default]
    Zero,
    /// Times are session times: a first row at 2 s is reached 2 s after the start.
    File,
    /// The session starts at this time of the file's clock \[ns\]; earlier rows are left out. So hands that were
    /// recorded by one clock stay together.
    At(i64),
}

/// Why a recording of a hand was not read. Messages name file, line and column.
#[derive(Debug, Error)]
pub enum ReadError {
    /// The file could not be opened or read.
    #[error("{file}: {source}")]
    Io {
        /// The file.
        file: String,
        /// The system's error.
        source: io::Error,
    },
    /// Not a regular file: a folder, a device or a pipe.
    #[error("{file}: not a regular file")]
    NotAFile {
        /// The file.
        file: String,
    },
    /// The file is too large.
    #[error("{file}: larger than the limit of {MAX_FILE_BYTES} bytes")]
    TooBig {
        /// The file.
        file: String,
    },
    /// The file has too many rows.
    #[error("{file}: line {line}: more than {MAX_ROWS} rows")]
    TooManyRows {
        /// The file.
        file: String,
        /// First line beyond the limit, from 1.
        line: u64,
    },
    /// No row of data.
    #[error("{file}: holds no rows of data")]
    Empty {
        /// The file.
        file: String,
    },
    /// The header is not the one expected.
    #[error("{file}: line {line}: the header {problem}; valid columns are {valid}")]
    Header {
        /// The file.
        file: String,
        /// Line, from 1.
        line: u64,
        /// What is wrong with it.
        problem: String,
        /// The columns that are expected.
        valid: String,
    },
    /// A row is wrong as a whole.
    #[error("{file}: line {line}: {problem}")]
    Row {
        /// The file.
        file: String,
        /// Line, from 1.
        line: u64,
        /// What is wrong.
        problem: RowProblem,
    },
    /// A value is wrong.
    #[error("{file}: line {line}, column {column}: {problem}")]
    Value {
        /// The file.
        file: String,
        /// Line, from 1.
        line: u64,
        /// Column by name.
        column: String,
        /// What is wrong.
        problem: RowProblem,
    },
    /// The rows do not form a valid trajectory.
    #[error("{file}: {source}")]
    Trajectory {
        /// The file.
        file: String,
        /// What is wrong.
        source: TrajectoryError,
    },
}

/// What is wrong with a row or a value in it.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum RowProblem {
    /// Not a number.
    #[error("{text} is not a number")]
    NotANumber {
        /// The text found, quoted and shortened.
        text: String,
    },
    /// Neither a number nor a time.
    #[error(
        "{text} is no time; valid are numbers (s, ms, us or ns) and times such as 2026-11-27T14:05:00.250Z"
    )]
    NotATime {
        /// The text found, quoted and shortened.
        text: String,
    },
    /// Times of another clock than the session's, which are to be taken as session times.
    #[error(
        "with start=file the hand would begin to move {time_secs} s after the start of the session: leave start=file \
         out, and it begins with the first row"
    )]
    NotSessionTime {
        /// The time \[s\].
        time_secs: f64,
    },
    /// All rows are before the time at which the session starts.
    #[error("the session starts at {start_secs} s of this clock, but the last row is at {time_secs} s")]
    OverBeforeStart {
        /// Where the session starts \[s\].
        start_secs: f64,
        /// Time of the last row \[s\].
        time_secs: f64,
    },
    /// Many rows, far apart: the unit is likely another.
    #[error(
        "{rows} rows are {apart_secs} s apart on average, too far for a hand: add time=ms, time=us or time=ns if the \
         times are in such a unit, time=s if they are in seconds all the same"
    )]
    TooSlow {
        /// How many rows there are.
        rows: usize,
        /// How far they are apart \[s\].
        apart_secs: f64,
    },
    /// NaN or an infinity.
    #[error("the number is not finite")]
    NotFinite,
    /// Too few or too many columns.
    #[error("{found} columns instead of {expected}")]
    ColumnCount {
        /// How many there are.
        found: usize,
        /// How many there must be.
        expected: usize,
    },
    /// A line longer than any valid one.
    #[error("the line is longer than {limit} bytes")]
    LineTooLong {
        /// Longest line that is read \[bytes\].
        limit: u64,
    },
    /// Time does not increase.
    #[error("time {time_secs} s is not after {previous_secs} s of the row before")]
    TimeNotIncreasing {
        /// Time of the row \[s\].
        time_secs: f64,
        /// Time of the row before \[s\].
        previous_secs: f64,
    },
    /// A number out of range.
    #[error("{value} is out of range ({min} to {max} {unit})")]
    OutOfRange {
        /// The number.
        value: f64,
        /// Smallest valid number.
        min: f64,
        /// Greatest valid number.
        max: f64,
        /// Unit of the column.
        unit: &'static str,
    },
    /// A quaternion that is not of unit length within 1e-3.
    #[error("the quaternion is not normalised (length {norm}, valid is 1 ± 0.001)")]
    NotNormalised {
        /// Its length.
        norm: f64,
    },
    /// A matrix that is no rotation within 1e-2.
    #[error("the matrix is no rotation (departs from orthonormal by {departure:.3}, or is a reflection)")]
    NotARotation {
        /// Greatest departure of a product of its columns from the identity.
        departure: f64,
    },
}

/// Opens a regular file that is small enough.
pub(crate) fn open(path: &Path) -> Result<(File, String), ReadError> {
    let name = path.display().to_string();
    // Checked before opening, because opening a pipe would block until it has a writer.
    let metadata = std::fs::metadata(path).map_err(|source| ReadError::Io { file: name.clone(), source })?;
    if !metadata.is_file() {
        return Err(ReadError::NotAFile { file: name });
    }
    if metadata.len() > MAX_FILE_BYTES {
        return Err(ReadError::TooBig { file: name });
    }
    let file = File::open(path).map_err(|source| ReadError::Io { file: name.clone(), source })?;
    Ok((file, name))
}

pub(crate) fn parse_number(field: &[u8]) -> Result<f64, RowProblem> {
    let text = std::str::from_utf8(field).ok().map(str::trim);
    let Some(value) = text.and_then(|text| text.parse::<f64>().ok()) else {
        return Err(RowProblem::NotANumber { text: quote(field) });
    };
    if value.is_finite() { Ok(value) } else { Err(RowProblem::NotFinite) }
}

/// Quotes a field for a message: escaped, as it may contain any bytes, and shortened.
pub(crate) fn quote(field: &[u8]) -> String {
    let text = String::from_utf8_lossy(&field[..field.len().min(4 * QUOTE_MAX)]);
    let short: String = text.chars().take(QUOTE_MAX).collect();
    let dots = if short.len() < field.len() { "…" } else { "" };
    format!("{short:?}{dots}")
}

pub(crate) fn check_position(position: &Vector3<f64>) -> Result<(), (usize, RowProblem)> {
    for (axis, &value) in position.iter().enumerate() {
        check_range(value, -POSITION_MAX, POSITION_MAX, "m").map_err(|problem| (axis, problem))?;
    }
    Ok(())
}

pub(crate) fn check_gripper(angle: f64) -> Result<(), RowProblem> {
    check_range(angle, -std::f64::consts::PI, std::f64::consts::PI, "rad")
}

pub(crate) fn check_range(value: f64, min: f64, max: f64, unit: &'static str) -> Result<(), RowProblem> {
    if (min..=max).contains(&value) { Ok(()) } else { Err(RowProblem::OutOfRange { value, min, max, unit }) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quotes_are_short_and_escaped() {
        assert_eq!(quote(b"1.2a"), "\"1.2a\"");
        assert_eq!(quote(b"\x1b[2J\xff"), "\"\\u{1b}[2J\u{fffd}\"");
        assert!(quote(&[b'x'; 10_000]).chars().count() < 50);
    }

    #[test]
    fn a_folder_and_a_missing_file_are_named() {
        let folder = tempfile::tempdir().unwrap();
        assert!(matches!(open(folder.path()), Err(ReadError::NotAFile { .. })));
        let missing = folder.path().join("no.csv");
        assert!(open(&missing).unwrap_err().to_string().contains("no.csv: "));
    }
}

//! Errors of mesh files: the file, the place in it, and the reason.

use std::fmt;
use std::path::PathBuf;

use thiserror::Error;

/// Position in a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FilePosition {
    /// The file as a whole.
    Whole,
    /// A line of text, counted from 1.
    Line(usize),
    /// An offset in bytes, counted from 0.
    Byte(usize),
}

impl fmt::Display for FilePosition {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            FilePosition::Whole => Ok(()),
            FilePosition::Line(line) => write!(f, ", line {line}"),
            FilePosition::Byte(byte) => write!(f, ", byte {byte}"),
        }
    }
}

/// A mesh file that cannot be used.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum MeshError {
    /// Missing, not readable, or not a file.
    #[error("{}: cannot be read: {source}", file.display())]
    Io {
        /// The file.
        file: PathBuf,
        /// The system's error.
        source: std::io::Error,
    },
    /// More than the caller's limit.
    #[error("{}{place}: {count} {what} are more than the limit of {limit}", file.display())]
    TooLarge {
        /// The file.
        file: PathBuf,
        /// Position of the number.
        place: FilePosition,
        /// What is counted: bytes, vertices, elements.
        what: &'static str,
        /// How many there are, or are declared.
        count: u64,
        /// How many are allowed.
        limit: u64,
    },
    /// The file declares more than it can hold.
    #[error("{}{place}: declares {declared} {what}, but at most {possible} fit in what is left of the file", file.display())]
    Truncated {
        /// The file.
        file: PathBuf,
        /// Position of the number.
        place: FilePosition,
        /// What is counted.
        what: &'static str,
        /// How many are declared.
        declared: u64,
        /// How many could be there.
        possible: u64,
    },
    /// The file violates the format.
    #[error("{}{place}: {reason}", file.display())]
    Malformed {
        /// The file.
        file: PathBuf,
        /// Position in the file.
        place: FilePosition,
        /// What was found and what was expected.
        reason: String,
    },
    /// Valid, but not supported by this reader.
    #[error("{}{place}: {what} is not supported; supported: {supported}", file.display())]
    Unsupported {
        /// The file.
        file: PathBuf,
        /// Position in the file.
        place: FilePosition,
        /// What was found.
        what: String,
        /// What is supported.
        supported: &'static str,
    },
    /// An element refers to a vertex that does not exist.
    #[error("{}{place}: {element} {index} refers to vertex {vertex}, but there are {vertices} vertices", file.display())]
    IndexOutOfRange {
        /// The file.
        file: PathBuf,
        /// Position in the file.
        place: FilePosition,
        /// Triangle, face or tetrahedron.
        element: &'static str,
        /// Which one, counted from 0.
        index: usize,
        /// The vertex as written in the file.
        vertex: i64,
        /// How many vertices there are.
        vertices: usize,
    },
    /// A NaN or an infinity.
    #[error("{}{place}: {what} {index} has a coordinate that is not finite ({value})", file.display())]
    NotFinite {
        /// The file.
        file: PathBuf,
        /// Position in the file.
        place: FilePosition,
        /// Vertex, normal or texture coordinate.
        what: &'static str,
        /// Which one, counted from 0.
        index: usize,
        /// The number.
        value: f64,
    },
    /// Well formed, but the caller's policy refuses it.
    #[error("{}: {reason}", file.display())]
    Refused {
        /// The file (or the name of a generated mesh).
        file: PathBuf,
        /// The first finding that the policy refuses, and how many there are.
        reason: String,
    },
}

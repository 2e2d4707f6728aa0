//! What may be replaced, and why a result cannot be written.

use std::io;
use std::path::{Path, PathBuf};

use thiserror::Error;

/// Parts of results in one place at a time, those included that a killed process left behind.
pub(super) const PARTS_MAX: u32 = 64;

/// What becomes of a regular file that is at the place already.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Replace {
    /// It is an earlier result, and stays.
    Never,
    /// It is replaced unless it is read-only: a document of which a part is written anew.
    Writable,
    /// It is replaced, also when it is read-only.
    Always,
}

/// Why a result cannot be written to its place.
#[derive(Debug, Error)]
#[error("{}: {reason}", file.display())]
pub struct OutputError {
    /// The place, as it was named.
    pub file: PathBuf,
    /// What is wrong with it.
    pub reason: Reason,
}

/// What is wrong with a place.
#[derive(Debug, Error)]
pub enum Reason {
    /// An earlier result.
    #[error("exists already; --force overwrites it")]
    Exists,
    /// An earlier result that is protected.
    #[error("exists already and is read-only; --force overwrites it")]
    ExistsProtected,
    /// A document that is protected.
    #[error("is read-only")]
    ReadOnly,
    /// Another process has claimed it.
    #[error("another session is writing it; name another file")]
    Taken,
    /// A link without a target.
    #[error("is a link that leads nowhere")]
    DeadLink,
    /// Nothing that a result can be written to.
    #[error("is {0}; valid are a regular file, a FIFO with a reader, a character device, and '-' for stdout")]
    Kind(&'static str),
    /// A FIFO without a reader.
    #[error("is a FIFO that nobody reads from; start its reader first")]
    NoReader,
    /// The folder is missing.
    #[error("cannot be written: the folder {} does not exist", .0.display())]
    NoFolder(PathBuf),
    /// No name is left for another part.
    #[error("{PARTS_MAX} parts of it lie beside it, such as {}; remove those that nobody writes", .0.display())]
    Parts(PathBuf),
    /// The system refuses.
    #[error("cannot be written: {0}")]
    System(#[from] io::Error),
}

impl OutputError {
    /// Whether something is at the place that stays there, so that another name would do.
    pub fn is_occupied(&self) -> bool {
        use Reason::{DeadLink, Exists, ExistsProtected, Kind, ReadOnly, Taken};
        matches!(self.reason, Exists | ExistsProtected | ReadOnly | Taken | DeadLink | Kind(_))
    }
}

/// For those who name the file themselves.
impl From<OutputError> for io::Error {
    fn from(error: OutputError) -> Self {
        match error.reason {
            Reason::System(error) => error,
            reason => io::Error::new(io::ErrorKind::InvalidInput, reason.to_string()),
        }
    }
}

impl Reason {
    pub(super) fn of(self, file: &Path) -> OutputError {
        OutputError { file: file.to_owned(), reason: self }
    }
}

//! How results are written: what may be at their place, who else writes there, and whole files or none.
//!
//! | at the place | what becomes of it |
//! |---|---|
//! | nothing | the place is claimed at once, so that no other process takes it |
//! | a regular file | refused or replaced, as [`Replace`] says; the old one is whole until the new one is complete |
//! | an empty file that nobody holds | is taken: a process that was killed has left it |
//! | a link | stays a link: what it leads to is treated by these rules; one that leads nowhere is refused |
//! | a FIFO, a character device | written to as it is; a FIFO without a reader is refused |
//! | a directory, a block device, a socket | refused |
//! | `-` | stdout |
//!
//! A result is written to a [`Part`] beside its place and takes that place by a rename. A [`Claim`] that was never filled
//! leaves nothing behind.

mod claim;
mod error;
mod place;
#[cfg(test)]
mod tests;

use std::fs::{self, File};
use std::path::Path;

use place::Place;

pub use claim::{Claim, Part};
pub use error::{OutputError, Reason, Replace};
pub use place::STDOUT;

/// Checks whether a result could be written to a place, and leaves it as it is.
///
/// # Errors
/// [`OutputError`].
pub fn check(file: &Path, replace: Replace) -> Result<(), OutputError> {
    match Place::of(file).map_err(|reason| reason.of(file))? {
        Place::Regular { metadata, .. } => {
            place::may_replace(&metadata, replace).map_err(|reason| reason.of(file))
        }
        Place::Nothing | Place::Stream | Place::Stdout => Ok(()),
    }
}

/// Whether a place is a FIFO, a character device or stdout, which take one result after another.
pub fn is_stream(file: &Path) -> bool {
    matches!(Place::of(file), Ok(Place::Stream | Place::Stdout))
}

/// Opens a file that grows at its place. A regular file is emptied: whoever must not lose one claims the place first.
///
/// # Errors
/// [`OutputError`].
pub fn open(file: &Path) -> Result<File, OutputError> {
    let opened = || match Place::of(file)? {
        Place::Nothing | Place::Regular { .. } => {
            Ok(File::options().write(true).create(true).truncate(true).open(file)?)
        }
        Place::Stream => place::open_stream(file),
        Place::Stdout => Ok(place::stdout()?),
    };
    opened().map_err(|reason| reason.of(file))
}

/// Removes a file that was begun in vain; a device, a FIFO or a link stays.
pub fn discard(file: &Path) {
    if fs::symlink_metadata(file).is_ok_and(|found| found.is_file()) {
        // It is useless, and a failure to remove it adds nothing to the first error.
        let _ = fs::remove_file(file);
    }
}

/// Writes a whole file or nothing.
///
/// # Errors
/// [`OutputError`].
pub fn write(file: &Path, bytes: &[u8], replace: Replace) -> Result<(), OutputError> {
    Claim::take(file, replace)?.write(bytes)
}

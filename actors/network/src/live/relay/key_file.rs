//! The file of a relay's key, of mode 0600.

use std::path::{Path, PathBuf};

use ring::rand::SystemRandom;
use thiserror::Error;

use crate::relay::{KEY_TEXT_BYTES, NoKey, RelayKey};
use crate::ticket::NoRandomness;
use crate::ticket::private_file::{self, PrivateFileError};

/// Why there is no key.
#[derive(Debug, Error)]
pub enum KeyFileError {
    /// The file cannot be read or written, or others can read it.
    #[error(transparent)]
    File(#[from] PrivateFileError),
    /// There is none.
    #[error("{}: there is no such file; copy the one that the relay has written", .0.display())]
    Missing(PathBuf),
    /// It is something else.
    #[error("{}: {}", .0.display(), .1)]
    NoKey(PathBuf, NoKey),
    /// The system has no randomness.
    #[error(transparent)]
    NoRandomness(#[from] NoRandomness),
}

/// The key in a file.
///
/// # Errors
/// [`KeyFileError`].
pub fn read(file: &Path) -> Result<RelayKey, KeyFileError> {
    // A key is one line; of anything else no more is read than shows that it is none.
    let bytes = private_file::read(file, KEY_TEXT_BYTES as u64 + 64)?;
    let bytes = bytes.ok_or_else(|| KeyFileError::Missing(file.to_owned()))?;
    String::from_utf8_lossy(&bytes).parse().map_err(|error| KeyFileError::NoKey(file.to_owned(), error))
}

/// The key in a file, which is made with a new key if there is none; and whether it was made.
///
/// # Errors
/// [`KeyFileError`].
pub fn read_or_make(file: &Path) -> Result<(RelayKey, bool), KeyFileError> {
    match read(file) {
        Err(KeyFileError::Missing(_)) => {
            let key = RelayKey::random(&SystemRandom::new())?;
            private_file::write(file, format!("{}\n", key.to_text()).as_bytes())?;
            Ok((key, true))
        }
        read => read.map(|key| (key, false)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_key_is_made_once_read_again_and_told_from_other_files() {
        let folder = tempfile::tempdir().expect("a folder");
        let file = folder.path().join("relay.key");
        assert!(matches!(read(&file), Err(KeyFileError::Missing(_))));
        let (made, is_new) = read_or_make(&file).expect("it is made");
        let (again, is_newer) = read_or_make(&file).expect("it is read");
        assert!(is_new && !is_newer && made == again && read(&file).expect("it is read") == made);
        private_file::write(&file, b"trocar1nonsense").expect("it is written");
        let told = read(&file).expect_err("no key").to_string();
        assert!(told.contains("relay.key") && told.contains("64 hexadecimal digits"), "{told}");
    }
}

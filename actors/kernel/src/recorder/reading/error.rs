//! Why a file cannot be used as a recording, or a part of it.

use std::io;
use std::path::PathBuf;

use thiserror::Error;

use crate::recorder::format::SCHEMA;
use crate::state_hash::StateHash;

/// A file that cannot be used as a recording.
#[derive(Debug, Error)]
pub enum RecordingError {
    /// The file cannot be read.
    #[error("recording '{}': {source}", file.display())]
    Io {
        /// The file.
        file: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// What is recovered from it cannot be written.
    #[error("what is recovered cannot be written: {0}")]
    Write(io::Error),
    /// The file is not a recording.
    #[error("recording '{}': not a recording of trocar: {what}", file.display())]
    NotARecording {
        /// The file.
        file: PathBuf,
        /// What is missing.
        what: String,
    },
    /// Another version of the format.
    #[error(
        "recording '{}', metadata 'trocar': schema {found} (written by version {version}); this version \
         reads schema {SCHEMA}",
        file.display()
    )]
    Schema {
        /// The file.
        file: PathBuf,
        /// The version found.
        found: String,
        /// Which version of trocar wrote it.
        version: String,
    },
    /// Components that this session does not know.
    #[error("recording '{}': unknown components: {names}", file.display())]
    UnknownComponents {
        /// The file.
        file: PathBuf,
        /// Their names.
        names: String,
    },
    /// A damaged part.
    #[error("recording '{}', byte {offset}: {message}", file.display())]
    Damaged {
        /// The file.
        file: PathBuf,
        /// Where the part begins.
        offset: u64,
        /// What is wrong with it.
        message: String,
    },
    /// The replay diverges from the recorded state hash.
    #[error(
        "recording '{}', revision {revision}: the hash of what is stored is {found}, recorded was {recorded}",
        file.display()
    )]
    Diverged {
        /// The file.
        file: PathBuf,
        /// Where.
        revision: u64,
        /// Hash of the replay.
        found: StateHash,
        /// Recorded hash.
        recorded: StateHash,
    },
}

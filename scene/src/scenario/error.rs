//! Errors of scenarios: file, line, column, key and reason.

use std::path::PathBuf;

use thiserror::Error;

use crate::mesh::MeshError;

/// A scenario that cannot be used.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum ScenarioError {
    /// Missing, not readable, or not text.
    #[error("{}: cannot be read: {source}", file.display())]
    Io {
        /// The file.
        file: PathBuf,
        /// The system's error.
        source: std::io::Error,
    },
    /// The text is invalid.
    #[error("{}:{line}:{column}: {}{reason}", file.display(), if key.is_empty() { String::new() } else { format!("{key}: ") })]
    Invalid {
        /// The file.
        file: PathBuf,
        /// Line, counted from 1.
        line: usize,
        /// Column in characters, counted from 1.
        column: usize,
        /// The key, from the outside in: `entity 'ring.1', shape`.
        key: String,
        /// What is wrong, and what would be valid.
        reason: String,
    },
    /// A mesh that the scenario refers to cannot be used.
    #[error("{}:{line}:{column}: {key}: {source}", file.display())]
    Mesh {
        /// The scenario.
        file: PathBuf,
        /// Line of the reference, counted from 1.
        line: usize,
        /// Column of the reference, counted from 1.
        column: usize,
        /// The key of the reference.
        key: String,
        /// What is wrong with the mesh.
        source: Box<MeshError>,
    },
}

//! Errors of textures.

use std::path::PathBuf;

use thiserror::Error;

/// A texture that cannot be generated or read.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum TextureError {
    /// No procedural texture has this name.
    #[error("no procedural texture is called {name:?}{}; there are {}", did_you_mean(.name, .valid), .valid.join(", "))]
    Unknown {
        /// The name that was asked for.
        name: String,
        /// The valid names.
        valid: &'static [&'static str],
    },
    /// An invalid size for a procedural texture.
    #[error(
        "procedural texture {name:?}: a size of {size} is not possible; valid are the powers of two from {min} to {max}"
    )]
    Size {
        /// The texture.
        name: &'static str,
        /// The requested size \[texels\].
        size: u32,
        /// The smallest size \[texels\].
        min: u32,
        /// The largest size \[texels\].
        max: u32,
    },
    /// The path of a file leaves its folder, or is no valid path.
    #[error("{path:?}: {reason}")]
    Path {
        /// The path as written.
        path: String,
        /// What is wrong with it.
        reason: &'static str,
    },
    /// Missing, not readable, or not a file.
    #[error("{}: cannot be read: {source}", file.display())]
    Io {
        /// The file.
        file: PathBuf,
        /// The system's error.
        source: std::io::Error,
    },
    /// A limit is exceeded.
    #[error("{}: {what} {found} is more than the limit of {limit}", file.display())]
    TooLarge {
        /// The file.
        file: PathBuf,
        /// The limited quantity, with its unit.
        what: &'static str,
        /// The file's value.
        found: u64,
        /// The limit.
        limit: u64,
    },
    /// A file of another format.
    #[error("{}: is no picture of a kind that is read; valid are PNG and JPEG", file.display())]
    Kind {
        /// The file.
        file: PathBuf,
    },
    /// A damaged image, or one with an unsupported feature.
    #[error("{}: not a sound PNG or JPEG picture: {reason}", file.display())]
    Malformed {
        /// The file.
        file: PathBuf,
        /// The decoder's message.
        reason: String,
    },
}

/// The valid name that is closest to `name`, as a question, if any is close.
fn did_you_mean(name: &str, valid: &[&str]) -> String {
    valid
        .iter()
        .map(|candidate| (strsim::jaro_winkler(name, candidate), candidate))
        .filter(|(likeness, _)| *likeness > 0.75)
        .max_by(|a, b| a.0.total_cmp(&b.0))
        .map_or_else(String::new, |(_, candidate)| format!("; did you mean {candidate:?}?"))
}

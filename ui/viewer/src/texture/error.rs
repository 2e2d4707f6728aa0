//! Why a texture cannot be had.

use std::path::PathBuf;

use thiserror::Error;

/// A texture that cannot be made or read.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum TextureError {
    /// No procedural texture has this name.
    #[error("no procedural texture is called {name:?}{}; there are {}", did_you_mean(.name, .valid), .valid.join(", "))]
    Unknown {
        /// The name that was asked for.
        name: String,
        /// The names that there are.
        valid: &'static [&'static str],
    },
    /// A procedural texture is not made in this size.
    #[error(
        "procedural texture {name:?}: a size of {size} is not possible; valid are the powers of two from {min} to {max}"
    )]
    Size {
        /// The texture.
        name: &'static str,
        /// The size that was asked for \[texels\].
        size: u32,
        /// The smallest size \[texels\].
        min: u32,
        /// The largest size \[texels\].
        max: u32,
    },
    /// The path of a file leaves the folder that it has to stay below, or is none.
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
        /// What the system says.
        source: std::io::Error,
    },
    /// More than the caller allows.
    #[error("{}: {what} {found} is more than the limit of {limit}", file.display())]
    TooLarge {
        /// The file.
        file: PathBuf,
        /// What is limited, with its unit.
        what: &'static str,
        /// As much as the file has.
        found: u64,
        /// As much as is allowed.
        limit: u64,
    },
    /// Not a picture of a kind that is read.
    #[error("{}: is no picture of a kind that is read; valid are PNG and JPEG", file.display())]
    Kind {
        /// The file.
        file: PathBuf,
    },
    /// A picture that is damaged, or uses something that is not read.
    #[error("{}: not a sound PNG or JPEG picture: {reason}", file.display())]
    Malformed {
        /// The file.
        file: PathBuf,
        /// What the decoder says.
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

//! Why nothing is sewn.

use thiserror::Error;

use super::needle::NeedleError;
use crate::linear_fem::PrecomputeError;
use crate::suture_thread::{ThreadError, Trouble};

/// Why there is no suture, or why a step was not made; what was before, still is.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum SutureError {
    /// A number out of range.
    #[error("{what} is {value}: valid is {valid}")]
    Number {
        /// Which.
        what: &'static str,
        /// What it is.
        value: f64,
        /// What it may be.
        valid: &'static str,
    },
    /// No needle.
    #[error(transparent)]
    Needle(#[from] NeedleError),
    /// No thread.
    #[error(transparent)]
    Thread(#[from] ThreadError),
    /// No tissue.
    #[error(transparent)]
    Tissue(#[from] PrecomputeError),
    /// A state that is not one of these bodies.
    #[error("the state does not fit: {0}")]
    State(&'static str),
    /// Something that acts on it and makes no sense.
    #[error("{what} {index}: {why}")]
    Given {
        /// What it is.
        what: &'static str,
        /// Its place in the list.
        index: usize,
        /// What is wrong with it.
        why: String,
    },
    /// Too much is followed at once.
    #[error(
        "the channels in the tissue touch more of it than can be followed: coarsen the mesh or the spacing"
    )]
    Full,
    /// No step was found.
    #[error("no step from {time} s on, not of {shortest} s either: {why}")]
    Diverged {
        /// From the beginning of the step \[s\].
        time: f64,
        /// That was tried \[s\].
        shortest: f64,
        /// What went wrong.
        why: Trouble,
    },
}

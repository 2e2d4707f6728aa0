//! Errors of suturing.

use thiserror::Error;
use trocar_scene::readable::quantity;

use super::needle::NeedleError;
use crate::linear_fem::PrecomputeError;
use crate::suture_thread::{FailureCause, ThreadError};

/// Why a suture was rejected, or a step failed; the previous state is kept.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum SutureError {
    /// A parameter out of range.
    #[error("{what} is {value}: valid is {valid}")]
    Number {
        /// The parameter.
        what: &'static str,
        /// Its value.
        value: f64,
        /// Its valid range.
        valid: &'static str,
    },
    /// An invalid needle.
    #[error(transparent)]
    Needle(#[from] NeedleError),
    /// An invalid thread.
    #[error(transparent)]
    Thread(#[from] ThreadError),
    /// An invalid tissue.
    #[error(transparent)]
    Tissue(#[from] PrecomputeError),
    /// A state that does not fit these bodies.
    #[error("the state does not fit: {0}")]
    State(&'static str),
    /// An invalid input of a step.
    #[error("{what} {index}: {why}")]
    Given {
        /// The kind of input.
        what: &'static str,
        /// Its index in the list.
        index: usize,
        /// What is wrong with it.
        why: String,
    },
    /// Too many channel points.
    #[error(
        "the channels in the tissue touch more of it than can be followed: coarsen the mesh or the spacing"
    )]
    Full,
    /// The step did not converge even when divided.
    #[error(
        "no step from {} on, not of {} either: {why}; move what holds it more slowly, or take shorter steps (a higher \
         'rate_hz')",
        quantity(*time, "s"),
        quantity(*shortest, "s")
    )]
    Diverged {
        /// Time since the beginning of the step \[s\].
        time: f64,
        /// The shortest substep that was tried \[s\].
        shortest: f64,
        /// The cause.
        why: FailureCause,
    },
}

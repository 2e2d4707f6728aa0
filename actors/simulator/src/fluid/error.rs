//! Errors of liquids and of their steps.

use std::ops::RangeInclusive;

use thiserror::Error;
use trocar_scene::readable::{given, quantity};

/// Why a fluid was rejected.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum FluidError {
    /// A parameter out of range.
    #[error("{what} of {}: {valid} is valid", given(*value))]
    Parameter {
        /// Its name.
        what: &'static str,
        /// Its value.
        value: f64,
        /// Its valid range.
        valid: &'static str,
    },
    /// Lists of different lengths, or too long.
    #[error("{count} particles: lists of one length, at most {most}, are valid")]
    State {
        /// Number given.
        count: usize,
        /// Number allowed.
        most: usize,
    },
    /// A non-finite number.
    #[error("particle {particle} has a number that is not finite")]
    NotFinite {
        /// Its index in the list.
        particle: usize,
    },
}

/// Why a step was rejected; the state is unchanged.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum FluidStepError {
    /// An invalid time step.
    #[error("a step of {0} s: 1e-9 to 1 s is valid")]
    Time(f64),
    /// Too fast for so long a step.
    #[error(
        "a step of {} had {} left after {most} parts: take shorter steps (a higher 'rate_hz'), or allow more parts",
        quantity(*dt, "s"),
        quantity(*left, "s")
    )]
    TooFast {
        /// The step \[s\].
        dt: f64,
        /// The part of it that remained \[s\].
        left: f64,
        /// Maximum number of substeps.
        most: u32,
    },
    /// A particle with a non-finite position.
    #[error("particle {number} has a position that is not finite: take shorter steps (a higher 'rate_hz')")]
    NotFinite {
        /// Its number.
        number: u64,
    },
}

pub(super) fn parameter(
    what: &'static str,
    value: f64,
    range: RangeInclusive<f64>,
    valid: &'static str,
) -> Result<(), FluidError> {
    if range.contains(&value) { Ok(()) } else { Err(FluidError::Parameter { what, value, valid }) }
}

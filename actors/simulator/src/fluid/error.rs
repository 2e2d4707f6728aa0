//! What can be wrong with a liquid and its steps.

use std::ops::RangeInclusive;

use thiserror::Error;

/// Why there can be no such liquid.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum FluidError {
    /// A parameter out of its range.
    #[error("{what} of {value}: {valid} is valid")]
    Parameter {
        /// Which one.
        what: &'static str,
        /// What it was.
        value: f64,
        /// What it may be.
        valid: &'static str,
    },
    /// Lists that do not belong together, or are too long.
    #[error("{count} particles: lists of one length, at most {most}, are valid")]
    State {
        /// How many came.
        count: usize,
        /// How many there may be.
        most: usize,
    },
    /// A number that is none.
    #[error("particle {particle} has a number that is not finite")]
    NotFinite {
        /// Which one, in the list that came.
        particle: usize,
    },
}

/// Why a step was not taken. Everything is as it was before.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum FluidStepError {
    /// No time.
    #[error("a step of {0} s: 1e-9 to 1 s is valid")]
    Time(f64),
    /// Too fast for so long a step.
    #[error("a step of {dt} s had {left} s left after {most} parts; take shorter steps, or allow more parts")]
    TooFast {
        /// The step \[s\].
        dt: f64,
        /// What was left of it \[s\].
        left: f64,
        /// How many parts it may have.
        most: u32,
    },
    /// A particle came to be nowhere.
    #[error("particle {number} came to be nowhere")]
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

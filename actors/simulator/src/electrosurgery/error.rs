//! Errors of electrosurgery.

use std::ops::RangeInclusive;

use thiserror::Error;
use trocar_scene::readable::{given, number, quantity};

/// Maximum number of items listed in a message.
const NAMED_MAX: usize = 8;

fn some(indices: &[u32]) -> String {
    let named: Vec<String> = indices.iter().take(NAMED_MAX).map(u32::to_string).collect();
    let more = indices.len().saturating_sub(NAMED_MAX);
    let more = if more > 0 { format!(" and {more} more") } else { String::new() };
    format!("{}{more}", named.join(", "))
}

/// Why a tissue was rejected.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum ElectrosurgeryError {
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
    /// Positions that are not finite, or more than 1 km away.
    #[error("vertices {} are nowhere: finite coordinates within 1000 m are valid", some(.0))]
    Positions(Vec<u32>),
    /// Elements with a vertex that does not exist.
    #[error("elements {} name vertices that do not exist: 0 to {vertices} - 1 are valid", some(.elements))]
    NoVertex {
        /// The elements.
        elements: Vec<u32>,
        /// Number of vertices.
        vertices: usize,
    },
    /// Degenerate elements.
    #[error("elements {} have no extent, and would conduct without limit", some(.0))]
    Degenerate(Vec<u32>),
    /// No elements, or too many.
    #[error("{0} elements: 1 to 10,000,000 are valid")]
    Count(usize),
    /// The lattice over the mesh would be too large.
    #[error("elements lie in {0} cells of the search grid: at most 100,000,000 are held; use a coarser grid")]
    TooLarge(usize),
    /// Cuts that do not fit this tissue.
    #[error("parted: {0}")]
    Parted(String),
    /// A state of another tissue, or with invalid numbers.
    #[error("state: {0}")]
    State(String),
}

/// Why a step was rejected; the state is unchanged.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum HeatStepError {
    /// An input out of range.
    #[error("{what} of {}: {valid} is valid", given(*value))]
    Input {
        /// Its name.
        what: &'static str,
        /// Its value.
        value: f64,
        /// Its valid range.
        valid: &'static str,
    },
    /// Too many electrodes.
    #[error("{0} electrodes: at most 16 at a time are valid")]
    Electrodes(usize),
    /// The organ's heat equation did not converge.
    #[error(
        "the heat of the organ does not settle: vertex {vertex} is off by {residual:.1e} K after {iterations} iterations"
    )]
    NotConverged {
        /// The vertex with the largest residual.
        vertex: u32,
        /// Its residual \[K\].
        residual: f64,
        /// Number of iterations.
        iterations: u32,
    },
    /// The source is too strong for its size and the step: it would need too many substeps.
    #[error(
        "a step of {} needs {} parts for this power on this area, and at most {most} are taken: take shorter steps (a \
         higher 'rate_hz'), less power, or a larger electrode",
        quantity(*dt, "s"),
        number(*parts)
    )]
    TooStrong {
        /// The step \[s\].
        dt: f64,
        /// Number of substeps needed.
        parts: f64,
        /// Number allowed.
        most: u32,
    },
}

pub(super) fn parameter(
    what: &'static str,
    value: f64,
    range: RangeInclusive<f64>,
    valid: &'static str,
) -> Result<(), ElectrosurgeryError> {
    if range.contains(&value) { Ok(()) } else { Err(ElectrosurgeryError::Parameter { what, value, valid }) }
}

pub(super) fn input(
    what: &'static str,
    value: f64,
    range: RangeInclusive<f64>,
    valid: &'static str,
) -> Result<(), HeatStepError> {
    if range.contains(&value) { Ok(()) } else { Err(HeatStepError::Input { what, value, valid }) }
}

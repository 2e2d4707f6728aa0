//! What can be wrong with tissue, its parameters and a step.

use std::ops::RangeInclusive;

use thiserror::Error;

/// How many of many are named.
const NAMED_MAX: usize = 8;

fn some(indices: &[u32]) -> String {
    let named: Vec<String> = indices.iter().take(NAMED_MAX).map(u32::to_string).collect();
    let more = indices.len().saturating_sub(NAMED_MAX);
    let more = if more > 0 { format!(" and {more} more") } else { String::new() };
    format!("{}{more}", named.join(", "))
}

/// Why there can be no such tissue.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum ElectrosurgeryError {
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
    /// Positions that are not finite, or more than 1 km away.
    #[error("vertices {} are nowhere: finite coordinates within 1000 m are valid", some(.0))]
    Positions(Vec<u32>),
    /// Elements that name a vertex that does not exist.
    #[error("elements {} name vertices that do not exist: 0 to {vertices} - 1 are valid", some(.elements))]
    NoVertex {
        /// Which elements.
        elements: Vec<u32>,
        /// How many vertices there are.
        vertices: usize,
    },
    /// Elements without area or volume.
    #[error("elements {} have no extent, and would conduct without limit", some(.0))]
    Degenerate(Vec<u32>),
    /// No elements, or more than can be told apart.
    #[error("{0} elements: 1 to 10,000,000 are valid")]
    Count(usize),
    /// The lattice over the mesh would need more room than there is.
    #[error("elements lie in {0} cells of the search grid: at most 100,000,000 are held; use a coarser grid")]
    TooLarge(usize),
    /// What blades have made of it cannot be of this tissue.
    #[error("parted: {0}")]
    Parted(String),
    /// A state that does not belong to this tissue, or that holds numbers that cannot be.
    #[error("state: {0}")]
    State(String),
}

/// Why a step was not taken. The state is as it was before.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum HeatStepError {
    /// A number that is given with a step, out of its range.
    #[error("{what} of {value}: {valid} is valid")]
    Input {
        /// Which one.
        what: &'static str,
        /// What it was.
        value: f64,
        /// What it may be.
        valid: &'static str,
    },
    /// More instruments than a step takes.
    #[error("{0} electrodes: at most 16 at a time are valid")]
    Electrodes(usize),
    /// The equations of the organ were not solved.
    #[error(
        "the heat of the organ does not settle: vertex {vertex} is off by {residual:.1e} K after {iterations} iterations"
    )]
    NotConverged {
        /// The worst vertex.
        vertex: u32,
        /// By how much \[K\].
        residual: f64,
        /// After how many iterations.
        iterations: u32,
    },
    /// The source is so strong for its size and the step that it would need too many parts.
    #[error(
        "a step of {dt} s needs {parts} parts for this power on this area: at most {most}; take shorter steps"
    )]
    TooStrong {
        /// The step \[s\].
        dt: f64,
        /// How many parts it needs.
        parts: f64,
        /// How many it may have.
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

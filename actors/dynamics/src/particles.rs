//! Nodes that move: their state, and what can be wrong with a step of them, whichever method takes it.

use nalgebra::{Point3, Vector3};
use serde::{Deserialize, Serialize};
use thiserror::Error;

/// Where every node is, and how it moves: all that a solver needs to continue.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct State {
    /// One per node \[m\].
    pub positions: Vec<Point3<f64>>,
    /// One per node \[m/s\].
    pub velocities: Vec<Vector3<f64>>,
}

/// Why a step was not taken. The state is what it was before it.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum StepError {
    /// Not a time.
    #[error("a step of {0} s: above 0 and finite is valid")]
    Time(f64),
    /// Longer than is safe, and the configuration says to refuse.
    #[error("a step of {step} s is longer than the largest safe one, {safe} s")]
    TooLarge {
        /// What was asked for \[s\].
        step: f64,
        /// What would be safe \[s\].
        safe: f64,
    },
    /// It would take too many parts.
    #[error("a step of {step} s takes {parts} parts of {safe} s; at most {most} are taken")]
    TooManyParts {
        /// What was asked for \[s\].
        step: f64,
        /// How many parts.
        parts: f64,
        /// The largest safe step \[s\].
        safe: f64,
        /// The limit.
        most: u32,
    },
    /// An input names something that does not exist, or is not a number.
    #[error("{what} {index}: {problem}")]
    Input {
        /// Prescribed node, force or contact.
        what: &'static str,
        /// Which of the list.
        index: usize,
        /// What is wrong with it.
        problem: &'static str,
    },
    /// A node left for infinity.
    #[error("node {node} has a position or velocity that is not finite")]
    NotFinite {
        /// The first such node.
        node: u32,
    },
    /// A node is faster than anything in the scene can be: the step was too large for the stiffness.
    #[error("node {node} would move at {speed} m/s, above the limit of {limit} m/s")]
    Runaway {
        /// The first such node.
        node: u32,
        /// Its speed \[m/s\].
        speed: f64,
        /// The configured limit \[m/s\].
        limit: f64,
    },
    /// The factorisation failed: the matrix is not positive definite to working precision.
    #[error("the step's matrix could not be factorised")]
    Factorisation,
}

//! Node state (positions and velocities), and the errors of a step, for every solver.

use nalgebra::{Point3, Vector3};
use serde::{Deserialize, Serialize};
use thiserror::Error;
use trocar_scene::readable::{number, quantity};

/// Positions and velocities of all nodes: the complete state of a solver.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct State {
    /// One per node \[m\].
    pub positions: Vec<Point3<f64>>,
    /// One per node \[m/s\].
    pub velocities: Vec<Vector3<f64>>,
}

/// Why a step was rejected. The state is unchanged.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum StepError {
    /// A step length that is not positive and finite.
    #[error("a step of {0} s: above 0 and finite is valid")]
    Time(f64),
    /// Longer than the safe step, with a configuration that rejects this.
    #[error(
        "a step of {} is longer than the largest safe one, {}: take shorter steps, or an implicit method",
        quantity(*step, "s"),
        quantity(*safe, "s")
    )]
    TooLarge {
        /// The requested step \[s\].
        step: f64,
        /// The largest safe step \[s\].
        safe: f64,
    },
    /// It would need too many substeps.
    #[error(
        "a step of {} takes {} parts of {}, and at most {most} are taken: step it by 'method = \"implicit\"', or make its \
         'lag' smaller, its cells larger, its springs softer, or the controller's 'rate_hz' higher",
        quantity(*step, "s"),
        number(*parts),
        quantity(*safe, "s")
    )]
    TooManyParts {
        /// The requested step \[s\].
        step: f64,
        /// Number of substeps.
        parts: f64,
        /// The largest safe step \[s\].
        safe: f64,
        /// The limit.
        most: u32,
    },
    /// An input refers to something that does not exist, or is not finite.
    #[error("{what} {index}: {problem}")]
    Input {
        /// The kind of input: prescribed node, force or contact.
        what: &'static str,
        /// Its index in the list.
        index: usize,
        /// What is wrong with it.
        problem: &'static str,
    },
    /// The position or velocity of a node became non-finite.
    #[error(
        "node {node} has a position or velocity that is not finite: take shorter steps (a higher 'rate_hz'), or check \
         stiffness and forces"
    )]
    NotFinite {
        /// The first such node.
        node: u32,
    },
    /// A node is faster than anything in the scene can be: the step was too large for the stiffness.
    #[error(
        "node {node} would move faster than {}, the limit: take shorter steps (a higher 'rate_hz'), or make it softer or \
         more damped",
        quantity(*limit, "m/s")
    )]
    Runaway {
        /// The first such node.
        node: u32,
        /// Its speed \[m/s\].
        speed: f64,
        /// The configured limit \[m/s\].
        limit: f64,
    },
    /// The factorisation failed: the matrix is not positive definite to working precision.
    #[error(
        "the step's matrix could not be factorised: take shorter steps (a higher 'rate_hz'), or check masses and stiffness"
    )]
    Factorisation,
}

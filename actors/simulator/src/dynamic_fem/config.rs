//! Configuration, errors and reports of a dynamic body.

use thiserror::Error;

use super::constitutive::Constitution;
use crate::linear_algebra::FactorError;

/// Mass matrix.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MassMatrix {
    /// Lumped: a quarter of each element's mass at each of its nodes.
    Lumped,
    /// Consistent with the interpolation of displacements.
    Consistent,
}

/// Material and solver settings of a body.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Config {
    /// Constitutive law.
    pub constitution: Constitution,
    /// Mass matrix.
    pub mass: MassMatrix,
    /// Density \[kg/m³\].
    pub density: f64,
    /// Mass-proportional Rayleigh damping \[1/s\].
    pub mass_damping: f64,
    /// Stiffness-proportional Rayleigh damping \[s\].
    pub stiffness_damping: f64,
    /// Tolerance: residual force relative to the internal, external and inertial forces.
    pub tolerance: f64,
    /// Maximum iterations, after which a step is accepted but reported as unsolved.
    pub iterations_max: u32,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            constitution: Constitution::Corotational,
            mass: MassMatrix::Lumped,
            density: 1000.0,
            mass_damping: 0.0,
            stiffness_damping: 0.0,
            tolerance: 1e-4,
            iterations_max: 100,
        }
    }
}

/// Why a body was rejected.
#[derive(Clone, Copy, Debug, Error, PartialEq)]
pub enum DynamicFemError {
    /// A parameter out of range.
    #[error("{what} is {value}: {valid} is valid")]
    OutOfRange {
        /// Its name.
        what: &'static str,
        /// Its value.
        value: f64,
        /// Its valid range.
        valid: &'static str,
    },
    /// A node that does not exist.
    #[error("node {node} is to be fixed, but there are {nodes}: 0 to {nodes} - 1 are valid")]
    NoNode {
        /// The node.
        node: u32,
        /// Number of nodes.
        nodes: usize,
    },
    /// No free node.
    #[error("all {0} nodes are fixed")]
    NothingFree(usize),
    /// The matrix could not be factorised, or not enough memory.
    #[error(transparent)]
    Factor(#[from] FactorError),
    /// A state of another body.
    #[error("the state does not fit this body: {0}")]
    State(&'static str),
}

/// Why a step failed; the body is unchanged.
#[derive(Clone, Copy, Debug, Error, PartialEq)]
pub enum StepError {
    /// An invalid time step.
    #[error("a step of {0} s: above 0 and up to 1 s is valid")]
    Dt(f64),
    /// An input with an invalid node.
    #[error("{what} number {index} names node {node} of {nodes}, a fixed one, or one a second time")]
    Node {
        /// Forces, prescribed nodes, springs or contacts.
        what: &'static str,
        /// Its index.
        index: usize,
        /// The node.
        node: u32,
        /// Number of nodes.
        nodes: usize,
    },
    /// A non-finite number, a negative stiffness, or a normal that is not of unit length.
    #[error("{what} number {index} has a number out of range")]
    Number {
        /// The acceleration, forces, prescribed nodes, springs or contacts.
        what: &'static str,
        /// Its index.
        index: usize,
    },
    /// The step would give a non-finite result.
    #[error(
        "the step led node {node} to a position that is not a finite number: take shorter steps (a higher 'rate_hz')"
    )]
    NotFinite {
        /// The node.
        node: u32,
    },
    /// The matrix could not be factorised.
    #[error(transparent)]
    Factor(#[from] FactorError),
}

/// Statistics of a step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Report {
    /// Residual force relative to the internal, external and inertial forces.
    pub residual: f64,
    /// Whether that is within the tolerance.
    pub solved: bool,
    /// Iterations.
    pub iterations: u32,
    /// Evaluations of energy and forces.
    pub evaluations: u32,
    /// Factorisations; most steps need none.
    pub factorisations: u32,
    /// Inverted elements at the end of the step.
    pub inverted: u32,
    /// The first of them.
    pub first_inverted: Option<u32>,
}

/// Energies \[J\].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Energies {
    /// Kinetic energy.
    pub kinetic: f64,
    /// Elastic energy.
    pub elastic: f64,
}

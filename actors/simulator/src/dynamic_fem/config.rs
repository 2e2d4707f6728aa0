//! What a body in motion is made of, and what its steps answer.

use thiserror::Error;

use super::constitutive::Constitution;
use crate::linear_algebra::FactorError;

/// How masses are spread.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MassMatrix {
    /// A quarter of each element at each of its nodes.
    Lumped,
    /// As displacements are interpolated.
    Consistent,
}

/// What a body is made of, and how exactly it is stepped.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Config {
    /// How elements answer to deformation.
    pub constitution: Constitution,
    /// How masses are spread.
    pub mass: MassMatrix,
    /// Density \[kg/m³\].
    pub density: f64,
    /// Rayleigh damping of the mass \[1/s\].
    pub mass_damping: f64,
    /// Rayleigh damping of the stiffness \[s\].
    pub stiffness_damping: f64,
    /// A step is solved when the forces out of balance are this share of the inner, outer and inertial ones.
    pub tolerance: f64,
    /// Iterations after which a step is taken as it is, and said not to be solved.
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

/// Why there is no body.
#[derive(Clone, Copy, Debug, Error, PartialEq)]
pub enum DynamicFemError {
    /// A number out of range.
    #[error("{what} is {value}: {valid} is valid")]
    OutOfRange {
        /// What it is.
        what: &'static str,
        /// What came.
        value: f64,
        /// What is valid.
        valid: &'static str,
    },
    /// A node that there is none of.
    #[error("node {node} is to be fixed, but there are {nodes}: 0 to {nodes} - 1 are valid")]
    NoNode {
        /// What was named.
        node: u32,
        /// How many there are.
        nodes: usize,
    },
    /// Nothing can move.
    #[error("all {0} nodes are fixed")]
    NothingFree(usize),
    /// No factor, or no room for one.
    #[error(transparent)]
    Factor(#[from] FactorError),
    /// A state of another body.
    #[error("the state does not fit this body: {0}")]
    State(&'static str),
}

/// Why a step was not taken; the body is as it was before.
#[derive(Clone, Copy, Debug, Error, PartialEq)]
pub enum StepError {
    /// No time to step by.
    #[error("a step of {0} s: above 0 and up to 1 s is valid")]
    Dt(f64),
    /// An input that cannot be.
    #[error("{what} number {index} names node {node} of {nodes}, a fixed one, or one a second time")]
    Node {
        /// Forces, prescribed nodes, springs or contacts.
        what: &'static str,
        /// Which of them.
        index: usize,
        /// The node.
        node: u32,
        /// How many there are.
        nodes: usize,
    },
    /// A number of an input is none, a stiffness is negative, or a normal is not of length 1.
    #[error("{what} number {index} has a number out of range")]
    Number {
        /// The acceleration, forces, prescribed nodes, springs or contacts.
        what: &'static str,
        /// Which of them.
        index: usize,
    },
    /// The step would have led nowhere.
    #[error("the step led node {node} to a position that is not a finite number")]
    NotFinite {
        /// Which node.
        node: u32,
    },
    /// No factor.
    #[error(transparent)]
    Factor(#[from] FactorError),
}

/// What a step took.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Report {
    /// Forces out of balance as a share of the inner, outer and inertial ones.
    pub residual: f64,
    /// Whether that is within the tolerance.
    pub solved: bool,
    /// Iterations.
    pub iterations: u32,
    /// Times that energy and forces were computed.
    pub evaluations: u32,
    /// Factorisations; most steps need none.
    pub factorisations: u32,
    /// Elements that are inside out at the end of the step.
    pub inverted: u32,
    /// The first of them.
    pub first_inverted: Option<u32>,
}

/// Energies \[J\].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Energies {
    /// Of motion.
    pub kinetic: f64,
    /// Of deformation.
    pub elastic: f64,
}

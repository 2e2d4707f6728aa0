//! What can be wrong with a network of springs, and with a step of it.

use thiserror::Error;

/// Bad elements that a message names; the others are counted.
const NAMED: usize = 16;

/// Indices that share a fault: the first few by name, and how many there are.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Faulty {
    /// The first 16, in ascending order.
    pub first: Vec<u32>,
    /// All of them.
    pub count: usize,
}

impl Faulty {
    /// Gathers those indices for which `bad` holds.
    pub(crate) fn among(count: usize, mut bad: impl FnMut(usize) -> bool) -> Self {
        let mut faulty = Self::default();
        for index in (0..count).filter(|&index| bad(index)) {
            if faulty.first.len() < NAMED {
                faulty.first.push(index as u32);
            }
            faulty.count += 1;
        }
        faulty
    }
    /// An error where there are any.
    pub(crate) fn refuse<E>(self, error: impl FnOnce(Self) -> E) -> Result<(), E> {
        if self.count == 0 { Ok(()) } else { Err(error(self)) }
    }
}

impl std::fmt::Display for Faulty {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        for (place, index) in self.first.iter().enumerate() {
            let comma = if place == 0 { "" } else { ", " };
            write!(formatter, "{comma}{index}")?;
        }
        match self.count.saturating_sub(self.first.len()) {
            0 => Ok(()),
            more => write!(formatter, " and {more} more"),
        }
    }
}

/// Why a network of springs cannot be built.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum NetworkError {
    /// A parameter outside its range.
    #[error("{what} is {value}; valid is {valid}")]
    Parameter {
        /// Which.
        what: &'static str,
        /// What it was.
        value: f64,
        /// What it may be.
        valid: &'static str,
    },
    /// Nothing to simulate.
    #[error("there are no nodes")]
    Empty,
    /// Two slices that belong together differ in length.
    #[error("{given} {what} for {expected} nodes")]
    Length {
        /// Of what.
        what: &'static str,
        /// How many there are.
        given: usize,
        /// How many there should be.
        expected: usize,
    },
    /// Nodes that are nowhere.
    #[error("nodes with a position that is not finite: {0}")]
    NotFinite(Faulty),
    /// Elements that name a node that does not exist, or one twice.
    #[error("{kind}s that name a node twice, or one that does not exist (there are {nodes}): {faulty}")]
    Nodes {
        /// Spring, hinge, segment, triangle or tetrahedron.
        kind: &'static str,
        /// Nodes that exist.
        nodes: usize,
        /// Which elements.
        faulty: Faulty,
    },
    /// Elements of no length, area or volume.
    #[error("{kind}s without extent: {faulty}")]
    NoExtent {
        /// Segment, triangle or tetrahedron.
        kind: &'static str,
        /// Which.
        faulty: Faulty,
    },
    /// Springs or hinges whose numbers cannot be used.
    #[error("{kind}s whose stiffness or rest length is negative or not finite: {faulty}")]
    Numbers {
        /// Spring or hinge.
        kind: &'static str,
        /// Which.
        faulty: Faulty,
    },
    /// Groups of constraints of which one has a node twice, or more of them than there can be.
    #[error("{kind}s in a group that has one of their nodes already, or in one beyond the last: {faulty}")]
    Groups {
        /// Distance, bend or tetrahedron.
        kind: &'static str,
        /// Which.
        faulty: Faulty,
    },
    /// Nodes without mass.
    #[error("nodes whose mass is not a positive number (a node that no element uses has none): {0}")]
    Masses(Faulty),
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

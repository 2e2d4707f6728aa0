//! What can be wrong with a network of springs, and with a step of it.

use thiserror::Error;
use trocar_dynamics::faulty::Faulty;

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

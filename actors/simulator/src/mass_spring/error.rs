//! Errors of a spring network and of its steps.

use thiserror::Error;
use trocar_dynamics::faulty::Faulty;

/// Why a spring network was rejected.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum NetworkError {
    /// A parameter out of range.
    #[error("{what} is {value}; valid is {valid}")]
    Parameter {
        /// The parameter.
        what: &'static str,
        /// Its value.
        value: f64,
        /// Its valid range.
        valid: &'static str,
    },
    /// No nodes.
    #[error("there are no nodes")]
    Empty,
    /// Two related lists of different lengths.
    #[error("{given} {what} for {expected} nodes")]
    Length {
        /// The list.
        what: &'static str,
        /// Its length.
        given: usize,
        /// The required length.
        expected: usize,
    },
    /// Non-finite nodes.
    #[error("nodes with a position that is not finite: {0}")]
    NotFinite(Faulty),
    /// Elements with a missing or repeated node.
    #[error("{kind}s that name a node twice, or one that does not exist (there are {nodes}): {faulty}")]
    Nodes {
        /// Spring, hinge, segment, triangle or tetrahedron.
        kind: &'static str,
        /// Number of nodes.
        nodes: usize,
        /// The elements.
        faulty: Faulty,
    },
    /// Elements without length, area or volume.
    #[error("{kind}s without extent: {faulty}")]
    NoExtent {
        /// Segment, triangle or tetrahedron.
        kind: &'static str,
        /// The elements.
        faulty: Faulty,
    },
    /// Springs, hinges or tetrahedra with invalid values.
    #[error("{kind}s whose stiffness or rest length is negative or not finite: {faulty}")]
    Numbers {
        /// Spring, hinge or tetrahedron.
        kind: &'static str,
        /// The elements.
        faulty: Faulty,
    },
    /// Constraint colours with two elements at one node, or too many colours.
    #[error("{kind}s in a group that has one of their nodes already, or in one beyond the last: {faulty}")]
    Groups {
        /// Distance, bend or tetrahedron.
        kind: &'static str,
        /// The elements.
        faulty: Faulty,
    },
    /// Nodes without mass.
    #[error("nodes whose mass is not a positive number (a node that no element uses has none): {0}")]
    Masses(Faulty),
}

//! What can be wrong with a thread, and with a step of it.

use thiserror::Error;

/// Why a thread was refused.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum ThreadError {
    /// A number of the material.
    #[error("thread material: {name} is {value}; valid: {valid}")]
    Material {
        /// Of the field.
        name: &'static str,
        /// What was given.
        value: f64,
        /// What is accepted.
        valid: &'static str,
    },
    /// Too few or too many nodes.
    #[error("a thread of {0} nodes; valid: 3 to {max}", max = super::NODES_MAX)]
    Nodes(usize),
    /// Nodes whose numbers are not finite.
    #[error("nodes with numbers that are not finite: {0:?}")]
    NotFinite(Vec<usize>),
    /// Edges that are shorter than a hundredth of the radius, or have no positive rest length.
    #[error("edges without length: {0:?}")]
    NoLength(Vec<usize>),
    /// Edges that fold back onto the one before.
    #[error("nodes at which the thread folds back onto itself: {0:?}")]
    Folded(Vec<usize>),
    /// A list of a state that does not fit the others.
    #[error("thread state: {list} has {found} entries, expected {expected}")]
    Length {
        /// Which list.
        list: &'static str,
        /// How long it is.
        found: usize,
        /// How long it has to be.
        expected: usize,
    },
}

/// Why a step was not taken; the thread is as it was before.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum ThreadStepError {
    /// The time step.
    #[error("a step of {0} s; valid: above 0, at most {max} s", max = super::STEP_MAX)]
    Step(f64),
    /// Something given for the step names what is not there or is no number.
    #[error("{what} {index}: {why}")]
    Given {
        /// `hold`, `load`, `obstacle`, `gravity`, …
        what: &'static str,
        /// Which one of the list.
        index: usize,
        /// What is wrong with it.
        why: String,
    },
    /// No step was short enough.
    #[error("node {node} at {time} s into the step: {why}, even with steps of {shortest} s")]
    Diverged {
        /// At which node.
        node: usize,
        /// Where in the step \[s\].
        time: f64,
        /// What was seen.
        why: Trouble,
        /// The shortest step that was tried \[s\].
        shortest: f64,
    },
}

/// What was seen at a node when a step had to be refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum Trouble {
    /// A number that is not finite.
    #[error("a number is not finite")]
    NotFinite,
    /// The rod's matrix.
    #[error("the matrix of the rod is not positive definite")]
    NotPositive,
    /// The rod is longer or shorter than it can be.
    #[error("the strain is beyond what the rod can take")]
    Strain,
    /// Two strands, or a strand and an obstacle, would pass through each other.
    #[error("a contact would be passed through")]
    PassedThrough,
    /// Iterations that do not come to an end.
    #[error("the iterations do not end")]
    Wanders,
    /// No forces were found that obey the rules of what it is tied to.
    #[error("the forces of what it is tied to were not found")]
    Unsettled,
    /// A needle at its end would go further in a step than it can be followed.
    #[error("the needle would go too far")]
    TooFar,
    /// A needle that cannot be moved.
    #[error("the needle has no inertia")]
    NoInertia,
    /// More of a tissue is touched than can be followed.
    #[error("more of the tissue is touched than can be followed")]
    Full,
    /// More contacts than are handled.
    #[error("more than {max} contacts", max = super::CONTACTS_MAX)]
    TooManyContacts,
}

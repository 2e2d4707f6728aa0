//! Errors of a thread and of its steps.

use thiserror::Error;
use trocar_scene::readable::quantity;

/// Why a thread was rejected.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum ThreadError {
    /// An invalid material parameter.
    #[error("thread material: {name} is {value}; valid: {valid}")]
    Material {
        /// The parameter.
        name: &'static str,
        /// The given value.
        value: f64,
        /// The valid range.
        valid: &'static str,
    },
    /// Too few or too many nodes.
    #[error("a thread of {0} nodes; valid: 3 to {max}", max = super::NODES_MAX)]
    Nodes(usize),
    /// Too few or too many nodes of a closed thread.
    #[error("a closed thread of {0} nodes; valid: {least} to {max}", least = super::CLOSED_NODES_MIN, max = super::NODES_MAX)]
    ClosedNodes(usize),
    /// Nodes with non-finite values.
    #[error("nodes with numbers that are not finite: {0:?}")]
    NotFinite(Vec<usize>),
    /// Edges shorter than a hundredth of the radius, or without a positive rest length.
    #[error("edges without length: {0:?}")]
    NoLength(Vec<usize>),
    /// Edges folded back onto the previous one.
    #[error("nodes at which the thread folds back onto itself: {0:?}")]
    Folded(Vec<usize>),
    /// A list of the state whose length does not match the others.
    #[error("thread state: {list} has {found} entries, expected {expected}")]
    Length {
        /// Which list.
        list: &'static str,
        /// Its length.
        found: usize,
        /// The required length.
        expected: usize,
    },
}

/// Why a step was rejected; the thread is unchanged.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum ThreadStepError {
    /// An invalid time step.
    #[error("a step of {0} s; valid: above 0, at most {max} s", max = super::STEP_MAX)]
    Step(f64),
    /// An input of the step with an invalid index or a non-finite value.
    #[error("{what} {index}: {why}")]
    Given {
        /// `hold`, `load`, `obstacle`, `gravity`, …
        what: &'static str,
        /// Its index in the list.
        index: usize,
        /// What is wrong with it.
        why: String,
    },
    /// The step did not converge even when divided.
    #[error(
        "node {node} at {} into the step: {why}, even with steps of {}; move what holds or touches the thread more \
         slowly, or take shorter steps (a higher 'rate_hz')",
        quantity(*time, "s"),
        quantity(*shortest, "s")
    )]
    Diverged {
        /// The node.
        node: usize,
        /// Time within the step \[s\].
        time: f64,
        /// The cause.
        why: FailureCause,
        /// The shortest substep that was tried \[s\].
        shortest: f64,
    },
}

/// Why a step failed at a node.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum FailureCause {
    /// A non-finite value.
    #[error("a number is not finite")]
    NotFinite,
    /// The rod's matrix is not positive definite.
    #[error("the matrix of the rod is not positive definite")]
    NotPositive,
    /// The strain of the rod is beyond its limit.
    #[error("the strain is beyond the limit of the rod")]
    Strain,
    /// Two strands, or a strand and an obstacle, would pass through each other.
    #[error("a strand or an obstacle would be passed through")]
    PassedThrough,
    /// Newton's iterations did not converge.
    #[error("Newton's method did not converge")]
    Wanders,
    /// No forces satisfy the laws of the coupled bodies.
    #[error("the forces between the thread and what it is tied to did not converge")]
    Unsettled,
    /// A held needle would move further in a step than can be tracked.
    #[error("the needle would move too far in one step")]
    TooFar,
    /// A needle without inertia.
    #[error("the needle has no inertia")]
    NoInertia,
    /// Contact with more of a tissue than can be handled.
    #[error("more of the tissue is touched than can be tracked")]
    Full,
    /// More contacts than can be handled.
    #[error("more than {max} contacts", max = super::CONTACTS_MAX)]
    TooManyContacts,
}

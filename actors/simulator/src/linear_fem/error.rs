//! Errors of a linear elastic body.

use thiserror::Error;

use super::attachment::{AttachmentError, Handle};
use super::bounds::{REMOVED_MAX, ROWS_MAX};
use super::compliance::PrecomputeError;

/// Why a call failed; the body is unchanged.
#[derive(Clone, Copy, Debug, Error, PartialEq)]
pub enum LinearFemError {
    /// The precomputation failed.
    #[error(transparent)]
    Precompute(#[from] PrecomputeError),
    /// A compliance of another mesh, material or boundary.
    #[error("the compliance belongs to another mesh, material or boundary")]
    OtherCompliance,
    /// Weights that do not define a mean of nodes.
    #[error(transparent)]
    Attachment(#[from] AttachmentError),
    /// A redundant constraint: its nodes are fixed or already constrained.
    #[error("the attachment at node {node} is fixed, or says what others that are held already say")]
    Dependent {
        /// Its first node.
        node: u32,
    },
    /// Too many constraints.
    #[error("{ROWS_MAX} directions are held already: let go of some")]
    Full,
    /// An unknown handle.
    #[error("nothing is held under the handle {}", .0.0)]
    NoHandle(Handle),
    /// A load on a node that is not a free surface node.
    #[error("a load on node {node}, which is no free node of the surface")]
    NotOnSurface {
        /// The node.
        node: u32,
    },
    /// A mesh that is no split of this body's mesh.
    #[error("the mesh is not one that this body becomes: its elements with new nodes behind all others")]
    OtherMesh,
    /// A non-finite number.
    #[error("{what} is not a finite number")]
    NotFinite {
        /// Its name.
        what: &'static str,
    },
    /// A number of forces other than that of nodes.
    #[error("{found} forces for {nodes} nodes")]
    Forces {
        /// Number of forces.
        found: usize,
        /// Number of nodes.
        nodes: usize,
    },
    /// A missing or removed element.
    #[error("element {tet} of {tets} is to be taken out: there is none, or it is out already")]
    NoElement {
        /// The element.
        tet: u32,
        /// Number of elements.
        tets: usize,
    },
    /// A number of alterations other than that of elements.
    #[error("{found} alterations for {tets} elements")]
    Alterations {
        /// Number of alterations.
        found: usize,
        /// Number of elements.
        tets: usize,
    },
    /// An alteration out of range.
    #[error(
        "element {tet} is to be altered beyond 0 to 1e6 times its stiffness or 0.01 to 100 times its length"
    )]
    Alteration {
        /// The element.
        tet: u32,
    },
    /// The inverse allows no more corrections.
    #[error(
        "its inverse is corrected for as much as it bears, {REMOVED_MAX} elements or twice as many nodes: a new one is due"
    )]
    TooManyRemoved,
    /// The removal would make the body numerically singular.
    #[error("without element {tet} a part of the body would be held by nothing")]
    Apart {
        /// The element.
        tet: u32,
    },
    /// The active set did not converge.
    #[error(
        "the active set of the one-sided constraints did not converge in {0} rounds: move the instruments less per step, or hold fewer places"
    )]
    NotSettled(usize),
    /// A state that does not belong to this solver.
    #[error("the state does not fit this body: {0}")]
    State(&'static str),
}

//! Why a linear body did not do what it was asked for.

use thiserror::Error;

use super::attachment::{AttachmentError, Handle};
use super::bounds::{REMOVED_MAX, ROWS_MAX};
use super::compliance::PrecomputeError;

/// Why something was not done; what was before, still is.
#[derive(Clone, Copy, Debug, Error, PartialEq)]
pub enum LinearFemError {
    /// The precomputation failed.
    #[error(transparent)]
    Precompute(#[from] PrecomputeError),
    /// A compliance of another mesh, material or boundary.
    #[error("the compliance belongs to another mesh, material or boundary")]
    OtherCompliance,
    /// Weights that are no mean of nodes.
    #[error(transparent)]
    Attachment(#[from] AttachmentError),
    /// What is to be held is fixed, or is held already by what is there.
    #[error("the attachment at node {node} is fixed, or says what others that are held already say")]
    Dependent {
        /// The first of its nodes.
        node: u32,
    },
    /// No more can be held.
    #[error("{ROWS_MAX} directions are held already: let go of some")]
    Full,
    /// Nothing of that name is held.
    #[error("nothing is held under the handle {}", .0.0)]
    NoHandle(Handle),
    /// A load on a node that is no free node of the surface.
    #[error("a load on node {node}, which is no free node of the surface")]
    NotOnSurface {
        /// Which node.
        node: u32,
    },
    /// A mesh that the body does not become by coming apart.
    #[error("the mesh is not one that this body becomes: its elements with new nodes behind all others")]
    OtherMesh,
    /// A number that is none.
    #[error("{what} is not a finite number")]
    NotFinite {
        /// What it is.
        what: &'static str,
    },
    /// One force per node was asked for.
    #[error("{found} forces for {nodes} nodes")]
    Forces {
        /// Forces that came.
        found: usize,
        /// Nodes of the mesh.
        nodes: usize,
    },
    /// An element that there is none of, or that is gone.
    #[error("element {tet} of {tets} is to be taken out: there is none, or it is out already")]
    NoElement {
        /// Which.
        tet: u32,
        /// Elements of the mesh.
        tets: usize,
    },
    /// One alteration per element was asked for.
    #[error("{found} alterations for {tets} elements")]
    Alterations {
        /// Alterations that came.
        found: usize,
        /// Elements of the mesh.
        tets: usize,
    },
    /// An alteration that none can be.
    #[error(
        "element {tet} is to be altered beyond 0 to 1e6 times its stiffness or 0.01 to 100 times its length"
    )]
    Alteration {
        /// Of which.
        tet: u32,
    },
    /// The old inverse does not serve any longer.
    #[error(
        "its inverse is corrected for as much as it bears, {REMOVED_MAX} elements or twice as many nodes: a new one is due"
    )]
    TooManyRemoved,
    /// What is left would hang by nothing.
    #[error("without element {tet} a part of the body would be held by nothing")]
    Apart {
        /// Which.
        tet: u32,
    },
    /// One-sided constraints went back and forth.
    #[error("which of the one-sided constraints act was not found in {0} rounds")]
    NotSettled(usize),
    /// A state that is not one of this solver's.
    #[error("the state does not fit this body: {0}")]
    State(&'static str),
}

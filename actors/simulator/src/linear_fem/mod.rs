//! Linear quasi-static finite elements with a precomputed inverse: the response to a few contact points is computed
//! from the compliance between surface nodes alone (Bro-Nielsen, Cotin 1996; capacitance matrices: James, Pai 1999).
//!
//! [`Compliance`] is computed once for a mesh, a material and a fixed boundary, and can be saved. At run time
//! [`LinearFem`] holds points of the body at displacements (bilateral, weighted over nodes, interior ones too) or keeps
//! them on one side of a plane, and computes the constraint forces: W λ = d − C K⁻¹ f with W = C K⁻¹ Cᵀ. The Cholesky
//! factor of W is updated with each added or removed constraint.
//!
//! Linear: exact for small displacements only. [`LinearFem::deformation`] measures the rotations and strains; beyond
//! [`ROTATION_LIMIT`] or [`STRAIN_LIMIT`] use a corotational method.

#![expect(clippy::neg_cmp_op_on_partial_ord, reason = "what is not a number passes no test")]

pub(crate) mod active_set;
pub(crate) mod altered_mesh;
mod attachment;
mod bounds;
mod cache;
mod compliance;
pub(crate) mod compliance_columns;
pub(crate) mod contact_patch;
pub(crate) mod displacements;
pub(crate) mod element_removal;
mod error;
pub(crate) mod low_rank_update;
pub(crate) mod node_split;
pub(crate) mod serialization;
mod solver;
mod state;
pub(crate) mod strain_check;

pub use attachment::{Attachment, AttachmentError, Handle, Hold};
pub use bounds::REMOVED_MAX;
pub use cache::{Cache, Origin};
pub use compliance::{Boundary, Compliance, Limits, PrecomputeError};
pub use compliance_columns::Columns;
pub use contact_patch::{PatchError, patch};
pub use error::LinearFemError;
pub use low_rank_update::Change;
pub use serialization::BytesError;
pub use solver::{HeldAttachment, LinearFem, Load, Reaction, Solution};
pub use state::LinearFemState;
pub use strain_check::{Deformation, ROTATION_LIMIT, STRAIN_LIMIT};

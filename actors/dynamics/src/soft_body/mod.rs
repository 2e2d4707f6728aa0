//! Common controller of soft-body methods: whichever method moves a body, instruments touch, grasp and press it alike.
//!
//! | Concept | File |
//! |---|---|
//! | the controller that schedules the bodies of a method | `controller.rs` |
//! | interface of a method: input and results of a step | `method.rs` |
//! | a body's state in the scene | `deformable.rs`, `pinned.rs`, `frozen.rs` |
//! | instruments as rods, their contacts, grasps | `instrument_rods.rs`, `rod_contact.rs`, `jaws.rs`, `grasp.rs` |
//! | their way in the time of a body that missed steps | `rod_paths.rs` |
//! | what jaws hold by friction, and crush | `jaw_friction.rs` |
//! | instruments that hands lead, held back, and which may pass | `held_back.rs`, `instrument_limits.rs` |
//! | contacts that detectors find | `contact/` |
//! | contact with the rigid bodies that move | `bearing/` |
//! | the slower side of a coupling | `coupling/` |

pub mod bearing;
pub mod contact;
pub mod controller;
pub mod coupling;
pub mod deformable;
pub mod frozen;
pub mod grasp;
pub mod held_back;
pub mod instrument_limits;
pub mod instrument_rods;
pub mod jaw_friction;
pub mod jaws;
pub mod method;
pub mod pinned;
pub mod rod_contact;
pub mod rod_paths;
mod stepped_body;
mod tick_course;

pub use controller::SoftController;
pub use deformable::Deformable;
pub use method::SoftMethod;
pub use pinned::{PinnedBody, PinnedWith};

use trocar_scene::{RegistryBuilder, RegistryError};

/// Registers the components that every method of soft bodies shares.
///
/// # Errors
/// When a name is already taken by another type.
pub fn register(builder: &mut RegistryBuilder) -> Result<(), RegistryError> {
    trocar_scene::register_all!(builder;
        grasp::Grips, PinnedBody, contact::SoftContacts, contact::RigidContacts,
        coupling::CoupledBody, coupling::CouplingGiven, coupling::CouplingTaken,
        jaw_friction::StrainedGrips, jaw_friction::Crushable, rod_paths::RodPaths,
    )?;
    Ok(())
}

//! The frame of every method of soft bodies: whichever method moves a body, instruments touch, hold and press it alike.
//!
//! | Concept | File |
//! |---|---|
//! | who schedules the bodies of a method | `controller.rs` |
//! | what a method is, what it is given and what it tells | `method.rs` |
//! | a body as the scene has it | `deformable.rs`, `pinned.rs`, `frozen.rs` |
//! | instruments as rods, where these touch, what jaws hold | `instrument_rods.rs`, `rod_contact.rs`, `jaws.rs`, `grasp.rs` |
//! | contacts that detectors find | `contact/` |
//! | the slower side of a coupling | `coupling/` |

pub mod contact;
pub mod controller;
pub mod coupling;
pub mod deformable;
pub mod frozen;
pub mod grasp;
pub mod instrument_rods;
pub mod jaws;
pub mod method;
pub mod pinned;
pub mod rod_contact;

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
    builder.register::<grasp::Grips>()?;
    builder.register::<contact::SoftContacts>()?;
    builder.register::<contact::RigidContacts>()?;
    builder.register::<coupling::CoupledBody>()?;
    builder.register::<coupling::CouplingGiven>()?;
    builder.register::<coupling::CouplingTaken>()?;
    builder.register::<PinnedBody>()?;
    Ok(())
}

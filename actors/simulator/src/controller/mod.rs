//! Who schedules the solvers: each controller steps the bodies that carry its component, from what the scene says of
//! them, and writes back where they are.
//!
//! Everything that a later life needs is in the scene: shapes at rest, positions and velocities of vertices, what is held,
//! burned or cut. What a solver refuses freezes the one body that it is about; the others go on.

pub mod cuts;
pub mod deformable;
pub mod dynamic_fem;
pub mod electrosurgery;
pub mod grips;
pub mod instruments;
pub mod mass_spring;
pub mod soft;
pub mod tools;
pub mod touch;
pub mod xpbd;

use trocar_scene::{RegistryBuilder, RegistryError};

pub use deformable::Deformable;
pub use dynamic_fem::{DynamicFemBody, DynamicFemController};
pub use electrosurgery::{
    CauterisedBody, ElectrodeTip, ElectrosurgeryController, HeatState, RemovedElements,
};
pub use instruments::{InstrumentsConfig, InstrumentsController};
pub use mass_spring::{MassSpringBody, MassSpringController};
pub use soft::{SoftController, SoftMethod};
pub use xpbd::{XpbdBody, XpbdController};

/// Registers the components of this crate.
///
/// # Errors
/// When a name is already taken by another type.
pub fn register(builder: &mut RegistryBuilder) -> Result<(), RegistryError> {
    builder.register::<MassSpringBody>()?;
    builder.register::<cuts::Cuts>()?;
    builder.register::<grips::Grips>()?;
    builder.register::<DynamicFemBody>()?;
    builder.register::<XpbdBody>()?;
    builder.register::<CauterisedBody>()?;
    builder.register::<ElectrodeTip>()?;
    builder.register::<RemovedElements>()?;
    builder.register::<HeatState>()?;
    Ok(())
}

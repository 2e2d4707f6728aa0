//! Who schedules the solvers: each controller steps the bodies that carry its component, from what the scene says of
//! them, and writes back where they are.
//!
//! Everything that a later life needs is in the scene: shapes at rest, positions and velocities of vertices, what is held,
//! burned or cut. What a solver refuses freezes the one body that it is about; the others go on.

pub mod deformable;
pub mod dynamic_fem;
pub mod dynamic_fem_memory;
pub mod electrosurgery;
pub mod instruments;
pub mod jaws;
pub mod linear_fem;
pub mod mass_spring;
pub mod tools;
pub mod touch;

use trocar_scene::{RegistryBuilder, RegistryError};

pub use deformable::Deformable;
pub use dynamic_fem::{DynamicFemBody, DynamicFemController};
pub use dynamic_fem_memory::DynamicFemMemory;
pub use electrosurgery::{
    CauterisedBody, ElectrodeTip, ElectrosurgeryController, HeatState, RemovedElements,
};
pub use instruments::{InstrumentsConfig, InstrumentsController};
pub use linear_fem::{LinearFemBody, LinearFemController, LinearFemGrips};
pub use mass_spring::{MassSpringBody, MassSpringController};

/// Registers the components of this crate.
///
/// # Errors
/// When a name is already taken by another type.
pub fn register(builder: &mut RegistryBuilder) -> Result<(), RegistryError> {
    builder.register::<MassSpringBody>()?;
    builder.register::<jaws::SurfaceState>()?;
    builder.register::<DynamicFemBody>()?;
    builder.register::<DynamicFemMemory>()?;
    builder.register::<LinearFemBody>()?;
    builder.register::<LinearFemGrips>()?;
    builder.register::<CauterisedBody>()?;
    builder.register::<ElectrodeTip>()?;
    builder.register::<RemovedElements>()?;
    builder.register::<HeatState>()?;
    Ok(())
}

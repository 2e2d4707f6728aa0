//! Rapier as the physics-engine controller.

pub mod contacts;
pub mod controller;
pub mod conversion;
pub mod coupling;
pub mod error;
pub mod grasp;
pub mod grasper;
pub mod jaws;
pub mod local_model;
pub mod mechanism;
pub mod settings;
pub mod shapes;
pub mod target_track;
pub mod world;

pub use controller::EngineController;
pub use error::EngineError;
pub use grasper::{Grasper, GrasperState};
pub use mechanism::MechanismState;
pub use settings::EngineSettings;
pub use world::{RigidWorld, WorldStatistics};

/// Registers the components that the engine adds to those of the field.
///
/// # Errors
/// When a name is already taken by another type.
pub fn register(builder: &mut trocar_scene::RegistryBuilder) -> Result<(), trocar_scene::RegistryError> {
    builder.register::<MechanismState>()?;
    Ok(())
}

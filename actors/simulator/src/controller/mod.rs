//! Controllers that schedule the solvers: each one steps the bodies with its component, reads their state from the
//! scene and writes it back.
//!
//! The scene holds everything that a restart needs: rest shapes, vertex positions and velocities, what is held, burned
//! or cut. A solver failure freezes the one body concerned; the others go on.

pub mod cauterised;
pub mod coupling;
pub mod cutting;
pub mod dynamic_fem;
pub mod electrosurgery;
pub mod fluid;
pub mod instruments;
pub mod linear_fem;
pub mod mass_spring;
pub mod rest_position;
pub mod suture;
pub mod suture_thread;
pub mod thermal_damage;
pub mod xpbd;

use trocar_scene::{RegistryBuilder, RegistryError};

pub use cauterised::{CauterisedBody, ElectrodeTip};
pub use cutting::membrane::SurfaceElements;
pub use cutting::volume::VolumeCuts;
pub use dynamic_fem::saved_state::{DynamicFemMemory, LentFactor, WantedFactor};
pub use dynamic_fem::{DynamicFemBody, DynamicFemController};
pub use electrosurgery::plume::Plume;
pub use electrosurgery::{ElectrosurgeryController, HeatState};
pub use fluid::bleeding::{BleedingController, Vessel, VesselState};
pub use fluid::irrigation::{Irrigator, Sucker};
pub use fluid::liquid::{FluidController, Liquid, LiquidState, LiquidWall};
pub use fluid::smoke::{SmokeCloud, SmokeCloudState, SmokeController};
pub use fluid::vital_signs::{Patient, PatientState, VitalSignsController};
pub use instruments::{InstrumentsConfig, InstrumentsController};
pub use linear_fem::embedded_points::PinPlaces;
pub use linear_fem::{LinearFemBody, LinearFemController};
pub use mass_spring::MassSpringController;
pub use mass_spring::component::MassSpringBody;
pub use mass_spring::factor_job::{SpringFactor, WantedSheetFactor};
pub use suture::SutureController;
pub use suture::components::{SewnTissue, SutureMemory, SutureNeedle};
pub use suture_thread::ThreadController;
pub use suture_thread::component::{Laid, LiesOn, Suture, ThreadBody};
pub use suture_thread::elastic_body::{Mark, TiedBody};
pub use suture_thread::knot::{KnotState, knot_code};
pub use suture_thread::saved_state::ThreadMemory;
pub use thermal_damage::{CoagulatedElement, CoagulatedElements, RemovedElements};
pub use xpbd::{XpbdBody, XpbdController, XpbdGroups};

/// Registers the components of this crate, and those of `trocar-dynamics`.
///
/// # Errors
/// When a name is already taken by another type.
pub fn register(builder: &mut RegistryBuilder) -> Result<(), RegistryError> {
    trocar_dynamics::register(builder)?;
    builder.register::<MassSpringBody>()?;
    builder.register::<SpringFactor>()?;
    builder.register::<cutting::surface::Cuts>()?;
    builder.register::<DynamicFemBody>()?;
    builder.register::<XpbdBody>()?;
    builder.register::<XpbdGroups>()?;
    builder.register::<DynamicFemMemory>()?;
    builder.register::<LinearFemBody>()?;
    builder.register::<linear_fem::contacts::Contacts>()?;
    builder.register::<PinPlaces>()?;
    builder.register::<CauterisedBody>()?;
    builder.register::<ElectrodeTip>()?;
    builder.register::<RemovedElements>()?;
    builder.register::<CoagulatedElements>()?;
    builder.register::<VolumeCuts>()?;
    builder.register::<SurfaceElements>()?;
    builder.register::<HeatState>()?;
    builder.register::<Plume>()?;
    builder.register::<SmokeCloud>()?;
    builder.register::<SmokeCloudState>()?;
    builder.register::<Vessel>()?;
    builder.register::<VesselState>()?;
    builder.register::<Liquid>()?;
    builder.register::<LiquidWall>()?;
    builder.register::<Irrigator>()?;
    builder.register::<Sucker>()?;
    builder.register::<LiquidState>()?;
    builder.register::<SewnTissue>()?;
    builder.register::<SutureNeedle>()?;
    builder.register::<SutureMemory>()?;
    builder.register::<ThreadBody>()?;
    builder.register::<ThreadMemory>()?;
    builder.register::<KnotState>()?;
    builder.register::<TiedBody>()?;
    builder.register::<Patient>()?;
    builder.register::<PatientState>()?;
    Ok(())
}

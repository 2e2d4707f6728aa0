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
pub mod region_stiffness;
mod rest_position;
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
pub use linear_fem::LinearFemController;
pub use linear_fem::component::LinearFemBody;
pub use linear_fem::embedded_points::PinPlaces;
pub use mass_spring::MassSpringController;
pub use mass_spring::component::MassSpringBody;
pub use mass_spring::factor_job::{SpringFactor, WantedSheetFactor};
pub use region_stiffness::{RegionMaterial, SoftRegions};
pub use suture::SutureController;
pub use suture::components::{SewnTissue, SutureMemory, SutureNeedle};
pub use suture_thread::ThreadController;
pub use suture_thread::component::{Laid, LiesOn, ThreadBody};
pub use suture_thread::elastic_body::{Mark, TiedBody};
pub use suture_thread::knot::{KnotState, knot_code};
pub use suture_thread::saved_state::ThreadMemory;
pub use suture_thread::suture::{Suture, SutureOf};
pub use thermal_damage::{CoagulatedElement, CoagulatedElements, RemovedElements};
pub use xpbd::XpbdController;
pub use xpbd::component::{XpbdBody, XpbdGroups};

/// Registers the components of this crate, and those of `trocar-dynamics`.
///
/// # Errors
/// When a name is already taken by another type.
pub fn register(builder: &mut RegistryBuilder) -> Result<(), RegistryError> {
    trocar_dynamics::register(builder)?;
    trocar_scene::register_all!(builder;
        MassSpringBody, SpringFactor, DynamicFemBody, DynamicFemMemory, XpbdBody, XpbdGroups,
        LinearFemBody, linear_fem::contacts::Contacts, PinPlaces,
        cutting::surface::Cuts, VolumeCuts, SurfaceElements,
        CauterisedBody, ElectrodeTip, RemovedElements, CoagulatedElements, HeatState, Plume, SoftRegions,
        SmokeCloud, SmokeCloudState, Vessel, VesselState, Patient, PatientState,
        Liquid, LiquidWall, Irrigator, Sucker, LiquidState,
        SewnTissue, SutureNeedle, SutureMemory, ThreadBody, ThreadMemory, KnotState, TiedBody,
    )?;
    Ok(())
}

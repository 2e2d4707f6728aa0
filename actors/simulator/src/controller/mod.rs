//! Who schedules the solvers: each controller steps the bodies that carry its component, from what the scene says of
//! them, and writes back where they are.
//!
//! Everything that a later life needs is in the scene: shapes at rest, positions and velocities of vertices, what is held,
//! burned or cut. What a solver refuses freezes the one body that it is about; the others go on.

pub mod blades;
pub mod bleeding;
pub mod cauterised;
pub mod coupled;
pub mod cuts;
pub mod dynamic_fem;
mod dynamic_fem_jobs;
pub mod dynamic_fem_memory;
pub mod electrosurgery;
pub mod fluid;
pub mod grafts;
pub mod heat;
mod heat_parted;
pub mod instruments;
pub mod irrigation;
pub mod knot_state;
mod knot_watch;
pub mod line_cuts;
pub mod linear_fem;
mod linear_fem_altered;
mod linear_fem_contacts;
mod linear_fem_fading;
mod linear_fem_holding;
mod linear_fem_jobs;
mod linear_fem_pins;
pub mod mass_spring;
pub mod mass_spring_body;
pub mod mass_spring_factor;
pub mod membrane;
pub mod parting;
pub mod plume;
pub mod rest_place;
mod sewing;
pub mod smoke;
pub mod suture;
pub mod suture_body;
pub mod thread;
pub mod thread_body;
pub mod thread_cuts;
pub mod thread_edges;
pub mod thread_grips;
mod thread_lines;
mod thread_lying;
pub mod thread_memory;
pub mod thread_obstacles;
pub mod thread_tied;
pub mod thread_told;
pub mod vital_signs;
pub mod xpbd;
mod xpbd_island;

use trocar_scene::{RegistryBuilder, RegistryError};

pub use bleeding::{BleedingController, Vessel, VesselState};
pub use cauterised::{CauterisedBody, ElectrodeTip};

pub use dynamic_fem::{DynamicFemBody, DynamicFemController};
pub use dynamic_fem_memory::{DynamicFemMemory, LentFactor, WantedFactor};
pub use electrosurgery::{ElectrosurgeryController, HeatState};
pub use fluid::{FluidController, Liquid, LiquidState, LiquidWall};

pub use heat::{Coagulated, CoagulatedElements, RemovedElements};
pub use instruments::{InstrumentsConfig, InstrumentsController};
pub use irrigation::{Irrigator, Sucker};
pub use knot_state::{KnotState, knot_code};
pub use linear_fem::{LinearFemBody, LinearFemController};
pub use linear_fem_pins::PinPlaces;
pub use mass_spring::MassSpringController;
pub use mass_spring_body::MassSpringBody;
pub use mass_spring_factor::{SpringFactor, WantedSheetFactor};
pub use membrane::SurfaceElements;

pub use parting::VolumeCuts;

pub use plume::Plume;

pub use smoke::{SmokeCloud, SmokeCloudState, SmokeController};

pub use suture::SutureController;
pub use suture_body::{SewnTissue, SutureMemory, SutureNeedle};
pub use thread::ThreadController;
pub use thread_body::{Laid, LiesOn, Suture, ThreadBody};
pub use thread_memory::ThreadMemory;
pub use thread_tied::{Mark, TiedBody};
pub use vital_signs::{Patient, PatientState, VitalSignsController};
pub use xpbd::{XpbdBody, XpbdController, XpbdGroups};

/// Registers the components of this crate, and of those that worlds of bodies share.
///
/// # Errors
/// When a name is already taken by another type.
pub fn register(builder: &mut RegistryBuilder) -> Result<(), RegistryError> {
    trocar_dynamics::register(builder)?;
    builder.register::<MassSpringBody>()?;
    builder.register::<SpringFactor>()?;
    builder.register::<cuts::Cuts>()?;
    builder.register::<DynamicFemBody>()?;
    builder.register::<XpbdBody>()?;
    builder.register::<XpbdGroups>()?;
    builder.register::<DynamicFemMemory>()?;
    builder.register::<LinearFemBody>()?;
    builder.register::<linear_fem_contacts::Contacts>()?;
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

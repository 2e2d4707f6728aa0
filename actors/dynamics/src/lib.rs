//! Shared dynamics of bodies: the trait for rigid-body worlds, instruments on virtual couplings, the common controller
//! of all soft-body methods, and co-simulation coupling between bodies. It contains no method that moves a body.
//!
//! | Concept | Module |
//! |---|---|
//! | rigid-body worlds with instruments, independent of the solver | [`rigid_world`] |
//! | the controller that schedules such a world | [`rigid_bodies`] |
//! | instruments on virtual couplings, and the grasp rule | [`instrument`] |
//! | the common controller of soft-body methods: rods, grasps, contacts, couplings | [`soft_body`] |
//! | co-simulation coupling: nodes of a slower body seen by a faster one | [`coupling`] |
//! | picking: the part of a surface that jaws hold | [`picking`] |
//! | tetrahedral meshes: defects, boundary, topology changes | [`tet_mesh`] |
//! | isotropic elasticity | [`elasticity`] |
//! | node state, and errors of a step | [`particles`], [`faulty`] |
#![forbid(unsafe_code)]

pub mod coupling;
pub mod elasticity;
pub mod faulty;
pub mod instrument;
pub mod particles;
pub mod picking;
pub mod rigid_bodies;
pub mod rigid_world;
pub mod soft_body;
pub mod tet_mesh;

use trocar_scene::{RegistryBuilder, RegistryError};

/// Registers the components of this crate.
///
/// # Errors
/// When a name is already taken by another type.
pub fn register(builder: &mut RegistryBuilder) -> Result<(), RegistryError> {
    builder.register::<instrument::mechanism::MechanismState>()?;
    soft_body::register(builder)?;
    builder.register::<instrument::deflection::InstrumentYields>()?;
    builder.register::<instrument::deflection::InstrumentDeflection>()?;
    Ok(())
}

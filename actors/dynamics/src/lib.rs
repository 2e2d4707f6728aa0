//! What several worlds of bodies share: what a world of rigid bodies has to do, how instruments follow hands, the frame of every
//! method of soft bodies, and what passes between bodies that touch or are coupled. It knows no method that moves a body.
//!
//! | Concept | Module |
//! |---|---|
//! | worlds of rigid bodies and instruments, whoever computes them | [`rigid_world`] |
//! | the controller that schedules any of them | [`rigid_bodies`] |
//! | how an instrument follows its hand, and when it holds something | [`instrument`] |
//! | the frame of every method of soft bodies: rods, grips, contacts, couplings | [`soft_body`] |
//! | nodes of slower bodies as faster ones meet them | [`coupling`] |
//! | what the jaws hold of a surface | [`picking`] |
//! | tetrahedral meshes: what is wrong with them, their boundary, how they come apart | [`tet_mesh`] |
//! | isotropic elasticity | [`elasticity`] |
//! | nodes that move, and what is wrong with them | [`particles`], [`faulty`] |
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
    soft_body::register(builder)
}

//! The controllers: each reads bodies from the scene, runs its method, and contributes contacts to the collision list,
//! which solvers read.
//!
//! Hardly any state must be restored: trees and hashes follow from the scene, and data cached between ticks affects
//! only the cost. The held impacts of [`ContinuousController`] and the proxies of [`FingerProxyController`] are written
//! into the scene.
//!
//! A body that vanishes or becomes invalid during a session (triangle corners that do not exist) has no contacts until
//! it is valid again; the events `surface_unusable` and `surface_usable` report this. Other bodies are processed as
//! usual. Only at the start of a session it is an error.

mod bodies;
mod combined_surface;
mod continuous;
mod dynamic_point;
mod finger_proxy;
mod obb_tree;
mod proximity;
mod report;
mod spherical_hash;
mod static_bodies;
mod station_touch;
mod tree_body;
mod z_buffer;

pub use continuous::{ContinuousConfig, ContinuousController, HeldImpact, HeldImpacts};
pub use dynamic_point::{DynamicPointConfig, DynamicPointController};
pub use finger_proxy::{FingerProxyConfig, FingerProxyController};
pub use obb_tree::{ObbTreeConfig, ObbTreeController};
pub use proximity::{ProximityConfig, ProximityController};
pub use spherical_hash::{SphericalHashConfig, SphericalHashController};
pub use station_touch::StationTouchController;
pub use z_buffer::{ZBufferConfig, ZBufferController};

/// Registers this crate's own components.
///
/// # Errors
/// When a name is already taken by another type.
pub fn register(builder: &mut trocar_scene::RegistryBuilder) -> Result<(), trocar_scene::RegistryError> {
    builder.register::<HeldImpacts>()?;
    Ok(())
}

//! The controllers: each reads bodies from the scene, asks its method, and contributes what it has found to the collision
//! list, where whoever responds finds it.
//!
//! Next to nothing has to be resumed: trees and hashes follow from the scene, and what a method remembers from one tick to
//! the next makes it faster, not another one. What [`ContinuousController`] holds and where [`FingerProxyController`] has its
//! proxies is written into the scene.
//!
//! A body that vanishes or cannot be used in mid-run (corners that there are none of) has no contacts until it is back; an
//! event `surface_unusable` tells so, `surface_usable` that it is back. Other bodies are looked at all the same. Only at
//! the start of a session is it an error.

mod bodies;
mod combined_surface;
mod continuous;
mod dynamic_point;
mod finger_proxy;
mod obb_tree;
mod proximity;
mod report;
mod spherical_hash;
mod tree_body;
mod z_buffer;

pub use continuous::{ContinuousConfig, ContinuousController, HeldImpact, HeldImpacts};
pub use dynamic_point::{DynamicPointConfig, DynamicPointController};
pub use finger_proxy::{FingerProxyConfig, FingerProxyController};
pub use obb_tree::{ObbTreeConfig, ObbTreeController};
pub use proximity::{ProximityConfig, ProximityController};
pub use spherical_hash::{SphericalHashConfig, SphericalHashController};
pub use z_buffer::{ZBufferConfig, ZBufferController};

/// Registers this crate's own components.
///
/// # Errors
/// When a name is already taken by another type.
pub fn register(builder: &mut trocar_scene::RegistryBuilder) -> Result<(), trocar_scene::RegistryError> {
    builder.register::<HeldImpacts>()?;
    Ok(())
}

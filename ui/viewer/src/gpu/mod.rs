//! The graphics device and its resources.

pub mod annotate;
pub mod composite;
pub mod device;
pub mod edits;
pub mod materials;
pub mod overlay;
pub(crate) mod particles;
pub mod passes;
pub mod shadow_maps;
pub mod surfaces;
pub mod targets;
pub(crate) mod uniforms;

pub use device::Gpu;

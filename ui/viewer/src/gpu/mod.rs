//! The graphics device and what lies on it.

pub mod composite;
pub mod device;
pub mod edits;
pub mod materials;
pub mod passes;
pub mod surfaces;
pub mod targets;

pub use device::Gpu;

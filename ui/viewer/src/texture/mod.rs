//! Textures: procedural ones by name, and image files.
//!
//! A procedural texture is a [`MapSet`]: colour, normals with height, and surface properties (roughness, wetness,
//! metalness, openness to ambient light), all of which tile without a seam. The same name and size give the same bytes
//! on every machine. A file is an [`Image8`], read by [`load()`] after [`resolve`] has checked that its path stays
//! below the scenario's folder.

mod error;
pub mod image8;
mod load;
pub mod noise;
mod procedural;
mod recipe;
mod relief;
mod technical;
mod textile;
mod tissue;
mod vessels;
mod viscera;

pub use error::TextureError;
pub use image8::{Image8, MapKind};
pub use load::{FILE_BYTES_MAX, load, resolve};
pub use procedural::{SIZE_MAX, SIZE_MIN, catalogue, procedural};
pub use recipe::MapSet;

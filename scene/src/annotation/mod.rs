//! Places on the surfaces of a scene, for what persons show one another: where a place is now, which place a ray hits,
//! and whether a place is still there.
//!
//! A [`SurfacePlace`](crate::SurfacePlace) is data. [`PlaceReader`] finds it in the world, [`nearest_place`] makes one
//! from a person's mouse, and [`SurfaceParts`] tells whether a surface still has it after a cut.

mod in_world;
mod ray;
mod surface_parts;

pub use in_world::{PlaceInWorld, PlaceReader, place_in_world};
pub use ray::{SurfaceHit, nearest_place};
pub use surface_parts::SurfaceParts;

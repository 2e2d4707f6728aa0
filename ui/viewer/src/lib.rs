//! Views of a scene.

pub mod colormap;
pub mod deform;
pub mod edit_map;
pub mod texture;
pub mod tube;

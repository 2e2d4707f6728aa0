//! Views of a scene.
//!
//! All of these tests run beside each other.

mod annotations;
mod head_tracked;
mod looks;
mod matter;
mod motion;
mod overlays;
mod pictures;
mod references;
mod support;
mod tiles;

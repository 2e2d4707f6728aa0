//! Views of a scene.

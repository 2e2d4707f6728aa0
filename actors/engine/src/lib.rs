//! Rapier as the physics-engine controller.

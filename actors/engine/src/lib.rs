//! Rapier as the physics-engine controller.

pub mod contacts;
pub mod controller;
pub mod conversion;
pub mod coupling;
pub mod error;
pub mod grasp;
pub mod grasper;
pub mod jaws;
pub mod local_model;
pub mod settings;
pub mod shapes;
pub mod target_track;
pub mod world;

pub use controller::EngineController;
pub use error::EngineError;
pub use grasper::{Grasper, GrasperState};
pub use settings::EngineSettings;
pub use world::{RigidWorld, WorldStatistics};

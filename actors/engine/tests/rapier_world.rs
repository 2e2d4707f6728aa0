//! Rapier's world: what any world of rigid bodies has to do.

#[path = "cases/mod.rs"]
mod cases;

use nalgebra::Vector3;
use trocar_engine::EngineSettings;
use trocar_engine::RigidWorld as W;
use trocar_engine::world::INSTRUMENTS_MAX as TOOLS_MAX;

/// Whether contacts that others have found are springs, which give way, or kept by impulses.
const GIVES_WAY: bool = true;

fn settings(gravity_in_world: Vector3<f64>, floor_height: Option<f64>) -> EngineSettings {
    EngineSettings { gravity_in_world, floor_height, ..EngineSettings::default() }
}

//! Rapier's world: what any world of rigid bodies has to do.

#[path = "cases/mod.rs"]
mod cases;

use nalgebra::Vector3;
use trocar_engine::EngineSettings;
use trocar_engine::RigidWorld as W;
use trocar_engine::world::INSTRUMENTS_MAX as TOOLS_MAX;

/// Whether contacts that others have found are springs, which give way, or kept by impulses.
const GIVES_WAY: bool = true;

/// How exact its joints are: [Validation](../../../docs/validation.md#joints).
const JOINT_BOUNDS: cases::joints::JointBounds = cases::joints::JointBounds {
    period: 6e-4,
    energy: 0.07,
    gap: 1e-6,
    gap_uneven: 2e-4,
    whip: 0.1,
    angle: 1e-5,
    force: 2e-5,
    chain: 1e-4,
    momentum: [1e-12, 2e-3],
    led: 0.0,
    restart: 1e-13,
};

fn settings(gravity_in_world: Vector3<f64>, floor_height: Option<f64>) -> EngineSettings {
    EngineSettings { gravity_in_world, floor_height, ..EngineSettings::default() }
}

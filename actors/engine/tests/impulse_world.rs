//! Our own world, by momenta and impulses: the same as Rapier's has to do.

#[path = "cases/mod.rs"]
mod cases;

use nalgebra::Vector3;
use trocar_simulator::impulse_world::RigidSettings;
pub(crate) use trocar_simulator::impulse_world::{ImpulseWorld as W, TOOLS_MAX};

/// Whether contacts that others have found are springs, which give way, or kept by impulses.
const GIVES_WAY: bool = false;

/// How exact its joints are: [Validation](../../../docs/validation.md#joints).
const JOINT_BOUNDS: cases::joints::JointBounds = cases::joints::JointBounds {
    period: 2e-5,
    energy: 1e-6,
    gap: 1e-12,
    gap_uneven: 1e-10,
    whip: 0.005,
    angle: 1e-12,
    force: 1e-12,
    chain: 1e-10,
    momentum: [1e-13, 1e-12],
    led: 5.0,
    restart: 1e-13,
};

fn settings(gravity_in_world: Vector3<f64>, floor_height: Option<f64>) -> RigidSettings {
    RigidSettings { gravity_in_world, floor_height, ..RigidSettings::default() }
}

//! Our own world, by momenta and impulses: the same as Rapier's has to do.

#[path = "cases/mod.rs"]
mod cases;

use nalgebra::Vector3;
use trocar_simulator::impulse_world::RigidSettings;
pub(crate) use trocar_simulator::impulse_world::{ImpulseWorld as W, TOOLS_MAX};

/// Whether contacts that others have found are springs, which give way, or kept by impulses.
const GIVES_WAY: bool = false;

fn settings(gravity_in_world: Vector3<f64>, floor_height: Option<f64>) -> RigidSettings {
    RigidSettings { gravity_in_world, floor_height, ..RigidSettings::default() }
}

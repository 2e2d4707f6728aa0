//! Irrigation and suction: tubes at instruments that add or remove liquid while they are switched on.

use nalgebra::{Isometry3, Point3, Vector3};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use trocar_scene::{Activation, Component, ComponentError, ControllerError, Entity, Snapshot};

use crate::fluid::{Emitter, Fluid, Hole};

/// An irrigator: a tube at an instrument, along its axis, that emits the scene's liquid while it is switched on.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Component)]
#[component(name = "irrigator", check = Self::ranges, schema)]
#[serde(default, deny_unknown_fields)]
pub struct Irrigator {
    /// Flow rate at full level \[m³/s\].
    pub rate: f64,
    /// Cross-sectional area of its opening \[m²\].
    pub area: f64,
}

impl Default for Irrigator {
    /// A litre in two minutes out of 5 mm.
    fn default() -> Self {
        Self { rate: 8e-6, area: 2e-5 }
    }
}

/// A sucker: a tube at an instrument that removes the scene's liquid near its tip while it is switched on.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Component)]
#[component(name = "sucker", check = Self::ranges, schema)]
#[serde(default, deny_unknown_fields)]
pub struct Sucker {
    /// Suction rate at full level \[m³/s\], if there is enough liquid.
    pub rate: f64,
    /// Reach from its tip \[m\].
    pub reach: f64,
}

impl Default for Sucker {
    /// Two litres in a minute.
    fn default() -> Self {
        Self { rate: 3.3e-5, reach: 0.008 }
    }
}

/// State of a sucker.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Suction {
    /// Number of particles removed.
    pub taken: u64,
    /// Suction volume not used yet \[m³\]; less than a particle where there is liquid.
    pub waiting: f64,
}

/// Rejects a tube that is both irrigator and sucker.
pub(crate) fn check(scene: &Snapshot) -> Result<(), ControllerError> {
    match scene.iter::<Irrigator>().find(|(entity, _)| scene.get::<Sucker>(*entity).is_some()) {
        Some((both, _)) => Err(ControllerError::Scene(format!(
            "'{}': it is an 'irrigator' and a 'sucker', and one switch says which: either is valid",
            scene.name(both)
        ))),
        None => Ok(()),
    }
}

fn level(scene: &Snapshot, entity: Entity) -> f64 {
    scene.get::<Activation>(entity).map_or(0.0, |activation| activation.level)
}

impl Irrigator {
    /// Emits liquid for `dt` seconds.
    pub(crate) fn emit(
        &self,
        (scene, entity): (&Snapshot, Entity),
        liquid_from_world: &Isometry3<f64>,
        dt: f64,
        emitter: &mut Emitter,
        fluid: &mut Fluid,
    ) {
        let liquid_from_tip = liquid_from_world * scene.world_pose(entity);
        let place = liquid_from_tip * Point3::origin();
        let hole = Hole { place, outwards: liquid_from_tip * Vector3::z(), area: self.area };
        let given = emitter.given + self.rate * level(scene, entity) * dt;
        emitter.emit(given, dt, &hole, fluid);
    }

    fn ranges(&self) -> Result<(), ComponentError> {
        ComponentError::range("rate", self.rate, 0.0..=1e-3, "0 to 1e-3 m³/s")?;
        ComponentError::range("area", self.area, 1e-8..=1e-2, "1e-8 to 1e-2 m²")
    }
}

impl Sucker {
    /// Removes liquid for `dt` seconds, nearest particles first.
    pub(crate) fn remove_within(
        &self,
        (scene, entity): (&Snapshot, Entity),
        liquid_from_world: &Isometry3<f64>,
        dt: f64,
        suction: &mut Suction,
        fluid: &mut Fluid,
    ) {
        let (particle, now) = (fluid.particle_volume(), self.rate * level(scene, entity) * dt);
        // Suction that lacked liquid is not made up for later.
        suction.waiting = if now > 0.0 { suction.waiting.min(particle) + now } else { 0.0 };
        let tip = liquid_from_world * scene.world_pose(entity) * Point3::origin();
        let taken = fluid.remove_within(&tip, self.reach, (suction.waiting / particle).floor() as u64);
        suction.taken += taken;
        suction.waiting -= taken as f64 * particle;
    }

    fn ranges(&self) -> Result<(), ComponentError> {
        ComponentError::range("rate", self.rate, 0.0..=1e-2, "0 to 1e-2 m³/s")?;
        ComponentError::range("reach", self.reach, 1e-4..=0.1, "1e-4 to 0.1 m")
    }
}

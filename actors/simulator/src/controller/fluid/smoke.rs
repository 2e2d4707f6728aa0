//! The controller of smoke: the plume of burning tissue rises, spreads and vanishes.

use std::collections::BTreeMap;
use std::sync::Arc;

use nalgebra::{Point3, Vector3};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use trocar_dynamics::soft_body::frozen::{FrozenPart, freeze};
use trocar_scene::readable::quantity;
use trocar_scene::{
    Access, BuildContext, Commands, Component, ComponentError, Controller, ControllerError, Entity,
    EntitySet, Frozen, Measured, Particles, Pose, RecordPolicy, Snapshot, Tick,
};

use crate::controller::electrosurgery::plume::Plume;
use crate::fluid::smoke::{Smoke, SmokeConfig, SmokeState};

/// Maximum smoke emission of a body per step \[kg\].
const PLUME_MAX: f64 = 1.0;
/// A position farther away is invalid \[m\].
const FAR: f64 = 1e3;

/// Smoke in a cavity; its puffs are the entity's particles, which define its appearance.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Component)]
#[component(name = "smoke", check = Self::ranges, schema)]
#[serde(default, deny_unknown_fields)]
pub struct SmokeCloud {
    /// Mass of smoke per puff \[kg\].
    pub puff: f64,
    /// Lifetime of a puff \[s\].
    pub lifetime: f64,
    /// Excess temperature over the gas at the tissue \[K\].
    pub warmth: f64,
    /// Velocity of the gas in the cavity, in world \[m/s\].
    #[schemars(with = "[f64; 3]")]
    pub wind: Vector3<f64>,
    /// Maximum number of puffs; beyond it the oldest are removed.
    pub puffs_max: u32,
}

impl Default for SmokeCloud {
    fn default() -> Self {
        let smoke = SmokeConfig::default();
        Self {
            puff: smoke.puff,
            lifetime: smoke.lifetime,
            warmth: smoke.warmth,
            wind: Vector3::zeros(),
            puffs_max: smoke.puffs_max as u32,
        }
    }
}

impl SmokeCloud {
    fn ranges(&self) -> Result<(), ComponentError> {
        ComponentError::range("puff", self.puff, 1e-15..=1.0, "1e-15 to 1 kg")?;
        ComponentError::range("lifetime", self.lifetime, 1e-3..=1e4, "0.001 to 10000 s")?;
        ComponentError::range("warmth", self.warmth, 0.0..=1e3, "0 to 1000 K")?;
        ComponentError::range("wind", self.wind.norm(), 0.0..=100.0, "0 to 100 m/s")?;
        ComponentError::range("puffs_max", f64::from(self.puffs_max), 1.0..=65_536.0, "1 to 65536")
    }
}

/// State for a restart.
#[derive(Clone, Debug, Serialize, Deserialize, Component)]
// Too large to be recorded; it is derived from recorded data.
#[component(name = "smoke_state", record = RecordPolicy::Derived)]
pub struct SmokeCloudState {
    /// The puffs, in the frame of the cloud.
    pub smoke: Arc<SmokeState>,
    /// Smoke taken over from each plume \[kg\].
    pub taken: Vec<(Entity, f64)>,
}

/// Simulates the smoke of the scene.
pub struct SmokeController {
    cloud: Entity,
    name: String,
    kind: SmokeCloud,
    look: Particles,
    smoke: Smoke,
    taken: BTreeMap<Entity, f64>,
    sources: Vec<(Point3<f64>, f64)>,
    frozen: bool,
}

impl SmokeController {
    /// Reads the cloud, and resumes its state from the scene.
    ///
    /// # Errors
    /// There is none, or more than one; the state does not match.
    pub fn new(gravity_in_world: Vector3<f64>, context: &BuildContext<'_>) -> Result<Self, ControllerError> {
        let mut clouds = context.scene.iter::<SmokeCloud>();
        let (Some((cloud, kind)), None) = (clouds.next(), clouds.next()) else {
            return Err(ControllerError::Scene("smoke: one entity has to be 'smoke'".into()));
        };
        let name = context.scene.name(cloud);
        let wrong = |what: String| ControllerError::Scene(format!("'{name}': {what}"));
        let cloud_from_world = context.scene.world_pose(cloud).inverse();
        let config = SmokeConfig {
            puff: kind.puff,
            lifetime: kind.lifetime,
            warmth: kind.warmth,
            up: cloud_from_world.rotation * -gravity_in_world,
            puffs_max: kind.puffs_max as usize,
            ..SmokeConfig::default()
        };
        let mut smoke = Smoke::new(config).map_err(|error| wrong(error.to_string()))?;
        let mut taken = BTreeMap::new();
        if let Some(known) = context.scene.get::<SmokeCloudState>(cloud) {
            smoke.restore(&known.smoke).map_err(|error| wrong(error.to_string()))?;
            taken.extend(known.taken.iter().copied());
        }
        let look = context.scene.get::<Particles>(cloud).cloned().unwrap_or_default();
        let frozen = context.scene.get::<Frozen>(cloud).is_some();
        Ok(Self { cloud, name: name.clone(), kind: *kind, look, smoke, taken, sources: Vec::new(), frozen })
    }
}

impl SmokeController {
    /// One step; if it fails, the smoke keeps its state.
    fn step(&mut self, tick: &Tick<'_>, scene: &Snapshot) -> Result<(), String> {
        let cloud_from_world = scene.world_pose(self.cloud).inverse();
        self.sources.clear();
        for (entity, plume) in scene.iter::<Plume>() {
            let taken = self.taken.get(&entity).copied().unwrap_or_default();
            if plume.emitted > taken {
                let place = cloud_from_world * (scene.world_pose(entity) * plume.place);
                let mass = plume.emitted - taken;
                if !(mass <= PLUME_MAX && place.iter().all(|x| x.abs() <= FAR)) {
                    return Err(format!(
                        "'{}' gives off {} at {:.3?} m in one step; at most {PLUME_MAX} kg within {FAR} m can be",
                        scene.name(entity),
                        quantity(mass, "kg"),
                        <[f64; 3]>::from(place)
                    ));
                }
                self.sources.push((place, mass));
            }
        }
        let wind = cloud_from_world.rotation * self.kind.wind;
        self.smoke
            .step(tick.period.as_secs_f64(), &self.sources, &wind)
            .map_err(|error| error.to_string())?;
        for (entity, plume) in scene.iter::<Plume>() {
            let taken = self.taken.entry(entity).or_default();
            *taken = taken.max(plume.emitted);
        }
        Ok(())
    }

    fn show(&mut self, tick: &Tick<'_>, out: &mut Commands) {
        let state = self.smoke.state();
        let is_gone = state.positions.is_empty() && self.look.positions.is_empty();
        if !is_gone || tick.number == 1 {
            self.look.first = state.first;
            self.look.positions = Arc::new(state.positions.clone());
            self.look.ages = Arc::new(state.ages.clone());
            out.put(self.cloud, self.look.clone());
            let taken = self.taken.iter().map(|(entity, mass)| (*entity, *mass)).collect();
            out.put(self.cloud, SmokeCloudState { smoke: Arc::new(state.clone()), taken });
        }
    }
}

impl Controller for SmokeController {
    fn access(&self) -> Access {
        let cloud = || EntitySet::Of(vec![self.cloud]);
        Access::new()
            .reads::<SmokeCloud>()
            .reads::<Plume>()
            .reads::<Pose>()
            .reads::<Frozen>()
            .writes::<Frozen>(cloud())
            .writes::<Particles>(cloud())
            .writes::<SmokeCloudState>(cloud())
            .writes::<Measured>(EntitySet::Own)
    }

    fn tick(&mut self, tick: &Tick<'_>, scene: &Snapshot, out: &mut Commands) -> Result<(), ControllerError> {
        if !self.frozen {
            match self.step(tick, scene) {
                Ok(()) => self.show(tick, out),
                Err(reason) => {
                    self.frozen = true;
                    freeze(self.cloud, FrozenPart::Body, reason, tick, out);
                }
            }
        }
        let state = self.smoke.state();
        let values = [
            ("puffs", state.positions.len() as f64),
            ("emitted_kg", state.emitted),
            ("frozen", f64::from(u8::from(self.frozen))),
            ("highest_m", state.positions.iter().map(|place| place.z).fold(f64::MIN, f64::max).max(-1e3)),
        ];
        let values =
            values.into_iter().map(|(what, value)| (format!("{}.{what}", self.name), value)).collect();
        out.put(tick.me, Measured { values });
        Ok(())
    }
}

//! Particles: smoke, and fluids such as blood and irrigation fluid.

use std::sync::Arc;

use nalgebra::Point3;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::{Component, ComponentError, RecordPolicy};

/// Particles that one entity can have.
pub const PARTICLES_MAX: usize = 65_536;

/// Kind of matter of particles.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum ParticleKind {
    /// Puffs without an edge that thin out as they spread.
    #[default]
    Smoke,
    /// Drops that flow together into one surface.
    Fluid,
}

/// Particles in the entity's frame.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Component)]
#[component(name = "particles", record = RecordPolicy::sampled(20.0, 0.0001), check = Self::validate, schema)]
#[serde(default, deny_unknown_fields)]
pub struct Particles {
    /// Kind of matter.
    pub kind: ParticleKind,
    /// Their centres \[m\]; at most 65,536.
    #[schemars(with = "Vec<[f64; 3]>")]
    pub positions: Arc<Vec<Point3<f64>>>,
    /// Number of the first one; the others are numbered consecutively. It grows when old particles are removed from the
    /// front, so that a viewer can identify and interpolate particles.
    pub first: u64,
    /// Radius of each \[m\]. A drop's radius overlaps its neighbours, so that they form one surface; a puff's radius
    /// holds nearly all matter of a fresh puff.
    pub radius: f64,
    /// Albedo of thick matter, linear RGB in \[0, 1\].
    pub color: [f64; 3],
    /// Extinction coefficient at the highest density \[1/m\].
    pub extinction: f64,
    /// Density of each in \[0, 1\]; 1 if the list is shorter. Less than 1 for a diluted drop or a settling puff.
    pub densities: Arc<Vec<f64>>,
    /// Age of each puff of smoke \[s\]; 0 if the list is shorter.
    pub ages: Arc<Vec<f64>>,
    /// Spread rate of smoke \[1/s\]: growth of a puff's squared radius, relative to its initial squared radius.
    pub spread: f64,
}

impl Default for Particles {
    fn default() -> Self {
        Self {
            kind: ParticleKind::Smoke,
            positions: Arc::default(),
            first: 0,
            radius: 0.005,
            color: [0.8; 3],
            extinction: 40.0,
            densities: Arc::default(),
            ages: Arc::default(),
            spread: 0.0,
        }
    }
}

impl Particles {
    /// Index of the particle with this number; `None` if it has been removed or does not exist yet.
    pub fn index_of(&self, number: u64) -> Option<usize> {
        let index = usize::try_from(number.checked_sub(self.first)?).ok()?;
        (index < self.positions.len()).then_some(index)
    }

    /// Radius \[m\] and extinction coefficient at the highest density \[1/m\] of a particle. A puff keeps its mass
    /// while its positional variance grows with time (Roberts, "The theoretical scattering of smoke in a turbulent
    /// atmosphere", 1923).
    pub fn particle(&self, index: usize) -> (f64, f64) {
        let density = self.densities.get(index).copied().unwrap_or(1.0);
        let age = self.ages.get(index).copied().unwrap_or(0.0);
        let wider = (1.0 + self.spread * age).sqrt();
        (self.radius * wider, self.extinction * density / wider.powi(3))
    }

    fn validate(&self) -> Result<(), ComponentError> {
        let count = self.positions.len();
        let room = PARTICLES_MAX as f64;
        ComponentError::range("positions (their number)", count as f64, ..=room, "at most 65536")?;
        for position in self.positions.iter() {
            let far = position.coords.amax();
            ComponentError::range("positions", far, ..=1e3, "within 1000 m of the entity")?;
        }
        let first = self.first as f64;
        ComponentError::range("first", first, ..=9e15, "at most 9,000,000,000,000,000")?;
        ComponentError::range("radius", self.radius, 1e-5..=0.1, "0.00001 to 0.1 m")?;
        let share = |field, value: f64| ComponentError::range(field, value, 0.0..=1.0, "0 to 1");
        self.color.iter().try_for_each(|part| share("color", *part))?;
        ComponentError::range("extinction", self.extinction, 0.0..=1e6, "0 to 1000000 1/m")?;
        ComponentError::range("spread", self.spread, 0.0..=1e3, "0 to 1000 1/s")?;
        for (name, values) in [("densities", &self.densities), ("ages", &self.ages)] {
            if !values.is_empty() && values.len() != count {
                let of = values.len();
                let message = format!("{name}: {of} values for {count} particles; one for each, or none");
                return Err(ComponentError::Malformed(message));
            }
        }
        self.densities.iter().try_for_each(|density| share("densities", *density))?;
        let age = |age: &f64| ComponentError::range("ages", *age, 0.0..=1e6, "0 to 1000000 s");
        self.ages.iter().try_for_each(age)?;
        if self.kind == ParticleKind::Fluid && !self.ages.is_empty() {
            return Err(ComponentError::Malformed("ages: only smoke grows old, this is a fluid".into()));
        }
        Ok(())
    }
}

//! Controllers that misbehave, to test that the others are unaffected.

use serde::{Deserialize, Serialize};
use trocar_scene::{
    Access, Commands, Component, Controller, ControllerError, Entity, EntitySet, Snapshot, Tick,
};

/// The component that hostile controllers write on their own entities.
#[derive(Clone, Copy, Debug, Serialize, Deserialize, Component)]
#[component(name = "nuisance")]
pub struct Nuisance(pub f64);

fn access() -> Access {
    Access::new().writes::<Nuisance>(EntitySet::Own).spawns()
}

/// Returns an error on every tick.
pub struct AlwaysFails;
impl Controller for AlwaysFails {
    fn access(&self) -> Access {
        access()
    }
    fn tick(&mut self, _: &Tick<'_>, _: &Snapshot, _: &mut Commands) -> Result<(), ControllerError> {
        Err(ControllerError::Failed("it never works".to_owned()))
    }
}

/// Writes NaN on every tick.
pub struct WritesNan;
impl Controller for WritesNan {
    fn access(&self) -> Access {
        access()
    }
    fn tick(&mut self, tick: &Tick<'_>, _: &Snapshot, out: &mut Commands) -> Result<(), ControllerError> {
        out.put(tick.me, Nuisance(f64::NAN));
        Ok(())
    }
}

/// Spawns this many entities per tick and despawns those of the previous tick.
pub struct Floods {
    per_tick: usize,
    last: Vec<Entity>,
}

impl Floods {
    /// `per_tick` spawns and as many despawns on each tick.
    pub fn new(per_tick: usize) -> Self {
        Self { per_tick, last: Vec::new() }
    }
}

impl Controller for Floods {
    fn access(&self) -> Access {
        access()
    }
    fn tick(&mut self, _: &Tick<'_>, _: &Snapshot, out: &mut Commands) -> Result<(), ControllerError> {
        for entity in self.last.drain(..) {
            out.despawn(entity);
        }
        for _ in 0..self.per_tick {
            let entity = out.spawn();
            out.put(entity, Nuisance(1.0));
            self.last.push(entity);
        }
        Ok(())
    }
}

/// Its first instance never returns from its hundredth tick; later instances behave.
pub struct NeverReturns;
impl Controller for NeverReturns {
    fn access(&self) -> Access {
        access()
    }
    fn tick(&mut self, tick: &Tick<'_>, _: &Snapshot, _: &mut Commands) -> Result<(), ControllerError> {
        if tick.epoch == 1 && tick.number >= 100 {
            loop {
                std::hint::spin_loop();
            }
        }
        Ok(())
    }
}

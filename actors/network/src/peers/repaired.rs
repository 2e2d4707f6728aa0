//! Built anew: a simulator of a peer whose bodies their owner has replaced.

use std::sync::Arc;

use trocar_kernel::spec::Factory;
use trocar_scene::{
    Access, BuildContext, Commands, Controller, ControllerError, Entity, Repaired, Revision, SimTime,
    Snapshot, Tick,
};

/// Builds a controller, and builds it anew from the scene whenever one of its bodies was [`Repaired`]: as after a failure, but
/// without one, since all that it needs is in the scene.
pub fn rebuilding(factory: Factory) -> Factory {
    Arc::new(move |context: &BuildContext<'_>| {
        let (controller, factory) = (factory(context)?, factory.clone());
        let access = controller.access();
        let (name, seed) = (context.name.to_owned(), context.seed);
        let seen = context.scene.revision();
        Ok(Box::new(Rebuilding { controller, factory, access, name, seed, seen }) as Box<dyn Controller>)
    })
}

struct Rebuilding {
    controller: Box<dyn Controller>,
    factory: Factory,
    access: Access,
    name: String,
    seed: u64,
    /// Repairs up to here are in what it was built from.
    seen: Revision,
}

impl Rebuilding {
    /// Whether it writes rows of this body.
    fn writes(&self, entity: Entity) -> bool {
        self.access.writes.iter().any(|(_, on)| match on {
            trocar_scene::EntitySet::All => true,
            trocar_scene::EntitySet::Own => false,
            trocar_scene::EntitySet::Of(entities) => entities.contains(&entity),
        })
    }

    fn build_anew(&mut self, tick: &Tick<'_>, scene: &Snapshot) -> Result<(), ControllerError> {
        let context = BuildContext {
            scene,
            // What it is built from belongs to the end of the step before.
            time: SimTime(tick.time.as_nanos().saturating_sub(tick.period.as_nanos())),
            period: tick.period,
            name: &self.name,
            me: tick.me,
            epoch: tick.epoch,
            seed: self.seed,
        };
        self.controller = (self.factory)(&context)?;
        Ok(())
    }
}

impl Controller for Rebuilding {
    fn access(&self) -> Access {
        self.access.clone().reads::<Repaired>()
    }

    fn tick(&mut self, tick: &Tick<'_>, scene: &Snapshot, out: &mut Commands) -> Result<(), ControllerError> {
        let is_repaired = scene.iter_changed::<Repaired>(self.seen).any(|(entity, _)| self.writes(entity));
        self.seen = scene.revision();
        if is_repaired {
            self.build_anew(tick, scene)?;
        }
        self.controller.tick(tick, scene, out)
    }
}

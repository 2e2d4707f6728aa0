//! Watches which bodies stand still because their solver could not go on, in all or in their heat.

use std::collections::BTreeSet;

use trocar_scene::{Entity, Frozen, HeatFrozen, SimTime, Snapshot};

use crate::summary::{FrozenBody, FrozenPart};

/// Most bodies that are told one by one; further ones are counted.
pub const TOLD_MAX: usize = 64;

/// Watches the bodies of a session.
#[derive(Clone, Debug, Default)]
pub struct FrozenWatch {
    told: Vec<FrozenBody>,
    known: BTreeSet<(Entity, FrozenPart)>,
}

impl FrozenWatch {
    /// Looks at the scene.
    pub fn look(&mut self, scene: &Snapshot) {
        for (body, of) in scene.iter::<Frozen>() {
            self.find(scene, (body, FrozenPart::Body), of.since, &of.reason);
        }
        for (body, of) in scene.iter::<HeatFrozen>() {
            self.find(scene, (body, FrozenPart::Heat), of.since, &of.reason);
        }
    }

    fn find(&mut self, scene: &Snapshot, (body, part): (Entity, FrozenPart), since: SimTime, reason: &str) {
        if self.known.insert((body, part)) && self.told.len() < TOLD_MAX {
            self.told.push(FrozenBody {
                name: scene.name(body),
                part,
                at_secs: since.as_secs_f64(),
                at_in_world: scene.world_pose(body).translation.vector.into(),
                reason: reason.to_owned(),
            });
        }
    }

    /// The bodies, in the order in which they were found, and the number of all. A body whose heat stands still as well
    /// is one body, and is told twice.
    pub fn found(self) -> (Vec<FrozenBody>, u64) {
        let bodies: BTreeSet<Entity> = self.known.iter().map(|(body, _)| *body).collect();
        (self.told, bodies.len() as u64)
    }
}

#[cfg(test)]
mod tests {
    use trocar_scene::{Commands, EntityAllocator, Name, RegistryBuilder, Store};

    use super::*;

    #[test]
    fn a_frozen_body_is_told_once_with_its_reason_and_counted_once_for_both_its_parts() {
        let mut builder = RegistryBuilder::new();
        trocar_scene::components::register(&mut builder).expect("distinct names");
        let mut store = Store::new(builder.build());
        let mut out = Commands::new(store.view().registry().clone(), EntityAllocator::new(0, 0));
        let bodies: Vec<Entity> = (0..TOLD_MAX + 6).map(|_| out.spawn()).collect();
        for (index, body) in bodies.iter().enumerate() {
            out.put(*body, Name(format!("pad-{index}")));
        }
        let mut watch = FrozenWatch::default();
        let mut stop = |store: &mut Store, body: Entity, part: FrozenPart| {
            let (reason, since) = ("it burst".to_owned(), SimTime::from_millis(1_250));
            match part {
                FrozenPart::Body => out.put(body, Frozen { reason, since }),
                FrozenPart::Heat => out.put(body, HeatFrozen { reason, since }),
            }
            out.seal();
            store.apply(&mut out, SimTime::ZERO);
            watch.look(store.view());
            watch.look(store.view());
        };
        stop(&mut store, bodies[3], FrozenPart::Body);
        stop(&mut store, bodies[3], FrozenPart::Heat);
        bodies[4..].iter().for_each(|body| stop(&mut store, *body, FrozenPart::Body));
        let (told, count) = watch.found();
        assert_eq!(told[0].to_string(), "pad-3 stands still since 1.25 s: it burst");
        assert_eq!(told[1].to_string(), "the heat of pad-3 stands still since 1.25 s: it burst");
        assert_eq!(told[2].name, "pad-4");
        assert_eq!((told.len(), count), (TOLD_MAX, bodies.len() as u64 - 3));
    }
}

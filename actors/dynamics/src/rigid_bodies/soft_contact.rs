//! Rigid side of contacts with soft bodies ([`crate::soft_body::contact::rigid`]): publishes inertia and applies the
//! soft bodies' impulses.

use trocar_scene::commands::Commands;
use trocar_scene::components::Motion;
use trocar_scene::entity::Entity;
use trocar_scene::kinematics::spatial::Wrench;
use trocar_scene::snapshot::Snapshot;
use trocar_scene::time::SimTime;

use super::RigidBodiesController;
use crate::rigid_world::{World, WorldError};
use crate::soft_body::bearing::bears;
use crate::soft_body::contact::RigidContacts;
use crate::soft_body::contact::rigid::motion;

impl<W: World> RigidBodiesController<W> {
    /// Publishes the bodies' inertia for steps of this length \[s\]. Once it is published, soft bodies answer the
    /// contacts.
    pub(crate) fn publish_inertia(&mut self, scene: &Snapshot, period_secs: f64) {
        if !self.meets_soft_bodies || period_secs <= 0.0 {
            return;
        }
        let is_any_soft = scene.has_soft_body_that(|of| of.bears);
        for (entity, known) in &mut self.bodies {
            if known.contacts.is_none() && !is_any_soft {
                continue;
            }
            let may_tell = self.declared.as_ref().is_none_or(|rows| rows.binary_search(entity).is_ok());
            let gives_way = may_tell && !known.frozen && known.body.motion == Motion::Dynamic;
            let inertia = gives_way.then(|| self.world.inertia(*entity)).flatten();
            if known.contacts.is_none() && inertia.is_none() {
                continue;
            }
            let (told, inertia) =
                (known.contacts.get_or_insert_with(Default::default), inertia.unwrap_or_default());
            let steps = (period_secs, self.step_secs);
            if told.inertia == inertia && (told.step, told.substep) == steps {
                continue;
            }
            let before = told.gives_way();
            (told.inertia, (told.step, told.substep)) = (inertia, steps);
            known.is_told = false;
            if told.gives_way() != before {
                // The soft bodies answer these contacts now.
                self.lists.clear();
            }
        }
    }

    /// Whether the soft body of this pair answers the contact for both.
    pub(crate) fn is_answered_for(&self, scene: &Snapshot, one: Entity, other: Entity) -> bool {
        let contacts = self.bodies.get(&one).and_then(|known| known.contacts.as_ref());
        contacts.is_some_and(RigidContacts::gives_way) && bears(scene, other)
    }

    /// Applies the soft bodies' impulses over the steps of the next `secs` seconds.
    ///
    /// # Errors
    /// A non-finite impulse.
    pub(crate) fn apply_soft_impulses(&mut self, scene: &Snapshot, secs: f64) -> Result<(), WorldError> {
        for (entity, known) in &mut self.bodies {
            let Some(told) = known.contacts.as_mut().filter(|told| told.gives_way()) else { continue };
            known.before =
                self.world.velocity(*entity).zip(self.world.pose(*entity)).map(|(velocity, pose)| {
                    (motion(&told.inertia, &pose.isometry(), &velocity), Wrench::default(), pose)
                });
            let Some(push) = told.take(*entity, scene, secs) else { continue };
            known.is_told = false;
            if push != Wrench::default() {
                self.world.push(*entity, &push)?;
                if let Some((_, pushed, _)) = &mut known.before {
                    *pushed = push;
                }
                self.pushed.push(*entity);
            }
        }
        Ok(())
    }

    /// Ends the soft bodies' push after `secs` seconds, and estimates the acceleration by everything else.
    ///
    /// # Errors
    /// A body that was removed.
    pub(crate) fn clear_soft_impulses(&mut self, secs: f64) -> Result<(), WorldError> {
        for (entity, known) in &mut self.bodies {
            let (Some(told), Some((before, push, pose))) = (&mut known.contacts, known.before.take()) else {
                continue;
            };
            let Some((velocity, now)) = self.world.velocity(*entity).zip(self.world.pose(*entity)) else {
                continue;
            };
            let after = motion(&told.inertia, &now.isometry(), &velocity);
            let by_push = told.inertia.change(&pose.isometry(), [push.force, push.torque]);
            let pull = [0, 1].map(|side| (after[side] - before[side]) / secs - by_push[side]);
            known.is_told &= !told.update_acceleration(pull);
        }
        self.pushed.drain(..).try_for_each(|entity| self.world.push(entity, &Wrench::default()))
    }

    /// Writes changed contact states for the soft bodies.
    pub(crate) fn write_given(&mut self, now: SimTime, out: &mut Commands) {
        for (entity, known) in &mut self.bodies {
            if let Some(contacts) = known.contacts.as_mut().filter(|_| !known.is_told) {
                contacts.time = now;
                out.put(*entity, contacts.clone());
                known.is_told = true;
            }
        }
    }
}

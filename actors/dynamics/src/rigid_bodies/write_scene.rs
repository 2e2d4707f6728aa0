//! Writes the results of a tick to the scene: poses, forces on hands, contacts, grasps.

use trocar_scene::commands::Commands;
use trocar_scene::components::{
    Collision, CollisionList, Detection, Frozen, Grasp, InstrumentForce, JawState, Motion, Parent, Pose,
    Velocity,
};
use trocar_scene::controller::Tick;
use trocar_scene::entity::Entity;
use trocar_scene::snapshot::Snapshot;
use trocar_scene::time::SimTime;

use super::external_contact_model::is_modelled;
use super::{COLLISIONS_MAX, RigidBodiesController, WRITES_IN_FLIGHT};
use crate::instrument::contact::Contact;
use crate::instrument::local_model::local_contact_model;
use crate::instrument::mechanism::MechanismState;
use crate::rigid_world::{FLOOR, World};

impl<W: World> RigidBodiesController<W> {
    pub(super) fn write_frozen(&mut self, scene: &Snapshot, tick: &Tick<'_>, out: &mut Commands) {
        for (entity, reason) in std::mem::take(&mut self.newly_frozen) {
            if self.declared.as_ref().is_none_or(|rows| rows.binary_search(&entity).is_ok())
                && let Some(pose) = self.world.pose(entity)
            {
                out.put(entity, in_parent(scene, entity, pose));
                out.put(entity, Velocity::default());
            }
            if self.may_be_told_frozen.binary_search(&entity).is_ok() {
                out.put(entity, Frozen { reason, since: tick.time });
            }
            out.event("frozen", entity, None, tick.time.as_secs_f64());
        }
    }

    pub(super) fn write_bodies(&mut self, scene: &Snapshot, out: &mut Commands) {
        for (entity, known) in &mut self.bodies {
            let undeclared = self.declared.as_ref().is_some_and(|rows| rows.binary_search(entity).is_err());
            if known.body.motion != Motion::Dynamic || undeclared || known.frozen {
                continue;
            }
            // A sleeping body does not move: its last pose, with zero velocity, is written once.
            let sleeps = self.world.is_sleeping(*entity);
            if sleeps && known.slept {
                continue;
            }
            known.slept = sleeps;
            let (Some(pose), Some(velocity)) = (self.world.pose(*entity), self.world.velocity(*entity))
            else {
                continue;
            };
            let pose = in_parent(scene, *entity, pose);
            known.written[known.next_slot] = Some(pose);
            known.next_slot = (known.next_slot + 1) % WRITES_IN_FLIGHT;
            out.put(*entity, pose);
            out.put(*entity, if sleeps { Velocity::default() } else { velocity });
        }
    }

    pub(super) fn write_instruments(&mut self, scene: &Snapshot, tick: &Tick<'_>, out: &mut Commands) {
        let (now, period_secs) = (tick.time, tick.period.as_secs_f64());
        let entities: Vec<Entity> = self.instruments.keys().copied().collect();
        // Contacts borrow the world; they are few.
        let contacts: Vec<Contact> = self.world.contacts().to_vec();
        let keeps_mechanism = scene.registry().id::<MechanismState>().is_some();
        for entity in entities {
            if self.declared.as_ref().is_some_and(|rows| rows.binary_search(&entity).is_err()) {
                continue;
            }
            let (Some(tool), Some(wrench)) =
                (self.world.tool(entity), self.world.take_wrench_on_hand(entity))
            else {
                continue;
            };
            let state = tool.state;
            let is_modelled = is_modelled(&self.access, entity);
            // One tick to get there, half a tick until haptics receive it.
            let obstacle = self.world.obstacle(entity, 1.5 * period_secs);
            out.put(entity, in_parent(scene, entity, state.tip_in_world.into()));
            out.put(entity, state.velocity);
            out.put(
                entity,
                JawState { angle: state.opening.angle, rate: state.opening.rate, pad_force: tool.pad_force },
            );
            if keeps_mechanism {
                out.put(
                    entity,
                    MechanismState {
                        tilt: state.opening.tilt,
                        tilt_rate: state.opening.tilt_rate,
                        drive_reference: state.drive_reference,
                        previous_target: tool.track.previous().copied(),
                        newest_target: tool.track.newest().copied(),
                    },
                );
            }
            out.put(entity, InstrumentForce { force: wrench.force, torque: wrench.torque, at: now });
            if is_modelled {
                out.put(
                    entity,
                    local_contact_model(entity, &tool.coupling, &state, &contacts, obstacle, now),
                );
            }
            let Some(known) = self.instruments.get_mut(&entity) else { continue };
            let since = known.grasp.filter(|grasp| tool.hold.is_some_and(|hold| hold.held == grasp.held));
            let grasp = tool.hold.map(|hold| Grasp {
                held: hold.held,
                anchor: hold.anchor.into(),
                since: since.map_or(now, |grasp| grasp.since),
                assisted: hold.assisted,
            });
            if grasp != known.grasp {
                match grasp {
                    Some(grasp) => out.put(entity, grasp),
                    None => out.remove::<Grasp>(entity),
                }
                known.grasp = grasp;
            }
        }
        self.write_collisions(&contacts, now, out);
    }

    fn write_collisions(&mut self, contacts: &[Contact], now: SimTime, out: &mut Commands) {
        let method = self.method;
        let mut collisions: Vec<Collision> = contacts
            .iter()
            .filter(|contact| contact.a.0 != FLOOR && contact.b.0 != FLOOR)
            .map(|contact| collision_of(contact, method, now))
            .collect();
        if collisions.len() > COLLISIONS_MAX {
            collisions.sort_by(|a, b| b.depth.total_cmp(&a.depth));
            collisions.truncate(COLLISIONS_MAX);
        }
        // An empty list need not follow an empty list.
        if collisions.is_empty() && self.collisions_were_empty {
            return;
        }
        self.collisions_were_empty = collisions.is_empty();
        let penetration_max = self.world.penetration_max();
        out.contribute(CollisionList { collisions, penetration_max });
    }
}

/// A world pose as the entity's row stores it: relative to its parent, if it has one.
fn in_parent(scene: &Snapshot, entity: Entity, world_from_entity: Pose) -> Pose {
    match scene.get::<Parent>(entity) {
        Some(parent) => (scene.world_pose(parent.0).inverse() * world_from_entity.isometry()).into(),
        None => world_from_entity,
    }
}

fn collision_of(contact: &Contact, method: Detection, detected_at: SimTime) -> Collision {
    let overlap = contact.normal_in_world * (0.5 * contact.depth);
    Collision {
        a: contact.a.0,
        primitive_a: contact.a.1,
        b: contact.b.0,
        primitive_b: contact.b.1,
        points_in_world: [contact.point_in_world + overlap, contact.point_in_world - overlap],
        normal_in_world: contact.normal_in_world,
        depth: contact.depth,
        force_in_world: contact.force_on_b_in_world(),
        velocity_constraint: 0.0,
        method,
        detected_at,
    }
}

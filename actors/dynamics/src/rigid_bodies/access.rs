//! Declared reads and writes of the rigid-body controller.

use trocar_scene::access::{Access, EntitySet};
use trocar_scene::components::{
    CollisionList, Frozen, Grasp, Instrument, InstrumentForce, InstrumentTarget, JawState, JointFrames,
    JointState, Joints, LocalContactModel, Motion, Parent, Pose, RigidBody, Shape, SurfaceMesh, Velocity,
    VertexPositions,
};
use trocar_scene::entity::Entity;
use trocar_scene::snapshot::Snapshot;

use crate::instrument::mechanism::MechanismState;
use crate::rigid_world::Scheduling;
use crate::soft_body::contact::{RigidContacts, SoftContacts};

/// The bodies that the world moves: those that are dynamic now, and the instruments. Declaring them leaves the poses of
/// all other entities to other controllers.
pub(crate) fn moved_entities(scene: &Snapshot) -> Vec<Entity> {
    let mut moved: Vec<Entity> = scene
        .iter::<RigidBody>()
        .filter(|(_, body)| body.motion == Motion::Dynamic)
        .map(|(entity, _)| entity)
        .chain(scene.iter::<Instrument>().map(|(entity, _)| entity))
        .collect();
    moved.sort_unstable();
    moved.dedup();
    moved
}

/// Rows that the controller may write; `None` for all.
pub(crate) fn declared_rows(scene: &Snapshot, scheduling: &Scheduling) -> Option<Vec<Entity>> {
    (!scheduling.claims_all_poses).then(|| moved_entities(scene))
}

/// Whether the session registers soft bodies that answer contacts.
pub(crate) fn meets_soft_bodies(scene: &Snapshot) -> bool {
    scene.registry().id::<RigidContacts>().is_some()
}

pub(crate) fn declared_access(
    scene: &Snapshot,
    scheduling: &Scheduling,
    modelled_by_others: &[Entity],
) -> Access {
    let on = |entities| if scheduling.claims_all_poses { EntitySet::All } else { EntitySet::Of(entities) };
    let moved = moved_entities(scene);
    let instruments: Vec<Entity> = scene.iter::<Instrument>().map(|(entity, _)| entity).collect();
    let mut modelled = instruments.clone();
    modelled.retain(|entity| modelled_by_others.binary_search(entity).is_err());
    // If others model some, its own are those present at the start.
    let modelled = if modelled_by_others.is_empty() { on(modelled) } else { EntitySet::Of(modelled) };
    let access = Access::new()
        .reads::<RigidBody>()
        .reads::<Shape>()
        .reads::<SurfaceMesh>()
        .reads::<VertexPositions>()
        .reads::<CollisionList>()
        .reads::<Parent>()
        .reads::<Pose>()
        .reads::<Velocity>()
        .reads::<Instrument>()
        .reads::<InstrumentTarget>()
        .reads::<JawState>()
        .reads::<Grasp>()
        .reads::<Frozen>()
        .writes::<Frozen>(EntitySet::Of(moved.clone()))
        .writes::<Pose>(on(moved.clone()))
        .writes::<Velocity>(on(moved.clone()))
        .writes::<JawState>(on(instruments.clone()))
        .writes::<InstrumentForce>(on(instruments.clone()))
        .writes::<LocalContactModel>(modelled)
        .writes::<Grasp>(on(instruments.clone()))
        .contributes::<CollisionList>();
    let jointed: Vec<Entity> = scene.iter::<Joints>().map(|(entity, _)| entity).collect();
    let access = access
        .reads::<Joints>()
        .reads::<JointFrames>()
        .writes::<JointFrames>(on(jointed.clone()))
        .writes::<JointState>(on(jointed));
    let access = if modelled_by_others.is_empty() { access } else { access.reads::<LocalContactModel>() };
    let access = match meets_soft_bodies(scene) {
        true => access
            .reads::<SoftContacts>()
            .reads_named(scene.registry().soft_bodies_that(|of| of.bears))
            .reads::<RigidContacts>()
            .writes::<RigidContacts>(on(moved)),
        false => access,
    };
    if scene.registry().id::<MechanismState>().is_some() {
        access.reads::<MechanismState>().writes::<MechanismState>(on(instruments))
    } else {
        access
    }
}

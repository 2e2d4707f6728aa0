//! Joints between soft bodies and rigid ones that move: a rope tied to a weight, an organ grown onto a bone.
//!
//! A joint is a spring in three directions, in each of them a pair of opposite planes of one contact stiffness. So every
//! method that bears rigid bodies carries joints too.

use nalgebra::Vector3;
use trocar_scene::{Entity, Motion, RigidBody, Snapshot};

use super::rigid_surface::RigidSurface;
use crate::soft_body::Deformable;
use crate::soft_body::contact::RigidJoint;
use crate::soft_body::coupling::CoupledBody;
use crate::soft_body::coupling::components::{JOINED_MAX, Joined};

/// The rigid body that a coupling names; `None` for another kind of body.
fn rigid(scene: &Snapshot, name: &str) -> Option<(Entity, Motion)> {
    let entity = scene.find(name)?;
    Some((entity, scene.get::<RigidBody>(entity)?.motion))
}

/// Whether a body is coupled, and with rigid bodies only.
pub(crate) fn is_with_rigid_only(scene: &Snapshot, coupled: &CoupledBody) -> bool {
    coupled.with.iter().all(|with| rigid(scene, &with.body).is_some())
}

/// Whether the name is that of a rigid body.
#[must_use]
pub fn is_rigid(scene: &Snapshot, name: &str) -> bool {
    rigid(scene, name).is_some()
}

/// The joints of a body with the rigid bodies that it is coupled with, both at rest.
///
/// # Errors
/// The name of a body that it cannot be joined to, and why.
pub(crate) fn joints(body: &Deformable, scene: &Snapshot) -> Result<Vec<RigidJoint>, String> {
    let mut joints = Vec::new();
    let Some(coupled) = scene.get::<CoupledBody>(body.entity) else { return Ok(joints) };
    for with in &coupled.with {
        let Some((entity, motion)) = rigid(scene, &with.body) else { continue };
        let wrong = |why: String| Err(format!("it is coupled with '{}': {why}", with.body));
        if motion != Motion::Dynamic {
            return wrong("that does not move by itself: anchor it there instead".into());
        }
        let Some(Joined { within, stiffness, damping }) = with.joined.filter(|_| with.lies.is_none()) else {
            return wrong("with a rigid body, 'joined' is valid: what lies on one needs no coupling".into());
        };
        let Some(surface) = RigidSurface::of(scene, entity) else {
            return wrong("that has no shape and no mesh".into());
        };
        let rigid_from_body = scene.world_pose(entity).inverse() * scene.world_pose(body.entity);
        let first = joints.len();
        for (vertex, rest) in (0..).zip(body.rest.iter()) {
            let place = rigid_from_body * rest;
            let is_near = surface.nearest(&place).is_some_and(|nearest| nearest.distance <= within);
            if is_near && !body.is_staying(vertex) {
                joints.push(RigidJoint { body: entity, vertex, place, stiffness, damping });
            }
        }
        match joints.len() - first {
            0 => return wrong(format!("none of its vertices is within {within} m of that at rest")),
            1..=JOINED_MAX => {}
            more => {
                return wrong(format!(
                    "{more} of its vertices are within {within} m of that at rest: up to {JOINED_MAX} are valid"
                ));
            }
        }
    }
    Ok(joints)
}

/// The six directions of a joint's planes, in world.
pub(super) fn directions() -> [Vector3<f64>; 6] {
    let [x, y, z] = [Vector3::x(), Vector3::y(), Vector3::z()];
    [x, -x, y, -y, z, -z]
}

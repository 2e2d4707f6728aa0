//! Reads contacts out of Rapier: the pair, the depth and the force.

use rapier3d_f64::dynamics::RigidBodySet;
use rapier3d_f64::geometry::{Collider, ColliderSet, ContactManifold, ContactPair};
use rapier3d_f64::math::Vector;
use rapier3d_f64::pipeline::PhysicsWorld;
use trocar_scene::components::Primitive;
use trocar_scene::entity::Entity;

use trocar_dynamics::instrument::contact::{Contact, primitive_code};

use crate::conversion::{point_from_rapier, vector_from_rapier};

/// Collider tag: the entity in the low 64 bits, its part above.
pub(crate) fn tag(entity: Entity, primitive: Primitive) -> u128 {
    u128::from(entity.to_bits()) | (u128::from(primitive_code(primitive)) << 64)
}

fn untag(tag: u128) -> (Entity, Primitive) {
    let code = (tag >> 64) as u64;
    let primitive = match code >> 32 {
        1 => Primitive::Jaw(code as u8),
        2 => Primitive::Shaft,
        _ => Primitive::Shape(code as u32),
    };
    (Entity::from_bits(tag as u64), primitive)
}

/// The entity and part that a collider belongs to.
pub(crate) fn owner(collider: &Collider) -> (Entity, Primitive) {
    untag(collider.user_data)
}

/// Maximum penetration depth of a pair at the current poses \[m\]; `None` without contact points.
pub(crate) fn depth_now(pair: &ContactPair, colliders: &ColliderSet) -> Option<f64> {
    let (first, second) = (colliders.get(pair.collider1)?, colliders.get(pair.collider2)?);
    let mut deepest: Option<f64> = None;
    for manifold in pair.manifolds() {
        let from_first = manifold.subshape_pos1().map_or(*first.position(), |pose| *first.position() * pose);
        let from_second =
            manifold.subshape_pos2().map_or(*second.position(), |pose| *second.position() * pose);
        let normal = from_first.rotation * manifold.local_n1;
        for point in &manifold.points {
            let gap = from_second.transform_point(point.local_p2).dot(normal)
                - from_first.transform_point(point.local_p1).dot(normal);
            if deepest.is_none_or(|depth| -gap > depth) {
                deepest = Some(-gap);
            }
        }
    }
    deepest
}

/// The contacts of a pair as the solver saw them in the last step of `step_secs`.
fn contacts_of(
    pair: &ContactPair,
    bodies: &RigidBodySet,
    colliders: &ColliderSet,
    step_secs: f64,
    out: &mut Vec<Contact>,
) {
    let (Some(first), Some(second)) = (colliders.get(pair.collider1), colliders.get(pair.collider2)) else {
        return;
    };
    let Some(depth) = depth_now(pair, colliders) else { return };
    let body = |collider: &Collider| collider.parent().and_then(|handle| bodies.get(handle));
    let fixed = |collider: &Collider| body(collider).is_none_or(|body| !body.is_dynamic());
    for manifold in pair.solver_manifolds() {
        let impulse: f64 = manifold
            .data
            .solver_contacts
            .iter()
            .filter_map(|contact| manifold.points.get(contact.contact_indices()[0] as usize))
            .map(|point| point.data.impulse)
            .sum();
        let Some(at) = center(manifold, bodies) else { continue };
        let normal = manifold.data.normal;
        let contact = Contact {
            a: owner(first),
            b: owner(second),
            point_in_world: point_from_rapier(at),
            normal_in_world: vector_from_rapier(normal),
            depth,
            normal_force: impulse / step_secs,
            friction_in_world: vector_from_rapier(friction_impulse_on_second(manifold)) / step_secs,
            friction_coefficient: manifold.data.friction,
            a_is_fixed: fixed(first),
            b_is_fixed: fixed(second),
        };
        out.push(if contact.key() > contact.swapped().key() { contact.swapped() } else { contact });
    }
}

/// Mean of the solver's points, weighted by impulse where there are impulses.
fn center(manifold: &ContactManifold, bodies: &RigidBodySet) -> Option<Vector> {
    let contacts = &manifold.data.solver_contacts;
    let (mut sum, mut total) = (Vector::ZERO, 0.0);
    for contact in contacts {
        let (on_first, on_second) = manifold.data.solver_contact_world_points(contact, bodies);
        let index = contact.contact_indices()[0] as usize;
        let weight = manifold.points.get(index).map_or(0.0, |point| point.data.impulse) + 1e-12;
        sum += (on_first + on_second) * (0.5 * weight);
        total += weight;
    }
    (total > 0.0).then(|| sum / total)
}

/// Rapier keeps the friction of a whole step as two components in a tangent basis of its own, and that of the last
/// iteration both in this basis and in world axes. The rotation and scale between the two pairs of components, applied
/// in world, give the step's friction exactly. (The basis is right-handed about the direction opposite to the normal.)
fn friction_impulse_on_second(manifold: &ContactManifold) -> Vector {
    let mut sum = Vector::ZERO;
    for contact in &manifold.data.solver_contacts {
        let Some(point) = manifold.points.get(contact.contact_indices()[0] as usize) else { continue };
        let (last, step) = (point.data.warmstart_tangent_impulse, point.data.tangent_impulse);
        let squared = last.norm_squared();
        if squared > 0.0 {
            let last_in_world = point.data.warmstart_tangent_world;
            let along = last.dot(&step) / squared;
            let across = (last.x * step.y - last.y * step.x) / squared;
            sum -= last_in_world * along - manifold.data.normal.cross(last_in_world) * across;
        }
    }
    sum
}

/// All contacts between bodies of which at least one is awake, in canonical order.
pub(crate) fn collect(world: &PhysicsWorld, step_secs: f64, out: &mut Vec<Contact>) {
    out.clear();
    for pair in awake_pairs(world) {
        contacts_of(pair, &world.bodies, &world.colliders, step_secs, out);
    }
    out.sort_by_key(Contact::key);
}

/// Pairs with contact points of which at least one body is awake and dynamic.
pub(crate) fn awake_pairs(world: &PhysicsWorld) -> impl Iterator<Item = &ContactPair> {
    world.narrow_phase.contact_pairs().filter(|pair| {
        pair.has_any_active_contact()
            && [pair.collider1, pair.collider2].into_iter().any(|handle| {
                world
                    .colliders
                    .get(handle)
                    .and_then(Collider::parent)
                    .and_then(|body| world.bodies.get(body))
                    .is_some_and(|body| body.is_dynamic() && !body.is_sleeping())
            })
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tags_survive_the_round_trip() {
        let entity = Entity::new(3, 17, 99);
        for primitive in [
            Primitive::Shape(0),
            Primitive::Shape(4_000_000),
            Primitive::Jaw(1),
            Primitive::Jaw(0),
            Primitive::Shaft,
        ] {
            assert_eq!(untag(tag(entity, primitive)), (entity, primitive));
        }
    }
}

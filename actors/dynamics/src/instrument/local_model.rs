//! Local contact model of an instrument, evaluated by haptics between two ticks of the rigid world: an intermediate
//! representation (Adachi, Kumano, Ogino 1995; Mark et al. 1996).
//!
//! Contacts with immovable bodies become planes, shifted to where they stop the *tip* (a contact on the shaft stops the
//! tip as well, as long as the instrument moves without rotating). Contacts with movable bodies, a held ring or the
//! other instrument, become a constant force.

use nalgebra::Vector3;
use trocar_scene::components::{ContactPlane, LocalContactModel};
use trocar_scene::entity::Entity;
use trocar_scene::time::SimTime;

use super::contact::Contact;
use super::coupling::CriticallyDampedCoupling;
use super::state::InstrumentState;

/// Planes whose normals differ by less than about 18° are merged.
const SAME_PLANE_COSINE: f64 = 0.95;
/// Surfaces further away than this are omitted \[m\].
const REACH: f64 = 0.0005;

/// A surface in the way of an instrument.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Obstacle {
    /// Unit normal towards the instrument.
    pub normal_in_world: Vector3<f64>,
    /// How far the instrument can still move against the normal \[m\].
    pub gap: f64,
    /// Coulomb friction of the pair.
    pub friction: f64,
}

/// Builds the local model of one instrument from the contacts of the step and from the predicted obstacle.
pub fn local_contact_model(
    instrument: Entity,
    coupling: &CriticallyDampedCoupling,
    state: &InstrumentState,
    contacts: &[Contact],
    obstacle: Option<Obstacle>,
    at: SimTime,
) -> LocalContactModel {
    let mut model = LocalContactModel {
        proxy_in_world: state.tip_in_world.into(),
        proxy_velocity: state.velocity,
        planes: [None; 4],
        base_force: Vector3::zeros(),
        at,
    };
    // Force and gap of each plane, to select the most important ones.
    let mut weights = [(0.0, f64::INFINITY); 4];
    for contact in contacts {
        let Some(side) = Side::of(contact, instrument) else { continue };
        if !side.other_is_fixed {
            model.base_force += side.force_on_instrument;
            continue;
        }
        let gap = -contact.depth;
        if gap > REACH {
            continue;
        }
        let plane = plane_at(coupling, state, side.normal_to_instrument, gap, contact.friction_coefficient);
        insert(&mut model.planes, &mut weights, plane, (contact.normal_force, gap));
    }
    if let Some(Obstacle { normal_in_world, gap, friction }) = obstacle {
        let plane = plane_at(coupling, state, normal_in_world, gap, friction);
        insert(&mut model.planes, &mut weights, plane, (0.0, gap));
    }
    model
}

/// The plane at which the tip stops when the instrument is `gap` away from a surface.
fn plane_at(
    coupling: &CriticallyDampedCoupling,
    state: &InstrumentState,
    normal_in_world: Vector3<f64>,
    gap: f64,
    friction: f64,
) -> ContactPlane {
    ContactPlane {
        point_in_world: (state.tip_in_world.translation.vector - normal_in_world * gap).into(),
        normal_in_world,
        stiffness: coupling.stiffness(),
        damping: coupling.damping(),
        friction,
    }
}

/// A contact in the instrument's view.
struct Side {
    normal_to_instrument: Vector3<f64>,
    force_on_instrument: Vector3<f64>,
    other_is_fixed: bool,
}

impl Side {
    fn of(contact: &Contact, instrument: Entity) -> Option<Self> {
        let force = contact.force_on_b_in_world();
        if contact.b.0 == instrument {
            Some(Self {
                normal_to_instrument: contact.normal_in_world,
                force_on_instrument: force,
                other_is_fixed: contact.a_is_fixed,
            })
        } else if contact.a.0 == instrument {
            Some(Self {
                normal_to_instrument: -contact.normal_in_world,
                force_on_instrument: -force,
                other_is_fixed: contact.b_is_fixed,
            })
        } else {
            None
        }
    }
}

/// Keeps the four planes with the largest force, of equal force the nearest; merges similar planes.
fn insert(
    planes: &mut [Option<ContactPlane>; 4],
    weights: &mut [(f64, f64); 4],
    plane: ContactPlane,
    weight: (f64, f64),
) {
    let heavier = |a: (f64, f64), b: (f64, f64)| a.0 > b.0 || (a.0 == b.0 && a.1 < b.1);
    for (slot, own) in planes.iter_mut().zip(weights.iter_mut()) {
        let Some(existing) = slot else { continue };
        if existing.normal_in_world.dot(&plane.normal_in_world) > SAME_PLANE_COSINE {
            let total = own.0 + weight.0;
            if heavier(weight, *own) {
                *slot = Some(plane);
                own.1 = weight.1;
            }
            own.0 = total;
            return;
        }
    }
    let mut candidate = (Some(plane), weight);
    for (slot, own) in planes.iter_mut().zip(weights.iter_mut()) {
        if slot.is_none() || heavier(candidate.1, *own) {
            std::mem::swap(slot, &mut candidate.0);
            std::mem::swap(own, &mut candidate.1);
            if candidate.0.is_none() {
                return;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plane(normal: Vector3<f64>) -> ContactPlane {
        ContactPlane {
            point_in_world: nalgebra::Point3::origin(),
            normal_in_world: normal,
            stiffness: 1.0,
            damping: 0.0,
            friction: 0.0,
        }
    }

    #[test]
    fn like_planes_count_once_and_the_heaviest_stay() {
        let (mut planes, mut weights) = ([None; 4], [(0.0, f64::INFINITY); 4]);
        insert(&mut planes, &mut weights, plane(Vector3::z()), (1.0, 0.0));
        insert(&mut planes, &mut weights, plane(Vector3::z()), (2.0, 0.0));
        assert_eq!((planes.iter().flatten().count(), weights[0].0), (1, 3.0));
        for (normal, force) in
            [(Vector3::x(), 0.1), (Vector3::y(), 0.2), (-Vector3::x(), 0.3), (-Vector3::y(), 0.4)]
        {
            insert(&mut planes, &mut weights, plane(normal), (force, 0.0));
        }
        assert_eq!(planes.iter().flatten().count(), 4);
        assert!(planes.iter().flatten().all(|kept| kept.normal_in_world != Vector3::x()));
        assert_eq!(planes[0].map(|kept| kept.normal_in_world), Some(Vector3::z()));
    }
}

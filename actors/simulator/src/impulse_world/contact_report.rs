//! Contact report of the world's last step.

use trocar_dynamics::instrument::contact::Contact;

use super::narrow_phase::ContactPoint;

/// Contacts in canonical order; those between the same two named parts are merged.
pub(super) fn report_contacts(contact_points: &[ContactPoint], step_secs: f64, contacts: &mut Vec<Contact>) {
    contacts.clear();
    for contact_point in contact_points.iter().filter(|contact_point| !contact_point.by_others) {
        let contact = contact_of(contact_point, step_secs);
        contacts.push(if contact.key() > contact.swapped().key() { contact.swapped() } else { contact });
    }
    contacts.sort_by_key(Contact::key);
    merge(contacts);
}

fn contact_of(contact_point: &ContactPoint, step_secs: f64) -> Contact {
    let [a, b] = &contact_point.sides;
    let normal = contact_point.point.normal;
    let force = contact_point.impulse / step_secs;
    let normal_force = force.dot(&normal);
    Contact {
        a: (a.entity, a.name),
        b: (b.entity, b.name),
        point_in_world: nalgebra::center(&contact_point.point.points[0], &contact_point.point.points[1]),
        normal_in_world: normal,
        depth: contact_point.point.depth,
        normal_force,
        friction_in_world: force - normal * normal_force,
        friction_coefficient: contact_point.friction,
        a_is_fixed: a.is_fixed,
        b_is_fixed: b.is_fixed,
    }
}

/// Merges contacts of the same parts with similar directions: the mean point, the sum of forces, the largest depth.
fn merge(contacts: &mut Vec<Contact>) {
    const LIKE: f64 = 0.95;
    let mut kept: Vec<(Contact, f64)> = Vec::with_capacity(contacts.len());
    for contact in contacts.iter() {
        let weight = contact.normal_force + 1e-12;
        let same = kept.iter_mut().rev().take_while(|(known, _)| known.key() == contact.key());
        let mut same = same.filter(|(known, _)| known.normal_in_world.dot(&contact.normal_in_world) > LIKE);
        if let Some((known, sum)) = same.next() {
            let share = weight / (*sum + weight);
            known.point_in_world += (contact.point_in_world - known.point_in_world) * share;
            let normal = known.normal_in_world * (1.0 - share) + contact.normal_in_world * share;
            let force = known.force_on_b_in_world() + contact.force_on_b_in_world();
            known.normal_in_world = normal.normalize();
            known.normal_force = force.dot(&known.normal_in_world);
            known.friction_in_world = force - known.normal_in_world * known.normal_force;
            known.depth = known.depth.max(contact.depth);
            *sum += weight;
        } else {
            kept.push((*contact, weight));
        }
    }
    contacts.clear();
    contacts.extend(kept.into_iter().map(|(contact, _)| contact));
}

//! Instruments that hands lead, held back by the engine's soft volumes. The engine is given forces or places of vertices,
//! and its elements are stiff against a vertex's mass: forces that stop an instrument would throw the vertices aside. So
//! those that stop one are led by it, along its normal and with it across, and it feels what that takes (Neumann's
//! condition for the instrument, Dirichlet's for the body), a substep later; a vertex that would have to be drawn is free.

use nalgebra::{Point3, Vector3};
use trocar_dynamics::soft_body::bearing::rigid_motion::RigidMotion;
use trocar_dynamics::soft_body::bearing::rigid_response::{PlaneContact, RigidPresses};

/// Depth from which on a contact leads its vertices at the beginning of a step \[m\]: those that it led in the last one
/// are on the plane.
const ON: f64 = -2e-5;

/// A vertex that a contact may lead.
pub(crate) struct LedVertex {
    pub vertex: u32,
    /// Its contact, by its number in the step.
    pub contact: usize,
    began: Vector3<f64>,
    pub is_led: bool,
    /// Force of the contact in the last substep, along its normal \[N\].
    force: f64,
    /// Impulse of the step \[N·s\].
    pub impulse: f64,
}

/// Number of contacts before those with instruments that hands lead, which are listed last.
pub(crate) fn first_led(rigid: &RigidPresses<'_>) -> usize {
    let is_led = |contact: &PlaneContact| rigid.bodies[contact.body as usize].is_led;
    rigid.contacts.iter().position(is_led).unwrap_or(rigid.contacts.len())
}

/// The vertices that contacts from number `first` on may lead, each by the first of them; ascending.
pub(crate) fn led_vertices(
    rigid: &RigidPresses<'_>,
    first: usize,
    positions: &[Point3<f64>],
    is_free: impl Fn(u32) -> bool,
) -> Vec<LedVertex> {
    let mut list: Vec<LedVertex> = Vec::new();
    for (number, contact) in rigid.contacts.iter().enumerate().skip(first) {
        for (vertex, share) in contact.joint() {
            let known = list.iter().any(|led| led.vertex == vertex);
            if share > 0.0 && !known && is_free(vertex) {
                let began = positions[vertex as usize].coords;
                let is_led = contact.depth > ON;
                list.push(LedVertex { vertex, contact: number, began, is_led, force: 0.0, impulse: 0.0 });
            }
        }
    }
    list.sort_by_key(|led| led.vertex);
    list
}

impl LedVertex {
    /// Where its contact has it at the end of a substep of `h` \[s\] \[m\]; `at` is where it is.
    pub fn goal(
        &self,
        contact: &PlaneContact,
        motion: &RigidMotion,
        at: &Point3<f64>,
        h: f64,
    ) -> Point3<f64> {
        let (way, velocity) = motion.linear();
        let gone = at.coords - self.began;
        let depth = contact.depth + contact.normal.dot(&(way + velocity * h - gone));
        let across = velocity - contact.normal * contact.normal.dot(&velocity);
        at + contact.normal * depth + across * h
    }

    /// After a substep of `h` \[s\] in which leading it took `reaction` \[N\]: whether it is led in the next one.
    pub fn end(
        &mut self,
        contact: &PlaneContact,
        motion: &mut RigidMotion,
        (at, reaction): (&Point3<f64>, &Vector3<f64>),
        h: f64,
    ) {
        let (way, velocity) = motion.linear();
        let depth = contact.depth + contact.normal.dot(&(way + velocity * h - (at.coords - self.began)));
        self.force = if self.is_led { contact.normal.dot(reaction) } else { 0.0 };
        self.is_led = if self.is_led { self.force > 0.0 } else { depth > 0.0 };
        self.force = self.force.max(0.0);
        self.impulse += self.force * h;
        motion.take(contact, self.force);
    }
}

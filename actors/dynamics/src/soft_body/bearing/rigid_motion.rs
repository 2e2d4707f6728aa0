//! Rigid bodies in the substeps of methods that divide a step, and the forces of their contacts there.

use nalgebra::{Matrix3, Vector3};

use super::rigid_response::{PlaneContact, RigidInStep};

/// Pairs of sweeps, to and fro, of [`press`].
const SWEEPS: usize = 3;

/// A rigid body on its way through the substeps of a step, for methods that divide it.
///
/// Its controller takes the impulses of a whole step, and moves it in steps of its own. Contacts therefore press as those
/// of a backward Euler step over the longer of the two, the *horizon*, although they act for a substep only: forces that
/// turned the body back within a substep would find it elsewhere, and give it energy.
#[derive(Clone, Copy, Debug)]
pub struct RigidMotion {
    mass_inverse: f64,
    inertia_inverse: Matrix3<f64>,
    pull: [Vector3<f64>; 2],
    velocity: [Vector3<f64>; 2],
    /// Displacement of the centre of mass \[m\], and rotation \[rad\], at the beginning of the substep.
    way: [Vector3<f64>; 2],
    /// Force \[N\] and torque \[N·m\] of contacts in the substep.
    wrench: [Vector3<f64>; 2],
    horizon: f64,
}

impl RigidMotion {
    /// At the beginning of a step of `step` seconds.
    #[must_use]
    pub fn of(body: &RigidInStep, step: f64) -> Self {
        Self {
            mass_inverse: body.mass.recip(),
            inertia_inverse: body.inertia.try_inverse().unwrap_or_else(Matrix3::zeros),
            pull: body.pull,
            velocity: body.velocity,
            way: [Vector3::zeros(); 2],
            wrench: [Vector3::zeros(); 2],
            horizon: body.own_step.max(step),
        }
    }

    /// How much deeper a contact is at the horizon by its motion since the beginning of the step \[m\].
    fn deeper(&self, contact: &PlaneContact) -> f64 {
        let [linear, angular] = self.faster();
        let ahead = |k: usize, faster: Vector3<f64>| {
            self.way[k] + (self.velocity[k] + faster * self.horizon) * self.horizon
        };
        contact.normal.dot(&(ahead(0, linear) + ahead(1, angular).cross(&contact.arm)))
    }

    /// Its acceleration, linear and angular.
    fn faster(&self) -> [Vector3<f64>; 2] {
        let [force, torque] = self.wrench;
        [self.pull[0] + force * self.mass_inverse, self.pull[1] + self.inertia_inverse * torque]
    }

    /// Displacement at the horizon along a contact's normal by its force \[m/N\].
    fn gives(&self, contact: &PlaneContact) -> f64 {
        let turn = contact.arm.cross(&contact.normal);
        (self.mass_inverse + turn.dot(&(self.inertia_inverse * turn))) * self.horizon * self.horizon
    }

    /// Takes the reaction to a change of a contact's force on the soft body \[N\].
    fn push(&mut self, contact: &PlaneContact, change: f64) {
        let force = contact.normal * -change;
        self.wrench[0] += force;
        self.wrench[1] += contact.arm.cross(&force);
    }

    /// Its displacement since the beginning of the step \[m\], and its velocity \[m/s\].
    #[must_use]
    pub fn linear(&self) -> (Vector3<f64>, Vector3<f64>) {
        (self.way[0], self.velocity[0])
    }

    /// Takes the reaction to a contact's force on the soft body in this substep \[N\].
    pub fn take(&mut self, contact: &PlaneContact, force: f64) {
        self.push(contact, force);
    }

    /// Ends a substep of `h` seconds.
    pub fn end(&mut self, h: f64) {
        let faster = self.faster();
        self.wrench = [Vector3::zeros(); 2];
        for (k, faster) in faster.into_iter().enumerate() {
            self.velocity[k] += faster * h;
            self.way[k] += self.velocity[k] * h;
        }
    }
}

/// Nodes of a soft body in a substep.
pub trait PressedNodes {
    /// Where a node is at the end of the substep without further forces \[m\], its velocity there \[m/s\], and its inverse
    /// mass \[1/kg\].
    fn at_end(&self, node: u32) -> (Vector3<f64>, Vector3<f64>, f64);
    /// Moves a node on by a force during the substep \[N\].
    fn push(&mut self, node: u32, force: &Vector3<f64>);
}

/// Begins a substep with the contacts' forces of the last one \[N\]: few sweeps then suffice, and what bears a body at rest
/// bears it evenly.
pub fn press_as_before(
    contacts: &[PlaneContact],
    forces: &[f64],
    moving: &mut [RigidMotion],
    nodes: &mut impl PressedNodes,
) {
    for (contact, force) in contacts.iter().zip(forces).filter(|(_, force)| **force > 0.0) {
        for (node, share) in contact.joint() {
            nodes.push(node, &(contact.normal * (force * share)));
        }
        moving[contact.body as usize].push(contact, *force);
    }
}

/// Gauss–Seidel sweeps over contacts in a substep of `h` seconds, to and fro, so that no order is preferred: each contact
/// takes the force that it has at the end, since contacts are too stiff for the mass of a light body to be stepped
/// explicitly, and energy must not grow. `touched` are the touched points at the beginning of the step \[m\]; `forces` are
/// those that already act \[N\].
pub fn press(
    contacts: &[PlaneContact],
    touched: &[Vector3<f64>],
    forces: &mut [f64],
    moving: &mut [RigidMotion],
    h: f64,
    nodes: &mut impl PressedNodes,
) {
    let mut update = |index: usize| {
        let (contact, force) = (&contacts[index], &mut forces[index]);
        let motion = &mut moving[contact.body as usize];
        let joint = contact.joint();
        let ahead = motion.horizon - h;
        let (mut gone, mut gives) = (-touched[index], motion.gives(contact));
        for &(node, share) in &joint {
            let (at, velocity, mobility) = nodes.at_end(node);
            gone += (at + velocity * ahead) * share;
            gives += share * share * mobility * h * motion.horizon;
        }
        let depth = contact.depth - contact.normal.dot(&gone) + motion.deeper(contact);
        let wanted = (contact.stiffness * depth - *force) / (1.0 + contact.stiffness * gives);
        let change = wanted.max(-*force);
        *force += change;
        joint.iter().for_each(|&(node, share)| nodes.push(node, &(contact.normal * (change * share))));
        motion.push(contact, change);
    };
    for _ in 0..SWEEPS {
        (0..contacts.len()).for_each(&mut update);
        (0..contacts.len()).rev().for_each(&mut update);
    }
}

//! Contact constraints of XPBD during a substep: unilateral, with static and dynamic friction.

use nalgebra::{Point3, Vector3};

use super::constraint::Nodes;
use crate::mass_spring::Contact;

/// State of a contact.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct ContactState {
    /// Contact point at the beginning of the step, and of the substep \[m\].
    pub touched: Vector3<f64>,
    before: Vector3<f64>,
    /// Normal and tangential multipliers of the substep \[N·s²\].
    along: f64,
    across: Vector3<f64>,
    /// Impulse of the step \[N·s\].
    pub impulse: Vector3<f64>,
}

impl ContactState {
    /// At the beginning of a step.
    pub fn new(contact: &Contact, positions: &[Point3<f64>]) -> Self {
        Self { touched: contact.point(positions), ..Self::default() }
    }

    /// At the beginning of a substep, before anything has moved.
    pub fn begin(&mut self, contact: &Contact, nodes: &Nodes<'_>) {
        self.before = place(contact, nodes);
        self.along = 0.0;
        self.across = Vector3::zeros();
    }

    /// One iteration in a substep of length `h`; `since` is the time from the beginning of the step to the end of the
    /// substep \[s\].
    pub fn project(&mut self, contact: &Contact, nodes: &mut Nodes<'_>, since: f64, h: f64) {
        if contact.stiffness == 0.0 {
            return;
        }
        let shares = contact.joint();
        let yields: f64 = shares.iter().map(|&(node, share)| share * share * nodes.place(node).1).sum();
        if yields == 0.0 {
            return;
        }
        let soft = nodes.rate / contact.stiffness;
        let normal = contact.normal;
        let now = place(contact, nodes);
        let gap = normal.dot(&(now - self.touched - contact.velocity * since)) - contact.depth;
        let slip = now - self.before - contact.velocity * h;
        // Damping parallel to the spring, as in Macklin et al. (2016): its ratio to the stiffness is a time.
        let drag = contact.damping / (contact.stiffness * h);
        let change = (-gap - soft * self.along - drag * normal.dot(&slip)) / ((1.0 + drag) * yields + soft);
        let pressed = (self.along + change).max(0.0);
        self.push(&shares, nodes, normal * (pressed - self.along));
        self.along = pressed;
        let slip = place(contact, nodes) - self.before - contact.velocity * h;
        let wanted = self.across - (slip - normal * normal.dot(&slip)) / yields;
        let (size, most) = (wanted.norm(), contact.friction * pressed);
        let held = if size > most { wanted * (most / size) } else { wanted };
        self.push(&shares, nodes, held - self.across);
        self.across = held;
    }

    fn push(&self, shares: &[(u32, f64); 3], nodes: &mut Nodes<'_>, by: Vector3<f64>) {
        for &(node, share) in shares {
            let mobility = nodes.place(node).1;
            nodes.shift(node, &(by * (share * mobility)));
        }
    }

    /// At the end of a substep.
    pub fn end(&mut self, contact: &Contact, h: f64) {
        self.impulse += (contact.normal * self.along + self.across) / h;
    }
}

fn place(contact: &Contact, nodes: &Nodes<'_>) -> Vector3<f64> {
    contact.joint().into_iter().map(|(node, share)| nodes.place(node).0 * share).sum()
}

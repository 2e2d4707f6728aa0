//! Contacts of XPBD with rigid bodies that move: constraints between a body's nodes and the six unknowns of the rigid
//! body (Müller, Macklin, Chentanez, Jeschke and Kim 2020).

use nalgebra::Vector3;
use trocar_dynamics::particles::State;
use trocar_dynamics::soft_body::bearing::rigid_motion::{PressedNodes, RigidMotion, press, press_as_before};
use trocar_dynamics::soft_body::bearing::rigid_response::{PlaneContact, RigidPresses};

use super::constraint::Nodes;

/// State of all contacts with rigid bodies in a step.
#[derive(Clone, Debug, Default)]
pub(super) struct RigidContactStates {
    bodies: Vec<RigidMotion>,
    /// Contact points at the beginning of the step \[m\].
    touched: Vec<Vector3<f64>>,
    /// Forces in the substep \[N\], and impulses of the step \[N·s\].
    forces: Vec<f64>,
    impulses: Vec<f64>,
}

impl RigidContactStates {
    /// Begins a step of `dt` seconds.
    pub fn begin_step(&mut self, rigid: &RigidPresses<'_>, dt: f64, state: &State) {
        self.bodies.clear();
        self.bodies.extend(rigid.bodies.iter().map(|body| RigidMotion::of(body, dt)));
        self.touched.clear();
        self.touched.extend(rigid.contacts.iter().map(|contact| contact.place(&state.positions)));
        self.impulses.clear();
        self.impulses.resize(rigid.contacts.len(), 0.0);
        self.forces.clear();
        self.forces.extend(rigid.contacts.iter().map(|contact| contact.force));
    }

    /// Begins a substep of `h` \[s\], with the nodes moved on from `before`.
    pub fn begin(&mut self, contacts: &[PlaneContact], nodes: &mut Nodes<'_>, before: &[[f64; 4]], h: f64) {
        let mut nodes = Projected { nodes, before, h };
        press_as_before(contacts, &self.forces, &mut self.bodies, &mut nodes);
    }

    /// One iteration in a substep of `h` \[s\] that began with the nodes at `before`.
    pub fn project(&mut self, contacts: &[PlaneContact], nodes: &mut Nodes<'_>, before: &[[f64; 4]], h: f64) {
        let mut nodes = Projected { nodes, before, h };
        press(contacts, &self.touched, &mut self.forces, &mut self.bodies, h, &mut nodes);
    }

    /// Ends a substep of `h` \[s\].
    pub fn end(&mut self, h: f64) {
        self.impulses.iter_mut().zip(&self.forces).for_each(|(sum, force)| *sum += force * h);
        self.bodies.iter_mut().for_each(|body| body.end(h));
    }

    /// Takes the forces of a step of `dt` \[s\] that was solved elsewhere \[N\].
    pub fn take(&mut self, forces: &[f64], dt: f64) {
        self.impulses.clear();
        self.impulses.extend(forces.iter().map(|force| force * dt));
    }

    /// Impulse of each contact of the step, along its normal \[N·s\].
    pub fn impulses(&self) -> &[f64] {
        &self.impulses
    }
}

/// The nodes in a substep of `h` seconds that began at `before`.
struct Projected<'a, 'b> {
    nodes: &'a mut Nodes<'b>,
    before: &'a [[f64; 4]],
    h: f64,
}

impl PressedNodes for Projected<'_, '_> {
    fn at_end(&self, node: u32) -> (Vector3<f64>, Vector3<f64>, f64) {
        let (at, mobility) = self.nodes.place(node);
        let [x, y, z, _] = self.before[node as usize];
        (at, (at - Vector3::new(x, y, z)) / self.h, mobility)
    }

    fn push(&mut self, node: u32, force: &Vector3<f64>) {
        let mobility = self.nodes.place(node).1;
        self.nodes.shift(node, &(force * (mobility * self.h * self.h)));
    }
}

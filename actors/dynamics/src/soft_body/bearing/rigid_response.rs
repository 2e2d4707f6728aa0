//! How rigid bodies respond to the contacts of a soft body within a step: solved with the soft body's own step, exactly.
//!
//! A rigid body has six unknowns, its displacement `q` in the step. For given positions of the soft body they minimise
//! `½ (q − q̃)ᵀ M (q − q̃) / h² + Σ ½ k dᵢ²` over the contacts that press, where `q̃` is the displacement without
//! contacts and `dᵢ` the depth, linear in `q`. So an implicit method sees contact energies of its own vertices only, with
//! the rigid bodies eliminated; any weaker coupling, one force after the other, is unstable where the body is light or
//! the contacts are many.

use nalgebra::{Matrix3, Matrix6, Point3, Vector3, Vector6};

/// Iterations over the set of contacts that press, at most; a handful is needed.
const ITERATIONS_MAX: usize = 32;

/// A rigid body in a step of a soft one, in the soft body's frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RigidInStep {
    /// Mass \[kg\].
    pub mass: f64,
    /// Inertia tensor about the centre of mass \[kg·m²\].
    pub inertia: Matrix3<f64>,
    /// Velocity of the centre of mass \[m/s\] and angular velocity \[rad/s\] at the beginning of the step.
    pub velocity: [Vector3<f64>; 2],
    /// Acceleration by everything else, linear \[m/s²\] and angular \[rad/s²\].
    pub pull: [Vector3<f64>; 2],
    /// Length of the steps in which its controller moves it \[s\]; 0 where that is not known yet.
    pub own_step: f64,
    /// Whether it is an instrument that a hand leads.
    pub is_led: bool,
}

/// A contact of a soft body with a plane that is fixed to a rigid body; everything in the soft body's frame. Its force is
/// along the normal.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlaneContact {
    /// Corners of the touched feature; one vertex three times for a vertex, the last twice for a segment.
    pub nodes: [u32; 3],
    /// Barycentric weights of the point: each in \[0, 1\], their sum 1.
    pub weights: [f64; 3],
    /// Unit normal, towards the side where the soft body may be.
    pub normal: Vector3<f64>,
    /// Depth of the point behind the plane at the beginning of the step \[m\]; negative for a gap.
    pub depth: f64,
    /// Stiffness: force per depth \[N/m\].
    pub stiffness: f64,
    /// The rigid body, by its number in the step.
    pub body: u32,
    /// From its centre of mass to the contact \[m\].
    pub arm: Vector3<f64>,
    /// Its force in the last step \[N\].
    pub force: f64,
}

impl PlaneContact {
    /// The touched point for vertices at these positions \[m\].
    #[must_use]
    pub fn place(&self, positions: &[Point3<f64>]) -> Vector3<f64> {
        let corners = self.nodes.iter().zip(self.weights);
        corners.map(|(&node, weight)| positions[node as usize].coords * weight).sum()
    }

    /// Its nodes with their weights, each node once.
    #[must_use]
    pub fn joint(&self) -> [(u32, f64); 3] {
        let ([a, b, c], [u, v, w]) = (self.nodes, self.weights);
        let first = u + if b == a { v } else { 0.0 } + if c == a { w } else { 0.0 };
        let second = if b == a { 0.0 } else { v + if c == b { w } else { 0.0 } };
        let third = if c == a || c == b { 0.0 } else { w };
        [(a, first), (b, second), (c, third)]
    }

    /// Change of its depth by a displacement of the rigid body.
    #[must_use]
    pub fn motion(&self) -> Vector6<f64> {
        let turn = self.arm.cross(&self.normal);
        Vector6::new(self.normal.x, self.normal.y, self.normal.z, turn.x, turn.y, turn.z)
    }
}

/// The contacts of a soft body with rigid bodies in a step.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct RigidPresses<'a> {
    /// The rigid bodies.
    pub bodies: &'a [RigidInStep],
    /// The contacts.
    pub contacts: &'a [PlaneContact],
}

/// What follows for the contacts, and for the rigid bodies, which it keeps from one evaluation to the next.
#[derive(Clone, Debug, Default)]
pub struct RigidResponse {
    /// Force of each contact on the soft body, along its normal \[N\].
    pub forces: Vec<f64>,
    /// Energy of contacts and inertia \[J\].
    pub energy: f64,
    depths: Vec<f64>,
    presses: Vec<bool>,
}

impl RigidPresses<'_> {
    /// Mass matrix of a body over the squared step.
    #[must_use]
    pub fn inertia(&self, body: usize, step: f64) -> Matrix6<f64> {
        let RigidInStep { mass, inertia, .. } = &self.bodies[body];
        let mut matrix = Matrix6::zeros();
        matrix.fixed_view_mut::<3, 3>(0, 0).fill_with_identity();
        let mut linear = matrix.fixed_view_mut::<3, 3>(0, 0);
        linear *= *mass;
        matrix.fixed_view_mut::<3, 3>(3, 3).copy_from(inertia);
        matrix / (step * step)
    }

    /// Depth of a contact at the end of a step of `step` seconds in which nothing touches its rigid body \[m\].
    #[must_use]
    pub fn free_depth(&self, contact: &PlaneContact, step: f64) -> f64 {
        let RigidInStep { velocity: [linear, spin], pull: [faster, more_spin], .. } =
            &self.bodies[contact.body as usize];
        let way = (linear + faster * step) * step;
        let turn = (spin + more_spin * step) * step;
        contact.depth + contact.normal.dot(&(way + turn.cross(&contact.arm)))
    }

    /// The contacts of each body are answered at the end of a step of `step` seconds in which the touched points have
    /// moved this far along the normals \[m\].
    pub fn answer(&self, step: f64, moved: impl Fn(usize) -> f64, response: &mut RigidResponse) {
        let RigidResponse { forces, energy, depths, presses } = response;
        forces.clear();
        forces.resize(self.contacts.len(), 0.0);
        *energy = 0.0;
        depths.clear();
        let all = self.contacts.iter().enumerate();
        depths.extend(all.map(|(index, contact)| self.free_depth(contact, step) - moved(index)));
        presses.clear();
        presses.extend(depths.iter().map(|depth| *depth > 0.0));
        for body in 0..self.bodies.len() {
            let own = |index: &usize| self.contacts[*index].body as usize == body;
            let all: Vec<usize> = (0..self.contacts.len()).filter(own).collect();
            if !all.iter().any(|&index| presses[index]) {
                continue;
            }
            let inertia = self.inertia(body, step);
            let mut gone = Vector6::zeros();
            for _ in 0..ITERATIONS_MAX {
                let (mut matrix, mut right) = (inertia, Vector6::zeros());
                for &index in all.iter().filter(|index| presses[**index]) {
                    let (contact, row) = (&self.contacts[index], self.contacts[index].motion());
                    matrix += row * row.transpose() * contact.stiffness;
                    right -= row * (contact.stiffness * depths[index]);
                }
                let Some(found) = matrix.cholesky().map(|factor| factor.solve(&right)) else { break };
                gone = found;
                let mut changed = false;
                for &index in &all {
                    let is = depths[index] + self.contacts[index].motion().dot(&gone) > 0.0;
                    changed |= std::mem::replace(&mut presses[index], is) != is;
                }
                if !changed {
                    break;
                }
            }
            *energy += 0.5 * gone.dot(&(inertia * gone));
            for &index in &all {
                let contact = &self.contacts[index];
                let depth = (depths[index] + contact.motion().dot(&gone)).max(0.0);
                forces[index] = contact.stiffness * depth;
                *energy += 0.5 * contact.stiffness * depth * depth;
            }
        }
    }

    /// Force of the contacts with the rigid bodies held, per depth: what an approximate Hessian takes for each contact
    /// \[N/m\]. Contacts share the mobility of their body.
    pub fn stiffnesses(&self, step: f64, presses: impl Fn(usize) -> bool, out: &mut Vec<f64>) {
        out.clear();
        let mut sums = vec![0.0; self.bodies.len()];
        let roots: Vec<f64> = self
            .contacts
            .iter()
            .map(|contact| {
                let inverse = self.inertia(contact.body as usize, step).try_inverse();
                let row = contact.motion();
                inverse.map_or(0.0, |inverse| row.dot(&(inverse * row))).max(0.0).sqrt()
            })
            .collect();
        for (index, contact) in self.contacts.iter().enumerate().filter(|(index, _)| presses(*index)) {
            sums[contact.body as usize] += roots[index];
        }
        out.extend(self.contacts.iter().zip(&roots).map(|(contact, root)| {
            contact.stiffness / (1.0 + contact.stiffness * root * sums[contact.body as usize])
        }));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ball(mass: f64) -> RigidInStep {
        let inertia = Matrix3::identity() * (0.4 * mass * 1e-4);
        let pull = [Vector3::new(0.0, 0.0, -9.81), Vector3::zeros()];
        RigidInStep { mass, inertia, velocity: [Vector3::zeros(); 2], pull, own_step: 0.0, is_led: false }
    }

    fn contact(arm: Vector3<f64>, normal: Vector3<f64>, depth: f64) -> PlaneContact {
        let (nodes, weights) = ([0; 3], [1.0, 0.0, 0.0]);
        PlaneContact { nodes, weights, normal, depth, stiffness: 500.0, body: 0, arm, force: 0.0 }
    }

    /// At rest the contacts bear the weight, whatever the step and however many they are.
    #[test]
    fn contacts_at_rest_bear_the_weight() {
        for (mass, step) in [(1e-3, 0.1), (0.05, 0.005), (5.0, 0.001), (5.0, 0.1)] {
            for count in [1, 4, 40] {
                let bodies = [ball(mass)];
                let depth = mass * 9.81 / (500.0 * f64::from(count));
                let contacts: Vec<PlaneContact> = (0..count)
                    .map(|index| {
                        let angle = f64::from(index) * std::f64::consts::TAU / f64::from(count);
                        let arm = Vector3::new(0.01 * angle.cos(), 0.01 * angle.sin(), -0.01);
                        contact(
                            if count == 1 { Vector3::new(0.0, 0.0, -0.01) } else { arm },
                            -Vector3::z(),
                            depth,
                        )
                    })
                    .collect();
                let presses = RigidPresses { bodies: &bodies, contacts: &contacts };
                let mut response = RigidResponse::default();
                presses.answer(step, |_| 0.0, &mut response);
                let sum: f64 = response.forces.iter().sum();
                assert!((sum / (mass * 9.81) - 1.0).abs() < 1e-9, "{mass} {step} {count}: {sum}");
            }
        }
    }

    /// The forces are the derivative of the energy.
    #[test]
    fn forces_are_the_gradient_of_the_energy() {
        let bodies = [ball(0.02)];
        let contacts = [
            contact(
                Vector3::new(0.004, 0.001, -0.009),
                Vector3::new(-0.4, -0.1, 0.9).normalize() * -1.0,
                2e-4,
            ),
            contact(
                Vector3::new(-0.003, 0.002, -0.009),
                Vector3::new(0.3, -0.2, 0.9).normalize() * -1.0,
                -1e-5,
            ),
            contact(Vector3::new(0.0, 0.0, 0.01), Vector3::z(), -1e-3),
        ];
        let presses = RigidPresses { bodies: &bodies, contacts: &contacts };
        let at = |moved: [f64; 3]| {
            let mut response = RigidResponse::default();
            presses.answer(0.005, |index| moved[index], &mut response);
            response
        };
        let middle = [1e-5, -2e-5, 0.0];
        for k in 0..3 {
            let shifted = |by: f64| {
                let mut moved = middle;
                moved[k] += by;
                at(moved).energy
            };
            let slope = (shifted(1e-8) - shifted(-1e-8)) / 2e-8;
            let force = at(middle).forces[k];
            assert!((slope + force).abs() < 1e-6 * (1.0 + force.abs()), "{k}: {slope} {force}");
        }
    }
}

//! Jaws that hold nodes by friction (Coulomb): constraints on the nodes' places, whose forces in each grip are bounded in
//! sum. What needs more slips, and goes on from where it is.

use nalgebra::{Point3, Vector3};
use trocar_dynamics::soft_body::jaw_friction::GripForce;

use super::constraint::Nodes;

/// A node in watched jaws.
#[derive(Clone, Copy, Debug)]
struct HeldNode {
    node: u32,
    grip: usize,
    /// Where its jaws have it at the end of the substep \[m\], and their velocity \[m/s\].
    goal: Vector3<f64>,
    velocity: Vector3<f64>,
    /// Mass times the way by which it was moved in the substep \[kg·m\].
    multiplier: Vector3<f64>,
}

/// The watched grips of a step.
#[derive(Clone, Debug, Default)]
pub(super) struct JawStates {
    held: Vec<HeldNode>,
    /// Sum of the multipliers of each grip, and whether it slips in this substep.
    sums: Vec<(Vector3<f64>, bool)>,
    /// What the jaws of each grip did: until the end of the step, their impulse \[N·s\].
    pub forces: Vec<GripForce>,
}

impl JawStates {
    pub fn begin_step(&mut self, limits: &[f64]) {
        self.held.clear();
        self.forces.clear();
        self.forces.resize(limits.len(), GripForce::default());
        self.sums.clear();
        self.sums.resize(limits.len(), (Vector3::zeros(), false));
    }

    /// A free node that jaws hold.
    pub fn hold(&mut self, node: u32, grip: usize, place: &Point3<f64>, velocity: Vector3<f64>) {
        self.held.push(HeldNode { node, grip, goal: place.coords, velocity, multiplier: Vector3::zeros() });
    }

    /// Beginning of a substep of `h` seconds.
    pub fn begin(&mut self, h: f64) {
        for held in &mut self.held {
            held.goal += held.velocity * h;
            held.multiplier = Vector3::zeros();
        }
    }

    /// Moves the held nodes to where their jaws have them, as far as these can.
    pub fn project(&mut self, nodes: &mut Nodes<'_>, limits: &[f64], h: f64) {
        if self.held.is_empty() {
            return;
        }
        self.sums.iter_mut().for_each(|sum| *sum = (Vector3::zeros(), false));
        let wanted = |held: &HeldNode, place: &[f64; 4]| {
            held.multiplier + (held.goal - Vector3::new(place[0], place[1], place[2])) / place[3]
        };
        for held in &self.held {
            self.sums[held.grip].0 += wanted(held, &nodes.places[held.node as usize]);
        }
        for held in &mut self.held {
            let (sum, slips) = &mut self.sums[held.grip];
            let share = GripForce::share(sum, limits[held.grip] * h * h);
            *slips = share < 1.0;
            let place = &mut nodes.places[held.node as usize];
            let multiplier = wanted(held, place) * share;
            let change = (multiplier - held.multiplier) * place[3];
            (0..3).for_each(|axis| place[axis] += change[axis]);
            held.multiplier = multiplier;
        }
    }

    /// End of a substep.
    pub fn end(&mut self, places: &[[f64; 4]], h: f64) {
        for held in &mut self.held {
            let (by, slips) = (&mut self.forces[held.grip], self.sums[held.grip].1);
            by.force += held.multiplier / h;
            by.slipped |= slips;
            if slips {
                let [x, y, z, _] = places[held.node as usize];
                held.goal = Vector3::new(x, y, z);
            }
        }
    }

    /// End of a step of `dt` seconds.
    pub fn end_step(&mut self, dt: f64) {
        self.forces.iter_mut().for_each(|by| by.force /= dt);
    }
}

//! Rods whose constraints are solved together with a weight that hangs on them.

use nalgebra::{Matrix3, Point3, Vector3};
use trocar_dynamics::soft_body::bearing::rigid_response::{PlaneContact, RigidInStep, RigidPresses};
use trocar_simulator::mass_spring::{LineMaterial, Network};
use trocar_simulator::xpbd::{Body, Xpbd, XpbdConfig, XpbdInput, distances_of};

const STEP: f64 = 1e-3;
const LENGTH: f64 = 0.1;
const SEGMENTS: u32 = 20;
/// Mass of the rod \[kg\], and stiffness of the joint \[N/m\].
const ROD: f64 = 1e-4;
const JOINT: f64 = 500.0;

/// A rod along −z whose last node is joined to a weight, which the test moves.
struct Hanging {
    rod: Xpbd,
    axial_stiffness: f64,
    mass: f64,
    /// Place of the weight \[m\], and its velocity \[m/s\].
    place: Vector3<f64>,
    velocity: Vector3<f64>,
    gravity: Vector3<f64>,
    forces: [f64; 6],
    is_direct: bool,
}

impl Hanging {
    fn new(mass: f64, axial_stiffness: f64, pinned: &[u32], damping: f64, is_direct: bool) -> Self {
        let edge = LENGTH / f64::from(SEGMENTS);
        let rest: Vec<_> = (0..=SEGMENTS).map(|k| Point3::new(0.0, 0.0, -edge * f64::from(k))).collect();
        let lines: Vec<_> = (0..SEGMENTS).map(|k| [k, k + 1]).collect();
        let material = LineMaterial { axial_stiffness, bending_stiffness: 1e-7, density: ROD / LENGTH };
        let network = Network::from_line(&rest, &lines, &material).expect("a line");
        let (distances, masses) = (distances_of(&network), &network.masses[..]);
        let body =
            Body { rest: &rest, masses, distances: &distances, bends: &network.hinges, ..Body::default() };
        let config = XpbdConfig { parts: 20, damping, ..XpbdConfig::default() };
        let mut rod = Xpbd::new(&body, pinned, config).expect("a rod");
        rod.take_network(&network).expect("its network");
        Self {
            rod,
            axial_stiffness,
            mass,
            place: rest[SEGMENTS as usize].coords,
            velocity: Vector3::zeros(),
            gravity: Vector3::zeros(),
            forces: [0.0; 6],
            is_direct,
        }
    }

    fn end(&self) -> Vector3<f64> {
        self.rod.state().positions[SEGMENTS as usize].coords
    }

    fn step(&mut self) {
        let apart = self.place - self.end();
        let directions = [0, 1, 2].map(|axis| Vector3::ith(axis, 1.0)).map(|axis| [axis, -axis]);
        let contacts: Vec<PlaneContact> = directions
            .into_iter()
            .flatten()
            .zip(self.forces)
            .map(|(normal, force)| PlaneContact {
                nodes: [SEGMENTS; 3],
                weights: [1.0, 0.0, 0.0],
                normal,
                depth: normal.dot(&apart),
                stiffness: JOINT,
                body: 0,
                arm: Vector3::zeros(),
                force,
            })
            .collect();
        let body = RigidInStep {
            mass: self.mass,
            inertia: Matrix3::identity(),
            velocity: [self.velocity, Vector3::zeros()],
            pull: [self.gravity, Vector3::zeros()],
            own_step: STEP,
            is_led: false,
        };
        let rigid = RigidPresses { bodies: &[body], contacts: &contacts };
        let input =
            XpbdInput { gravity: self.gravity, rigid, direct: self.is_direct, ..XpbdInput::default() };
        self.rod.step(STEP, &input).expect("a step");
        let forces: Vec<f64> = self.rod.rigid_forces(STEP).collect();
        self.forces.copy_from_slice(&forces);
        let on_rod: Vector3<f64> =
            contacts.iter().zip(&forces).map(|(contact, force)| contact.normal * *force).sum();
        self.velocity += (self.gravity - on_rod / self.mass) * STEP;
        self.place += self.velocity * STEP;
    }

    /// Its length by that of its closed form: the weight and the rod's own.
    fn stretch(&self) -> f64 {
        let own = 0.5 * ROD;
        let wanted = (self.mass + own) * self.gravity.norm() * LENGTH / self.axial_stiffness;
        (-self.end().z - LENGTH) / wanted
    }

    fn momentum(&self) -> Vector3<f64> {
        let of_rod = self.rod.masses().iter().zip(&self.rod.state().velocities).map(|(mass, v)| v * *mass);
        self.velocity * self.mass + of_rod.sum::<Vector3<f64>>()
    }
}

/// F L / EA, whatever the weight; sweeps over the same constraints stretch the rod without limit.
#[test]
fn a_weight_stretches_a_rod_by_its_closed_form_at_any_ratio_of_masses() {
    let hang = |ratio: f64, is_direct: bool, steps: u32| {
        let mass = ratio * ROD;
        // By a hundredth of its length.
        let mut hanging = Hanging::new(mass, 100.0 * mass * 9.81, &[0], 20.0, is_direct);
        hanging.gravity = Vector3::new(0.0, 0.0, -9.81);
        (0..steps).for_each(|_| hanging.step());
        hanging.stretch()
    };
    for ratio in [1.0, 10.0, 100.0, 1000.0] {
        // The joint swings at 10 Hz, damped by the steps alone.
        let stretch = hang(ratio, true, 8000);
        assert!((stretch - 1.0).abs() < 1e-3, "a weight of {ratio} times the rod's mass: {stretch}");
    }
    let swept = hang(1000.0, false, 300);
    assert!(swept > 3.0, "by sweeps {swept} of the closed form");
}

/// A weight that flies off with a free rod behind it: what one loses the other gets.
#[test]
fn a_rod_gets_the_momentum_that_its_weight_loses() {
    for ratio in [1.0, 1000.0] {
        let mut flying = Hanging::new(ratio * ROD, 50.0, &[], 0.0, true);
        flying.velocity = Vector3::new(0.3, 0.1, -0.5);
        let begun = flying.momentum();
        let mut exchanged = 0.0_f64;
        for step in 0..500 {
            flying.step();
            exchanged = exchanged.max((flying.velocity - begun / flying.mass).norm() * flying.mass);
            let off = (flying.momentum() - begun).norm();
            assert!(off < 1e-9 * begun.norm(), "{ratio}, step {step}: {off} of {} N·s", begun.norm());
        }
        assert!(exchanged > 0.2 * ROD * 0.59, "{exchanged} N·s");
    }
}

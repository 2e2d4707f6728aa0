//! A thread and rigid bodies that move: it bears them, and what one gets the other loses.

use nalgebra::{Isometry3, Matrix3, Point3, UnitQuaternion, Vector3};
use trocar_simulator::suture_thread::{
    Hold, Obstacle, ObstacleMobility, Shape, Surroundings, Thread, ThreadMaterial, TwistHold,
};

use crate::support::thread::resampled;

const GRAVITY: Vector3<f64> = Vector3::new(0.0, 0.0, -9.81);
/// A capsule across the sling \[m\].
const RADIUS: f64 = 5e-3;
const HALF_LENGTH: f64 = 0.012;

/// A rigid capsule along y that the test moves by the thread's impulses.
struct Weight {
    mass: f64,
    inertia: Vector3<f64>,
    pose: Isometry3<f64>,
    velocity: Vector3<f64>,
    spin: Vector3<f64>,
}

impl Weight {
    fn new(mass: f64) -> Self {
        let (about, along) =
            (mass * (HALF_LENGTH * HALF_LENGTH / 3.0 + RADIUS * RADIUS / 4.0), mass * 1.25e-5);
        Self {
            mass,
            inertia: Vector3::new(about, along, about),
            pose: Isometry3::identity(),
            velocity: Vector3::zeros(),
            spin: Vector3::zeros(),
        }
    }

    fn obstacle(&self, gravity: &Vector3<f64>, dt: f64, friction: f64) -> Obstacle<'static> {
        let velocity = self.velocity + gravity * dt;
        let ends = [-HALF_LENGTH, HALF_LENGTH].map(|y| Point3::new(0.0, y, 0.0));
        Obstacle {
            shape: Shape::Capsule { ends, radius: RADIUS },
            from: self.pose,
            to: Isometry3::from_parts(
                (self.pose.translation.vector + velocity * dt).into(),
                UnitQuaternion::from_scaled_axis(self.spin * dt) * self.pose.rotation,
            ),
            friction,
            mobility: Some(ObstacleMobility {
                mass_inverse: self.mass.recip(),
                centre: Point3::origin(),
                inertia_inverse: Matrix3::from_diagonal(&self.inertia.map(f64::recip)),
                lever: None,
            }),
        }
    }

    /// Moves it on by the thread's impulse on it, and gravity.
    fn take(&mut self, gravity: &Vector3<f64>, dt: f64, [impulse, moment]: [Vector3<f64>; 2]) {
        self.velocity += gravity * dt + impulse / self.mass;
        self.spin += moment.component_div(&self.inertia);
        self.pose.translation.vector += self.velocity * dt;
        self.pose.rotation = UnitQuaternion::from_scaled_axis(self.spin * dt) * self.pose.rotation;
    }
}

/// Half around a capsule, and straight up on either side.
fn sling() -> Vec<Point3<f64>> {
    let radius = RADIUS + 8e-4;
    let arc = (0..=24).map(|k| {
        let angle = std::f64::consts::PI * (1.0 + f64::from(k) / 24.0);
        Point3::new(radius * angle.cos(), 0.0, radius * angle.sin())
    });
    let up = |x: f64| std::iter::once(Point3::new(x, 0.0, 0.03));
    resampled(&up(-radius).chain(arc).chain(up(radius)).collect::<Vec<_>>(), 1e-3)
}

#[test]
fn a_weight_hangs_in_a_sling_with_half_of_its_weight_in_each_strand_at_any_friction() {
    for (friction, mass, dt) in [(0.0, 0.02, 1e-3), (0.2, 0.1, 2e-3), (1.0, 0.02, 1e-3), (2.0, 0.02, 1e-3)] {
        let nodes = sling();
        let last = nodes.len() - 1;
        let mut thread = Thread::new(ThreadMaterial::silk_2_0(), &nodes).expect("a thread");
        let directors = [thread.state().directors[0], thread.state().directors[last - 1]];
        let mut weight = Weight::new(mass);
        let mut impulse = Vector3::zeros();
        let mut highest = f64::MIN;
        for step in 0..(0.15 / dt) as usize {
            let holds = [Hold::fixed(0, nodes[0]), Hold::fixed(last, nodes[last])];
            let twist_holds = [(0, directors[0]), (last - 1, directors[1])]
                .map(|(edge, director)| TwistHold { edge, director });
            let obstacles = [weight.obstacle(&GRAVITY, dt, friction)];
            let around = Surroundings {
                gravity: GRAVITY,
                holds: &holds,
                twist_holds: &twist_holds,
                obstacles: &obstacles,
                ..Surroundings::default()
            };
            thread.step(dt, &around).unwrap_or_else(|error| panic!("μ {friction}, step {step}: {error}"));
            let given = thread.yielded()[0].impulse;
            impulse = given[0] / dt;
            weight.take(&GRAVITY, dt, given);
            highest = highest.max(weight.pose.translation.z);
        }
        let found = format!("μ {friction}, {mass} kg: {:?}, {impulse:?}", weight.pose.translation.vector);
        let wanted = mass * 9.81;
        assert!(highest < 1e-4, "it is thrown up, {found}");
        assert!((impulse.z / wanted - 1.0).abs() < 2e-3, "{found}");
        assert!(weight.velocity.norm() < 1e-3, "{found}");
        assert!((-1.2e-3..-6e-4).contains(&weight.pose.translation.z), "{found}");
        // Friction may hold more in the arc than the weight, but not in the strands.
        let strands = [0, last - 1].map(|edge| thread.state().tensions[edge]);
        assert!(
            strands.iter().all(|tension| (tension / (0.5 * wanted) - 1.0).abs() < 0.02),
            "{found}: {strands:?}"
        );
    }
}

#[test]
fn a_free_thread_and_a_free_weight_that_collide_keep_their_momentum() {
    let nodes: Vec<Point3<f64>> =
        (0..=40).map(|k| Point3::new(-0.02 + 1e-3 * f64::from(k), 0.0, -0.006)).collect();
    let mut material = ThreadMaterial::silk_2_0();
    material.drag = 0.0;
    let mut thread = Thread::new(material, &nodes).expect("a thread");
    // Ten times the thread's mass, and off its middle.
    let mut weight = Weight::new(3.7e-5);
    weight.pose.translation.vector = Vector3::new(0.004, 0.0, 0.0);
    weight.velocity = Vector3::new(0.1, 0.02, -0.3);
    let momentum = |thread: &Thread, weight: &Weight| {
        let state = thread.state();
        let masses = (0..state.positions.len()).map(|node| {
            let of = |edge: Option<usize>| {
                edge.and_then(|edge| state.rest_lengths.get(edge)).copied().unwrap_or(0.0)
            };
            0.5 * material.mass_per_length * (of(node.checked_sub(1)) + of(Some(node)))
        });
        masses.zip(&state.velocities).map(|(mass, velocity)| velocity * mass).sum::<Vector3<f64>>()
            + weight.velocity * weight.mass
    };
    let before = momentum(&thread, &weight);
    let (dt, none) = (5e-4, Vector3::zeros());
    let mut exchanged = 0.0;
    for _ in 0..100 {
        let obstacles = [weight.obstacle(&none, dt, 0.3)];
        thread.step(dt, &Surroundings { obstacles: &obstacles, ..Surroundings::default() }).expect("a step");
        let given = thread.yielded()[0].impulse;
        exchanged += given[0].norm();
        weight.take(&none, dt, given);
    }
    let lost = (momentum(&thread, &weight) - before).norm();
    assert!(exchanged > 1e-6, "they collide: {exchanged} N·s");
    assert!(lost < 1e-6 * exchanged, "{lost} of {exchanged} N·s");
}

#[test]
fn a_weight_that_touches_a_thread_from_the_very_first_step_is_met() {
    let nodes: Vec<Point3<f64>> =
        (0..=40).map(|k| Point3::new(-0.02 + 1e-3 * f64::from(k), 0.0, 0.0)).collect();
    let material = ThreadMaterial::silk_2_0();
    let mut thread = Thread::new(material, &nodes).expect("a thread");
    let mut weight = Weight::new(3.7e-5);
    weight.pose.translation.vector.z = RADIUS + material.radius + 1e-5;
    weight.velocity.z = -0.05;
    let obstacles = [weight.obstacle(&Vector3::zeros(), 1e-3, 0.3)];
    let around = Surroundings { obstacles: &obstacles, ..Surroundings::default() };
    thread.step(1e-3, &around).expect("a step");
    let [impulse, _] = thread.yielded()[0].impulse;
    assert!(impulse.z > 0.0 && impulse.z < 2.0 * 0.05 * weight.mass, "{impulse:?} N·s");
}

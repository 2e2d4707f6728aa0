//! Contacts of a thread: static friction does not creep, nothing fast passes through, action and reaction are equal.

use crate::support::thread as thread_support;
use nalgebra::{Isometry3, Point3, Translation3, Vector3};
use trocar_simulator::suture_thread::knot::{KnotKind, identify};
use trocar_simulator::suture_thread::{
    Hold, Obstacle, Shape, Surroundings, Thread, ThreadError, ThreadMaterial, ThreadStepError,
};

fn line(edges: usize, spacing: f64) -> Vec<Point3<f64>> {
    (0..=edges).map(|i| Point3::new(spacing * (i as f64 - 0.5 * edges as f64), 0.0, 0.0)).collect()
}

#[test]
fn a_thread_on_a_slope_stays_below_the_angle_of_friction_and_slides_above() {
    // tan 20° = 0.364.
    let angle = 20.0_f64.to_radians();
    let moved = |friction: f64| {
        let material = ThreadMaterial::silk_2_0();
        let points: Vec<_> = line(40, 5e-4).iter().map(|p| p + Vector3::z() * material.radius).collect();
        let mut thread = Thread::new(material, &points).expect("a thread");
        let shape = Shape::HalfSpace { normal: Vector3::z() };
        let obstacles = [Obstacle::fixed(shape, Isometry3::identity(), friction)];
        // Down along the thread, where it cannot roll.
        let gravity = Vector3::new(angle.sin(), 0.0, -angle.cos()) * 9.81;
        let around = Surroundings { gravity, obstacles: &obstacles, ..Surroundings::default() };
        for _ in 0..200 {
            thread.step(1e-3, &around).expect("a step");
        }
        (thread.positions()[20].x - points[20].x, thread.reactions()[0].force)
    };
    let (stays, force) = moved(0.40);
    assert!(stays < 1e-7, "crept by {stays} m");
    let weight = ThreadMaterial::silk_2_0().mass_per_length * 40.0 * 5e-4 * 9.81;
    assert!((force.norm() / weight - 1.0).abs() < 1e-3, "{force} for {weight}");
    let (slides, _) = moved(0.33);
    // ½ (sin − μ cos) g t², without air drag.
    let expected = 0.5 * 9.81 * (angle.sin() - 0.33 * angle.cos()) * 0.04;
    assert!((slides / expected - 1.0).abs() < 0.1, "{slides} m, expected {expected}");
}

/// A thread thrown against an obstacle at a metre per second, 1 mm per step; returns the lowest position of its middle
/// \[m\].
fn thrown_against(shape: Shape) -> f64 {
    let material = ThreadMaterial::silk_2_0();
    let points: Vec<_> = line(60, 4e-4).iter().map(|p| p + Vector3::z() * 4e-3).collect();
    let mut state = Thread::new(material, &points).expect("a thread").state().clone();
    state.velocities.fill(Vector3::new(0.0, 0.0, -1.0));
    let mut thread = Thread::restore(material, state).expect("a thread");
    let obstacles = [Obstacle::fixed(shape, Isometry3::identity(), 0.2)];
    let around = Surroundings { obstacles: &obstacles, ..Surroundings::default() };
    let (mut lowest, mut touched) = (f64::INFINITY, false);
    for _ in 0..12 {
        thread.step(1e-3, &around).expect("a step");
        lowest = lowest.min(thread.positions()[30].z);
        touched |= thread.reactions()[0].force.z < 0.0;
    }
    assert!(touched, "it never came there");
    lowest
}

#[test]
fn nothing_passes_through_at_a_metre_per_second() {
    let post =
        Shape::Capsule { ends: [Point3::new(0.0, -0.02, 0.0), Point3::new(0.0, 0.02, 0.0)], radius: 2e-4 };
    assert!(thrown_against(post) > 2e-4, "a wire thinner than a step is long");
    let corners = [
        Point3::new(-0.004, -0.01, 0.0),
        Point3::new(0.004, -0.01, 0.0),
        Point3::new(0.004, 0.01, 0.0),
        Point3::new(-0.004, 0.01, 0.0),
    ];
    let triangles = [[0, 1, 2], [0, 2, 3]];
    let sheet = Shape::Mesh { from: &corners, to: &corners, triangles: &triangles, radius: 0.0 };
    assert!(thrown_against(sheet) > 0.5e-4, "a sheet without thickness");
}

#[test]
fn strands_thrown_at_each_other_stay_the_same_knot() {
    let material = ThreadMaterial::silk_2_0();
    let points = thread_support::loose_knot(&[3, -3], material.radius, 1.5 * material.diameter());
    let mut state = Thread::new(material, &points).expect("a thread").state().clone();
    // Everything converges on the knot at a metre per second.
    for (velocity, point) in state.velocities.iter_mut().zip(&points) {
        *velocity = -(point.coords - Vector3::z() * 1e-3).normalize();
    }
    let mut thread = Thread::restore(material, state).expect("a thread");
    for _ in 0..12 {
        thread.step(1e-3, &Surroundings::default()).expect("a step");
    }
    assert_eq!(identify(thread.positions()).expect("a knot").kind, KnotKind::Square);
}

#[test]
fn a_carried_thread_goes_with_what_carries_it() {
    let material = ThreadMaterial::silk_2_0();
    let points: Vec<_> = line(30, 5e-4).iter().map(|p| p + Vector3::z() * material.radius).collect();
    let mut thread = Thread::new(material, &points).expect("a thread");
    let shape = Shape::HalfSpace { normal: Vector3::z() };
    let at = |time: f64| {
        Isometry3::from_parts(Translation3::new(0.05 * time * time, 0.0, 0.0), Default::default())
    };
    for step in 0..300 {
        let time = 1e-3 * f64::from(step);
        let obstacles =
            [Obstacle { shape, from: at(time), to: at(time + 1e-3), friction: 0.5, mobility: None }];
        let gravity = Vector3::new(0.0, 0.0, -9.81);
        let around = Surroundings { gravity, obstacles: &obstacles, ..Surroundings::default() };
        thread.step(1e-3, &around).expect("a step");
    }
    let moved = thread.positions()[15].x - points[15].x;
    assert!((moved - 0.05 * 0.09).abs() < 2e-6, "{moved}");
}

#[test]
fn bad_input_is_named_and_changes_nothing() {
    let material = ThreadMaterial::silk_2_0();
    let mut points = line(10, 5e-4);
    let mut thread = Thread::new(material, &points).expect("a thread");
    let before = thread.state().clone();
    let holds = [Hold::fixed(11, Point3::origin())];
    let around = Surroundings { holds: &holds, ..Surroundings::default() };
    let error = thread.step(1e-3, &around).expect_err("no such node");
    assert!(matches!(error, ThreadStepError::Given { what: "hold", index: 0, .. }), "{error}");
    assert_eq!(thread.step(0.1, &Surroundings::default()), Err(ThreadStepError::Step(0.1)));
    let gravity = Vector3::new(0.0, f64::NAN, 0.0);
    assert!(thread.step(1e-3, &Surroundings { gravity, ..Surroundings::default() }).is_err());
    assert_eq!(thread.state(), &before);
    (points[3], points[7].z) = (points[4], f64::NAN);
    assert_eq!(Thread::new(material, &points).err(), Some(ThreadError::NotFinite(vec![7])));
    points[7].z = 0.0;
    assert_eq!(Thread::new(material, &points).err(), Some(ThreadError::NoLength(vec![3])));
    let wrong = ThreadMaterial { radius: -1.0, ..material };
    assert!(matches!(Thread::new(wrong, &line(5, 1e-3)), Err(ThreadError::Material { name: "radius", .. })));
}

#[test]
fn a_long_thread_comes_to_rest_on_a_table_and_then_costs_hardly_any_steps() {
    let material = ThreadMaterial::silk_2_0();
    // Twisted at one end, and dropped from half a millimetre.
    let points: Vec<_> = (0..=300)
        .map(|i| {
            let turn = 0.15 * f64::from(i.min(100));
            let onwards = Vector3::new(-15.0_f64.sin(), 15.0_f64.cos(), 0.0) * f64::from((i - 100).max(0));
            Point3::new(3e-3 * turn.cos(), 3e-3 * turn.sin(), 4.9e-5 * turn) + onwards * 4.5e-4
        })
        .collect();
    let mut thread = Thread::new(material, &points).expect("a thread");
    let table = Shape::HalfSpace { normal: Vector3::z() };
    let obstacles = [Obstacle::fixed(table, Isometry3::translation(0.0, 0.0, -4e-4), 0.3)];
    let holds = [Hold::fixed(0, points[0]), Hold::fixed(300, points[300])];
    let gravity = Vector3::new(0.0, 0.0, -9.81);
    let around = Surroundings { gravity, holds: &holds, obstacles: &obstacles, ..Surroundings::default() };
    let (mut deepest, mut newton, mut last) = (0.0_f64, 0, 0);
    for step in 0..600 {
        let report = thread.step(1e-3, &around).expect("a step");
        deepest = deepest.max(report.penetration_max);
        newton += report.sweeps;
        if step >= 550 {
            last += report.sweeps;
            assert!(report.contacts > 150, "{report:?}");
        }
        for contact in &thread.state().contacts {
            let normal = contact.force.z;
            let across = contact.force.xy().norm();
            let on_table = contact.key.with == 1;
            assert!(!on_table || (normal > 0.0 && across <= 0.3 * normal * (1.0 + 1e-9)), "{contact:?}");
        }
    }
    assert!(deepest < 1e-6, "{deepest} m deep");
    // There are few of each, even while it falls, unwinds and slides.
    assert!(newton < 600 * 12 && last < 50 * 3, "{newton} Newton steps, of those {last} at rest");
}

//! Joints of the solver by itself: integrators, joints that were torn open, contacts beside joints, what is refused.

use nalgebra::{Isometry3, Point3, UnitQuaternion, Vector3};
use trocar_scene::JointKind;
use trocar_simulator::rigid::{
    BodyJoint, ContactConfig, Integrator, JointEnd, RigidBodies, RigidContact, RigidError, RigidMass,
    RigidState,
};

const GRAVITY: Vector3<f64> = Vector3::new(0.0, 0.0, -9.81);

/// Rods of 2 cm along x, each joined to the one before and the first to the origin.
fn chain(masses: &[f64], integrator: Integrator) -> RigidBodies {
    let of = |mass: &f64| RigidMass { mass: *mass, inertia: Vector3::new(1e-6, 4e-5, 4e-5) * *mass };
    let all: Vec<RigidMass> = masses.iter().map(of).collect();
    let states: Vec<RigidState> = (0..masses.len())
        .map(|link| RigidState {
            position: Point3::new(0.01 + 0.02 * link as f64, 0.0, 0.0),
            rotation: UnitQuaternion::identity(),
            momentum: Vector3::zeros(),
            angular_momentum: Vector3::zeros(),
        })
        .collect();
    let end = |x: f64| Isometry3::translation(x, 0.0, 0.0);
    let joint = |link: usize| BodyJoint {
        body: link as u32,
        body_from_joint: end(-0.01),
        other: link.checked_sub(1).map_or(JointEnd::World([Isometry3::identity(); 2]), |before| {
            JointEnd::Body { body: before as u32, body_from_joint: end(0.01) }
        }),
        kind: JointKind::Ball,
    };
    let joints: Vec<BodyJoint> = (0..masses.len()).map(joint).collect();
    let config = ContactConfig { iterations: 200, tolerance: 1e-9, ..ContactConfig::default() };
    let mut bodies = RigidBodies::new(&all, &states, GRAVITY, integrator, config).expect("bodies");
    bodies.set_joints(&joints).expect("joints");
    bodies
}

fn open(bodies: &RigidBodies, joints: usize) -> f64 {
    (0..joints).map(|joint| bodies.joint_errors(joint)[0]).fold(0.0, f64::max)
}

#[test]
fn joints_stay_closed_with_the_integrators_whose_positions_follow_the_impulses() {
    for (integrator, most) in
        [(Integrator::Symplectic, 1e-10), (Integrator::RungeKutta4, 1e-10), (Integrator::ExplicitEuler, 1e-3)]
    {
        let mut bodies = chain(&[0.01, 0.02, 0.01], integrator);
        let mut worst = 0.0_f64;
        for _ in 0..1000 {
            bodies.step(1e-3, &[], &[]).expect("a step");
            worst = worst.max(open(&bodies, 3));
        }
        println!("{integrator:?}: open by {worst:.2e} m");
        assert!(worst < most, "{integrator:?}: {worst:.2e} m");
        assert!(integrator != Integrator::ExplicitEuler || worst > 1e-7, "it moves before it is solved");
    }
}

/// A body is put elsewhere: it comes back without being thrown.
#[test]
fn a_joint_that_was_torn_open_closes_gently() {
    let mut bodies = chain(&[0.01], Integrator::Symplectic);
    let far = RigidState { position: Point3::new(0.01, 0.05, 0.0), ..bodies.states()[0] };
    bodies.place(0, far).expect("a body");
    let (mut fastest, mut before) = (0.0_f64, open(&bodies, 1));
    for step in 0..400 {
        bodies.step(1e-3, &[], &[]).expect("a step");
        let now = open(&bodies, 1);
        assert!(now <= before + 1e-12, "step {step}: {now} after {before}");
        before = now;
        fastest = fastest.max((bodies.states()[0].momentum / 0.01).norm());
    }
    println!("open by {before:.2e} m, up to {fastest:.3} m/s");
    assert!(before < 1e-8, "{before:.2e} m");
    // It falls and swings meanwhile, no faster than a fall of twice the length.
    assert!(fastest < (2.0_f64 * 9.81 * 0.04).sqrt(), "{fastest} m/s");
}

/// A table holds up the end of a horizontal chain: joints and contacts are in balance.
#[test]
fn what_hangs_between_a_joint_and_a_table_is_borne_by_both() {
    let mut bodies = chain(&[0.02], Integrator::Symplectic);
    for _ in 0..500 {
        let depth = -bodies.states()[0].position.z;
        let contact = RigidContact {
            body: 0,
            other: None,
            point_in_world: Point3::new(0.02, 0.0, 0.0),
            normal_in_world: Vector3::z(),
            depth,
            friction: 0.0,
            restitution: 0.0,
            surface_velocity: Vector3::zeros(),
        };
        bodies.step(1e-3, &[], &[contact]).expect("a step");
    }
    let half = 0.5 * 0.02 * 9.81;
    let (joint, table) = (bodies.joint_impulses()[0].impulse / 1e-3, bodies.impulses()[0].impulse / 1e-3);
    println!("joint {joint:?}, table {table:?}");
    assert!((joint.z / half - 1.0).abs() < 1e-4 && (table.z / half - 1.0).abs() < 1e-4);
    assert!(open(&bodies, 1) < 1e-8);
}

#[test]
fn joints_that_join_nothing_or_too_much_are_refused() {
    let mut bodies = chain(&[0.01, 0.01], Integrator::Symplectic);
    let joint = BodyJoint {
        body: 0,
        body_from_joint: Isometry3::identity(),
        other: JointEnd::World([Isometry3::identity(); 2]),
        kind: JointKind::Fixed,
    };
    let to = |body: u32| JointEnd::Body { body, body_from_joint: Isometry3::identity() };
    for wrong in [
        BodyJoint { body: 2, ..joint },
        BodyJoint { other: to(2), ..joint },
        BodyJoint { other: to(0), ..joint },
        BodyJoint { body_from_joint: Isometry3::translation(f64::NAN, 0.0, 0.0), ..joint },
    ] {
        assert!(matches!(bodies.set_joints(&[joint, wrong]), Err(RigidError::Joint { joint: 1, bodies: 2 })));
    }
    // Sixty welds of one body say the same sixty times: the impulse is shared, nothing else changes.
    bodies.set_joints(&[joint; 60]).expect("joints");
    bodies.step(1e-3, &[], &[]).expect("a step");
    let all: Vector3<f64> = bodies.joint_impulses().iter().map(|of| of.impulse).sum();
    assert!((all.z / (0.01 * 9.81e-3) - 1.0).abs() < 1e-9, "{all}");
    assert!(matches!(bodies.set_joints(&[joint; 200]), Err(RigidError::Joints { .. })));
}

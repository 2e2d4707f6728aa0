//! Tests of touch at a station. `ui/cli/tests/network/stations.rs` has whole sessions.

use trocar_scene::components::{Motion, Pose, RigidBody, Shape};
use trocar_scene::{Commands, EntityAllocator, Registry, SCENARIO_SPAWNER, Store};

use super::*;

fn plane(z: f64, normal_in_world: Vector3<f64>) -> ContactPlane {
    let point_in_world = Point3::new(0.01, 0.0, z);
    ContactPlane { point_in_world, normal_in_world, stiffness: 800.0, damping: 1.0, friction: 0.3 }
}

/// A plate that never moves, whose top is z = 0, and a ball above it that does.
fn plate_and_ball() -> (Store, Commands, Entity) {
    let registry = Registry::standard();
    let mut out = Commands::new(registry.clone(), EntityAllocator::new(0, SCENARIO_SPAWNER));
    let (plate, ball) = (out.spawn(), out.spawn());
    out.put(plate, Shape::Box { half_extents: [0.05, 0.05, 0.01] });
    out.put(plate, RigidBody::default());
    out.put(plate, Pose::at(0.0, 0.0, -0.01));
    out.put(ball, Shape::Sphere { radius: 0.01 });
    out.put(ball, RigidBody { motion: Motion::Dynamic, ..RigidBody::default() });
    out.put(ball, Pose::at(0.0, 0.0, 0.02));
    let mut store = Store::new(registry);
    out.seal();
    store.apply(&mut out, SimTime::ZERO);
    out.clear();
    (store, out, plate)
}

#[test]
fn only_what_never_moves_is_met_and_it_is_read_again_when_it_is_elsewhere() {
    let (mut store, mut out, plate) = plate_and_ball();
    let mut bodies = StaticBodies::new(&store.snapshot());
    let near = bodies.nearest(&Point3::new(0.01, 0.0, 0.002), 0.004).expect("the plate");
    assert!((near.point_in_world - Point3::new(0.01, 0.0, 0.0)).norm() < 1e-12);
    assert!((near.outwards_in_world - Vector3::z()).norm() < 1e-12);
    assert_eq!(bodies.nearest(&Point3::new(0.0, 0.0, 0.0095), 0.004), None, "the ball yields");
    out.put(plate, Pose::at(0.0, 0.0, -0.02));
    out.seal();
    store.apply(&mut out, SimTime::from_millis(1));
    bodies.follow(&store.snapshot());
    assert_eq!(bodies.nearest(&Point3::new(0.01, 0.0, 0.002), 0.004), None);
    assert!(bodies.nearest(&Point3::new(0.01, 0.0, -0.008), 0.004).is_some());
}

#[test]
fn a_wall_of_the_hosts_says_how_far_above_it_the_tip_is_stopped_and_only_there() {
    let (store, ..) = plate_and_ball();
    let bodies = StaticBodies::new(&store.snapshot());
    let wall = touched_wall(&plane(0.0015, Vector3::z()), &bodies).expect("the plate's");
    assert!((wall.standoff - 0.0015).abs() < 1e-12);
    assert_eq!(touched_wall(&plane(0.0015, Vector3::x()), &bodies), None, "of something else");
    assert_eq!(touched_wall(&plane(0.01, Vector3::z()), &bodies), None, "too far from the plate");
    assert!(wall.is(&plane(0.0, Vector3::z())));
    assert!(!wall.is(&plane(0.001, Vector3::z())) && !wall.is(&plane(0.0, Vector3::x())));
}

//! The parts of a peg-transfer bench are found, and what a scene lacks is named.

use nalgebra::{UnitQuaternion, Vector3};
use trocar_scene::*;
use trocar_tasks::peg_bench::{BenchError, find_hand, find_pegs, find_rings};

fn scene(fill: impl FnOnce(&mut Commands)) -> Snapshot {
    let registry = Registry::standard();
    let mut commands = Commands::new(registry.clone(), EntityAllocator::new(0, SCENARIO_SPAWNER));
    fill(&mut commands);
    commands.seal();
    let mut store = Store::new(registry);
    store.apply(&mut commands, SimTime::ZERO);
    store.snapshot()
}

fn ring(out: &mut Commands, tube_radius: f64, motion: Motion) -> Entity {
    let entity = out.spawn();
    out.put(entity, Name(format!("ring.{}", entity.counter())));
    out.put(entity, Shape::Torus { ring_radius: 0.01, tube_radius });
    out.put(entity, RigidBody { motion, ..RigidBody::default() });
    entity
}

fn board(out: &mut Commands, x: f64) {
    let entity = out.spawn();
    // A quarter turn about y: the pegs point along world x.
    let turn = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), std::f64::consts::FRAC_PI_2);
    out.put(entity, Pose::new(Vector3::new(x, 0.0, 0.0), turn));
    let pegs = vec![[0.0, 0.02]];
    out.put(
        entity,
        Shape::PegBoard {
            half_extents: [0.05, 0.05],
            thickness: 0.01,
            pegs,
            peg_radius: 0.002,
            peg_height: 0.02,
        },
    );
}

#[test]
fn rings_are_dynamic_tori_of_one_size() {
    let mut expected = Vec::new();
    let found = scene(|out| {
        expected.push(ring(out, 0.002, Motion::Dynamic));
        ring(out, 0.003, Motion::Static);
        expected.push(ring(out, 0.002, Motion::Dynamic));
    });
    let rings = find_rings(&found).expect("two rings");
    assert_eq!((rings.entities, rings.ring_radius, rings.tube_radius), (expected, 0.01, 0.002));

    let odd = scene(|out| {
        ring(out, 0.002, Motion::Dynamic);
        ring(out, 0.003, Motion::Dynamic);
    });
    assert_eq!(find_rings(&odd), Err(BenchError::RingSize("ring.2".to_owned())));
    assert_eq!(find_rings(&scene(|_| ())), Err(BenchError::NoRing));
}

#[test]
fn pegs_stand_on_two_boards_in_world() {
    let found = scene(|out| {
        board(out, 0.0);
        board(out, 1.0);
    });
    let pegs = find_pegs(&found).expect("two boards");
    assert_eq!(pegs.iter().map(|peg| peg.board).collect::<Vec<_>>(), [0, 1]);
    assert!((pegs[1].foot_in_world.coords - Vector3::new(1.0, 0.02, 0.0)).norm() < 1e-12, "{:?}", pegs[1]);
    assert!((pegs[1].axis_in_world - Vector3::x()).norm() < 1e-12, "{:?}", pegs[1]);
    assert_eq!((pegs[0].height, pegs[0].radius), (0.02, 0.002));
    let error = find_pegs(&scene(|out| board(out, 0.0))).expect_err("one board");
    assert!(error.to_string().contains("1 peg_board shapes"), "{error}");
}

#[test]
fn a_missing_hand_is_named_by_its_side() {
    let error = find_hand(&scene(|_| ()), Side::Left).expect_err("no hand").to_string();
    assert_eq!(error, "the scene has no left hand");
}

//! Bodies and instruments against closed forms; determinism; what the world refuses.

use nalgebra::{Isometry3, UnitQuaternion, Vector3};
use proptest::prelude::*;
use trocar_dynamics::instrument::state::InstrumentState;
use trocar_dynamics::rigid_world::{World, WorldError};
use trocar_scene::components::{
    Instrument, InstrumentKind, InstrumentTarget, Motion, Pose, RigidBody, Shape, Velocity,
};
use trocar_scene::entity::Entity;
use trocar_scene::time::SimTime;

use super::common::*;
use super::{TOOLS_MAX, W, settings};

const BALL: Entity = Entity::new(0, 0, 50);

fn add_ball(world: &mut W, z: f64, restitution: f64) {
    let body = RigidBody { motion: Motion::Dynamic, mass: 0.01, restitution, ..RigidBody::default() };
    let shape = Shape::Sphere { radius: 0.005 };
    world.insert_body(BALL, &body, &shape, &Pose::at(0.0, 0.0, z), &Velocity::default()).unwrap();
}

fn steps(world: &mut W, count: usize) {
    (0..count).for_each(|_| world.step().unwrap());
}

#[test]
fn free_fall_follows_the_parabola() {
    let mut world = world();
    add_ball(&mut world, 1.0, 0.0);
    steps(&mut world, 200);
    let fallen = 1.0 - world.pose(BALL).unwrap().translation.z;
    // Semi-implicit Euler falls at most half a step of speed too far.
    assert!((fallen - 0.5 * 9.81 * 0.04).abs() < 9.81 * 0.2 * 0.001, "{fallen} m");
    assert!((world.velocity(BALL).unwrap().linear.z + 9.81 * 0.2).abs() < 1e-9);
}

#[test]
fn a_ball_bounces_to_the_square_of_its_restitution() {
    let mut world = world();
    let (drop, restitution) = (0.1, 0.7);
    let table = RigidBody { restitution, ..RigidBody::default() };
    let slab = Shape::Box { half_extents: [0.1, 0.1, 0.01] };
    world.insert_body(BOARDS[0], &table, &slab, &Pose::at(0.0, 0.0, -0.01), &Velocity::default()).unwrap();
    add_ball(&mut world, drop + 0.005, restitution);
    let (mut touched, mut apex) = (false, 0.0f64);
    for _ in 0..400 {
        world.step().unwrap();
        let z = world.pose(BALL).unwrap().translation.z - 0.005;
        touched |= world.velocity(BALL).unwrap().linear.z > 0.1;
        if touched && world.velocity(BALL).unwrap().linear.z > -0.2 {
            apex = apex.max(z);
        }
    }
    let expected = restitution * restitution * drop;
    println!("apex {:.2} mm, closed form {:.2} mm", apex * 1e3, expected * 1e3);
    assert!((apex / expected - 1.0).abs() < 0.05);
}

#[test]
fn a_rolling_sphere_accelerates_at_five_sevenths() {
    let tilt = 0.1f64;
    let settings = settings(Vector3::new(9.81 * tilt.sin(), 0.0, -9.81 * tilt.cos()), Some(0.0));
    let mut world = <W as World>::new(settings, SimTime::ZERO).unwrap();
    add_ball(&mut world, 0.005, 0.0);
    steps(&mut world, 100);
    let before = world.velocity(BALL).unwrap().linear.x;
    steps(&mut world, 200);
    let acceleration = (world.velocity(BALL).unwrap().linear.x - before) / 0.2;
    let expected = 5.0 / 7.0 * 9.81 * tilt.sin();
    println!("acceleration {acceleration:.4}, closed form {expected:.4} m/s2");
    assert!((acceleration / expected - 1.0).abs() < 0.01);
}

#[test]
fn a_kinematic_body_travels_and_pushes() {
    let mut world = world();
    add_boards(&mut world);
    let pusher = Entity::new(0, 0, 60);
    let body = RigidBody { motion: Motion::Kinematic, ..RigidBody::default() };
    let shape = Shape::Box { half_extents: [0.002, 0.02, 0.004] };
    world.insert_body(pusher, &body, &shape, &Pose::at(-0.06, 0.0, 0.0045), &Velocity::default()).unwrap();
    let ring = add_ring(&mut world, 0, Pose::at(-0.04, 0.0, TUBE_RADIUS), 0.5);
    for tick in 1..=10 {
        let pose = Pose::at(-0.06 + 0.0015 * f64::from(tick), 0.0, 0.0045);
        world.move_body(pusher, &pose, &Velocity::default(), 0.01).unwrap();
        steps(&mut world, 5);
        let halfway = world.pose(pusher).unwrap().translation.x;
        assert!((halfway - pose.translation.x + 0.00075).abs() < 1e-9, "it travels evenly");
        steps(&mut world, 5);
    }
    let front = -0.045 + 0.002;
    assert!((world.pose(pusher).unwrap().translation.x + 0.045).abs() < 1e-9);
    assert!(
        world.pose(ring).unwrap().translation.x - RING_RADIUS - TUBE_RADIUS > front - 2e-4,
        "pushed along"
    );
    assert!(world.penetration_max() < 1e-4);
}

#[test]
fn a_ring_dropped_over_a_peg_lands_around_it() {
    let mut world = world();
    add_boards(&mut world);
    let [x, y] = pegs(1)[4];
    // 3 mm off the axis: the hole is 6.5 mm, the peg 1 mm.
    let ring = add_ring(&mut world, 0, Pose::at(x + 0.003, y - 0.002, 0.03), 0.5);
    steps(&mut world, 600);
    let at = world.pose(ring).unwrap().translation;
    assert!((at.z - TUBE_RADIUS).abs() < 1e-4, "flat on the board: {} m", at.z);
    assert!(
        (at - Vector3::new(x, y, at.z)).norm() < RING_RADIUS - TUBE_RADIUS - 0.001 + 1e-4,
        "around the peg"
    );
    assert!(world.penetration_max() < 1e-4, "{}", world.penetration_max());
}

#[test]
fn rings_that_tumble_onto_the_board_do_not_sink_in() {
    let mut worst: f64 = 0.0;
    for k in 0..20 {
        let f = f64::from(k);
        let mut world = world();
        add_boards(&mut world);
        let turn = UnitQuaternion::from_euler_angles(0.4 * (0.7 * f).sin(), 0.5 * (1.3 * f).cos(), f);
        add_ring(&mut world, 0, Pose::new(Vector3::new(-0.026, 0.0, 0.01 + 0.0015 * f), turn), 0.5);
        steps(&mut world, 250);
        worst = worst.max(world.penetration_max());
    }
    println!("deepest penetration of 20 tumbling rings: {:.4} mm", worst * 1e3);
    assert!(worst < 5e-5);
}

#[test]
fn a_ring_dropped_onto_the_tip_of_a_peg_does_not_pass_through_it() {
    let mut world = world();
    add_boards(&mut world);
    let [x, y] = pegs(1)[4];
    let ring = add_ring(&mut world, 0, Pose::at(x + RING_RADIUS, y, 0.05), 0.5);
    for _ in 0..1000 {
        world.step().unwrap();
    }
    let at = world.pose(ring).unwrap().translation;
    println!("came to rest at {at:.4?}, penetration {:.4} mm", world.penetration_max() * 1e3);
    assert!(at.z > 0.0 && world.penetration_max() < 2e-4);
}

#[test]
fn a_ring_dropped_beside_the_boards_rests_on_the_floor() {
    let mut world = world();
    add_boards(&mut world);
    let ring = add_ring(&mut world, 0, Pose::at(0.0, 0.08, 0.02), 0.5);
    steps(&mut world, 1500);
    assert!((world.pose(ring).unwrap().translation.z - (-0.05 + TUBE_RADIUS)).abs() < 1e-4);
    assert!(world.is_sleeping(ring));
}

#[test]
fn resting_rings_sleep_and_wake_by_touch() {
    let mut world = world();
    add_boards(&mut world);
    add_rings(&mut world);
    steps(&mut world, 1000);
    assert!((0..6).all(|index| world.is_sleeping(ring_entity(index))));
    let [x, y] = pegs(0)[0];
    // A closed instrument pushes the first ring aside.
    let mut hands =
        [TestHand::new(&mut world, LEFT, &Instrument::default(), pointing_down(x - 0.015, y, 0.001), 0.0)];
    run(&mut world, &mut hands, 0.5, |_, _, hand| hand.tip.translation.vector.x += 1e-5, no_watch);
    assert!(!world.is_sleeping(ring_entity(0)));
    assert!(world.pose(ring_entity(0)).unwrap().translation.x > x + 1e-4);
    assert!(world.is_sleeping(ring_entity(5)), "the others sleep on");
}

#[test]
fn a_pressed_board_feels_as_stiff_as_the_coupling() {
    let mut world = world();
    add_boards(&mut world);
    let mut hands =
        [TestHand::new(&mut world, LEFT, &Instrument::default(), pointing_down(-0.026, 0.0, 0.002), 0.0)];
    let mut felt = Vec::new();
    for depth in [0.001, 0.002, 0.003] {
        run(&mut world, &mut hands, 0.3, |_, _, hand| hand.tip.translation.vector.z = -depth, no_watch);
        world.take_wrench_on_hand(LEFT);
        run(&mut world, &mut hands, 0.1, hold_still, no_watch);
        felt.push(world.take_wrench_on_hand(LEFT).unwrap().force.z);
    }
    let stiffness = (felt[2] - felt[0]) / 0.002;
    println!("felt {felt:.3?} N: {stiffness:.1} N/m, penetration {:.4} mm", world.penetration_max() * 1e3);
    assert!((stiffness / 1000.0 - 1.0).abs() < 0.02);
    assert!(world.penetration_max() < 1e-4);
}

#[test]
fn any_jump_of_the_target_stays_bounded() {
    let mut world = world();
    add_boards(&mut world);
    add_rings(&mut world);
    let mut hands =
        [TestHand::new(&mut world, LEFT, &Instrument::default(), pointing_down(-0.04, 0.0, 0.05), 0.5)];
    let mut force_max: f64 = 0.0;
    for k in 0..40 {
        let (x, z) = (if k % 2 == 0 { -0.1 } else { 0.1 }, if k % 3 == 0 { -0.05 } else { 0.05 });
        let tilt = Isometry3::rotation(Vector3::new(0.7 * f64::from(k % 5), 0.3, 0.0));
        run(
            &mut world,
            &mut hands,
            0.05,
            |_, _, hand| hand.tip = pointing_down(x, 0.0, z) * tilt,
            |world, _| {
                force_max = force_max.max(world.take_wrench_on_hand(LEFT).unwrap().force.norm());
            },
        );
        let state = world.tool(LEFT).unwrap().state;
        assert!(state.velocity.linear.norm() < 10.0 && state.tip_in_world.translation.vector.norm() < 1.0);
    }
    assert!(force_max <= 20.0 + 1e-9, "{force_max} N");
    run(&mut world, &mut hands, 0.5, |_, _, hand| hand.tip = pointing_down(0.0, 0.0, 0.08), no_watch);
    let state = world.tool(LEFT).unwrap().state;
    assert!(
        (state.tip_in_world.translation.vector - Vector3::new(0.0, 0.0, 0.08)).norm() < 1e-4,
        "it recovers"
    );
}

#[test]
fn two_instruments_do_not_pass_through_each_other() {
    let mut world = world();
    let mut hands = [
        TestHand::new(&mut world, LEFT, &Instrument::default(), pointing_down(-0.02, 0.0, 0.1), 0.0),
        TestHand::new(&mut world, RIGHT, &Instrument::default(), pointing_down(0.02, 0.0, 0.1), 0.0),
    ];
    let plan = |index: usize, t: f64, hand: &mut TestHand| {
        let side = if index == 0 { 1.0 } else { -1.0 };
        hand.tip.translation.vector.x = side * (-0.02 + 0.023 * minimum_jerk(t, 0.5));
    };
    run(&mut world, &mut hands, 0.7, plan, no_watch);
    let (left, right) = (world.pose(LEFT).unwrap().translation, world.pose(RIGHT).unwrap().translation);
    assert!(left.x < right.x, "each stays on its own side");
    let forces = [LEFT, RIGHT].map(|hand| world.take_wrench_on_hand(hand).unwrap().force.x);
    assert!(world.penetration_max() < 1e-4, "{}", world.penetration_max());
    println!("forces {forces:?}");
}

/// A fixed play with everything in it, down to bits.
fn played(steps: usize) -> Vec<u64> {
    let mut world = world();
    add_boards(&mut world);
    add_rings(&mut world);
    let [x, y] = pegs(0)[2];
    let mut hands = [
        TestHand::new(
            &mut world,
            LEFT,
            &Instrument::default(),
            pointing_down(x + RING_RADIUS, y, 0.0005),
            0.5,
        ),
        TestHand::new(&mut world, RIGHT, &Instrument::default(), pointing_down(0.03, 0.0, 0.05), 0.5),
    ];
    let plan = |index: usize, t: f64, hand: &mut TestHand| {
        if index == 0 {
            hand.jaw_angle = if t > 0.1 { 0.0 } else { 0.5 };
            hand.tip.translation.vector.z = 0.0005 + 0.03 * minimum_jerk(t - 0.3, 0.3);
        } else {
            hand.tip.translation.vector.y = 0.01 * (10.0 * t).sin();
        }
    };
    run(&mut world, &mut hands, steps as f64 * 0.001, plan, no_watch);
    let mut bits = Vec::new();
    for entity in (0..6).map(ring_entity).chain([LEFT, RIGHT]) {
        let (pose, velocity) = (world.pose(entity).unwrap(), world.velocity(entity).unwrap());
        let numbers =
            pose.translation.iter().chain(pose.rotation.coords.iter()).chain(velocity.linear.iter());
        bits.extend(numbers.map(|number| number.to_bits()));
    }
    bits
}

#[test]
fn the_same_play_gives_the_same_bits() {
    assert_eq!(played(800), played(800));
}

#[test]
fn a_removed_body_is_gone_and_what_lay_on_it_falls() {
    let mut world = world();
    add_boards(&mut world);
    let ring = add_ring(&mut world, 0, Pose::at(-0.04, 0.0, TUBE_RADIUS), 0.5);
    steps(&mut world, 700);
    assert!(world.is_sleeping(ring));
    assert!(world.remove(BOARDS[0]));
    assert!(!world.remove(BOARDS[0]));
    steps(&mut world, 300);
    assert!(world.pose(ring).unwrap().translation.z < -0.03);
}

#[test]
fn bad_bodies_are_refused_by_name() {
    let mut world = world();
    let mut refused = |body: RigidBody, shape: Shape, pose: Pose| {
        world.insert_body(BALL, &body, &shape, &pose, &Velocity::default()).unwrap_err().to_string()
    };
    let body = |mass| RigidBody { motion: Motion::Dynamic, mass, ..RigidBody::default() };
    let ball = Shape::Sphere { radius: 0.01 };
    assert!(refused(body(-1.0), ball.clone(), Pose::default()).contains("mass"));
    assert!(refused(body(f64::NAN), ball.clone(), Pose::default()).contains("rigid_body"));
    assert!(refused(body(0.01), Shape::Sphere { radius: 0.0 }, Pose::default()).contains("radius"));
    assert!(
        refused(body(0.01), Shape::Torus { ring_radius: 0.001, tube_radius: 0.002 }, Pose::default())
            .contains("ring_radius")
    );
    assert!(refused(body(0.01), ball.clone(), Pose::at(f64::NAN, 0.0, 0.0)).contains("pose"));
    assert!(refused(body(0.01), ball, Pose::at(f64::INFINITY, 0.0, 0.0)).contains("0:0:50"));
}

#[test]
fn bad_instruments_and_targets_are_refused() {
    let mut world = world();
    let bad = Instrument { mass: -1.0, ..Instrument::default() };
    assert!(matches!(
        world.insert_tool(LEFT, &bad, &InstrumentState::default(), None),
        Err(WorldError::InvalidComponent { component: "instrument", .. })
    ));
    let target = InstrumentTarget::default();
    assert_eq!(world.set_target(LEFT, target), Err(WorldError::Unknown { entity: LEFT }));
    world.insert_tool(LEFT, &Instrument::default(), &InstrumentState::default(), None).unwrap();
    let nan = InstrumentTarget { jaw_angle: f64::NAN, ..target };
    assert!(world.set_target(LEFT, nan).is_err());
    for index in 0..TOOLS_MAX as u32 - 1 {
        let entity = Entity::new(0, 0, 100 + index);
        world.insert_tool(entity, &Instrument::default(), &InstrumentState::default(), None).unwrap();
    }
    let entity = Entity::new(0, 0, 200);
    assert_eq!(
        world.insert_tool(entity, &Instrument::default(), &InstrumentState::default(), None),
        Err(WorldError::TooManyInstruments { entity, max: TOOLS_MAX })
    );
}

#[test]
fn a_probe_has_no_jaws_and_pushes_with_its_tip() {
    let mut world = world();
    add_boards(&mut world);
    let probe = Instrument { kind: InstrumentKind::Probe, ..Instrument::default() };
    let mut hands = [TestHand::new(&mut world, LEFT, &probe, pointing_down(-0.026, 0.0, 0.01), 0.0)];
    let plan = |_: usize, t: f64, hand: &mut TestHand| {
        hand.tip.translation.vector.z = 0.01 - 0.011 * minimum_jerk(t, 0.3);
    };
    run(&mut world, &mut hands, 0.5, plan, no_watch);
    world.take_wrench_on_hand(LEFT);
    run(&mut world, &mut hands, 0.1, hold_still, no_watch);
    let force = world.take_wrench_on_hand(LEFT).unwrap().force;
    assert!((force.z - 1.0).abs() < 0.02, "1 mm below the board at 1,000 N/m: {force}");
    assert!(world.pose(LEFT).unwrap().translation.z.abs() < 1e-4);
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 48, ..ProptestConfig::default() })]

    /// Whatever is accepted can be stepped; nothing panics.
    #[test]
    fn whatever_is_accepted_stays_finite(
        mass in prop_oneof![Just(-1.0), Just(f64::NAN), 1e-6..1e3f64],
        sizes in prop::array::uniform3(prop_oneof![Just(0.0), Just(-0.01), Just(f64::INFINITY), 1e-5..1.0f64]),
        kind in 0..5usize,
        speed in -100.0..100.0f64,
        spin in -1e3..1e3f64,
    ) {
        let [a, b, c] = sizes;
        let shape = match kind {
            0 => Shape::Box { half_extents: sizes },
            1 => Shape::Sphere { radius: a },
            2 => Shape::Cylinder { radius: a, half_height: b },
            3 => Shape::Capsule { radius: a, half_height: c },
            _ => Shape::Torus { ring_radius: a, tube_radius: b },
        };
        let mut world = world();
        add_boards(&mut world);
        let body = RigidBody { motion: Motion::Dynamic, mass, ..RigidBody::default() };
        let velocity = Velocity { linear: Vector3::new(0.0, 0.0, speed), angular: Vector3::new(spin, 0.0, 0.0) };
        if world.insert_body(BALL, &body, &shape, &Pose::at(0.0, 0.0, 0.02), &velocity).is_ok() {
            for _ in 0..20 {
                if world.step().is_err() {
                    break;
                }
                prop_assert!(world.pose(BALL).unwrap().translation.iter().all(|x| x.is_finite()));
            }
        }
    }
}

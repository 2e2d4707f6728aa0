//! Grasping by friction: what holds, what slips, what falls, and what two hands feel of one ring.

use super::W;
use super::common::*;
use nalgebra::{Isometry3, Vector3};
use trocar_dynamics::rigid_world::World;
use trocar_scene::components::{Instrument, Motion, Pose, RigidBody, Shape, Velocity};
use trocar_scene::entity::Entity;

const WEIGHT: f64 = RING_MASS * 9.81;

fn instrument(force: f64, friction: f64) -> Instrument {
    Instrument { jaw_force_max: force, jaw_friction: friction, ..Instrument::default() }
}

/// Grasps a ring that lies on the board, lifts it by 30 mm and waits. The world, the ring and the hand.
fn lifted(instrument: &Instrument, ring_friction: f64) -> (W, Entity, TestHand) {
    let mut world = world();
    add_boards(&mut world);
    let ring = add_ring(&mut world, 0, Pose::at(-0.04, 0.0, TUBE_RADIUS), ring_friction);
    let mut hands = [grasp_ring(&mut world, LEFT, instrument, [-0.04, 0.0], 0.0005)];
    lift(&mut world, &mut hands);
    (world, ring, hands[0])
}

fn lift(world: &mut W, hands: &mut [TestHand]) {
    let start: Vec<_> = hands.iter().map(|hand| hand.tip).collect();
    let plan = |index: usize, t: f64, hand: &mut TestHand| {
        hand.tip.translation.vector.z = start[index].translation.vector.z + 0.03 * minimum_jerk(t, 0.5);
    };
    run(world, hands, 0.5, plan, no_watch);
    run(world, hands, 0.2, hold_still, no_watch);
}

/// `instrument_from_ring` of the left instrument.
fn relative_pose(world: &W, ring: Entity) -> Isometry3<f64> {
    world.pose(LEFT).unwrap().isometry().inverse() * world.pose(ring).unwrap().isometry()
}

fn height(world: &W, ring: Entity) -> f64 {
    world.pose(ring).unwrap().translation.z
}

#[test]
fn friction_alone_lifts_and_holds_a_shaken_ring() {
    for (force, friction) in [(1.0, 0.3), (1.0, 0.6), (1.5, 0.5), (2.0, 0.5), (5.0, 0.5)] {
        let (mut world, ring, hand) = lifted(&instrument(force, friction), friction);
        let held = relative_pose(&world, ring);
        assert_eq!(
            world.tool(LEFT).unwrap().hold.map(|hold| (hold.held, hold.assisted)),
            Some((ring, false))
        );
        let center = hand.tip.translation.vector;
        let mut slip: f64 = 0.0;
        // 5 Hz, 5 mm either way and 10 mm upwards: half of gravity in both directions.
        let plan = |_: usize, t: f64, hand: &mut TestHand| {
            let (phase, swing) = (std::f64::consts::TAU * 5.0 * t, 0.005 * minimum_jerk(t, 0.4));
            hand.tip.translation.vector = center + Vector3::new(phase.sin(), 0.0, 1.0 - phase.cos()) * swing;
        };
        run(&mut world, &mut [hand], 2.0, plan, |world, _| {
            let now = relative_pose(world, ring);
            slip = slip.max((now.translation.vector - held.translation.vector).norm());
        });
        let penetration = world.penetration_max();
        println!(
            "{force} N jaws, friction {friction}: slip {:.3} mm, penetration {:.4} mm",
            slip * 1e3,
            penetration * 1e3
        );
        assert!(height(&world, ring) > 0.02, "the ring is held");
        assert!(slip < 5e-4, "slip of {slip} m");
        assert!(penetration < 1e-4, "penetration of {penetration} m");
    }
}

#[test]
fn without_friction_the_ring_stays_on_the_board() {
    let (world, ring, _) = lifted(&instrument(1.5, 0.0), 0.5);
    println!("ring at {:.2} mm", height(&world, ring) * 1e3);
    assert!(height(&world, ring) < 0.003);
    assert_eq!(world.tool(LEFT).unwrap().hold, None);
}

#[test]
fn with_one_jaw_the_ring_stays_on_the_board() {
    let (world, ring, _) = lifted(&Instrument { jaws: 1, ..instrument(1.5, 0.6) }, 0.5);
    println!("ring at {:.2} mm", height(&world, ring) * 1e3);
    assert!(height(&world, ring) < 0.003);
    assert_eq!(world.tool(LEFT).unwrap().hold, None);
}

#[test]
fn opening_the_jaws_drops_the_ring() {
    let (mut world, ring, hand) = lifted(&instrument(1.5, 0.6), 0.5);
    run(&mut world, &mut [hand], 1.0, |_, _, hand| hand.jaw_angle = 0.5, no_watch);
    assert!(height(&world, ring) < 0.003);
    assert_eq!(world.tool(LEFT).unwrap().hold, None);
}

#[test]
fn a_hand_feels_the_weight_that_it_lifts() {
    let (mut world, _, hand) = lifted(&instrument(1.5, 0.6), 0.5);
    world.take_wrench_on_hand(LEFT);
    run(&mut world, &mut [hand], 0.5, hold_still, no_watch);
    let wrench = world.take_wrench_on_hand(LEFT).unwrap();
    println!("weight {WEIGHT:.5} N, felt {:.5} N, torque {:.2e} N m", -wrench.force.z, wrench.torque.norm());
    assert!((wrench.force.z + WEIGHT).abs() < 0.02 * WEIGHT);
    assert!(wrench.force.xy().norm() < 0.05 * WEIGHT);
    // The ring's centre hangs 8 mm beside the tip.
    assert!((wrench.torque.norm() - WEIGHT * RING_RADIUS).abs() < 0.15 * WEIGHT * RING_RADIUS);
}

/// One ring in both hands, each at its own side, 30 mm up.
fn ring_in_two_hands(instrument: &Instrument) -> (W, Entity, [TestHand; 2]) {
    let mut world = world();
    add_boards(&mut world);
    let ring = add_ring(&mut world, 0, Pose::at(-0.04, 0.0, TUBE_RADIUS), 0.5);
    let mut hands = [(LEFT, -RING_RADIUS), (RIGHT, RING_RADIUS)].map(|(entity, x)| {
        TestHand::new(&mut world, entity, instrument, pointing_down(-0.04 + x, 0.0, 0.0005), 0.5)
    });
    run(&mut world, &mut hands, 0.1, hold_still, no_watch);
    run(&mut world, &mut hands, 0.4, |_, _, hand| hand.jaw_angle = 0.0, no_watch);
    lift(&mut world, &mut hands);
    (world, ring, hands)
}

fn mean_forces(world: &mut W, hands: &mut [TestHand], secs: f64) -> [Vector3<f64>; 2] {
    for hand in hands.iter() {
        world.take_wrench_on_hand(hand.entity);
    }
    run(world, hands, secs, hold_still, no_watch);
    [LEFT, RIGHT].map(|entity| world.take_wrench_on_hand(entity).unwrap().force)
}

#[test]
fn two_hands_share_the_weight_of_one_ring() {
    let (mut world, ring, mut hands) = ring_in_two_hands(&instrument(1.5, 0.6));
    for entity in [LEFT, RIGHT] {
        assert_eq!(world.tool(entity).unwrap().hold.map(|hold| hold.held), Some(ring));
    }
    let [left, right] = mean_forces(&mut world, &mut hands, 0.5);
    let sum = left + right;
    println!(
        "left {left:.4?}, right {right:.4?}, sum of vertical forces {:.3} of the weight",
        -sum.z / WEIGHT
    );
    assert!((sum.z + WEIGHT).abs() < 0.05 * WEIGHT);
}

#[test]
fn pulling_apart_is_felt_alike_by_both_hands() {
    for assist in [false, true] {
        let build = Instrument { grasp_assist: assist, ..instrument(1.5, 0.6) };
        let (mut world, ring, mut hands) = ring_in_two_hands(&build);
        let start = hands.map(|hand| hand.tip.translation.vector.x);
        let pull = |index: usize, t: f64, hand: &mut TestHand| {
            let outwards = if index == 0 { -0.001 } else { 0.001 };
            hand.tip.translation.vector.x = start[index] + outwards * minimum_jerk(t, 0.3);
        };
        run(&mut world, &mut hands, 0.4, pull, no_watch);
        let [left, right] = mean_forces(&mut world, &mut hands, 0.2);
        println!("assist {assist}: left {:.4} N, right {:.4} N", left.x, right.x);
        assert!(left.x > 0.4 && right.x < -0.4, "both are pulled inwards");
        assert!((left.x + right.x).abs() < 0.02 * left.x.abs());
        assert!(height(&world, ring) > 0.02);
    }
}

#[test]
fn the_grasp_constraint_forms_by_opposing_contacts_and_breaks_above_its_force() {
    let build = Instrument { grasp_assist: true, grasp_break_force: 2.0, ..instrument(0.5, 0.2) };
    let (mut world, ring, mut hands) = ring_in_two_hands(&build);
    for entity in [LEFT, RIGHT] {
        assert!(world.tool(entity).unwrap().hold.unwrap().assisted, "formed");
    }
    // Friction alone carries 0.2 N per hand; 1 mm pulls with 1 N.
    let start = hands.map(|hand| hand.tip.translation.vector.y);
    let pull = |reach: f64| {
        move |index: usize, t: f64, hand: &mut TestHand| {
            let outwards = if index == 0 { -reach } else { reach };
            hand.tip.translation.vector.y = start[index] + outwards * minimum_jerk(t, 0.3);
        }
    };
    run(&mut world, &mut hands, 0.4, pull(0.0005), no_watch);
    assert!([LEFT, RIGHT].iter().all(|hand| world.tool(*hand).unwrap().hold.unwrap().assisted), "holds");
    let mut force_max: f64 = 0.0;
    let mut torn_at = None;
    run(&mut world, &mut hands, 1.0, pull(0.012), |world, t| {
        let assisted = [LEFT, RIGHT]
            .iter()
            .all(|hand| world.tool(*hand).unwrap().hold.is_some_and(|hold| hold.assisted));
        if !assisted && torn_at.is_none() {
            torn_at = Some(t);
        }
        force_max = force_max.max(world.take_wrench_on_hand(LEFT).unwrap().force.norm());
    });
    println!("torn after {torn_at:?} s at up to {force_max:.2} N");
    assert!(torn_at.is_some());
    assert!(force_max > 1.5 && force_max < 5.0);
    assert!(world.pose(ring).unwrap().translation.norm() < 0.2, "nothing was flung away");
}

#[test]
fn the_grasp_constraint_lets_go_when_the_jaws_open() {
    let build = Instrument { grasp_assist: true, ..instrument(1.5, 0.6) };
    let (mut world, ring, hand) = lifted(&build, 0.5);
    assert!(world.tool(LEFT).unwrap().hold.unwrap().assisted);
    run(&mut world, &mut [hand], 1.0, |_, _, hand| hand.jaw_angle = 0.5, no_watch);
    assert!(height(&world, ring) < 0.003);
}

#[test]
fn the_grasp_constraint_needs_two_jaws() {
    let build = Instrument { grasp_assist: true, jaws: 1, ..instrument(1.5, 0.6) };
    let (world, ring, _) = lifted(&build, 0.5);
    assert!(height(&world, ring) < 0.003);
}

/// A block on a table, and jaws of 10 mm that close about it and lift it by 40 mm.
#[derive(Clone, Copy, Debug)]
struct BlockGrasp {
    jaw_force: f64,
    mass: f64,
    friction: f64,
    /// Half of the block's width between the jaws \[m\]: at 1.5 mm the pads are parallel, wider ones wedge it out.
    half_width: f64,
}

/// What became of a block.
#[derive(Clone, Copy, Debug)]
struct BlockGrasped {
    is_held: bool,
    /// How far the jaws threw it aside while they closed, how far it slipped in them after they closed, and how far in
    /// the last 0.3 s \[m\].
    thrown: f64,
    slipped: f64,
    creeps: f64,
    /// How deep the jaws were in it \[m\].
    penetration: f64,
}

impl BlockGrasp {
    fn run(self) -> BlockGrasped {
        let block = Entity::new(0, 0, 40);
        let mut world = world();
        let table = RigidBody { friction: 0.5, ..RigidBody::default() };
        let slab = Shape::Box { half_extents: [0.1, 0.1, 0.005] };
        world
            .insert_body(BOARDS[0], &table, &slab, &Pose::at(0.0, 0.0, -0.005), &Velocity::default())
            .unwrap();
        let body = RigidBody {
            motion: Motion::Dynamic,
            mass: self.mass,
            friction: self.friction,
            ..RigidBody::default()
        };
        let shape = Shape::Box { half_extents: [self.half_width, 0.004, 0.004] };
        world.insert_body(block, &body, &shape, &Pose::at(0.0, 0.0, 0.004), &Velocity::default()).unwrap();
        let jaws =
            Instrument { jaw_length: 0.01, jaw_angle_max: 1.2, ..instrument(self.jaw_force, self.friction) };
        let mut hands = [TestHand::new(&mut world, LEFT, &jaws, pointing_down(0.0, 0.0, 0.003), 1.0)];
        let mut penetration: f64 = 0.0;
        let mut watch = |world: &mut W, _: f64| {
            let held = |pair: [Entity; 2]| pair.contains(&LEFT) && pair.contains(&block);
            let depths = world.contacts().iter().filter(|at| held([at.a.0, at.b.0])).map(|at| at.depth);
            penetration = depths.fold(penetration, f64::max);
        };
        run(&mut world, &mut hands, 0.5, |_, t, hand| hand.jaw_angle = 1.0 - 2.0 * t, &mut watch);
        run(&mut world, &mut hands, 0.1, hold_still, &mut watch);
        let thrown = world.pose(block).unwrap().translation.xy().norm();
        let begin = relative_pose(&world, block).translation.vector;
        let raise = |_: usize, t: f64, hand: &mut TestHand| {
            hand.tip.translation.vector.z = 0.003 + 0.04 * minimum_jerk(t, 0.5);
        };
        run(&mut world, &mut hands, 0.6, raise, &mut watch);
        let lifted = relative_pose(&world, block).translation.vector;
        run(&mut world, &mut hands, 0.3, hold_still, &mut watch);
        let end = relative_pose(&world, block).translation.vector;
        BlockGrasped {
            is_held: height(&world, block) > 0.03,
            thrown,
            slipped: (end - begin).norm(),
            creeps: (end - lifted).norm(),
            penetration,
        }
    }
}

#[test]
fn jaws_of_any_force_hold_a_block_that_friction_can_bear() {
    let grasp = |jaw_force, mass, friction, half_width| BlockGrasp { jaw_force, mass, friction, half_width };
    for grasp in [
        grasp(0.5, 0.005, 0.6, 0.003),
        grasp(5.0, 0.005, 0.6, 0.003),
        grasp(20.0, 0.005, 0.6, 0.003),
        grasp(50.0, 0.005, 1.0, 0.003),
        grasp(50.0, 0.001, 0.6, 0.003),
        grasp(20.0, 0.05, 0.3, 0.0015),
        grasp(50.0, 0.001, 0.3, 0.0015),
    ] {
        let found = grasp.run();
        println!("{grasp:?}: {found:?}");
        assert!(found.is_held, "{grasp:?}: {found:?}");
        assert!(found.thrown < 3e-4, "{grasp:?}: {found:?}");
        assert!(found.slipped < 2e-4, "{grasp:?}: {found:?}");
        assert!(found.creeps < 3e-5, "{grasp:?}: {found:?}");
        assert!(found.penetration < 2e-4, "{grasp:?}: {found:?}");
    }
}

#[test]
fn a_block_is_lifted_from_one_and_a_half_of_the_force_that_friction_needs_and_stays_below_it() {
    // Pads that are parallel press along x only, so that friction holds 2 μ N. The drive's torque F L is borne at most
    // L − 2 mm from the hinge, where the pads begin: N is at least F, and at most F L / (L − 8 mm) = 5 F.
    let (mass, friction) = (0.05, 0.3);
    let needed = mass * 9.81 / (2.0 * friction);
    for (times, is_lifted) in [(1.5, true), (1.0 / 5.5, false)] {
        let grasp = BlockGrasp { jaw_force: times * needed, mass, friction, half_width: 0.0015 };
        let found = grasp.run();
        println!("{times} of the force: {found:?}");
        assert_eq!(found.is_held, is_lifted, "{grasp:?}: {found:?}");
    }
}

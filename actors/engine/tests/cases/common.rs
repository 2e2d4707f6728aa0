//! A peg-transfer scene on the plain world, and hands that move instruments in it.
#![allow(dead_code)]

use nalgebra::{Isometry3, UnitQuaternion, Vector3};
use trocar_dynamics::instrument::state::InstrumentState;
use trocar_dynamics::rigid_world::World;
use trocar_scene::components::{Instrument, InstrumentTarget, Motion, Pose, RigidBody, Shape, Velocity};
use trocar_scene::entity::Entity;
use trocar_scene::time::SimTime;

use super::{W, settings};

/// Of every world here.
pub const STEP_SECS: f64 = 0.001;
pub const RING_RADIUS: f64 = 0.008;
pub const TUBE_RADIUS: f64 = 0.0015;
pub const RING_MASS: f64 = 0.005;
pub const LEFT: Entity = Entity::new(0, 0, 1);
pub const RIGHT: Entity = Entity::new(0, 0, 2);
pub const BOARDS: [Entity; 2] = [Entity::new(0, 0, 3), Entity::new(0, 0, 4)];

pub fn ring_entity(index: u32) -> Entity {
    Entity::new(0, 0, 10 + index)
}

pub fn ring_shape() -> Shape {
    Shape::Torus { ring_radius: RING_RADIUS, tube_radius: TUBE_RADIUS }
}

pub fn ring_body(friction: f64) -> RigidBody {
    RigidBody { motion: Motion::Dynamic, mass: RING_MASS, friction, ..RigidBody::default() }
}

pub fn board_shape() -> Shape {
    let pegs = [-0.015, 0.015].iter().flat_map(|y| [-0.028, 0.0, 0.028].map(|x| [x, *y])).collect();
    Shape::PegBoard {
        half_extents: [0.038, 0.03],
        thickness: 0.01,
        pegs,
        peg_radius: 0.001,
        peg_height: 0.02,
    }
}

/// Feet of the six pegs of a board in world.
pub fn pegs(board: usize) -> Vec<[f64; 2]> {
    let x0 = if board == 0 { -0.04 } else { 0.04 };
    [-0.015, 0.015].iter().flat_map(|y| [-0.028, 0.0, 0.028].map(|x| [x0 + x, *y])).collect()
}

pub fn world() -> W {
    <W as World>::new(settings(Vector3::new(0.0, 0.0, -9.81), Some(-0.05)), SimTime::ZERO).unwrap()
}

pub fn add_boards(world: &mut W) {
    let body = RigidBody { friction: 0.4, ..RigidBody::default() };
    for (index, entity) in BOARDS.iter().enumerate() {
        let pose = Pose::at(if index == 0 { -0.04 } else { 0.04 }, 0.0, 0.0);
        world.insert_body(*entity, &body, &board_shape(), &pose, &Velocity::default()).unwrap();
    }
}

pub fn add_ring(world: &mut W, index: u32, pose: Pose, friction: f64) -> Entity {
    let entity = ring_entity(index);
    world.insert_body(entity, &ring_body(friction), &ring_shape(), &pose, &Velocity::default()).unwrap();
    entity
}

/// Six rings flat around the pegs of the left board.
pub fn add_rings(world: &mut W) {
    for (index, [x, y]) in pegs(0).into_iter().enumerate() {
        add_ring(world, index as u32, Pose::at(x, y, TUBE_RADIUS), 0.5);
    }
}

/// An instrument that points down (its +z is −z in world), with the blades' width along the world's `y`.
pub fn pointing_down(x: f64, y: f64, z: f64) -> Isometry3<f64> {
    Isometry3::from_parts(
        Vector3::new(x, y, z).into(),
        UnitQuaternion::from_axis_angle(&Vector3::y_axis(), std::f64::consts::PI),
    )
}

/// A hand: where it wants its instrument.
#[derive(Clone, Copy, Debug)]
pub struct TestHand {
    pub entity: Entity,
    pub tip: Isometry3<f64>,
    pub velocity: Vector3<f64>,
    pub jaw_angle: f64,
}

impl TestHand {
    pub fn new(
        world: &mut W,
        entity: Entity,
        instrument: &Instrument,
        tip: Isometry3<f64>,
        jaw: f64,
    ) -> Self {
        let mut state = InstrumentState { tip_in_world: tip, ..InstrumentState::default() };
        state.opening.angle = jaw;
        state.drive_reference = jaw;
        world.insert_tool(entity, instrument, &state, None).unwrap();
        let hand = Self { entity, tip, velocity: Vector3::zeros(), jaw_angle: jaw };
        hand.send(world);
        hand
    }

    pub fn send(&self, world: &mut W) {
        let target = InstrumentTarget {
            tip_in_world: self.tip.into(),
            velocity_in_world: Velocity { linear: self.velocity, angular: Vector3::zeros() },
            jaw_angle: self.jaw_angle,
            sampled_at: world.now(),
        };
        world.set_target(self.entity, target).unwrap();
    }
}

/// Steps for `secs` with `hands` following `plan(hand index, seconds since start) -> tip position`.
pub fn run(
    world: &mut W,
    hands: &mut [TestHand],
    secs: f64,
    mut plan: impl FnMut(usize, f64, &mut TestHand),
    mut watch: impl FnMut(&mut W, f64),
) {
    let step = STEP_SECS;
    let steps = (secs / step).round() as usize;
    for k in 0..steps {
        let t = k as f64 * step;
        for (index, hand) in hands.iter_mut().enumerate() {
            let before = hand.tip.translation.vector;
            plan(index, t, hand);
            hand.velocity = (hand.tip.translation.vector - before) / step;
            if k == 0 {
                hand.velocity = Vector3::zeros();
            }
            hand.send(world);
        }
        world.step().unwrap();
        watch(world, t + step);
    }
}

pub fn hold_still(_: usize, _: f64, _: &mut TestHand) {}
pub fn no_watch(_: &mut W, _: f64) {}

/// Smooth step from 0 to 1 over `secs` (minimum jerk).
pub fn minimum_jerk(t: f64, secs: f64) -> f64 {
    let s = (t / secs).clamp(0.0, 1.0);
    s * s * s * (10.0 + s * (6.0 * s - 15.0))
}

/// A ring grasped by its side at +x by an instrument that points down, at rest on the board, jaws closing for
/// 0.4 s. Returns the hand.
pub fn grasp_ring(
    world: &mut W,
    entity: Entity,
    instrument: &Instrument,
    center: [f64; 2],
    z: f64,
) -> TestHand {
    let tip = pointing_down(center[0] + RING_RADIUS, center[1], z);
    let mut hand = TestHand::new(world, entity, instrument, tip, 0.5);
    let mut hands = [hand];
    run(world, &mut hands, 0.1, hold_still, no_watch);
    run(world, &mut hands, 0.4, |_, _, hand| hand.jaw_angle = 0.0, no_watch);
    hand = hands[0];
    hand
}

//! Friction of a sliding block in both worlds, against Coulomb's law.

use nalgebra::Vector3;
use trocar_dynamics::rigid_world::World;
use trocar_engine::{EngineSettings, RigidWorld};
use trocar_scene::components::{Motion, Pose, RigidBody, Shape, Velocity};
use trocar_scene::entity::Entity;
use trocar_scene::time::SimTime;
use trocar_simulator::impulse_world::{ImpulseWorld, RigidSettings};

const BLOCK: Entity = Entity::new(0, 0, 1);
const PLANE: Entity = Entity::new(0, 0, 2);
const GRAVITY: f64 = 9.81;
const MASS: f64 = 0.02;

/// The direction of gravity on a slope of this slope along a direction of the plane.
fn tilted(slope: f64, along: [f64; 2]) -> Vector3<f64> {
    let angle = slope.atan();
    let down = Vector3::new(along[0], along[1], 0.0).normalize();
    (down * angle.sin() - Vector3::z() * angle.cos()) * GRAVITY
}

/// Friction over its coefficient, of a block that slides on a level plane under a gravity that is tilted.
fn effective<T: World>(mut world: T, half: [f64; 3], friction: f64, slope: f64) -> f64 {
    let plane = RigidBody { friction, ..RigidBody::default() };
    let ground = Shape::Box { half_extents: [5.0, 5.0, 0.01] };
    world
        .insert_body(PLANE, &plane, &ground, &Pose::at(0.0, 0.0, -0.01), &Velocity::default())
        .expect("a plane");
    let block = RigidBody { motion: Motion::Dynamic, mass: MASS, friction, ..RigidBody::default() };
    let shape = Shape::Box { half_extents: half };
    world
        .insert_body(BLOCK, &block, &shape, &Pose::at(0.0, 0.0, half[2]), &Velocity::default())
        .expect("a block");
    let speed = |world: &T| world.velocity(BLOCK).expect("a velocity").linear.xy().norm();
    (0..100).for_each(|_| world.step().expect("a step"));
    let before = speed(&world);
    (0..200).for_each(|_| world.step().expect("a step"));
    let faster = (speed(&world) - before) / 0.2;
    let angle = slope.atan();
    (GRAVITY * angle.sin() - faster) / (GRAVITY * angle.cos() * friction)
}

fn rapier(gravity_in_world: Vector3<f64>) -> RigidWorld {
    let settings = EngineSettings { gravity_in_world, floor_height: None, ..EngineSettings::default() };
    <RigidWorld as World>::new(settings, SimTime::ZERO).expect("a world")
}

fn ours(gravity_in_world: Vector3<f64>) -> ImpulseWorld {
    let settings = RigidSettings { gravity_in_world, floor_height: None, ..RigidSettings::default() };
    <ImpulseWorld as World>::new(settings, SimTime::ZERO).expect("a world")
}

const BLOCKS: [[f64; 3]; 3] = [[0.01, 0.01, 0.01], [0.03, 0.03, 0.003], [0.02, 0.01, 0.005]];

#[test]
fn in_our_world_a_block_that_slides_is_rubbed_by_coulombs_law_in_every_direction() {
    for half in BLOCKS {
        for (friction, slope) in [(0.3, 0.6), (0.5, 0.55)] {
            for along in [[1.0, 0.0], [0.0, 1.0], [1.0, 1.0], [0.866, 0.5]] {
                let share = effective(ours(tilted(slope, along)), half, friction, slope);
                assert!((share - 1.0).abs() < 2e-3, "{half:?}, μ {friction}, along {along:?}: {share}");
            }
        }
    }
}

/// How much of Coulomb's friction Rapier's model gives to a block with these half sides that slides along x.
///
/// Its solver projects the impulse of each contact onto the cone of friction along the direction that would stop the contact at
/// once, K⁻¹ v, where K is the mobility of the contact; off the block's middle K is not isotropic, and the impulse turns away
/// from v. What points aside cancels between the two sides of the block, and what is left is the cosine of the angle.
fn of_projection([a, b, c]: [f64; 3]) -> f64 {
    let (ix, iz) = (MASS / 3.0 * (b * b + c * c), MASS / 3.0 * (a * a + b * b));
    let along_y = 1.0 / MASS + c * c / ix + a * a / iz;
    let coupling = a * b / iz;
    along_y / along_y.hypot(coupling)
}

#[test]
fn in_rapiers_world_a_block_that_slides_along_its_sides_is_rubbed_less_by_the_angle_of_its_projection() {
    for (half, known) in BLOCKS.into_iter().zip([0.936, 0.860, 0.958]) {
        let expected = of_projection(half);
        assert!((expected - known).abs() < 1e-3, "{half:?}: {expected}");
        for (friction, slope) in [(0.3, 0.6), (0.5, 0.55)] {
            let share = effective(rapier(tilted(slope, [1.0, 0.0])), half, friction, slope);
            assert!((share - expected).abs() < 4e-3, "{half:?}, μ {friction}: {share}, not {expected}");
        }
    }
    // Along the diagonal of a square the corners that turn aside bear nothing.
    for half in [BLOCKS[0], BLOCKS[1]] {
        let share = effective(rapier(tilted(0.6, [1.0, 1.0])), half, 0.3, 0.6);
        assert!((share - 1.0).abs() < 2e-3, "{half:?}: {share}");
    }
}

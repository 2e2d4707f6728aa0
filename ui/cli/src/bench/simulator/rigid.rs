//! Benchmarks of our rigid bodies.

use trocar::summary::BenchResult;
use trocar_dynamics::rigid_world::World;
use trocar_scene::{Entity, Motion, Pose, RigidBody, Shape, SimTime, Velocity};
use trocar_simulator::impulse_world::{ImpulseWorld, RigidSettings};

use super::per_run;
use super::roofline::{Work, share};
use crate::failure::Failure;

/// Edge length of the boxes \[m\], and their initial distance.
const EDGE: f64 = 0.01;
const APART: f64 = 0.0105;

/// Median time of a step of boxes that fall on each other and onto a floor, from the first touch on, before any sleeps;
/// and the number of contact visits of a step over all solver sweeps.
fn pile(bodies: usize) -> Result<((f64, f64), f64), Failure> {
    let settings = RigidSettings { floor_height: Some(0.0), ..RigidSettings::default() };
    let mut world = <ImpulseWorld as World>::new(settings, SimTime::ZERO).map_err(Failure::internal)?;
    let body = RigidBody { motion: Motion::Dynamic, mass: 0.005, friction: 0.4, ..RigidBody::default() };
    let shape = Shape::Box { half_extents: [0.5 * EDGE; 3] };
    // Square layers on top of each other.
    let side = (bodies as f64).cbrt().ceil() as usize;
    for index in 0..bodies {
        let [i, j, k] = [index % side, index / side % side, index / side / side];
        let at = Pose::at(APART * i as f64, APART * j as f64, 0.5 * EDGE + APART * k as f64);
        let entity = Entity::new(0, 0, index as u32 + 1);
        world.insert_body(entity, &body, &shape, &at, &Velocity::default()).map_err(Failure::internal)?;
    }
    let (mut failed, mut steps, mut visits) = (None, 0.0, 0.0);
    let mut step = || {
        if let Err(error) = World::step(&mut world) {
            failed = Some(error);
        }
        steps += 1.0;
        visits += world.effort() as f64;
    };
    (0..20).for_each(|_| step());
    let figure = per_run(10, &mut step);
    failed.map_or(Ok((figure, visits / steps)), |error| Err(Failure::internal(error)))
}

/// Median time of a step of a pile of so many boxes.
pub fn pile_secs(bodies: usize) -> Result<(f64, f64), Failure> {
    pile(bodies).map(|(figure, _)| figure)
}

/// Roofline share of a pile of a hundred boxes.
pub fn share_of_pile() -> Result<BenchResult, Failure> {
    let (figure, visits) = pile(100)?;
    // For each contact visit, of two bodies: along the normal, twice, a velocity and an impulse; tangentially a
    // velocity with two cross products, an impulse with two matrix products, and the friction law in between.
    let operations = visits * (2.0 * (18.0 + 26.0) + 38.0 + 2.0 * 24.0 + 60.0);
    Ok(share("rigid_100", figure.0, Work { operations, single: false, bytes: 0.0 }))
}

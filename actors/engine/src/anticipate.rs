//! Predicted contacts of an instrument before the next tick: the nearest surface, or else the first hit of its
//! colliders when cast along the tip's velocity.
//!
//! At 500 Hz the solver's predicted contacts suffice. At 10 Hz a hand travels centimetres between two ticks, and
//! haptics must know of a wall before the engine reaches it. A tip at rest may start at any time, so near surfaces
//! count as well, whatever the current direction of motion.

use nalgebra::Vector3;
use rapier3d_f64::parry::bounding_volume::BoundingVolume;
use rapier3d_f64::parry::query::{ShapeCastOptions, contact};
use rapier3d_f64::pipeline::{PhysicsWorld, QueryFilter};

use trocar_dynamics::instrument::local_model::Obstacle;

use crate::conversion::{vector_from_rapier, vector_to_rapier};
use crate::grasper::Grasper;

/// A shorter path is covered by the solver's predicted contacts \[m\].
const PATH_MIN: f64 = 0.0004;
/// Maximum length of the cast \[m\].
const PATH_MAX: f64 = 0.03;

/// Speed that a hand may reach before an engine's next tick \[m/s\].
const START_SPEED: f64 = 0.3;

/// The first fixed surface that the instrument reaches within `horizon_secs` if its tip keeps `velocity` and its
/// rotation.
pub(crate) fn first_obstacle(
    world: &PhysicsWorld,
    grasper: &Grasper,
    velocity: &Vector3<f64>,
    horizon_secs: f64,
) -> Option<Obstacle> {
    let near = nearest_obstacle(world, grasper, (START_SPEED * horizon_secs).min(PATH_MAX));
    if near.is_some() {
        return near;
    }
    let speed = velocity.norm();
    let path = (speed * horizon_secs).min(PATH_MAX);
    if path < PATH_MIN {
        return None;
    }
    let options = ShapeCastOptions {
        max_time_of_impact: path / speed,
        // A surface that it already touches and slides along is a contact, not an obstacle.
        stop_at_penetration: false,
        ..ShapeCastOptions::default()
    };
    let mut first: Option<(f64, Obstacle)> = None;
    for (_, handle) in grasper.colliders() {
        let Some(collider) = world.colliders.get(handle) else { continue };
        let query = world.query_pipeline_with_filter(QueryFilter::only_fixed());
        let cast =
            query.cast_shape(collider.position(), vector_to_rapier(velocity), collider.shape(), options);
        let Some((other, hit)) = cast else { continue };
        let normal = vector_from_rapier(hit.normal1);
        let gap = -velocity.dot(&normal) * hit.time_of_impact;
        if gap >= 0.0 && first.is_none_or(|(time, _)| hit.time_of_impact < time) {
            let friction = world.colliders.get(other).map_or(0.0, |other| other.friction());
            let friction = (friction * collider.friction()).sqrt();
            first = Some((hit.time_of_impact, Obstacle { normal_in_world: normal, gap, friction }));
        }
    }
    first.map(|(_, obstacle)| obstacle)
}

/// The fixed surface nearest to the instrument, if one is within `reach` \[m\].
fn nearest_obstacle(world: &PhysicsWorld, grasper: &Grasper, reach: f64) -> Option<Obstacle> {
    let fixed = |collider: &rapier3d_f64::geometry::Collider| {
        collider.parent().and_then(|body| world.bodies.get(body)).is_none_or(|body| body.is_fixed())
    };
    let mut nearest: Option<Obstacle> = None;
    for (_, handle) in grasper.colliders() {
        let Some(own) = world.colliders.get(handle) else { continue };
        let around = own.compute_aabb().loosened(reach);
        let close = |other: &rapier3d_f64::geometry::Collider| around.intersects(&other.compute_aabb());
        for (_, other) in world.colliders.iter().filter(|(_, other)| fixed(other) && close(other)) {
            let reach = nearest.map_or(reach, |nearest| nearest.gap);
            let found = contact(own.position(), own.shape(), other.position(), other.shape(), reach);
            let Ok(Some(found)) = found else { continue };
            let gap = found.dist.max(0.0);
            if nearest.is_none_or(|nearest| gap < nearest.gap) {
                let friction = (own.friction() * other.friction()).sqrt();
                nearest =
                    Some(Obstacle { normal_in_world: vector_from_rapier(found.normal2), gap, friction });
            }
        }
    }
    nearest
}

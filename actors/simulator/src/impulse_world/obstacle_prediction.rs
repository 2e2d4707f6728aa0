//! Obstacle prediction for an instrument until the next tick of a slow world: the nearest fixed surface, or else what
//! its parts will hit.

use nalgebra::{Isometry3, Translation3, Vector3};
use trocar_dynamics::instrument::local_model::Obstacle;

use super::aabb::Bounds;
use super::bodies::{Body, Solid};
use super::closest_features::{TouchPoint, touch};
use super::convex_parts::Part;
use super::instrument::Tool;

/// A shorter path is covered by the contacts of a step \[m\].
const PATH_MIN: f64 = 0.0004;
/// Longest path examined \[m\].
const PATH_MAX: f64 = 0.03;
/// Velocity that a hand may reach before the next tick \[m/s\].
const START_SPEED: f64 = 0.3;
/// Maximum advancement steps along a path, and distance that counts as contact \[m\].
const ADVANCES_MAX: usize = 32;
const THERE: f64 = 1e-5;

/// The first of the `fixed` bodies that a tool hits within `horizon_secs` at constant tip velocity and rotation.
pub(super) fn first_obstacle<'a>(
    tool: &Tool,
    fixed: impl Iterator<Item = &'a Body> + Clone,
    horizon_secs: f64,
) -> Option<Obstacle> {
    let reach = (START_SPEED * horizon_secs).min(PATH_MAX);
    if let Some((_, obstacle)) = nearest(tool, fixed.clone(), reach, &Vector3::zeros()) {
        return Some(obstacle);
    }
    let velocity = tool.state.velocity.linear;
    let speed = velocity.norm();
    let path = (speed * horizon_secs).min(PATH_MAX);
    if path < PATH_MIN {
        return None;
    }
    // Conservative advancement: nothing can be hit before covering the distance to it.
    let mut gone = 0.0;
    for _ in 0..ADVANCES_MAX {
        let on_the_way = velocity * (gone / speed);
        let (gap, obstacle) = nearest(tool, fixed.clone(), path - gone, &on_the_way)?;
        if gap <= THERE {
            let gap = -on_the_way.dot(&obstacle.normal_in_world);
            return (gap >= 0.0).then_some(Obstacle { gap, ..obstacle });
        }
        gone += gap;
        if gone >= path {
            return None;
        }
    }
    None
}

/// The nearest fixed surface within `reach` of the tool, displaced by `by` \[m\], and its distance.
fn nearest<'a>(
    tool: &Tool,
    fixed: impl Iterator<Item = &'a Body>,
    reach: f64,
    by: &Vector3<f64>,
) -> Option<(f64, Obstacle)> {
    let mut best: Option<(f64, Obstacle)> = None;
    let mut points = Vec::new();
    let moved = |pose: &Isometry3<f64>| Translation3::from(*by) * pose;
    for body in fixed {
        let reach = best.map_or(reach, |(gap, _)| gap);
        if body.solid.all.is_apart(&tool.solid.all.moved(by), reach) {
            continue;
        }
        for (index, (own, pose)) in tool.solid.parts.iter().zip(&tool.solid.placed).enumerate() {
            let friction = if tool.jaw_of[index].is_some() {
                tool.instrument.jaw_friction
            } else {
                tool.instrument.jaw_friction.min(0.2)
            };
            let bounds = tool.solid.bounds[index].moved(by);
            for point in touching((own, &bounds), &moved(pose), &body.solid, reach, &mut points) {
                let gap = (-point.depth).max(0.0);
                if best.is_none_or(|(nearest, _)| gap < nearest) {
                    let friction = (friction * body.component.friction).sqrt();
                    best = Some((gap, Obstacle { normal_in_world: -point.normal, gap, friction }));
                }
            }
        }
    }
    best
}

fn touching<'a>(
    (own, bounds): (&Part, &Bounds),
    pose: &Isometry3<f64>,
    other: &Solid,
    reach: f64,
    points: &'a mut Vec<TouchPoint>,
) -> &'a [TouchPoint] {
    points.clear();
    for ((part, placed), its) in other.parts.iter().zip(&other.placed).zip(&other.bounds) {
        if !its.is_apart(bounds, reach) {
            touch((own, pose), (part, placed), reach, points);
        }
    }
    points
}

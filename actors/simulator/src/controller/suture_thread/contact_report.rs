//! Reaction forces of a thread on instruments and bodies: contacts, and the pull on jaws.

use nalgebra::{Isometry3, Point3, Vector3};
use trocar_scene::{Collision, Detection, Entity, Primitive, SimTime};

use super::grasp::{GraspForce, in_world};
use super::obstacles::{ObstacleParts, PartShape};
use crate::suture_thread::Reaction;

/// Smaller forces count as zero \[N\].
const FORCE_MIN: f64 = 1e-6;

/// Contact results of a thread's tick.
#[derive(Clone, Copy, Debug)]
pub struct ContactReport<'a> {
    /// The thread.
    pub thread: Entity,
    /// Its frame.
    pub world_from_thread: Isometry3<f64>,
    /// Its obstacles.
    pub parts: &'a ObstacleParts,
    /// Mean reaction on each obstacle over the tick.
    pub reactions: &'a [Reaction],
    /// Pull on jaws.
    pub pulls: &'a [(Entity, GraspForce)],
    /// Maximum displacement of the elastic body that it is tied around \[m\].
    pub displacement_max: f64,
}

impl ContactReport<'_> {
    /// Writes them as rows of the collision list.
    pub fn report(&self, at: SimTime, collisions: &mut Vec<Collision>) {
        let mut add =
            |a: Entity, primitive_a: Primitive, place: Point3<f64>, force: Vector3<f64>, depth: f64| {
                collisions.push(collision(a, primitive_a, self.thread, place, force, depth, at));
            };
        for (part, reaction) in self.parts.list.iter().zip(self.reactions) {
            let size = reaction.force.norm();
            if size < FORCE_MIN {
                continue;
            }
            // The point nearest to the part's origin about which the torque orthogonal to the force is zero.
            let arm = reaction.force.cross(&reaction.torque) / (size * size);
            let place = self.world_from_thread * Point3::from(part.to.translation.vector + arm);
            let primitive = match part.jaw {
                Some(jaw) => Primitive::Jaw(jaw as u8),
                None if part.rod.is_some() => Primitive::Shaft,
                None => Primitive::Shape(0),
            };
            let depth = match &part.form {
                PartShape::Elastic => self.displacement_max,
                _ => size / part.stiffness,
            };
            let on_thread = self.world_from_thread.rotation * -reaction.force;
            add(part.met.entity, primitive, place, on_thread, depth);
        }
        for (instrument, pull) in self.pulls {
            let (place, force) = in_world(pull, &self.world_from_thread);
            // Distance of the instrument from the held part: force over depth is the stiffness felt.
            add(*instrument, Primitive::Jaw(0), place, force, (pull.places[1] - pull.places[0]).norm());
        }
    }
}

/// A contact at a point of a thread or needle (`b`), with the force on it.
pub(crate) fn collision(
    a: Entity,
    primitive_a: Primitive,
    b: Entity,
    place: Point3<f64>,
    force_in_world: Vector3<f64>,
    depth: f64,
    detected_at: SimTime,
) -> Collision {
    Collision {
        a,
        primitive_a,
        b,
        primitive_b: Primitive::Shape(0),
        points_in_world: [place; 2],
        normal_in_world: force_in_world.try_normalize(1e-12).unwrap_or_else(Vector3::z),
        depth,
        force_in_world,
        velocity_constraint: 0.0,
        method: Detection::Simulator,
        detected_at,
    }
}

//! Contacts that others have found. A detector says where two bodies touched in the scene that it read; since then they have
//! moved on. So both points are fixed to their bodies at the poses of *that* moment, and each step answers the depth between
//! them as it is now.

use nalgebra::{Isometry3, Point3, Vector3};
use trocar_scene::{Collision, Entity};

/// Most contacts that are answered at a time; the deepest ones are.
pub(super) const FOUND_MAX: usize = 512;

/// A contact that has been found, fixed to its bodies.
#[derive(Clone, Copy, Debug)]
pub(super) struct Found {
    pub entities: [Entity; 2],
    /// In the frames of the two; in world where there is no such body \[m\].
    points: [Point3<f64>; 2],
    /// From the first to the second, in the frame of the second if it is known, else of the first, else in world.
    normal: Vector3<f64>,
    is_known: [bool; 2],
}

impl Found {
    /// Fixes a collision to the poses that its bodies had then; `None` for a body that is not in this world. No answer: it was
    /// found too long ago, or says nothing.
    pub fn new(collision: &Collision, then: [Option<Option<Isometry3<f64>>>; 2]) -> Option<Self> {
        let poses = match then {
            [Some(first), Some(second)] => [first, second],
            _ => return None,
        };
        let normal = collision.normal_in_world.try_normalize(0.5)?;
        let frame = poses[1].or(poses[0]).unwrap_or_else(Isometry3::identity);
        let local = |side: usize| {
            let point = collision.points_in_world[side];
            poses[side].map_or(point, |pose| pose.inverse_transform_point(&point))
        };
        Some(Self {
            entities: [collision.a, collision.b],
            points: [local(0), local(1)],
            normal: frame.rotation.inverse() * normal,
            is_known: poses.map(|pose| pose.is_some()),
        })
    }

    /// Where it is now: points, direction and depth in world, for bodies at these poses.
    pub fn now(&self, poses: [Isometry3<f64>; 2]) -> ([Point3<f64>; 2], Vector3<f64>, f64) {
        let place = |side: usize| {
            if self.is_known[side] { poses[side] * self.points[side] } else { self.points[side] }
        };
        let points = [place(0), place(1)];
        let normal = match self.is_known {
            [_, true] => poses[1].rotation * self.normal,
            [true, false] => poses[0].rotation * self.normal,
            [false, false] => self.normal,
        };
        (points, normal, (points[0] - points[1]).dot(&normal))
    }
}

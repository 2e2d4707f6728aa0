//! Contacts from external detectors. A detector reports where two bodies touched in the scene that it read; they have
//! moved since. Both points are therefore fixed to their bodies at the poses of *that* moment, and each step responds
//! to the present depth.

use nalgebra::{Isometry3, Point3, Vector3};
use trocar_scene::{Collision, Entity};

/// Maximum number of contacts in a step; the deepest are kept.
pub(super) const FOUND_MAX: usize = 512;

/// A detected contact, fixed to its bodies.
#[derive(Clone, Copy, Debug)]
pub(super) struct DetectedContact {
    pub entities: [Entity; 2],
    /// Points in the frames of the two bodies; in world without a body \[m\].
    points: [Point3<f64>; 2],
    /// Direction from the first to the second, in the frame of the second if there is one, else of the first, else in
    /// world.
    normal: Vector3<f64>,
    is_known: [bool; 2],
}

impl DetectedContact {
    /// Fixes a collision to the poses that its bodies had then, `None` for a body outside of this world. Returns `None`
    /// for a detection that is too old or invalid.
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

    /// Its present points, direction and depth in world, for bodies at these poses.
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

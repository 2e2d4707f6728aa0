//! Geometry of a peg-transfer board: ring-around-peg test, clearance, visibility.

use nalgebra::{Isometry3, Point3, Vector3};
use serde::{Deserialize, Serialize};

/// An upright peg.
#[derive(Clone, Debug, PartialEq)]
pub struct Peg {
    /// Which board it stands on, counted from 0.
    pub board: usize,
    /// Its foot on the board's face, in world \[m\].
    pub foot_in_world: Point3<f64>,
    /// Unit direction from foot to head, in world.
    pub axis_in_world: Vector3<f64>,
    /// From foot to head \[m\].
    pub height: f64,
}

/// A ring's shape: a torus about its own z axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RingShape {
    /// Radius of the centre line \[m\].
    pub ring_radius: f64,
    /// Radius of the tube \[m\].
    pub tube_radius: f64,
}

/// Placement of a ring in world.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct RingPlacement {
    /// Its centre \[m\].
    pub center_in_world: Point3<f64>,
    /// Unit direction of its axis of revolution; the sign does not matter.
    pub axis_in_world: Vector3<f64>,
}

impl RingShape {
    /// Height of the ring's lowest point above the plane through `foot` with the unit normal `up` \[m\].
    pub fn clearance(&self, ring: &RingPlacement, foot: &Point3<f64>, up: &Vector3<f64>) -> f64 {
        let tilt = ring.axis_in_world.cross(up).norm();
        (ring.center_in_world - foot).dot(up) - self.ring_radius * tilt - self.tube_radius
    }

    /// Whether the peg passes through the ring's hole.
    ///
    /// The peg's axis is intersected with the ring's plane: the point must lie on the peg and inside the hole. A ring
    /// that stands on its edge (more than about 70° of tilt) is around no peg.
    pub fn is_around(&self, ring: &RingPlacement, peg: &Peg) -> bool {
        let steepness = peg.axis_in_world.dot(&ring.axis_in_world);
        if steepness.abs() < 0.35 {
            return false;
        }
        let along = (ring.center_in_world - peg.foot_in_world).dot(&ring.axis_in_world) / steepness;
        let cut = peg.foot_in_world + peg.axis_in_world * along;
        (0.0..=peg.height).contains(&along)
            && (cut - ring.center_in_world).norm() < self.ring_radius - self.tube_radius
    }

    /// The first of `pegs` that passes through the ring's hole.
    pub fn peg_inside(&self, ring: &RingPlacement, pegs: &[Peg]) -> Option<usize> {
        pegs.iter().position(|peg| self.is_around(ring, peg))
    }
}

/// The trainee's field of view.
#[derive(Clone, Debug, PartialEq)]
pub enum FieldOfView {
    /// An axis-aligned box in world.
    Box {
        /// Lowest corner \[m\].
        min: Point3<f64>,
        /// Highest corner \[m\].
        max: Point3<f64>,
    },
    /// A camera that looks along its +z axis, image down along +y.
    Frustum {
        /// `world_from_camera`.
        world_from_camera: Isometry3<f64>,
        /// Vertical field of view \[rad\].
        vertical: f64,
        /// Width divided by height.
        aspect: f64,
        /// Nearest and farthest visible depth \[m\].
        depths: [f64; 2],
    },
}

impl FieldOfView {
    /// Whether `point` in world \[m\] is seen.
    pub fn contains(&self, point: &Point3<f64>) -> bool {
        match self {
            Self::Box { min, max } => (0..3).all(|i| (min[i]..=max[i]).contains(&point[i])),
            Self::Frustum { world_from_camera, vertical, aspect, depths } => {
                let in_camera = world_from_camera.inverse_transform_point(point);
                let half_height = in_camera.z * (0.5 * vertical).tan();
                (depths[0]..=depths[1]).contains(&in_camera.z)
                    && in_camera.y.abs() <= half_height
                    && in_camera.x.abs() <= half_height * aspect
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::UnitQuaternion;

    const RING: RingShape = RingShape { ring_radius: 0.008, tube_radius: 0.0015 };

    fn peg() -> Peg {
        Peg { board: 0, foot_in_world: Point3::origin(), axis_in_world: Vector3::z(), height: 0.02 }
    }
    fn ring(x: f64, z: f64, tilt: f64) -> RingPlacement {
        let axis = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), tilt) * Vector3::z();
        RingPlacement { center_in_world: Point3::new(x, 0.0, z), axis_in_world: axis }
    }

    #[test]
    fn around_means_through_the_hole_and_below_the_head() {
        assert!(RING.is_around(&ring(0.0, 0.0015, 0.0), &peg()));
        assert!(RING.is_around(&ring(0.006, 0.0015, 0.0), &peg()));
        assert!(!RING.is_around(&ring(0.0066, 0.0015, 0.0), &peg()));
        assert!(!RING.is_around(&ring(0.0, 0.021, 0.0), &peg()));
        assert!(RING.is_around(&ring(0.0, 0.01, 0.8), &peg()));
        assert!(RING.is_around(&ring(0.0, 0.01, std::f64::consts::PI), &peg()));
        assert!(!RING.is_around(&ring(0.0, 0.01, 1.4), &peg()));
        assert_eq!(RING.peg_inside(&ring(0.0, 0.01, 0.0), &[peg()]), Some(0));
        assert_eq!(RING.peg_inside(&ring(0.02, 0.01, 0.0), &[peg()]), None);
    }

    #[test]
    fn clearance_takes_the_tilt_into_account() {
        let up = Vector3::z();
        let flat = RING.clearance(&ring(0.0, 0.01, 0.0), &Point3::origin(), &up);
        assert!((flat - 0.0085).abs() < 1e-12);
        let tilted = RING.clearance(&ring(0.0, 0.01, 0.5), &Point3::origin(), &up);
        assert!((tilted - (0.0085 - 0.008 * 0.5f64.sin())).abs() < 1e-12);
    }

    #[test]
    fn a_camera_sees_what_lies_in_its_frustum() {
        // Straight above the origin, looking down.
        let view = FieldOfView::Frustum {
            world_from_camera: Isometry3::from_parts(
                Vector3::new(0.0, 0.0, 0.2).into(),
                UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI),
            ),
            vertical: std::f64::consts::FRAC_PI_2,
            aspect: 1.5,
            depths: [0.01, 0.5],
        };
        assert!(view.contains(&Point3::new(0.29, 0.19, 0.0)));
        assert!(!view.contains(&Point3::new(0.31, 0.0, 0.0)));
        assert!(!view.contains(&Point3::new(0.0, 0.21, 0.0)));
        assert!(!view.contains(&Point3::new(0.0, 0.0, 0.195)));
        assert!(!view.contains(&Point3::new(0.0, 0.0, 0.3)));
        let cube = FieldOfView::Box { min: Point3::new(-1.0, -1.0, 0.0), max: Point3::new(1.0, 1.0, 1.0) };
        assert!(cube.contains(&Point3::new(0.5, -0.5, 0.5)));
        assert!(!cube.contains(&Point3::new(0.5, -0.5, -0.1)));
    }
}

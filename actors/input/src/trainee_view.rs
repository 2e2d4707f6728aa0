//! Observations of a virtual trainee: rings, pegs and its own two instruments, as plain geometry.

use nalgebra::{Isometry3, Point3, Rotation3, UnitQuaternion, Vector3};

/// An upright peg.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PegSeen {
    /// Which board it stands on, counted from 0.
    pub board: usize,
    /// Its foot in world \[m\].
    pub foot: Vector3<f64>,
    /// Unit direction from foot to head.
    pub up: Vector3<f64>,
    /// From foot to head \[m\].
    pub height: f64,
    /// Its radius \[m\].
    pub radius: f64,
}

/// Dimensions of a grasper that matter for grasping.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GrasperSeen {
    /// From the hinge to the tip \[m\].
    pub jaw_length: f64,
    /// Width of a blade \[m\].
    pub jaw_width: f64,
    /// Thickness of a blade \[m\].
    pub jaw_thickness: f64,
    /// Largest opening \[rad\].
    pub jaw_angle_max: f64,
    /// Radius of the shaft \[m\].
    pub shaft_radius: f64,
    /// The point in world that the shaft passes (or that it is swung about when it moves freely) \[m\].
    pub apex: Vector3<f64>,
}

/// The constant parts of an exercise.
#[derive(Clone, Debug, PartialEq)]
pub struct BenchSeen {
    /// All pegs.
    pub pegs: Vec<PegSeen>,
    /// Radius of a ring's centre line \[m\].
    pub ring_radius: f64,
    /// Radius of a ring's tube \[m\].
    pub tube_radius: f64,
    /// Left, right.
    pub graspers: [GrasperSeen; 2],
    /// The board on which the rings start.
    pub first_board: usize,
}

/// A hand's instrument at one moment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HandSeen {
    /// `world_from_instrument`.
    pub tip: Isometry3<f64>,
    /// Opening of the jaws \[rad\].
    pub jaw_angle: f64,
    /// Index of the ring between the jaws.
    pub held: Option<usize>,
}

/// A ring at one moment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RingSeen {
    /// `world_from_ring`; the axis of revolution is z.
    pub pose: Isometry3<f64>,
    /// Speed of its centre \[m/s\].
    pub speed: f64,
}

/// All moving parts at one moment.
#[derive(Clone, Debug, PartialEq)]
pub struct MomentSeen {
    /// Rings, always in the same order.
    pub rings: Vec<RingSeen>,
    /// Left, right.
    pub hands: [HandSeen; 2],
}

impl RingSeen {
    /// Its centre in world \[m\].
    pub fn center(&self) -> Vector3<f64> {
        self.pose.translation.vector
    }
    /// Its axis, turned to the side of `up`.
    pub fn normal(&self, up: &Vector3<f64>) -> Vector3<f64> {
        let normal = self.pose.rotation * Vector3::z();
        if normal.dot(up) < 0.0 { -normal } else { normal }
    }
}

impl BenchSeen {
    /// The up direction, from the first peg.
    pub fn up(&self) -> Vector3<f64> {
        self.pegs.first().map_or_else(Vector3::z, |peg| peg.up)
    }
    /// The peg nearest to `point` \[m\].
    pub fn nearest_peg(&self, point: &Vector3<f64>) -> Option<&PegSeen> {
        let distance = |peg: &PegSeen| (peg.foot - point).norm_squared();
        self.pegs.iter().min_by(|a, b| distance(a).total_cmp(&distance(b)))
    }
    /// Height of `point` above the nearest board \[m\].
    pub fn height(&self, point: &Vector3<f64>) -> f64 {
        self.nearest_peg(point).map_or(point.z, |peg| (point - peg.foot).dot(&peg.up))
    }
    /// Extent of a ring below its centre at its current tilt \[m\].
    pub fn drop_below_center(&self, ring: &RingSeen) -> f64 {
        self.ring_radius * ring.normal(&self.up()).cross(&self.up()).norm() + self.tube_radius
    }
    /// The peg that a ring occupies: it passes through the ring's hole, and no other ring is lower on it.
    pub fn peg_of(&self, rings: &[RingSeen], ring: usize) -> Option<usize> {
        let seen = rings.get(ring)?;
        let peg = self.peg_inside(seen)?;
        let height = self.height(&seen.center());
        let stacked = rings.iter().enumerate().any(|(other, lower)| {
            other != ring && self.height(&lower.center()) < height && self.peg_inside(lower) == Some(peg)
        });
        (!stacked).then_some(peg)
    }
    /// The peg that passes through the ring's hole, by observation.
    pub fn peg_inside(&self, ring: &RingSeen) -> Option<usize> {
        self.pegs.iter().position(|peg| {
            let normal = ring.normal(&peg.up);
            let steepness = normal.dot(&peg.up);
            if steepness < 0.35 {
                return false;
            }
            let along = (ring.center() - peg.foot).dot(&normal) / steepness;
            let cut = peg.foot + peg.up * along;
            (0.0..=peg.height).contains(&along)
                && (cut - ring.center()).norm() < self.ring_radius - self.tube_radius
        })
    }
}

/// `world_from_instrument` for a tip at `position` whose shaft comes from `apex` and whose jaws close as
/// nearly along `closing` as the shaft allows.
pub fn tip_pose(position: &Vector3<f64>, apex: &Vector3<f64>, closing: &Vector3<f64>) -> Isometry3<f64> {
    let z = (position - apex).try_normalize(1e-9).unwrap_or_else(|| -Vector3::z());
    let across = closing - z * closing.dot(&z);
    let x = across.try_normalize(1e-6).unwrap_or_else(|| any_perpendicular(&z));
    let y = z.cross(&x);
    let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_basis_unchecked(&[x, y, z]));
    Isometry3::from_parts((*position).into(), rotation)
}

fn any_perpendicular(z: &Vector3<f64>) -> Vector3<f64> {
    let helper = if z.x.abs() < 0.9 { Vector3::x() } else { Vector3::y() };
    z.cross(&helper).normalize()
}

/// The tip position that brings a point fixed to the instrument at `offset_in_tip` \[m\] to `goal` \[m\].
///
/// The instrument turns about its apex while it moves, so this is a fixed point; with offsets far below the
/// insertion depth each iteration gains two digits.
pub fn tip_for_point(
    goal: &Vector3<f64>,
    offset_in_tip: &Point3<f64>,
    apex: &Vector3<f64>,
    closing: &Vector3<f64>,
) -> Vector3<f64> {
    let mut position = *goal;
    for _ in 0..8 {
        let rotation = tip_pose(&position, apex, closing).rotation;
        position = goal - rotation * offset_in_tip.coords;
    }
    position
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_tip_pose_has_its_shaft_through_the_apex_and_closes_as_asked() {
        let apex = Vector3::new(-0.1, -0.09, 0.17);
        let position = Vector3::new(-0.03, 0.01, 0.005);
        let pose = tip_pose(&position, &apex, &Vector3::new(-0.5, 0.8, 0.1));
        let z = pose.rotation * Vector3::z();
        assert!(z.cross(&(position - apex)).norm() < 1e-12 && z.dot(&(position - apex)) > 0.0);
        let x = pose.rotation * Vector3::x();
        assert!(x.dot(&z).abs() < 1e-12);
        assert!(x.dot(&Vector3::new(-0.5, 0.8, 0.1)) > 0.0);
        assert!((pose.rotation.norm() - 1.0).abs() < 1e-12);
        // A closing direction along the shaft is impossible; the pose is valid all the same.
        let awkward = tip_pose(&position, &apex, &z);
        assert!(awkward.rotation.coords.iter().all(|v| v.is_finite()));
    }

    #[test]
    fn of_two_rings_on_a_peg_only_the_lower_one_has_taken_it() {
        let foot = Vector3::new(0.04, 0.0, 0.0);
        let peg = PegSeen { board: 0, foot, up: Vector3::z(), height: 0.02, radius: 0.001 };
        let grasper = GrasperSeen {
            jaw_length: 0.018,
            jaw_width: 0.003,
            jaw_thickness: 0.0015,
            jaw_angle_max: 0.9,
            shaft_radius: 0.0025,
            apex: Vector3::new(0.1, -0.09, 0.17),
        };
        let bench = BenchSeen {
            pegs: vec![peg],
            ring_radius: 0.008,
            tube_radius: 0.0015,
            graspers: [grasper, grasper],
            first_board: 0,
        };
        let ring = |x: f64, z: f64| RingSeen { pose: Isometry3::translation(x, 0.0, z), speed: 0.0 };
        let rings = [ring(0.041, 0.0045), ring(0.04, 0.0015), ring(0.08, 0.0015)];
        let taken = [0, 1, 2, 3].map(|index| bench.peg_of(&rings, index));
        assert_eq!(taken, [None, Some(0), None, None], "stacked, lowest, elsewhere, no such ring");
    }

    #[test]
    fn the_point_on_the_instrument_meets_its_goal() {
        let (apex, closing) = (Vector3::new(0.1, -0.09, 0.17), Vector3::new(0.6, 0.8, 0.0));
        let goal = Vector3::new(0.02, 0.03, 0.04);
        let offset = Point3::new(0.008, 0.001, -0.002);
        let tip = tip_for_point(&goal, &offset, &apex, &closing);
        let reached = tip_pose(&tip, &apex, &closing) * offset;
        assert!((reached.coords - goal).norm() < 1e-9, "{}", (reached.coords - goal).norm());
    }
}

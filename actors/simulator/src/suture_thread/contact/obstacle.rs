//! Obstacles that a thread can touch.

use nalgebra::{Isometry3, Point3, Translation3, Vector3};

/// The shape of an obstacle in its own frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Shape<'a> {
    /// A sphere about the origin.
    Sphere {
        /// Radius \[m\].
        radius: f64,
    },
    /// All points within a radius of a segment, for shafts, jaws and posts.
    Capsule {
        /// Ends of the segment \[m\].
        ends: [Point3<f64>; 2],
        /// Radius \[m\].
        radius: f64,
    },
    /// All points behind the plane through the origin.
    HalfSpace {
        /// Outward unit normal.
        normal: Vector3<f64>,
    },
    /// A surface; triangles stop the thread on both sides. It may deform during the step.
    Mesh {
        /// Vertices at the beginning of the step \[m\].
        from: &'a [Point3<f64>],
        /// Vertices at its end \[m\].
        to: &'a [Point3<f64>],
        /// Corners of the triangles.
        triangles: &'a [[u32; 3]],
        /// Half the thickness of the surface \[m\].
        radius: f64,
    },
}

/// An obstacle with a prescribed motion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Obstacle<'a> {
    /// Shape, in its own frame.
    pub shape: Shape<'a>,
    /// `world_from_obstacle` at the beginning of the step.
    pub from: Isometry3<f64>,
    /// The same at its end.
    pub to: Isometry3<f64>,
    /// Coulomb's friction coefficient of the thread on it.
    pub friction: f64,
}

impl<'a> Obstacle<'a> {
    /// A fixed obstacle.
    #[must_use]
    pub fn fixed(shape: Shape<'a>, world_from_obstacle: Isometry3<f64>, friction: f64) -> Self {
        Self { shape, from: world_from_obstacle, to: world_from_obstacle, friction }
    }

    /// What is invalid in it, if anything.
    pub(crate) fn wrong(&self) -> Option<String> {
        let finite = |point: &Point3<f64>| point.iter().all(|x| x.is_finite());
        let pose = |pose: &Isometry3<f64>| {
            pose.translation.vector.iter().all(|x| x.is_finite()) && (pose.rotation.norm() - 1.0).abs() < 1e-6
        };
        if !self.friction.is_finite() || self.friction < 0.0 {
            return Some(format!("a friction of {}; valid: 0 or more", self.friction));
        }
        if !pose(&self.from) || !pose(&self.to) {
            return Some("a pose that is not finite or not normalised".to_owned());
        }
        let radius = |radius: f64, least: f64| {
            (!radius.is_finite() || radius < least).then(|| format!("a radius of {radius} m"))
        };
        match &self.shape {
            Shape::Sphere { radius: of } => radius(*of, f64::MIN_POSITIVE),
            Shape::Capsule { ends, radius: of } => {
                if !ends.iter().all(finite) {
                    return Some("ends that are not finite".to_owned());
                }
                radius(*of, f64::MIN_POSITIVE)
            }
            Shape::HalfSpace { normal } => {
                let unit = (normal.norm() - 1.0).abs() < 1e-6;
                (!unit).then(|| "a normal that is not of length 1".to_owned())
            }
            Shape::Mesh { from, to, triangles, radius: of } => {
                if from.len() != to.len() {
                    return Some(format!("{} vertices before the step and {} after", from.len(), to.len()));
                }
                if let Some(bad) = from.iter().zip(*to).position(|(a, b)| !finite(a) || !finite(b)) {
                    return Some(format!("vertex {bad} is not finite"));
                }
                if let Some(bad) =
                    triangles.iter().position(|of| of.iter().any(|&corner| corner as usize >= from.len()))
                {
                    return Some(format!("triangle {bad} names a vertex that there is none of"));
                }
                radius(*of, 0.0)
            }
        }
    }
}

/// Motion of an obstacle in a substep.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Motion {
    pub from: Isometry3<f64>,
    pub to: Isometry3<f64>,
    /// Fractions of the whole step, for deforming meshes.
    pub fractions: [f64; 2],
}

impl Motion {
    /// The motion between two fractions of the whole step.
    pub fn of(obstacle: &Obstacle, fractions: [f64; 2]) -> Self {
        let at = |fraction: f64| {
            let (a, b) = (&obstacle.from, &obstacle.to);
            let place = a.translation.vector.lerp(&b.translation.vector, fraction);
            let rotation = a.rotation.try_slerp(&b.rotation, fraction, 1e-12).unwrap_or(b.rotation);
            Isometry3::from_parts(Translation3::from(place), rotation)
        };
        Self { from: at(fractions[0]), to: at(fractions[1]), fractions }
    }
}

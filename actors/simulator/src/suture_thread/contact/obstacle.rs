//! Obstacles that a thread can touch.

use nalgebra::{Isometry3, Matrix3, Point3, Translation3, UnitQuaternion, Vector3};

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
    /// How it gives way to the thread within the step; absent: its motion is prescribed.
    pub mobility: Option<ObstacleMobility>,
}

/// Inverse mass of an obstacle that is free to move: `to` is its pose without the thread's forces.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ObstacleMobility {
    /// Inverse mass \[1/kg\].
    pub mass_inverse: f64,
    /// Centre of mass, in the obstacle's frame \[m\].
    pub centre: Point3<f64>,
    /// Inverse inertia tensor about it, in world axes \[1/(kg·m²)\].
    pub inertia_inverse: Matrix3<f64>,
    /// How far it goes by a change of velocity, at once, if it is moved by the impulses of a longer span together \[s\];
    /// absent: it moves on freely.
    pub lever: Option<f64>,
}

impl<'a> Obstacle<'a> {
    /// A fixed obstacle.
    #[must_use]
    pub fn fixed(shape: Shape<'a>, world_from_obstacle: Isometry3<f64>, friction: f64) -> Self {
        let mobility = None;
        Self { shape, from: world_from_obstacle, to: world_from_obstacle, friction, mobility }
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
        let is_sound = |mobility: &ObstacleMobility| {
            mobility.mass_inverse >= 0.0
                && mobility.mass_inverse.is_finite()
                && finite(&mobility.centre)
                && mobility.inertia_inverse.iter().all(|x| x.is_finite())
                && mobility.lever.is_none_or(|lever| lever > 0.0 && lever.is_finite())
        };
        if !self.mobility.as_ref().is_none_or(is_sound) {
            return Some("a mass or inertia that is not finite".to_owned());
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

/// How far an obstacle has given way since the beginning of a step, and how fast it does, about its centre of mass.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Yielded {
    /// Displacement \[m\], and rotation \[rad\].
    pub way: [Vector3<f64>; 2],
    /// Velocity \[m/s\], and angular velocity \[rad/s\].
    pub velocity: [Vector3<f64>; 2],
    /// Impulse of the thread on it \[N·s\], and its moment about the centre of mass \[N·m·s\].
    pub impulse: [Vector3<f64>; 2],
}

impl Yielded {
    /// After `dt` seconds with a force \[N\] and torque about the centre of mass \[N·m\] on the obstacle.
    pub(crate) fn after(
        &self,
        mobility: &ObstacleMobility,
        dt: f64,
        [force, torque]: [Vector3<f64>; 2],
    ) -> Self {
        let faster = [force * (mobility.mass_inverse * dt), mobility.inertia_inverse * torque * dt];
        let velocity = match mobility.lever {
            Some(_) => self.velocity,
            None => [0, 1].map(|k| self.velocity[k] + faster[k]),
        };
        let goes = |k: usize| match mobility.lever {
            Some(lever) => faster[k] * lever,
            None => velocity[k] * dt,
        };
        Self {
            way: [0, 1].map(|k| self.way[k] + goes(k)),
            velocity,
            impulse: [self.impulse[0] + force * dt, self.impulse[1] + torque * dt],
        }
    }

    /// A pose of the obstacle that has given way so far.
    pub(crate) fn of(&self, pose: &Isometry3<f64>, mobility: &ObstacleMobility) -> Isometry3<f64> {
        let centre = (pose * mobility.centre).coords;
        Translation3::from(centre + self.way[0])
            * UnitQuaternion::from_scaled_axis(self.way[1])
            * Translation3::from(-centre)
            * pose
    }
}

//! Twists and wrenches, which are dual: their product is mechanical power.

use std::ops::{Add, AddAssign, Mul, Neg, Sub};

use nalgebra::{Isometry3, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};

/// Velocity of a rigid body at a named point, in a named frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Twist {
    /// Velocity of the point \[m/s\].
    pub linear: Vector3<f64>,
    /// Angular velocity \[rad/s\].
    pub angular: Vector3<f64>,
}

/// Force and moment on a rigid body at a named point, in a named frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Wrench {
    /// Force \[N\].
    pub force: Vector3<f64>,
    /// Moment about the point \[N·m\].
    pub torque: Vector3<f64>,
}

impl Twist {
    /// At rest.
    pub const ZERO: Self = Self { linear: Vector3::new(0.0, 0.0, 0.0), angular: Vector3::new(0.0, 0.0, 0.0) };

    /// From its two parts \[m/s\] and \[rad/s\].
    pub const fn new(linear: Vector3<f64>, angular: Vector3<f64>) -> Self {
        Self { linear, angular }
    }
    /// The same motion, seen at a point `offset` \[m\] away from the present one.
    pub fn at_offset(&self, offset: &Vector3<f64>) -> Self {
        Self { linear: self.linear + self.angular.cross(offset), angular: self.angular }
    }
    /// Whether every number is finite.
    pub fn is_finite(&self) -> bool {
        finite(&self.linear) && finite(&self.angular)
    }
}

impl Wrench {
    /// No load.
    pub const ZERO: Self = Self { force: Vector3::new(0.0, 0.0, 0.0), torque: Vector3::new(0.0, 0.0, 0.0) };

    /// From its two parts \[N\] and \[N·m\].
    pub const fn new(force: Vector3<f64>, torque: Vector3<f64>) -> Self {
        Self { force, torque }
    }
    /// The same load, with its moment about a point `offset` \[m\] away from the present one.
    pub fn at_offset(&self, offset: &Vector3<f64>) -> Self {
        Self { force: self.force, torque: self.torque - offset.cross(&self.force) }
    }
    /// Power delivered to a body that moves with `twist` \[W\]; both at the same point and in the same frame.
    pub fn power(&self, twist: &Twist) -> f64 {
        self.force.dot(&twist.linear) + self.torque.dot(&twist.angular)
    }
    /// Whether every number is finite.
    pub fn is_finite(&self) -> bool {
        finite(&self.force) && finite(&self.torque)
    }
}

macro_rules! vector_space {
    ($type:ident, $a:ident, $b:ident) => {
        impl Add for $type {
            type Output = Self;
            fn add(self, other: Self) -> Self {
                Self { $a: self.$a + other.$a, $b: self.$b + other.$b }
            }
        }
        impl AddAssign for $type {
            fn add_assign(&mut self, other: Self) {
                *self = *self + other;
            }
        }
        impl Sub for $type {
            type Output = Self;
            fn sub(self, other: Self) -> Self {
                Self { $a: self.$a - other.$a, $b: self.$b - other.$b }
            }
        }
        impl Neg for $type {
            type Output = Self;
            fn neg(self) -> Self {
                Self { $a: -self.$a, $b: -self.$b }
            }
        }
        impl Mul<f64> for $type {
            type Output = Self;
            fn mul(self, factor: f64) -> Self {
                Self { $a: self.$a * factor, $b: self.$b * factor }
            }
        }
    };
}
vector_space!(Twist, linear, angular);
vector_space!(Wrench, force, torque);

/// Whether every component is finite.
pub fn finite(vector: &Vector3<f64>) -> bool {
    vector.iter().all(|x| x.is_finite())
}

/// Whether a pose is finite and its rotation normalised to 1e-6.
pub fn valid_pose(pose: &Isometry3<f64>) -> bool {
    finite(&pose.translation.vector)
        && pose.rotation.coords.iter().all(|x| x.is_finite())
        && (pose.rotation.coords.norm_squared() - 1.0).abs() < 1e-6
}

/// Twice the vector part of a rotation's quaternion: its rotation vector \[rad\] for small angles, bounded by 2 for
/// large ones. Unlike the exact one it takes no arc tangent, so it is bit-identical on every machine.
pub fn small_rotation_vector(rotation: &UnitQuaternion<f64>) -> Vector3<f64> {
    let coords = rotation.coords;
    Vector3::new(coords.x, coords.y, coords.z) * if coords.w < 0.0 { -2.0 } else { 2.0 }
}

/// The rotation of least angle that takes the unit vector `from` to the unit vector `to`.
///
/// Opposite vectors have no such rotation; within 1e-12 of that a half turn about an axis that depends on
/// `from` only is returned, so the answer is always finite.
pub fn minimal_rotation(from: &Vector3<f64>, to: &Vector3<f64>) -> UnitQuaternion<f64> {
    let cosine = from.dot(to);
    if 1.0 + cosine < 1e-12 {
        let helper = if from.x.abs() < 0.9 { Vector3::x() } else { Vector3::y() };
        let axis = from.cross(&helper).normalize();
        return UnitQuaternion::new_unchecked(nalgebra::Quaternion::new(0.0, axis.x, axis.y, axis.z));
    }
    let sine = from.cross(to);
    UnitQuaternion::new_normalize(nalgebra::Quaternion::new(1.0 + cosine, sine.x, sine.y, sine.z))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn power_does_not_depend_on_the_point() {
        let twist = Twist::new(Vector3::new(0.1, -0.2, 0.3), Vector3::new(1.0, 2.0, -0.5));
        let wrench = Wrench::new(Vector3::new(2.0, 0.3, -1.0), Vector3::new(0.01, -0.02, 0.05));
        let offset = Vector3::new(0.05, 0.2, -0.1);
        let there = wrench.at_offset(&offset).power(&twist.at_offset(&offset));
        assert!((wrench.power(&twist) - there).abs() < 1e-14);
    }

    #[test]
    fn small_rotations_are_vectors_and_large_ones_stay_bounded() {
        let vector = Vector3::new(0.01, -0.02, 0.005);
        let rotation = UnitQuaternion::from_scaled_axis(vector);
        assert!((small_rotation_vector(&rotation) - vector).norm() < 1e-5);
        let negative = UnitQuaternion::new_unchecked(-rotation.into_inner());
        assert!((small_rotation_vector(&negative) - vector).norm() < 1e-5);
        let large = UnitQuaternion::from_scaled_axis(Vector3::new(0.0, 3.1, 0.0));
        assert!(small_rotation_vector(&large).norm() <= 2.0);
    }

    #[test]
    fn the_minimal_rotation_takes_one_axis_to_the_other_without_roll() {
        let (from, to) = (Vector3::new(0.6, 0.0, 0.8), Vector3::new(-0.8, 0.6, 0.0));
        let rotation = minimal_rotation(&from, &to);
        assert!((rotation * from - to).norm() < 1e-14);
        assert!((rotation.angle() - from.dot(&to).acos()).abs() < 1e-12);
        let half_turn = minimal_rotation(&from, &-from);
        assert!((half_turn * from + from).norm() < 1e-12);
    }
}

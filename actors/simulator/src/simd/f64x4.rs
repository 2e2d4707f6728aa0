//! 3-vectors padded to a SIMD register.

use std::ops::{Add, AddAssign, Mul, Sub, SubAssign};

use nalgebra::Vector3;

/// A 3-vector with a fourth component 0: loaded, added and scaled as a whole in registers of four numbers.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[repr(C, align(32))]
pub(crate) struct Quad(pub [f64; 4]);

impl Quad {
    #[inline(always)]
    pub fn times(self, other: Self) -> Self {
        let ([a, b, c, d], [e, f, g, h]) = (self.0, other.0);
        Self([a * e, b * f, c * g, d * h])
    }

    #[inline(always)]
    pub fn sum(self) -> f64 {
        let [x, y, z, nothing] = self.0;
        (x + z) + (y + nothing)
    }

    #[inline(always)]
    pub fn vector(self) -> Vector3<f64> {
        Vector3::new(self.0[0], self.0[1], self.0[2])
    }
}

impl From<&Vector3<f64>> for Quad {
    #[inline(always)]
    fn from(vector: &Vector3<f64>) -> Self {
        Self([vector.x, vector.y, vector.z, 0.0])
    }
}

lane_by_lane!(Quad: Add add, Sub sub);

impl Mul<f64> for Quad {
    type Output = Self;
    #[inline(always)]
    fn mul(self, factor: f64) -> Self {
        let [a, b, c, d] = self.0;
        Self([a * factor, b * factor, c * factor, d * factor])
    }
}

impl AddAssign for Quad {
    #[inline(always)]
    fn add_assign(&mut self, other: Self) {
        *self = *self + other;
    }
}

impl SubAssign for Quad {
    #[inline(always)]
    fn sub_assign(&mut self, other: Self) {
        *self = *self - other;
    }
}

/// The dot product of two lists of them.
#[inline(always)]
pub(crate) fn dot(first: &[Quad], second: &[Quad]) -> f64 {
    first.iter().zip(second).fold(Quad::default(), |sum, (first, second)| sum + first.times(*second)).sum()
}

//! Four numbers in a baseline SIMD register, so that four constraints are computed by the instructions of one.

use std::ops::{Add, Div, Mul, Neg, Sub};

/// Number of lanes.
pub(crate) const LANES: usize = 4;

#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[repr(align(16))]
pub(crate) struct Wide(pub [f32; LANES]);

impl Wide {
    #[inline(always)]
    pub fn all(value: f32) -> Self {
        Self([value; LANES])
    }
    #[inline(always)]
    pub fn root(self) -> Self {
        let [a, b, c, d] = self.0;
        Self([a.sqrt(), b.sqrt(), c.sqrt(), d.sqrt()])
    }
}

lane_by_lane!(Wide: Add add, Sub sub, Mul mul, Div div);

impl Wide {
    /// Differences of double-precision numbers.
    #[inline(always)]
    pub fn between(from: &[f64; LANES], to: &[f64; LANES]) -> Self {
        let of = |lane: usize| (to[lane] - from[lane]) as f32;
        Self([of(0), of(1), of(2), of(3)])
    }
    #[inline(always)]
    pub fn doubled(self) -> [f64; LANES] {
        let [a, b, c, d] = self.0;
        [f64::from(a), f64::from(b), f64::from(c), f64::from(d)]
    }
}

impl Neg for Wide {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        let [a, b, c, d] = self.0;
        Self([-a, -b, -c, -d])
    }
}

// Written out throughout: closures over arrays are not inlined.

/// Four vectors.
pub(crate) type Vectors = [Wide; 3];

#[inline(always)]
pub(crate) fn dot(a: &Vectors, b: &Vectors) -> Wide {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}
#[inline(always)]
pub(crate) fn cross(a: &Vectors, b: &Vectors) -> Vectors {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}
/// `a x + b y + c z`, lane by lane.
#[inline(always)]
pub(crate) fn sum(a: Wide, x: &Vectors, b: Wide, y: &Vectors, c: Wide, z: &Vectors) -> Vectors {
    [a * x[0] + b * y[0] + c * z[0], a * x[1] + b * y[1] + c * z[1], a * x[2] + b * y[2] + c * z[2]]
}
#[inline(always)]
pub(crate) fn plus(a: &Vectors, b: &Vectors) -> Vectors {
    [a[0] + b[0], a[1] + b[1], a[2] + b[2]]
}
#[inline(always)]
pub(crate) fn times(a: &Vectors, by: Wide) -> Vectors {
    [a[0] * by, a[1] * by, a[2] * by]
}

//! Four-lane vectors as plain arrays, which the compiler maps to SIMD registers.

use std::ops::{Add, Div, Mul, Sub};

/// Four numbers, of four boxes or four triangles.
#[derive(Clone, Copy, Debug, PartialEq)]
#[repr(C, align(16))]
pub(super) struct Lanes(pub [f32; 4]);

/// Three coordinates of four points.
pub(super) type Lanes3 = [Lanes; 3];

impl Lanes {
    pub const ZERO: Self = Self([0.0; 4]);

    #[inline(always)]
    pub fn all(value: f32) -> Self {
        Self([value; 4])
    }

    #[inline(always)]
    fn zip(self, other: Self, with: impl Fn(f32, f32) -> f32) -> Self {
        let (a, b) = (self.0, other.0);
        Self([with(a[0], b[0]), with(a[1], b[1]), with(a[2], b[2]), with(a[3], b[3])])
    }

    /// Written as a select, which is one instruction; `f32::max` takes three because of NaN.
    #[inline(always)]
    pub fn max(self, other: Self) -> Self {
        self.zip(other, |a, b| if a > b { a } else { b })
    }

    #[inline(always)]
    pub fn min(self, other: Self) -> Self {
        self.zip(other, |a, b| if a < b { a } else { b })
    }

    #[inline(always)]
    pub fn abs(self) -> Self {
        let a = self.0;
        Self([a[0].abs(), a[1].abs(), a[2].abs(), a[3].abs()])
    }

    #[inline(always)]
    pub fn clamp_to_one(self) -> Self {
        self.max(Self::ZERO).min(Self::all(1.0))
    }

    #[inline(always)]
    pub fn lowest(self) -> f32 {
        let [a, b, c, d] = self.0;
        let (a, b) = (if a < b { a } else { b }, if c < d { c } else { d });
        if a < b { a } else { b }
    }

    #[inline(always)]
    pub fn highest(self) -> f32 {
        let [a, b, c, d] = self.0;
        let (a, b) = (if a > b { a } else { b }, if c > d { c } else { d });
        if a > b { a } else { b }
    }

    /// `self` where `value` is less than `limit`, else `other`.
    #[inline(always)]
    pub fn where_less(self, value: Self, limit: Self, other: Self) -> Self {
        let pick = |lane: usize| if value.0[lane] < limit.0[lane] { self.0[lane] } else { other.0[lane] };
        Self([pick(0), pick(1), pick(2), pick(3)])
    }

    /// Bit mask of the lanes where `self` is at most `limit`.
    #[inline(always)]
    pub fn at_most(self, limit: Self) -> u32 {
        let bit = |lane: usize| u32::from(self.0[lane] <= limit.0[lane]) << lane;
        bit(0) | bit(1) | bit(2) | bit(3)
    }
}

impl Add for Lanes {
    type Output = Self;
    #[inline(always)]
    fn add(self, other: Self) -> Self {
        self.zip(other, |a, b| a + b)
    }
}

impl Sub for Lanes {
    type Output = Self;
    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        self.zip(other, |a, b| a - b)
    }
}

impl Mul for Lanes {
    type Output = Self;
    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        self.zip(other, |a, b| a * b)
    }
}

impl Div for Lanes {
    type Output = Self;
    #[inline(always)]
    fn div(self, other: Self) -> Self {
        self.zip(other, |a, b| a / b)
    }
}

/// Maps 0, 1 and 2; unlike `array::map` always in registers.
#[inline(always)]
pub(super) fn three<T>(of: impl Fn(usize) -> T) -> [T; 3] {
    [of(0), of(1), of(2)]
}

/// Maps each of three; unlike `array::map` always in registers.
#[inline(always)]
pub(super) fn each<T: Copy, U>(values: [T; 3], of: impl Fn(T) -> U) -> [U; 3] {
    [of(values[0]), of(values[1]), of(values[2])]
}

#[inline(always)]
pub(super) fn splat(point: [f32; 3]) -> Lanes3 {
    [Lanes::all(point[0]), Lanes::all(point[1]), Lanes::all(point[2])]
}

#[inline(always)]
pub(super) fn times(a: Lanes3, factor: Lanes) -> Lanes3 {
    [a[0] * factor, a[1] * factor, a[2] * factor]
}

#[inline(always)]
pub(super) fn minus(a: Lanes3, b: Lanes3) -> Lanes3 {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

#[inline(always)]
pub(super) fn dot(a: Lanes3, b: Lanes3) -> Lanes {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

#[inline(always)]
pub(super) fn cross(a: Lanes3, b: Lanes3) -> Lanes3 {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

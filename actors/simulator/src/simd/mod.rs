//! SIMD lanes, and run-time dispatch to the widest registers.

/// Implements operators on a tuple struct of four lanes. They are written out, because closures over arrays are not
/// always inlined.
macro_rules! lane_by_lane {
    ($type:ident: $($trait:ident $name:ident),+) => {
        $(impl $trait for $type {
            type Output = Self;
            #[inline(always)]
            fn $name(self, other: Self) -> Self {
                let ([a, b, c, d], [e, f, g, h]) = (self.0, other.0);
                Self([a.$name(e), b.$name(f), c.$name(g), d.$name(h)])
            }
        })+
    };
}

pub(crate) mod dispatch;
pub(crate) mod f32x4;
pub(crate) mod f32x8;
pub(crate) mod f64x4;

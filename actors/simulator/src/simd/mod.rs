//! SIMD lanes, and run-time dispatch to the widest registers.

pub(crate) mod dispatch;
pub(crate) mod f32x4;
pub(crate) mod f32x8;
pub(crate) mod f64x4;

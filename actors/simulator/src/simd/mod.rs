//! Numbers side by side in lanes, and the choice of the widest that a machine has.

pub(crate) mod dispatch;
pub(crate) mod f32x4;
pub(crate) mod f32x8;
pub(crate) mod f64x4;

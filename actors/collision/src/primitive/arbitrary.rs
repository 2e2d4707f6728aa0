//! Random points for property tests: anywhere in a cube, often with coordinates 0, 0.5 or almost 0, so that touching,
//! coplanar and degenerate cases occur.

use nalgebra::Point3;
use proptest::prelude::*;

/// Coordinates from −1 to 1, one in three of them 0 or a half.
pub(crate) fn point() -> impl Strategy<Value = Point3<f64>> {
    let coordinate = || prop_oneof![-1.0..1.0_f64, Just(0.0), Just(0.5)];
    [coordinate(), coordinate(), coordinate()].prop_map(Point3::from)
}

/// The same, with one in four within `tiny` of 0.
pub(crate) fn point_with(tiny: f64) -> impl Strategy<Value = Point3<f64>> {
    let coordinate = || prop_oneof![-1.0..1.0_f64, Just(0.0), Just(0.5), -tiny..tiny];
    [coordinate(), coordinate(), coordinate()].prop_map(Point3::from)
}

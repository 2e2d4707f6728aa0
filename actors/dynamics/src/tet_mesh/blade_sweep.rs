//! The area that a blade's edge sweeps between two frames.

use nalgebra::Point3;
use serde::{Deserialize, Serialize};
use trocar_collision::primitive::Triangle;

/// Twice the area of a triangle over its longer side squared, below which it counts as degenerate.
const FLAT: f64 = 1e-9;

/// A blade's edge in two frames; the swept area is approximated by two triangles.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Sweep {
    /// Both ends in the previous frame \[m\].
    pub before: [Point3<f64>; 2],
    /// Both ends now \[m\].
    pub after: [Point3<f64>; 2],
}

impl Sweep {
    /// The triangles of the area, without degenerate ones: an edge that turns about one end sweeps one triangle.
    pub fn triangles(&self) -> impl Iterator<Item = Triangle> + use<> {
        let ([a, b], [c, d]) = (self.before, self.after);
        let has_area = |[a, b, c]: &Triangle| {
            let (ab, ac) = (b - a, c - a);
            ab.cross(&ac).norm() > FLAT * ab.norm_squared().max(ac.norm_squared())
        };
        [[a, b, c], [b, d, c]].into_iter().filter(has_area)
    }
}

//! What the edge of a blade sweeps between two frames.

use nalgebra::Point3;
use serde::{Deserialize, Serialize};
use trocar_collision::primitive::Triangle;

/// Twice the area of a triangle as a share of its longer side squared, below which it is a line.
const FLAT: f64 = 1e-9;

/// The edge of a blade at two frames; what it sweeps in between is taken as two triangles.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Sweep {
    /// Both ends at the frame before \[m\].
    pub before: [Point3<f64>; 2],
    /// Both ends now \[m\].
    pub after: [Point3<f64>; 2],
}

impl Sweep {
    /// The triangles of the area, without those that are a line: an edge that turns about one of its ends sweeps one triangle.
    pub fn triangles(&self) -> impl Iterator<Item = Triangle> + use<> {
        let ([a, b], [c, d]) = (self.before, self.after);
        let has_area = |[a, b, c]: &Triangle| {
            let (ab, ac) = (b - a, c - a);
            ab.cross(&ac).norm() > FLAT * ab.norm_squared().max(ac.norm_squared())
        };
        [[a, b, c], [b, d, c]].into_iter().filter(has_area)
    }
}

//! Places on surfaces that move with them, whatever the surface does: what points, strokes and labels are fixed to.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::ComponentError;
use crate::entity::Entity;

/// How far the sum of barycentric coordinates may be from one, each of them below zero, and the length of a normal from
/// one.
const WEIGHT_TOLERANCE: f32 = 1e-3;
/// How far a point may be from the origin of its body \[m\].
pub const PLACE_REACH_MAX: f32 = 100.0;

/// A place on the surface of a body. It moves with the body, and with the tissue under it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SurfacePlace {
    /// The body.
    #[schemars(with = "String")]
    pub entity: Entity,
    /// Where on it.
    pub on: SurfacePoint,
}

/// Where on a body a place is.
///
/// Triangles and segments are named by their vertices, not by their numbers: a cut or a burn renumbers triangles, and
/// keeps the vertices that stay. A triangle that is cut has other vertices afterwards, and its places are lost.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum SurfacePoint {
    /// On a triangle of the mesh.
    Triangle {
        /// Its vertices, counter-clockwise seen from the side that is meant: a membrane has two.
        corners: [u32; 3],
        /// Weights of the vertices: each 0 to 1, with the sum 1.
        barycentric: [f32; 3],
    },
    /// On a segment of a thread or band.
    Segment {
        /// Its vertices.
        ends: [u32; 2],
        /// From the first (0) to the second (1).
        along: f32,
    },
    /// On a body without a mesh.
    Body {
        /// In the body's frame \[m\].
        point: [f32; 3],
        /// Unit normal there, outwards, in the body's frame.
        normal: [f32; 3],
    },
}

impl SurfacePlace {
    /// Refuses what is no place on any surface. Whether the body has it, a snapshot tells.
    ///
    /// # Errors
    /// Names the number that is out of its range.
    pub fn check(&self) -> Result<(), ComponentError> {
        const ROOM: std::ops::RangeInclusive<f64> =
            -(WEIGHT_TOLERANCE as f64)..=1.0 + WEIGHT_TOLERANCE as f64;
        const ONE: std::ops::RangeInclusive<f64> =
            1.0 - WEIGHT_TOLERANCE as f64..=1.0 + WEIGHT_TOLERANCE as f64;
        match &self.on {
            SurfacePoint::Triangle { barycentric, .. } => {
                for weight in barycentric {
                    ComponentError::range("barycentric", f64::from(*weight), ROOM, "0 to 1")?;
                }
                let sum: f32 = barycentric.iter().sum();
                ComponentError::range("barycentric (their sum)", f64::from(sum), ONE, "1")
            }
            SurfacePoint::Segment { along, .. } => {
                ComponentError::range("along", f64::from(*along), ROOM, "0 to 1")
            }
            SurfacePoint::Body { point, normal } => {
                let reach = f64::from(PLACE_REACH_MAX);
                for part in point {
                    ComponentError::range("point", f64::from(*part), -reach..=reach, "-100 to 100 m")?;
                }
                let length = normal.iter().map(|part| f64::from(*part).powi(2)).sum::<f64>().sqrt();
                ComponentError::range("normal (its length)", length, ONE, "1")
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn refused(on: SurfacePoint) -> bool {
        SurfacePlace { entity: Entity::new(0, 0, 7), on }.check().is_err()
    }

    #[test]
    fn a_place_outside_of_its_triangle_or_without_a_number_is_refused() {
        let on = |barycentric| SurfacePoint::Triangle { corners: [0, 1, 2], barycentric };
        assert!(!refused(on([0.2, 0.3, 0.5])));
        assert!(!refused(on([1.0, 0.0, 0.0])));
        for weights in [[f32::NAN, 0.5, 0.5], [0.5, 0.5, 0.5], [-1.0, 1.0, 1.0], [f32::INFINITY, 0.0, 0.0]] {
            assert!(refused(on(weights)), "{weights:?}");
        }
    }

    #[test]
    fn a_place_beyond_its_segment_or_far_from_its_body_is_refused() {
        let along = |along| SurfacePoint::Segment { ends: [3, 4], along };
        assert!(!refused(along(0.5)));
        assert!(refused(along(1.1)) && refused(along(f32::NAN)));
        let at = |point, normal| SurfacePoint::Body { point, normal };
        assert!(!refused(at([0.1, 0.0, -0.2], [0.0, 0.6, 0.8])));
        assert!(refused(at([101.0, 0.0, 0.0], [0.0, 0.0, 1.0])));
        assert!(refused(at([f32::NAN, 0.0, 0.0], [0.0, 0.0, 1.0])));
        assert!(refused(at([0.0; 3], [0.0; 3])) && refused(at([0.0; 3], [1.0, 1.0, 0.0])));
    }
}

//! Angle-weighted pseudonormals of faces, edges and vertices, for inside tests (Bærentzen and Aanæs, *Signed distance
//! computation using the angle weighted pseudonormal*, 2005).

use nalgebra::Vector3;

use crate::Surface;
use crate::topology::Topology;

/// The pseudonormal at a point with these weights on a triangle: of its face, of the faces at its edge, or of those at
/// its vertex, weighted by their angles. At the nearest point of a closed surface, the query point is inside exactly if
/// the pseudonormal points away from it. Not of unit length; `None` if no face there has an area, or if they cancel
/// out.
///
/// # Panics
/// When the triangle does not exist.
#[must_use]
pub fn pseudonormal(
    surface: &Surface,
    topology: &Topology,
    triangle: u32,
    weights: &[f64; 3],
) -> Option<Vector3<f64>> {
    let corners = &surface.triangles()[triangle as usize];
    let sharing = topology.sharing(corners, triangle, weights);
    let held = (0..3).filter(|&corner| weights[corner] > 0.0).count();
    let vertex = (0..3).find(|&corner| weights[corner] > 0.0).map(|corner| corners[corner]);
    let sum = match (held, vertex) {
        (1, Some(vertex)) => sharing.iter().fold(Vector3::zeros(), |sum, &about| {
            let corners = &surface.triangles()[about as usize];
            let Some(own) = corners.iter().position(|&corner| corner == vertex) else { return sum };
            let triangle = surface.triangle(about);
            let first = triangle[(own + 1) % 3] - triangle[own];
            let second = triangle[(own + 2) % 3] - triangle[own];
            let normal = first.cross(&second);
            let size = normal.norm();
            if size > 0.0 { sum + normal * (size.atan2(first.dot(&second)) / size) } else { sum }
        }),
        (2, _) => sharing.iter().fold(Vector3::zeros(), |sum, &about| sum + face(surface, about)),
        _ => face(surface, triangle),
    };
    (sum.norm_squared() > 1e-24).then_some(sum)
}

/// Unit normal of a face; zero without an area.
pub(crate) fn face(surface: &Surface, triangle: u32) -> Vector3<f64> {
    let [a, b, c] = surface.triangle(triangle);
    let normal = (b - a).cross(&(c - a));
    let size = normal.norm();
    if size > 0.0 { normal / size } else { Vector3::zeros() }
}

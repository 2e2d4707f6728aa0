//! Maps a point at or in a deformed body to its position in the rest shape.

use nalgebra::{Matrix3, Point3};
use trocar_collision::primitive::closest_on_triangle;

/// The point whose position relative to the rest surface is that of `place` relative to the current surface, by the
/// nearest triangle and its rotating frame. Without a surface, `place` itself.
#[must_use]
pub fn rest_place(
    place: &Point3<f64>,
    triangles: &[[u32; 3]],
    positions: &[Point3<f64>],
    rest: &[Point3<f64>],
) -> Point3<f64> {
    let corners = |nodes: &[u32; 3], of: &[Point3<f64>]| {
        let [a, b, c] = nodes.map(|node| of.get(node as usize).copied());
        Some([a?, b?, c?])
    };
    let near = triangles.iter().filter_map(|nodes| {
        let nearest = closest_on_triangle(place, &corners(nodes, positions)?);
        Some(((place - nearest.point).norm_squared(), nodes, nearest))
    });
    let Some((_, nodes, nearest)) = near.min_by(|a, b| a.0.total_cmp(&b.0)) else { return *place };
    let (Some(now), Some(before)) = (corners(nodes, positions), corners(nodes, rest)) else { return *place };
    let on_rest = before
        .iter()
        .zip(nearest.weights)
        .fold(nalgebra::Vector3::zeros(), |sum, (corner, weight)| sum + corner.coords * weight);
    let off = place - nearest.point;
    match (frame(&now), frame(&before)) {
        (Some(now), Some(before)) => Point3::from(on_rest + before * now.tr_mul(&off)),
        _ => Point3::from(on_rest + off),
    }
}

/// Axes along the first edge, across it, and along the normal.
fn frame([a, b, c]: &[Point3<f64>; 3]) -> Option<Matrix3<f64>> {
    let along = (b - a).try_normalize(0.0)?;
    let out = (b - a).cross(&(c - a)).try_normalize(0.0)?;
    Some(Matrix3::from_columns(&[along, out.cross(&along), out]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Isometry3, Vector3};

    #[test]
    fn a_place_goes_back_with_what_has_moved_and_turned() {
        let rest: Vec<Point3<f64>> = [[0.0, 0.0], [0.01, 0.0], [0.0, 0.01], [0.01, 0.01]]
            .map(|[x, y]| Point3::new(x, y, 0.0))
            .to_vec();
        let triangles = [[0, 1, 2], [1, 3, 2]];
        let moved = Isometry3::new(Vector3::new(0.1, -0.2, 0.3), Vector3::new(0.4, 1.0, -0.3));
        let now: Vec<_> = rest.iter().map(|point| moved * point).collect();
        for place in [[0.002, 0.003, 0.001], [0.009, 0.008, -0.002], [-0.001, 0.005, 0.0]] {
            let place = Point3::from(place);
            let back = rest_place(&(moved * place), &triangles, &now, &rest);
            assert!((back - place).norm() < 1e-12, "{back}");
        }
        // Stretched to twice its length along x, it is half as far along, and as high above.
        let stretched: Vec<_> = rest.iter().map(|p| Point3::new(2.0 * p.x, p.y, p.z)).collect();
        let back = rest_place(&Point3::new(0.006, 0.002, 0.0015), &triangles, &stretched, &rest);
        assert!((back - Point3::new(0.003, 0.002, 0.0015)).norm() < 1e-12, "{back}");
        assert_eq!(rest_place(&Point3::origin(), &[], &[], &[]), Point3::origin());
    }
}

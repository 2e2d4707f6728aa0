//! Mass properties of the volume enclosed by a surface (Mirtich 1996).

use nalgebra::{Matrix3, Point3, Vector3};

/// A homogeneous solid of mass 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct UnitSolid {
    /// Enclosed volume \[m³\].
    pub volume: f64,
    /// Centre of mass \[m\].
    pub centre: Point3<f64>,
    /// Inertia about the centre, per mass \[m²\].
    pub inertia: Matrix3<f64>,
}

/// Fraction of the bounding box's volume below which a surface encloses nothing.
const FLAT: f64 = 1e-6;

/// The solid within a closed surface: the sum over the signed tetrahedra between a point and each triangle (Mirtich,
/// "Fast and accurate computation of polyhedral mass properties", 1996, whose integrals these are in closed form). An
/// inverted surface gives the same result. `None`: it encloses no volume.
#[must_use]
pub fn enclosed(vertices: &[Point3<f64>], triangles: &[[u32; 3]]) -> Option<UnitSolid> {
    let first = vertices.first()?;
    let (low, high) = vertices.iter().fold((*first, *first), |(low, high), at| (low.inf(at), high.sup(at)));
    // About the centre of the bounding box: far from the origin the sums would cancel.
    let middle = nalgebra::center(&low, &high);
    let mut six_volumes = 0.0;
    let mut first_moment = Vector3::zeros();
    let mut second_moment = Matrix3::zeros();
    for corners in triangles {
        let corner = |index: usize| vertices.get(corners[index] as usize).map(|vertex| vertex - middle);
        let (a, b, c) = (corner(0)?, corner(1)?, corner(2)?);
        let signed = a.dot(&b.cross(&c));
        let sum = a + b + c;
        six_volumes += signed;
        first_moment += sum * (signed / 24.0);
        let squares = a * a.transpose() + b * b.transpose() + c * c.transpose() + sum * sum.transpose();
        second_moment += squares * (signed / 120.0);
    }
    let volume = six_volumes / 6.0;
    let size = high - low;
    // Written so that NaN counts as no volume.
    let encloses = volume.abs() > FLAT * size.x * size.y * size.z;
    if !encloses {
        return None;
    }
    let centre = first_moment / volume;
    let about_centre = second_moment / volume - centre * centre.transpose();
    let inertia = Matrix3::identity() * about_centre.trace() - about_centre;
    Some(UnitSolid { volume: volume.abs(), centre: middle + centre, inertia })
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Isometry3, Translation3, UnitQuaternion};

    /// A box with these edge lengths and a corner at the origin.
    fn cuboid(size: Vector3<f64>) -> (Vec<Point3<f64>>, Vec<[u32; 3]>) {
        let corner = |i: usize| {
            let bit = |k: usize| (i >> k & 1) as f64;
            Point3::new(bit(0) * size.x, bit(1) * size.y, bit(2) * size.z)
        };
        let faces = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
        let triangles = faces.iter().flat_map(|[a, b, c, d]| [[*a, *b, *c], [*a, *c, *d]]).collect();
        ((0..8).map(corner).collect(), triangles)
    }

    #[test]
    fn a_box_has_that_of_the_closed_form_wherever_it_is() {
        let size = Vector3::new(0.02, 0.03, 0.05);
        let (vertices, mut triangles) = cuboid(size);
        let turn = UnitQuaternion::from_euler_angles(0.3, -0.8, 1.9);
        for place in [Vector3::zeros(), Vector3::new(0.5, -2.0, 1.0)] {
            let moved = Isometry3::from_parts(Translation3::from(place), turn);
            let vertices: Vec<_> = vertices.iter().map(|vertex| moved * vertex).collect();
            for _ in 0..2 {
                let solid = enclosed(&vertices, &triangles).expect("a solid");
                assert!((solid.volume / (0.02 * 0.03 * 0.05) - 1.0).abs() < 1e-12);
                assert!((solid.centre - moved * Point3::from(size / 2.0)).norm() < 1e-12);
                let square = size.component_mul(&size) / 12.0;
                let own = Vector3::new(square.y + square.z, square.x + square.z, square.x + square.y);
                let turn = turn.to_rotation_matrix();
                let expected = turn.matrix() * Matrix3::from_diagonal(&own) * turn.matrix().transpose();
                assert!((solid.inertia - expected).norm() < 1e-12 * expected.norm().max(1.0));
                // Inverted.
                triangles.iter_mut().for_each(|corners| corners.swap(1, 2));
            }
        }
    }

    #[test]
    fn what_encloses_nothing_has_none() {
        let (vertices, triangles) = cuboid(Vector3::new(1.0, 1.0, 0.0));
        assert_eq!(enclosed(&vertices, &triangles), None);
        assert_eq!(enclosed(&[], &[]), None);
        assert_eq!(enclosed(&vertices[..3], &[[0, 1, 9]]), None);
    }
}

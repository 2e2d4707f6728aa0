//! Validity check of linear elasticity: rotation and strain of every element.

use nalgebra::{Matrix3, Vector3};
use trocar_dynamics::tet_mesh::TetMesh;

/// Rotation of an element beyond which linear elasticity is invalid \[rad\]: 10°.
pub const ROTATION_LIMIT: f64 = 10.0 * std::f64::consts::PI / 180.0;
/// Principal strain beyond which linear elasticity is invalid: 10 %.
pub const STRAIN_LIMIT: f64 = 0.1;

/// The largest rotation and strain of any element.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Deformation {
    /// Largest rotation \[rad\]; π for an inverted element.
    pub rotation: f64,
    /// The element with the largest rotation.
    pub rotated_tet: u32,
    /// Largest principal strain in magnitude, in the frame of the element; infinite for an inverted one.
    pub strain: f64,
    /// The element with the largest strain.
    pub strained_tet: u32,
}

impl Deformation {
    /// From displacements of all nodes \[m\].
    ///
    /// # Panics
    /// When there is not one displacement per node.
    #[must_use]
    pub fn of(mesh: &TetMesh, displacements: &[Vector3<f64>]) -> Self {
        Self::without(mesh, displacements, &[])
    }

    /// The same without removed elements.
    ///
    /// # Panics
    /// When there is not one displacement per node.
    #[must_use]
    pub fn without(mesh: &TetMesh, displacements: &[Vector3<f64>], gone: &[u32]) -> Self {
        assert_eq!(displacements.len(), mesh.rest().len(), "one displacement per node");
        let mut most = Self::default();
        let mut gone = gone.to_vec();
        gone.sort_unstable();
        for (index, tet) in mesh.tets().iter().enumerate() {
            if gone.binary_search(&(index as u32)).is_ok() {
                continue;
            }
            let [a, b, c, d] = tet.map(|node| displacements[node as usize]);
            let edges = Matrix3::from_columns(&[b - a, c - a, d - a]);
            let by = edges * mesh.inverse_shapes()[index];
            if most.exceeds(by.norm()) {
                continue;
            }
            let gradient = Matrix3::identity() + by;
            let (rotation, strain) = rotation_and_strain(&gradient);
            if rotation > most.rotation {
                (most.rotation, most.rotated_tet) = (rotation, index as u32);
            }
            if strain > most.strain {
                (most.strain, most.strained_tet) = (strain, index as u32);
            }
        }
        most
    }

    /// Whether no element with a deformation gradient this near to 1 (Frobenius norm) can rotate or strain more. Its
    /// rotation is the nearest one, so the strain is at most that distance, and the rotation at most twice as far from
    /// 1.
    fn exceeds(&self, size: f64) -> bool {
        // More than the rounding error.
        let size = size * (1.0 + 1e-9);
        size < 1.0
            && size <= self.strain
            && 2.0 * (size * std::f64::consts::FRAC_1_SQRT_2).asin() <= self.rotation
    }

    /// A message that explains why linear elasticity is invalid here.
    #[must_use]
    pub fn validity_warning(&self) -> String {
        format!(
            "an element turned by {:.0}°, one strained by {:.0} %: beyond {:.0}° or {:.0} % linear elasticity misleads",
            self.rotation.to_degrees(),
            100.0 * self.strain.min(1e3),
            ROTATION_LIMIT.to_degrees(),
            100.0 * STRAIN_LIMIT
        )
    }

    /// Whether both are within the limits of linear elasticity.
    #[must_use]
    pub fn is_small(&self) -> bool {
        self.rotation <= ROTATION_LIMIT && self.strain <= STRAIN_LIMIT
    }
}

/// Maximum Newton iterations for a rotation; within the limits, six are plenty.
const NEWTON_MAX: usize = 20;

/// Angle of the rotation in F = R S \[rad\], and the largest principal |S − 1|.
fn rotation_and_strain(gradient: &Matrix3<f64>) -> (f64, f64) {
    let flipped = (std::f64::consts::PI, f64::INFINITY);
    if !(gradient.determinant() > 0.0) {
        return flipped;
    }
    // The polar decomposition by Newton's iteration (Higham 1986).
    let mut rotation = *gradient;
    for _ in 0..NEWTON_MAX {
        let Some(inverse) = rotation.try_inverse() else { return flipped };
        let next = (rotation + inverse.transpose()) * 0.5;
        let change = (next - rotation).amax();
        rotation = next;
        if change < 1e-12 {
            break;
        }
    }
    let axial = Vector3::new(
        rotation[(2, 1)] - rotation[(1, 2)],
        rotation[(0, 2)] - rotation[(2, 0)],
        rotation[(1, 0)] - rotation[(0, 1)],
    );
    let angle = axial.norm().atan2(rotation.trace() - 1.0);
    let stretch = rotation.transpose() * gradient;
    let symmetric = (stretch + stretch.transpose()) * 0.5;
    let strain =
        symmetric.symmetric_eigenvalues().iter().map(|value| (value - 1.0).abs()).fold(0.0, f64::max);
    (angle, strain)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Rotation3;

    #[test]
    fn a_rotation_and_a_stretch_are_told_apart() {
        let turn = Rotation3::from_axis_angle(&Vector3::y_axis(), 0.4).into_inner();
        let stretch = Matrix3::from_diagonal(&Vector3::new(1.2, 0.95, 1.0));
        let (rotation, strain) = rotation_and_strain(&(turn * stretch));
        assert!((rotation - 0.4).abs() < 1e-12 && (strain - 0.2).abs() < 1e-12, "{rotation} {strain}");
        let (rotation, strain) = rotation_and_strain(&Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, -0.5)));
        assert!(rotation > 3.0 && strain.is_infinite());
    }

    #[test]
    fn what_is_passed_over_is_neither_turned_nor_strained_the_most() {
        use nalgebra::Point3;
        use rand::{Rng, SeedableRng};
        let mut random = rand_pcg::Pcg64Mcg::seed_from_u64(6);
        // Elements without common nodes.
        let count = 60;
        let corners = [[0.0, 0.0, 0.0], [1.0, 0.1, 0.0], [0.2, 1.0, 0.1], [0.1, 0.2, 1.0]];
        let place = |element: u32, corner: [f64; 3]| {
            Point3::new(corner[0] + 2.0 * f64::from(element), corner[1], corner[2])
        };
        let rest: Vec<_> =
            (0..count).flat_map(|element| corners.map(|corner| place(element, corner))).collect();
        let tets: Vec<_> = (0..count).map(|k| [4 * k, 4 * k + 1, 4 * k + 2, 4 * k + 3]).collect();
        let mesh =
            TetMesh::new(&rest, &tets, &trocar_dynamics::tet_mesh::MeshRules::default()).expect("a mesh");
        for size in [1e-3, 0.05, 0.3, 2.0] {
            let moved: Vec<_> =
                rest.iter().map(|_| Vector3::from_fn(|_, _| random.random_range(-size..size))).collect();
            let found = Deformation::of(&mesh, &moved);
            let (mut rotation, mut strain) = (0.0, 0.0);
            for (index, tet) in tets.iter().enumerate() {
                let [a, b, c, d] = tet.map(|node| moved[node as usize]);
                let by = Matrix3::from_columns(&[b - a, c - a, d - a]) * mesh.inverse_shapes()[index];
                let own = rotation_and_strain(&(Matrix3::identity() + by));
                (rotation, strain) = (f64::max(rotation, own.0), f64::max(strain, own.1));
            }
            assert_eq!((found.rotation, found.strain), (rotation, strain), "{size}");
            // Without a previous maximum, no element is skipped.
            assert!(!Deformation::default().exceeds(size) && found.exceeds(0.0));
        }
    }
}

//! Polar decomposition and signed SVD of deformation gradients.

use nalgebra::{Matrix3, Vector3};

/// Maximum Newton iterations; convergence is quadratic, so that a dozen occur only near a singular matrix.
const NEWTON_MAX: usize = 12;

/// The rotation nearest to a deformation gradient: by Newton's iteration (Higham 1986) for regular elements, by SVD for
/// flat or inverted ones. A pure function of its argument.
pub(super) fn rotation(gradient: &Matrix3<f64>) -> Matrix3<f64> {
    let mut now = *gradient;
    for _ in 0..NEWTON_MAX {
        let cofactor = cofactor(&now);
        let determinant = now.column(0).dot(&cofactor.column(0));
        // Newton is slow near flat matrices and finds a reflection for inverted ones.
        if !(determinant > 1e-3) {
            break;
        }
        let next = (now + cofactor / determinant) * 0.5;
        let change = (next - now).norm_squared();
        now = next;
        // The square of the remainder is below rounding.
        if change < 1e-16 {
            return now;
        }
    }
    let (u, _, v) = signed_svd(gradient);
    u * v.transpose()
}

/// F = U Σ Vᵀ with proper rotations: the smallest stretch carries the sign of the determinant (Irving et al. 2004).
pub(super) fn signed_svd(gradient: &Matrix3<f64>) -> (Matrix3<f64>, Vector3<f64>, Matrix3<f64>) {
    let svd = gradient.svd(true, true);
    let (Some(mut u), Some(v_t)) = (svd.u, svd.v_t) else {
        return (Matrix3::identity(), Vector3::zeros(), Matrix3::identity());
    };
    let (mut v, mut stretches) = (v_t.transpose(), svd.singular_values);
    let smallest = stretches.imin();
    if u.determinant() < 0.0 {
        u.column_mut(smallest).neg_mut();
        stretches[smallest] = -stretches[smallest];
    }
    if v.determinant() < 0.0 {
        v.column_mut(smallest).neg_mut();
        stretches[smallest] = -stretches[smallest];
    }
    (u, stretches, v)
}

/// det(F) F⁻ᵀ, also of a singular matrix.
pub(super) fn cofactor(f: &Matrix3<f64>) -> Matrix3<f64> {
    let [a, b, c] = [0, 1, 2].map(|column| Vector3::new(f[(0, column)], f[(1, column)], f[(2, column)]));
    Matrix3::from_columns(&[b.cross(&c), c.cross(&a), a.cross(&b)])
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(2000))]
        /// For any matrix: the result is a proper rotation, and no rotation nearby is nearer.
        #[test]
        fn the_nearest_rotation_is_found(entries in prop::collection::vec(-1.5..1.5_f64, 9)) {
            let gradient = Matrix3::from_column_slice(&entries);
            let found = rotation(&gradient);
            prop_assert!((found.transpose() * found - Matrix3::identity()).amax() < 1e-9);
            prop_assert!((found.determinant() - 1.0).abs() < 1e-9);
            let (u, stretches, v) = signed_svd(&gradient);
            prop_assert!((u * Matrix3::from_diagonal(&stretches) * v.transpose() - gradient).amax() < 1e-9);
            prop_assert!((u.determinant() - 1.0).abs() < 1e-9 && (v.determinant() - 1.0).abs() < 1e-9);
            let (own, best) = ((gradient - found).norm(), (gradient - u * v.transpose()).norm());
            prop_assert!(own <= best + 1e-7, "{own} {best}");
        }
    }
}

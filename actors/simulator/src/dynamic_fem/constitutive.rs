//! Constitutive laws: energy density, stress, and stiffness projected to positive semidefinite.

use nalgebra::{Matrix3, Vector3};
use trocar_dynamics::elasticity::Elastic;

use super::polar::{cofactor, rotation, signed_svd};

/// Constitutive law of an element, in terms of its deformation gradient F.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Constitution {
    /// Corotational: linear in the rotated frame of the element, ψ = μ‖F − R‖² + λ/2 tr²(RᵀF − 1).
    Corotational,
    /// Neo-Hookean, ψ = μ/2 (I₁ − 3) − μ ln J + λ/2 ln² J (Bonet, Wood 1997). Below J = [`JACOBIAN_MIN`] the logarithm
    /// is continued by its parabola, so that an inverted element recovers.
    NeoHookean,
    /// St. Venant–Kirchhoff, ψ = μ E:E + λ/2 tr² E with Green's strain E = (FᵀF − 1)/2. It softens in compression, and
    /// an inverted element stays inverted: for comparison, and for large rotations at small strains.
    StVenantKirchhoff,
}

/// Volume ratio below which the logarithm is continued by a parabola.
pub const JACOBIAN_MIN: f64 = 0.2;

/// A constitutive law with its constants.
#[derive(Clone, Copy, Debug)]
pub(super) struct Material {
    constitution: Constitution,
    lambda: f64,
    mu: f64,
}

/// The logarithm with its first two derivatives, continued by a parabola.
fn logarithm(jacobian: f64) -> [f64; 3] {
    if jacobian >= JACOBIAN_MIN {
        let inverse = jacobian.recip();
        return [jacobian.ln(), inverse, -inverse * inverse];
    }
    let inverse = JACOBIAN_MIN.recip();
    let below = (jacobian - JACOBIAN_MIN) * inverse;
    [JACOBIAN_MIN.ln() + below - 0.5 * below * below, (1.0 - below) * inverse, -inverse * inverse]
}

/// Stiffness of an element at a state, in its principal frames, projected to positive semidefinite (Teran et al. 2005;
/// in closed form after Smith, de Goes, Kim 2019).
pub(super) struct Stiffness {
    pub u: Matrix3<f64>,
    pub v: Matrix3<f64>,
    /// Between principal stretches \[Pa\].
    pub stretch: Matrix3<f64>,
    /// Of symmetric and of antisymmetric shear in the plane normal to each axis \[Pa\].
    pub shear: [[f64; 2]; 3],
}

impl Material {
    pub fn new(constitution: Constitution, elastic: &Elastic) -> Self {
        Self { constitution, lambda: elastic.lambda(), mu: elastic.mu() }
    }

    /// ψ \[J/m³\] and the first Piola–Kirchhoff stress ∂ψ/∂F \[Pa\].
    pub fn energy_and_stress(&self, f: &Matrix3<f64>) -> (f64, Matrix3<f64>) {
        let Self { lambda, mu, .. } = *self;
        match self.constitution {
            Constitution::Corotational => {
                let turn = rotation(f);
                let apart = f - turn;
                // tr(RᵀF − 1).
                let trace = turn.dot(f) - 3.0;
                let energy = mu * apart.norm_squared() + 0.5 * lambda * trace * trace;
                (energy, apart * (2.0 * mu) + turn * (lambda * trace))
            }
            Constitution::NeoHookean => {
                let cofactor = cofactor(f);
                let jacobian = f.column(0).dot(&cofactor.column(0));
                let [log, slope, _] = logarithm(jacobian);
                let energy = 0.5 * mu * (f.norm_squared() - 3.0) - mu * log + 0.5 * lambda * log * log;
                (energy, f * mu + cofactor * ((lambda * log - mu) * slope))
            }
            Constitution::StVenantKirchhoff => {
                let strain = (f.tr_mul(f) - Matrix3::identity()) * 0.5;
                let trace = strain.trace();
                let energy = mu * strain.norm_squared() + 0.5 * lambda * trace * trace;
                (energy, f * (strain * (2.0 * mu) + Matrix3::from_diagonal_element(lambda * trace)))
            }
        }
    }

    /// The second derivative of ψ, without negative eigenvalues.
    pub fn stiffness(&self, f: &Matrix3<f64>) -> Stiffness {
        let Self { lambda, mu, .. } = *self;
        let (u, s, v) = signed_svd(f);
        let mut stretch;
        let mut shear = [[0.0; 2]; 3];
        match self.constitution {
            Constitution::Corotational => {
                stretch = Matrix3::repeat(lambda) + Matrix3::from_diagonal_element(2.0 * mu);
                let excess = lambda * (s.sum() - 3.0) - 2.0 * mu;
                for (axis, shear) in shear.iter_mut().enumerate() {
                    let sum = s[(axis + 1) % 3] + s[(axis + 2) % 3];
                    let turning = if sum > 1e-6 { 2.0 * mu + 2.0 * excess / sum } else { 0.0 };
                    *shear = [2.0 * mu, turning.max(0.0)];
                }
                // Already positive: λ above −2μ/3.
            }
            Constitution::NeoHookean => {
                let [log, slope, bend] = logarithm(s.product());
                let first = (lambda * log - mu) * slope;
                let second = lambda * slope * slope + (lambda * log - mu) * bend;
                let areas = Vector3::new(s[1] * s[2], s[2] * s[0], s[0] * s[1]);
                stretch = areas * areas.transpose() * second + Matrix3::from_diagonal_element(mu);
                for (axis, shear) in shear.iter_mut().enumerate() {
                    let (j, k) = ((axis + 1) % 3, (axis + 2) % 3);
                    stretch[(j, k)] += first * s[axis];
                    stretch[(k, j)] += first * s[axis];
                    *shear = [(mu - first * s[axis]).max(0.0), (mu + first * s[axis]).max(0.0)];
                }
                stretch = made_positive(stretch);
            }
            Constitution::StVenantKirchhoff => {
                let squares = s.component_mul(&s);
                let pressure = 0.5 * lambda * (squares.sum() - 3.0) - mu;
                stretch = s * s.transpose() * lambda
                    + Matrix3::from_diagonal(&(squares * (3.0 * mu)).add_scalar(pressure));
                for (axis, shear) in shear.iter_mut().enumerate() {
                    let (j, k) = ((axis + 1) % 3, (axis + 2) % 3);
                    let (sum, product) = (squares[j] + squares[k], s[j] * s[k]);
                    *shear = [sum + product, sum - product].map(|share| (mu * share + pressure).max(0.0));
                }
                stretch = made_positive(stretch);
            }
        }
        Stiffness { u, v, stretch, shear }
    }
}

/// The nearest positive semidefinite matrix.
fn made_positive(matrix: Matrix3<f64>) -> Matrix3<f64> {
    let mut eigen = matrix.symmetric_eigen();
    eigen.eigenvalues.apply(|value| *value = value.max(0.0));
    eigen.recompose()
}

impl Stiffness {
    /// The force on a corner per displacement of another \[N/m\], from the gradients of their shape functions rotated
    /// into the frame of V and the rest volume of the element.
    pub fn block(&self, volume: f64, a: &Vector3<f64>, b: &Vector3<f64>) -> Matrix3<f64> {
        let mut inner = Matrix3::zeros();
        for k in 0..3 {
            inner[(k, k)] += self.stretch[(k, k)] * a[k] * b[k];
            for j in [(k + 1) % 3, (k + 2) % 3] {
                let [even, odd] = self.shear[3 - k - j];
                inner[(k, k)] += 0.5 * (even + odd) * a[j] * b[j];
                inner[(j, k)] += self.stretch[(j, k)] * b[k] * a[j] + 0.5 * (even - odd) * b[j] * a[k];
            }
        }
        self.u * inner * self.u.transpose() * volume
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const ALL: [Constitution; 3] =
        [Constitution::Corotational, Constitution::NeoHookean, Constitution::StVenantKirchhoff];

    fn material(constitution: Constitution) -> Material {
        Material::new(constitution, &Elastic::new(1e4, 0.45).expect("a material"))
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(500))]
        /// The stress is the derivative of the energy, also of flat and inverted elements.
        #[test]
        fn the_stress_is_the_slope_of_the_energy(
            entries in prop::collection::vec(-1.2..1.2_f64, 9),
            direction in prop::collection::vec(-1.0..1.0_f64, 9),
        ) {
            let f = Matrix3::from_column_slice(&entries);
            let d = Matrix3::from_column_slice(&direction);
            // Where two stretches cancel, the nearest rotation is discontinuous.
            let (_, s, _) = signed_svd(&f);
            prop_assume!(s.sum() - s.max() > 0.2);
            for constitution in ALL {
                let material = material(constitution);
                let step = 1e-5;
                let energy = |t: f64| material.energy_and_stress(&(f + d * t)).0;
                let slope = (energy(step) - energy(-step)) / (2.0 * step);
                let (value, stress) = material.energy_and_stress(&f);
                let scale = stress.norm() * d.norm() + value.abs() + 1.0;
                prop_assert!((stress.dot(&d) - slope).abs() < 1e-5 * scale, "{constitution:?}");
            }
        }

        /// Near rest the stiffness is the derivative of the stress; everywhere it is positive semidefinite.
        #[test]
        fn the_stiffness_is_the_slope_of_the_stress(
            entries in prop::collection::vec(-0.015..0.015_f64, 9),
            a in prop::collection::vec(-1.0..1.0_f64, 3),
            b in prop::collection::vec(-1.0..1.0_f64, 3),
        ) {
            let f = Matrix3::identity() + Matrix3::from_column_slice(&entries);
            let (a, b) = (Vector3::from_column_slice(&a), Vector3::from_column_slice(&b));
            // Nothing is clamped in slight tension.
            let f = f * 1.03;
            for constitution in ALL {
                let material = material(constitution);
                let stiffness = material.stiffness(&f);
                let block = stiffness.block(2.0, &stiffness.v.tr_mul(&a), &stiffness.v.tr_mul(&b));
                for axis in 0..3 {
                    let d = Vector3::ith(axis, 1.0) * b.transpose();
                    let step = 1e-5;
                    let stress = |t: f64| material.energy_and_stress(&(f + d * t)).1;
                    let slope = (stress(step) - stress(-step)) * a * (2.0 / (2.0 * step));
                    let error = (block.column(axis) - slope).norm();
                    prop_assert!(error < 1e-3 * 1e4, "{constitution:?}: {error}");
                }
            }
        }

        #[test]
        fn the_stiffness_is_never_negative(entries in prop::collection::vec(-1.5..1.5_f64, 9)) {
            let f = Matrix3::from_column_slice(&entries);
            for constitution in ALL {
                let stiffness = material(constitution).stiffness(&f);
                let least = stiffness.stretch.symmetric_eigenvalues().min();
                prop_assert!(least >= -1e-9 * stiffness.stretch.norm(), "{least}");
                prop_assert!(stiffness.shear.iter().flatten().all(|&k| k >= 0.0));
            }
        }
    }

    #[test]
    fn uniaxial_stress_is_that_of_the_closed_form() {
        // E 1e4, ν 0.45; the sides are free: the stress across is zero. P along, at three stretches.
        let material = material(Constitution::NeoHookean);
        for (stretch, expected) in [(0.7, -4339.388), (0.9, -1107.129), (1.1, 917.034)] {
            let (mut low, mut high) = (0.5, 1.5);
            for _ in 0..100 {
                let across = 0.5 * (low + high);
                let f = Matrix3::from_diagonal(&Vector3::new(stretch, across, across));
                let stress = material.energy_and_stress(&f).1[(1, 1)];
                if stress > 0.0 { high = across } else { low = across }
            }
            let f = Matrix3::from_diagonal(&Vector3::new(stretch, low, low));
            let found = material.energy_and_stress(&f).1[(0, 0)];
            assert!((found - expected).abs() < 1e-3, "{stretch}: {found} Pa, not {expected}");
        }
    }
}

//! The law of XPBD's volumes: ψ = μ ‖dev E‖² + K/2 (J − 1)², against the stresses that follow from it in closed form.

use nalgebra::{Matrix3, Point3, Vector3};
use trocar_simulator::mass_spring::Prescribed;
use trocar_simulator::xpbd::{Body, Elasticity, Xpbd, XpbdConfig, XpbdInput};

use super::solver::beam;

const SIZE: f64 = 0.02;
const MATERIAL: Elasticity = Elasticity { young_modulus: 1e5, poisson_ratio: 0.3, density: 1000.0 };

/// Shear and bulk modulus \[Pa\].
fn moduli() -> [f64; 2] {
    let Elasticity { young_modulus, poisson_ratio, .. } = MATERIAL;
    [0.5 * young_modulus / (1.0 + poisson_ratio), young_modulus / (3.0 * (1.0 - 2.0 * poisson_ratio))]
}

/// Nominal stress along a stretch s with transverse stretches q: ∂ψ/∂s of μ/6 (s² − q²)² + K/2 (s q² − 1)².
fn uniaxial(s: f64, q: f64) -> f64 {
    let [mu, bulk] = moduli();
    2.0 / 3.0 * mu * s * (s * s - q * q) + bulk * q * q * (s * q * q - 1.0)
}

/// The transverse stretch of a bar whose sides are free: ∂ψ/∂q = 0.
fn transverse(s: f64) -> f64 {
    let [mu, bulk] = moduli();
    let slope = |q: f64| -2.0 / 3.0 * mu * q * (s * s - q * q) + 2.0 * bulk * s * q * (s * q * q - 1.0);
    let (mut low, mut high) = (0.3, 2.0);
    for _ in 0..200 {
        let middle = 0.5 * (low + high);
        if slope(middle) > 0.0 { high = middle } else { low = middle }
    }
    low
}

/// The force \[N\] on the nodes that `pulled` picks, of a block in which those that `held` picks are held where the
/// deformation puts them, once the others have come to rest.
fn force(
    gradient: &Matrix3<f64>,
    held: impl Fn(&Point3<f64>) -> bool,
    pulled: impl Fn(&Point3<f64>) -> bool,
) -> Vector3<f64> {
    let (rest, tets) = beam([3, 3, 3], [SIZE; 3]);
    let body = Body { rest: &rest, tets: &tets, elasticity: Some(MATERIAL), ..Body::default() };
    let nodes = |pick: &dyn Fn(&Point3<f64>) -> bool| -> Vec<u32> {
        (0..rest.len() as u32).filter(|&node| pick(&rest[node as usize])).collect()
    };
    let (held, pulled) = (nodes(&held), nodes(&pulled));
    let config = XpbdConfig { parts: 40, damping: 60.0, ..XpbdConfig::default() };
    let mut solver = Xpbd::new(&body, &[], config).expect("a block");
    let steps = 300;
    for step in 1..=steps {
        let share = f64::from(step.min(100)) / 100.0;
        let now = Matrix3::identity() + (gradient - Matrix3::identity()) * share;
        let to: Vec<Prescribed> = held
            .iter()
            .map(|&node| Prescribed { node, position: Point3::from(now * rest[node as usize].coords) })
            .collect();
        solver.step(1e-3, &XpbdInput { prescribed: &to, ..XpbdInput::default() }).expect("a step");
    }
    solver.pull_on(&pulled)
}

#[test]
fn a_block_is_stretched_and_sheared_by_the_stress_of_its_energy() {
    let area = SIZE * SIZE;
    let is_end = |point: &Point3<f64>| point.x < 1e-9 || point.x > SIZE - 1e-9;
    let [mu, bulk] = moduli();
    for s in [0.7, 0.9, 1.05, 1.2, 1.4] {
        let q = transverse(s);
        let wanted = uniaxial(s, q);
        let gradient = Matrix3::from_diagonal(&Vector3::new(s, q, q));
        let stress = -force(&gradient, is_end, |point| point.x > SIZE - 1e-9).x / area;
        assert!((stress / wanted - 1.0).abs() < 5e-3, "stretch {s}: {stress} Pa, not {wanted} Pa");
        // Not that of a neo-Hookean material, ψ = μ/2 (I₁ − 3 − 2 ln J) + λ/2 (ln J)².
        if !(0.85..1.3).contains(&s) {
            let lambda = bulk - 2.0 / 3.0 * mu;
            let (mut low, mut high) = (0.3_f64, 2.0_f64);
            for _ in 0..200 {
                let middle = 0.5 * (low + high);
                let slope = mu * (middle - 1.0 / middle) + lambda * (s * middle * middle).ln() / middle;
                if slope > 0.0 { high = middle } else { low = middle }
            }
            let neo_hookean = mu * (s - 1.0 / s) + lambda * (s * low * low).ln() / s;
            assert!((neo_hookean / wanted - 1.0).abs() > 0.1, "stretch {s}: {neo_hookean} Pa");
        }
    }
    let is_surface =
        |point: &Point3<f64>| point.iter().any(|coordinate| !(1e-9..=SIZE - 1e-9).contains(coordinate));
    for shear in [0.05_f64, 0.3, 0.6] {
        let mut gradient = Matrix3::identity();
        gradient[(0, 1)] = shear;
        // The tractions on the faces x = 0 and x = SIZE cancel on the edges of the face y = SIZE.
        let stress = -force(&gradient, is_surface, |point| point.y > SIZE - 1e-9).x / area;
        let wanted = mu * (shear + 2.0 / 3.0 * shear.powi(3));
        assert!((stress / wanted - 1.0).abs() < 5e-3, "shear {shear}: {stress} Pa, not {wanted} Pa");
    }
}

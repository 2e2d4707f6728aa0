//! Linear elements against independent results: scikit-fem's deflections and frequencies of the clamped beam, with
//! linear and with quadratic elements.

use crate::support::beam;
use crate::support::direct::{direct, factored, numbers};
use nalgebra::{DMatrix, SymmetricEigen, Vector3};
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;
use trocar_simulator::stiffness::{consistent_mass, stiffness};

fn deflection(cells: [usize; 3]) -> f64 {
    let mesh = beam::mesh(cells);
    let fixed = beam::nodes_at(&mesh, 0.0);
    let displacements = direct(&mesh, &beam::material(), &fixed, &beam::end_traction(&mesh));
    beam::end_deflection(&mesh, &displacements)
}

#[test]
fn the_beam_deflects_as_scikit_fem_says() {
    for (cells, expected) in [([10, 2, 2], 1.306_239_43e-3), ([20, 4, 4], 2.015_915_56e-3)] {
        let found = deflection(cells);
        assert!((found / expected - 1.0).abs() < 1e-7, "{cells:?}: {found:.12e}, not {expected:e}");
    }
}

/// Linear elements converge with second order once bending is resolved: extrapolating two of them gives the result of
/// quadratic ones (2.52123435e-3 m on 10×2×2 and 2.53697265e-3 m on 20×4×4; the latter is accurate to 0.1 %).
#[test]
fn deflections_lead_to_the_answer_of_quadratic_elements() {
    let answer = 2.536_972_65e-3;
    let found = [[10, 2, 2], [20, 4, 4], [40, 8, 8], [80, 16, 16]].map(deflection);
    // Linear elements are over-stiff: half of the deflection is missing on the coarsest mesh, a fifth on the next, 1.6
    // % on the last.
    let errors = found.map(|found| answer - found);
    assert!(errors.iter().all(|&error| error > 0.0), "too stiff, never too soft: {errors:?}");
    assert!(errors[0] > 0.45 * answer && errors[3] < 0.016 * answer, "{errors:?}");
    let orders = [0, 1, 2].map(|mesh| (errors[mesh] / errors[mesh + 1]).log2());
    assert!(orders[0] > 1.1 && orders[1] > 1.5 && (1.9..2.1).contains(&orders[2]), "{orders:?}");
    for (meshes, tolerance) in [([1, 2], 0.02), ([2, 3], 1e-3)] {
        let driven = meshes.map(|mesh| found[mesh]);
        let led_to = driven[1] + (driven[1] - driven[0]) / 3.0;
        assert!((led_to / answer - 1.0).abs() < tolerance, "{driven:?} lead to {led_to}");
    }
}

/// The lowest frequencies \[Hz\], by subspace iteration with the consistent mass.
fn lowest_frequency(cells: [usize; 3]) -> f64 {
    const SPACE: usize = 8;
    let mesh = beam::mesh(cells);
    let (numbers, count) = numbers(&mesh, &beam::nodes_at(&mesh, 0.0));
    let k = stiffness(&mesh, &beam::material(), &numbers, count);
    let m = consistent_mass(&mesh, 1000.0, &numbers, count);
    let mut factor = factored(&k);
    let mut random = Pcg64Mcg::seed_from_u64(7);
    let mut any = || Vector3::from_fn(|_, _| random.random_range(-1.0..1.0));
    let mut space: Vec<Vec<Vector3<f64>>> = (0..SPACE).map(|_| (0..count).map(|_| any()).collect()).collect();
    let mut image = vec![Vector3::zeros(); count];
    let mut lowest = f64::INFINITY;
    for _ in 0..100 {
        for vector in &mut space {
            m.multiply(vector, &mut image);
            let mut flat: Vec<f64> = image.iter().flat_map(|v| v.iter().copied()).collect();
            factor.solve(&mut flat);
            vector.iter_mut().zip(flat.chunks(3)).for_each(|(v, f)| *v = Vector3::from_column_slice(f));
        }
        let mut reduced = [DMatrix::<f64>::zeros(SPACE, SPACE), DMatrix::zeros(SPACE, SPACE)];
        for (matrix, reduced) in [&k, &m].into_iter().zip(&mut reduced) {
            for i in 0..SPACE {
                matrix.multiply(&space[i], &mut image);
                for j in 0..SPACE {
                    reduced[(i, j)] = image.iter().zip(&space[j]).map(|(a, b)| a.dot(b)).sum();
                }
            }
        }
        let [k_in, m_in] = reduced;
        let l = m_in.cholesky().expect("independent").l().try_inverse().expect("regular");
        let eigen = SymmetricEigen::new(&l * k_in * l.transpose());
        let turn = l.transpose() * &eigen.eigenvectors;
        let old = space.clone();
        for (i, vector) in space.iter_mut().enumerate() {
            for (node, v) in vector.iter_mut().enumerate() {
                *v = (0..SPACE).map(|j| old[j][node] * turn[(j, i)]).sum();
            }
        }
        let now = eigen.eigenvalues.min();
        let done = (now / lowest - 1.0).abs() < 1e-13;
        lowest = now;
        if done {
            break;
        }
    }
    lowest.sqrt() / std::f64::consts::TAU
}

#[test]
fn the_beam_vibrates_as_scikit_fem_says() {
    for (cells, expected) in [([10, 2, 2], 4.076_689_11), ([20, 4, 4], 3.436_793_7)] {
        let found = lowest_frequency(cells);
        assert!((found / expected - 1.0).abs() < 1e-7, "{cells:?}: {found:.10} Hz, not {expected}");
    }
}

/// 3.17787 Hz on 10×2×2 and 3.16604 Hz on 20×4×4 of quadratic elements.
#[test]
fn frequencies_lead_to_the_answer_of_quadratic_elements() {
    let answer = 3.16604;
    let found = [[20, 4, 4], [40, 8, 8]].map(lowest_frequency);
    assert!(found[0] > found[1] && found[1] > answer, "too stiff, never too soft: {found:?}");
    let led_to = found[1] - (found[0] - found[1]) / 3.0;
    assert!((led_to / answer - 1.0).abs() < 3e-3, "{found:?} lead to {led_to} Hz");
}

//! Linear elements against independent numbers: scikit-fem's deflections and frequencies of the clamped beam, of its linear
//! elements and of its quadratic ones.

#[path = "support/beam.rs"]
mod beam;
#[path = "support/direct.rs"]
mod direct;

use direct::{direct, factored, numbers};
use nalgebra::{DMatrix, SymmetricEigen, Vector3};
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;
use trocar_simulator::elasticity::{consistent_mass, stiffness};

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

#[test]
fn the_error_falls_towards_the_answer_of_quadratic_elements() {
    let found = [[10, 2, 2], [20, 4, 4], [40, 8, 8], [80, 16, 16]].map(|cells| {
        let t = std::time::Instant::now();
        let d = deflection(cells);
        eprintln!("{cells:?} {d:e} {:?}", t.elapsed());
        d
    });
    eprintln!("{found:?}");
    for w in found.windows(3) {
        let r = (w[1] - w[0]) / (w[2] - w[1]);
        eprintln!(
            "aitken {:e} order {} richardson {:e}",
            w[2] + (w[2] - w[1]) / (r - 1.0),
            r.log2(),
            w[2] + (w[2] - w[1]) / 3.0
        );
    }
    let f = [[10, 2, 2], [20, 4, 4], [40, 8, 8]].map(|cells| {
        let t = std::time::Instant::now();
        let d = lowest_frequency(cells);
        eprintln!("{cells:?} {d:e} {:?}", t.elapsed());
        d
    });
    for w in f.windows(3) {
        let r = (w[1] - w[0]) / (w[2] - w[1]);
        eprintln!(
            "aitken {:e} order {} richardson {:e}",
            w[2] + (w[2] - w[1]) / (r - 1.0),
            r.log2(),
            w[2] + (w[2] - w[1]) / 3.0
        );
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

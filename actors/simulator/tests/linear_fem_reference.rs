//! Linear elements against independent numbers: scikit-fem's deflections and frequencies, the patch test, the order of
//! convergence.

#[path = "support/beam.rs"]
mod beam;

use nalgebra::{DMatrix, Matrix3, Point3, SymmetricEigen, Vector3};
use proptest::prelude::*;
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;
use trocar_simulator::elasticity::{Elastic, consistent_mass, stiffness};
use trocar_simulator::sparse::{BlockMatrix, SparseCholesky};
use trocar_simulator::tet_mesh::{BoxCells, MeshRules, TetMesh, box_cells};

/// Numbers of the nodes that are not fixed.
fn numbers(mesh: &TetMesh, fixed: &[u32]) -> (Vec<Option<u32>>, usize) {
    let mut next = 0;
    let numbers = (0..mesh.rest().len() as u32).map(|node| {
        (!fixed.contains(&node)).then(|| {
            next += 1;
            next - 1
        })
    });
    (numbers.collect(), next as usize)
}

fn factored(matrix: &BlockMatrix) -> SparseCholesky {
    let mut factor = SparseCholesky::new(matrix.pattern(), 1).expect("room");
    factor.factor(matrix.pattern(), matrix.values()).expect("positive definite");
    factor
}

/// A direct f64 solve: displacements of all nodes.
fn direct(mesh: &TetMesh, material: &Elastic, fixed: &[u32], forces: &[Vector3<f64>]) -> Vec<Vector3<f64>> {
    let (numbers, count) = numbers(mesh, fixed);
    let mut factor = factored(&stiffness(mesh, material, &numbers, count));
    let mut right = vec![0.0; 3 * count];
    for (number, force) in numbers.iter().zip(forces) {
        if let Some(number) = number {
            right[3 * *number as usize..][..3].copy_from_slice(force.as_slice());
        }
    }
    factor.solve(&mut right);
    let of = |number: &Option<u32>| {
        number.map_or_else(Vector3::zeros, |n| Vector3::from_column_slice(&right[3 * n as usize..][..3]))
    };
    numbers.iter().map(of).collect()
}

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
    // Quadratic elements on 20×4×4. Linear ones are over-stiff: half of the answer is missing on the coarse mesh,
    // a fifth on the next.
    let answer = 2.536_972_65e-3;
    let errors = [[10, 2, 2], [20, 4, 4], [40, 8, 8]].map(|cells| answer - deflection(cells));
    assert!(errors.iter().all(|&error| error > 0.0), "too stiff, never too soft: {errors:?}");
    let orders = [errors[0] / errors[1], errors[1] / errors[2]].map(f64::log2);
    // The order is 2; it is reached once bending is resolved.
    assert!(orders[0] > 1.1 && orders[1] > 1.5 && orders[1] < 2.2, "{orders:?}");
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

proptest! {
    #![proptest_config(ProptestConfig::with_cases(60))]
    /// The patch test: where the boundary is displaced linearly, the inside follows exactly, however the elements are
    /// shaped.
    #[test]
    fn a_linear_field_is_reproduced_on_any_mesh(
        shifts in prop::collection::vec(-1.0..1.0_f64, 3 * 125),
        slope in prop::collection::vec(-0.01..0.01_f64, 9),
        poisson in 0.0..0.45_f64,
    ) {
        let grid = BoxCells { cells: [4, 4, 4], size: Vector3::repeat(0.04), origin: Point3::origin() };
        let (mut nodes, tets) = box_cells(&grid);
        // A quarter of a cell's smallest height keeps every element upright.
        for (node, shift) in nodes.iter_mut().zip(shifts.chunks(3)) {
            *node += Vector3::from_column_slice(shift) * 0.0012;
        }
        let mesh = TetMesh::new(&nodes, &tets, &MeshRules::default()).expect("a sound mesh");
        let material = Elastic::new(1e4, poisson).expect("a material");
        let slope = Matrix3::from_column_slice(&slope);
        let field = |node: u32| slope * nodes[node as usize].coords;
        let fixed = mesh.surface_nodes().to_vec();
        let (numbers, count) = numbers(&mesh, &fixed);
        prop_assert_eq!(count, 27);
        // Forces of the displaced boundary on the inside: −K_ib u_b.
        let total = mesh.rest().len();
        let all: Vec<_> = (0..total as u32).map(Some).collect();
        let whole = stiffness(&mesh, &material, &all, total);
        let displaced: Vec<_> =
            all.iter().map(|n| n.filter(|n| numbers[*n as usize].is_none()).map_or_else(Vector3::zeros, field)).collect();
        let mut forces = vec![Vector3::zeros(); total];
        whole.multiply(&displaced, &mut forces);
        let forces: Vec<_> = forces.into_iter().map(|force| -force).collect();
        let found = direct(&mesh, &material, &fixed, &forces);
        for node in 0..total as u32 {
            if numbers[node as usize].is_some() {
                let error = (found[node as usize] - field(node)).norm();
                prop_assert!(error < 1e-12 * 0.04, "{node}: {error:e}");
            }
        }
    }
}

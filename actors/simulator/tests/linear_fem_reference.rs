//! Linear elements against independent numbers: scikit-fem's deflections and frequencies, the patch test, Hertz, the
//! order of convergence.

#[path = "support/beam.rs"]
mod beam;

use nalgebra::{DMatrix, Matrix3, Point3, SymmetricEigen, Vector3};
use proptest::prelude::*;
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;
use trocar_simulator::elasticity::{Elastic, consistent_mass, stiffness};
use trocar_simulator::linear_fem::{Attachment, Hold, Limits, LinearFem};
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
    // Quadratic elements on 20×4×4. Linear ones are over-stiff: a third of the answer is missing on the coarse mesh.
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

/// A block of 80×80×40 mm, finest about the middle of its top, `cells` on every side of it.
fn block(cells: usize) -> TetMesh {
    const GRADING: f64 = 4.5;
    let side: Vec<f64> =
        (0..=cells).map(|i| 0.04 * (GRADING * i as f64 / cells as f64).sinh() / GRADING.sinh()).collect();
    let across: Vec<f64> = side[1..].iter().rev().map(|x| -x).chain(side.iter().copied()).collect();
    let depth: Vec<f64> = side.iter().rev().map(|z| -z).collect();
    let cells = [across.len() - 1, across.len() - 1, depth.len() - 1];
    let grid = BoxCells { cells, size: Vector3::from(cells.map(|n| n as f64)), origin: Point3::origin() };
    let (mut nodes, tets) = box_cells(&grid);
    for node in &mut nodes {
        let [i, j, k] = [node.x, node.y, node.z].map(|x| x.round() as usize);
        *node = Point3::new(across[i], across[j], depth[k]);
    }
    // Far from the contact cells are long.
    let rules = MeshRules { mean_ratio_min: 0.005, ..MeshRules::default() };
    TetMesh::new(&nodes, &tets, &rules).expect("a sound mesh")
}

/// Forces of a rigid frictionless sphere of 5 mm at 0.5 and 1 mm, over those of Hertz.
fn over_hertz(cells: usize, poisson: f64) -> [f64; 2] {
    const RADIUS: f64 = 5e-3;
    let mesh = block(cells);
    let material = Elastic::new(1e4, poisson).expect("a material");
    // Everything but the inside of the top is fixed.
    let rest = mesh.rest().to_vec();
    let far = rest.iter().map(|at| at.x).fold(0.0, f64::max) - 1e-9;
    let top = |at: &Point3<f64>| at.z > -1e-9 && at.x.abs() < far && at.y.abs() < far;
    let fixed: Vec<u32> =
        mesh.surface_nodes().iter().copied().filter(|&node| !top(&rest[node as usize])).collect();
    let mut fem = LinearFem::new(mesh, &material, &fixed, &Limits::default(), &mut |_| true).expect("a body");
    let down = -Vector3::z_axis();
    let contacts: Vec<_> = (0..rest.len() as u32)
        .filter(|&node| top(&rest[node as usize]) && rest[node as usize].coords.norm() < 2.6e-3)
        .map(|node| {
            let at = rest[node as usize];
            let handle = fem.hold(Attachment::node(node, Hold::AtLeast(down))).expect("room");
            (handle, (at.x.powi(2) + at.y.powi(2)) / (2.0 * RADIUS))
        })
        .collect();
    let mut press = |depth: f64| {
        for (handle, gap) in &contacts {
            fem.set_target(*handle, down.into_inner() * (depth - gap)).expect("it is held");
        }
        let solution = fem.solve(&[]).expect("it settles");
        assert!(solution.reactions.iter().all(|reaction| reaction.force.z <= 0.0), "contacts do not pull");
        -solution.reactions.iter().map(|reaction| reaction.force.z).sum::<f64>()
    };
    // The contact grows, and shrinks again.
    let forces = [press(0.5e-3), press(1e-3), press(0.5e-3)];
    assert!((forces[2] / forces[0] - 1.0).abs() < 1e-6, "the way does not matter: {forces:?}");
    let hertz = |depth: f64| 4e4 / 3.0 / (1.0 - poisson.powi(2)) * RADIUS.sqrt() * depth.powf(1.5);
    [forces[0] / hertz(0.5e-3), forces[1] / hertz(1e-3)]
}

#[test]
fn the_force_of_a_rigid_sphere_falls_towards_that_of_hertz() {
    // 0.01321746 and 0.03738463 N at ν 0.45. Linear elements under contacts at nodes are too stiff, by the more the fewer
    // of them lie under the sphere: four and a half across the radius of the contact leave a quarter.
    let coarse = over_hertz(6, 0.45);
    let fine = over_hertz(10, 0.45);
    for (coarse, fine) in coarse.into_iter().zip(fine) {
        assert!(fine > 1.0 && fine < 1.3, "{fine} of Hertz");
        assert!(fine - 1.0 < 0.65 * (coarse - 1.0), "{coarse} of Hertz, then {fine}");
    }
}

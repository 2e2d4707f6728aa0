//! Linear elements on arbitrary meshes: the patch test, and the order of convergence for a smooth solution.

use crate::support::delaunay;
use crate::support::direct::displaced;
use nalgebra::{Isometry3, Matrix3, Point3, Vector3};
use proptest::prelude::*;
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;
use trocar_dynamics::elasticity::Elastic;
use trocar_dynamics::tet_mesh::{BoxCells, MeshRules, TetMesh, box_cells};
use trocar_scene::organs::{Implicit, Part, tetrahedra};

/// Deviation of the interior from a linear field prescribed on the boundary, relative to the largest displacement; and
/// the number of interior nodes.
fn off_the_patch(mesh: &TetMesh, slope: &Matrix3<f64>, poisson: f64) -> (f64, usize) {
    let material = Elastic::new(1e4, poisson).expect("a material");
    let field = |node: u32| slope * mesh.rest()[node as usize].coords;
    let fixed = mesh.surface_nodes();
    let none = vec![Vector3::zeros(); mesh.rest().len()];
    let found = displaced(mesh, &material, fixed, field, &none);
    let nodes = 0..mesh.rest().len() as u32;
    let largest = nodes.clone().map(|node| field(node).norm()).fold(0.0, f64::max);
    let worst = nodes.map(|node| (found[node as usize] - field(node)).norm()).fold(0.0, f64::max);
    (worst / largest, mesh.rest().len() - fixed.len())
}

fn any_slope(random: &mut Pcg64Mcg) -> Matrix3<f64> {
    Matrix3::from_fn(|_, _| random.random_range(-0.01..0.01))
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(60))]
    /// The patch test: with a linear displacement on the boundary, the interior is exact for any shape of elements.
    #[test]
    fn a_linear_field_is_reproduced_on_any_mesh(
        shifts in prop::collection::vec(-1.0..1.0_f64, 3 * 125),
        slope in prop::collection::vec(-0.01..0.01_f64, 9),
        poisson in 0.0..0.45_f64,
    ) {
        let grid = BoxCells { cells: [4, 4, 4], size: Vector3::repeat(0.04), origin: Point3::origin() };
        let (mut nodes, tets) = box_cells(&grid);
        // A quarter of a cell's smallest height inverts no element.
        for (node, shift) in nodes.iter_mut().zip(shifts.chunks(3)) {
            *node += Vector3::from_column_slice(shift) * 0.0012;
        }
        let mesh = TetMesh::new(&nodes, &tets, &MeshRules::default()).expect("a sound mesh");
        let (off, inside) = off_the_patch(&mesh, &Matrix3::from_column_slice(&slope), poisson);
        prop_assert_eq!(inside, 27);
        prop_assert!(off < 1e-13, "{}", off);
    }
}

/// Delaunay tetrahedra of random points, without a grid, slivers included.
#[test]
fn a_linear_field_is_reproduced_between_points_thrown_at_random() {
    let mut random = Pcg64Mcg::seed_from_u64(11);
    for case in 0..40 {
        let points: Vec<Point3<f64>> =
            (0..150).map(|_| Point3::from([0; 3].map(|_| random.random_range(0.0..0.04)))).collect();
        let tets = delaunay::tetrahedra(&points);
        let rules = MeshRules { mean_ratio_min: 1e-3, ..MeshRules::default() };
        let (mesh, _) = TetMesh::repaired(&points, &tets, &rules).expect("a mesh");
        let poisson = random.random_range(0.0..0.45);
        let (off, inside) = off_the_patch(&mesh, &any_slope(&mut random), poisson);
        assert!(inside > 60, "case {case}: {inside} nodes inside");
        assert!(off < 1e-13, "case {case}: {off:e}");
    }
}

/// A body of blended implicit shapes, like the organs.
fn organ() -> Implicit {
    let pose = Isometry3::rotation(Vector3::new(0.3, -0.2, 0.5));
    Implicit {
        parts: vec![
            Part::Ellipsoid { pose, radii: Vector3::new(0.03, 0.02, 0.015) },
            Part::Cone {
                ends: [Point3::new(0.01, 0.0, 0.0), Point3::new(0.03, 0.02, 0.01)],
                radii: [0.012, 0.008],
            },
        ],
        blend: 5e-3,
        ..Implicit::default()
    }
}

fn meshed(edge: f64, levels: u8) -> TetMesh {
    let data = tetrahedra(&organ(), edge, levels).expect("a mesh");
    TetMesh::new(&data.positions, &data.tets, &MeshRules::default()).expect("a sound mesh")
}

#[test]
fn a_linear_field_is_reproduced_on_the_graded_mesh_of_an_implicit_body() {
    let mut random = Pcg64Mcg::seed_from_u64(3);
    for (edge, levels) in [(4e-3, 0), (4e-3, 1), (2.5e-3, 2)] {
        let mesh = meshed(edge, levels);
        let (off, inside) = off_the_patch(&mesh, &any_slope(&mut random), 0.45);
        assert!(inside > 50, "{inside} nodes inside");
        assert!(off < 1e-13, "edges of {edge} m, {levels} levels: {off:e}");
    }
}

/// A non-polynomial displacement, and its body force: with u = Σ c sin(k·x + φ), −div σ = Σ ((λ + μ)(c·k) k + μ k² c)
/// sin(k·x + φ).
struct Smooth {
    waves: [(Vector3<f64>, Vector3<f64>, f64); 2],
    material: Elastic,
}

impl Smooth {
    fn new(size: f64) -> Self {
        let k = std::f64::consts::PI / size;
        let waves = [
            (Vector3::new(1e-3, -0.5e-3, 0.3e-3), Vector3::new(0.9, 0.5, -0.3) * k, 0.4),
            (Vector3::new(0.2e-3, 0.7e-3, -0.6e-3), Vector3::new(-0.4, 0.8, 0.7) * k, 1.1),
        ];
        Self { waves, material: Elastic::new(1e4, 0.3).expect("a material") }
    }

    fn displacement(&self, at: &Point3<f64>) -> Vector3<f64> {
        self.waves.iter().map(|(c, k, phase)| c * (k.dot(&at.coords) + phase).sin()).sum()
    }

    fn gradient(&self, at: &Point3<f64>) -> Matrix3<f64> {
        let of = |(c, k, phase): &(Vector3<f64>, Vector3<f64>, f64)| {
            c * k.transpose() * (k.dot(&at.coords) + phase).cos()
        };
        self.waves.iter().map(of).sum()
    }

    fn force(&self, at: &Point3<f64>) -> Vector3<f64> {
        let (lambda, mu) = (self.material.lambda(), self.material.mu());
        let of = |(c, k, phase): &(Vector3<f64>, Vector3<f64>, f64)| {
            (k * ((lambda + mu) * c.dot(k)) + c * (mu * k.norm_squared())) * (k.dot(&at.coords) + phase).sin()
        };
        self.waves.iter().map(of).sum()
    }

    /// Errors of linear elements on a mesh, root mean square over its volume: of the displacement \[m\], and of its
    /// gradient.
    fn errors(&self, mesh: &TetMesh) -> [f64; 2] {
        let rest = mesh.rest();
        let mut loads = vec![Vector3::zeros(); rest.len()];
        each_place(mesh, |tet, weights, at, volume| {
            let force = self.force(&at) * volume;
            for (node, weight) in mesh.tets()[tet].iter().zip(weights) {
                loads[*node as usize] += force * weight;
            }
        });
        let field = |node: u32| self.displacement(&rest[node as usize]);
        let found = displaced(mesh, &self.material, mesh.surface_nodes(), field, &loads);
        let (mut squares, mut slopes) = (0.0, 0.0);
        each_place(mesh, |tet, weights, at, volume| {
            let nodes = mesh.tets()[tet];
            let mean = |node: usize| found[nodes[node] as usize];
            let here: Vector3<f64> = (0..4).map(|node| mean(node) * weights[node]).sum();
            squares += volume * (here - self.displacement(&at)).norm_squared();
            let gradients = mesh.gradients(tet);
            let slope: Matrix3<f64> = (0..4).map(|node| mean(node) * gradients[node].transpose()).sum();
            slopes += volume * (slope - self.gradient(&at)).norm_squared();
        });
        [squares, slopes].map(|sum| (sum / mesh.volume()).sqrt())
    }
}

/// Gauss points of every element, exact to the third degree in each direction of the collapsed cube: element,
/// barycentric weights, point, and volume represented.
fn each_place(mesh: &TetMesh, mut visit: impl FnMut(usize, [f64; 4], Point3<f64>, f64)) {
    let far = 0.6_f64.sqrt();
    let line = [(0.5 - far / 2.0, 5.0 / 18.0), (0.5, 4.0 / 9.0), (0.5 + far / 2.0, 5.0 / 18.0)];
    for (tet, nodes) in mesh.tets().iter().enumerate() {
        let corners = nodes.map(|node| mesh.rest()[node as usize].coords);
        for (x, wx) in line {
            for (y, wy) in line {
                for (z, wz) in line {
                    let weights = [1.0 - x, x * (1.0 - y), x * y * (1.0 - z), x * y * z];
                    let at: Vector3<f64> = (0..4).map(|corner| corners[corner] * weights[corner]).sum();
                    let volume = 6.0 * mesh.volumes()[tet] * wx * wy * wz * x * x * y;
                    visit(tet, weights, Point3::from(at), volume);
                }
            }
        }
    }
}

/// Checks that errors fall quadratically with the edge length, those of the gradient linearly, each mesh having half
/// the edge length of the previous one.
fn assert_orders(what: &str, smooth: &Smooth, meshes: &[TetMesh]) {
    let errors: Vec<_> = meshes.iter().map(|mesh| smooth.errors(mesh)).collect();
    for pair in errors.windows(2) {
        let [displacement, gradient] = [0, 1].map(|what| (pair[0][what] / pair[1][what]).log2());
        assert!((1.8..2.2).contains(&displacement), "{what}: order {displacement}, {errors:?}");
        assert!((0.9..1.1).contains(&gradient), "{what}: order {gradient} of the gradient, {errors:?}");
    }
}

#[test]
fn the_error_of_a_smooth_solution_falls_with_the_square_of_the_edges() {
    let mut random = Pcg64Mcg::seed_from_u64(5);
    let grids = [4_usize, 8, 16].map(|cells| {
        let grid = BoxCells { cells: [cells; 3], size: Vector3::repeat(0.04), origin: Point3::origin() };
        let (mut nodes, tets) = box_cells(&grid);
        // A tenth of a cell's edge.
        let shift = 0.004 / cells as f64;
        nodes.iter_mut().for_each(|node| {
            *node += Vector3::from_fn(|_, _| random.random_range(-shift..shift));
        });
        TetMesh::new(&nodes, &tets, &MeshRules::default()).expect("a sound mesh")
    });
    assert_orders("a box", &Smooth::new(0.04), &grids);
    let organs = [8e-3, 4e-3, 2e-3].map(|edge| meshed(edge, 0));
    assert_orders("an organ", &Smooth::new(0.04), &organs);
}

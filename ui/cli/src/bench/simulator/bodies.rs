//! Test bodies of the suite `simulator`: beams of six-tetrahedra cells, square cloths, coils of thread, membranes,
//! basins of liquid.

use nalgebra::{Point3, Vector3};
use trocar_dynamics::tet_mesh::{BoxCells, MeshRules, TetMesh, box_cells};
use trocar_simulator::electrosurgery::{Electrosurgery, LatticeConfig, ThermalMaterial, Tissue};
use trocar_simulator::fluid::{Fluid, FluidConfig};
use trocar_simulator::mass_spring::{Config, Integrator, MassSpring, Network, SurfaceMaterial};
use trocar_simulator::suture_thread::{Thread, ThreadMaterial};
use trocar_simulator::xpbd::{Body, Elasticity, Xpbd, XpbdConfig};

use crate::failure::Failure;

/// Gravity \[m/s²\].
pub const GRAVITY: Vector3<f64> = Vector3::new(0.0, 0.0, -9.81);

/// A block of cells, and its nodes at x = 0.
pub fn block(cells: [usize; 3], size: [f64; 3]) -> Result<(TetMesh, Vec<u32>), Failure> {
    let (nodes, tets) = box_cells(&BoxCells { cells, size: size.into(), origin: Point3::origin() });
    let mesh = TetMesh::new(&nodes, &tets, &MeshRules::default()).map_err(Failure::internal)?;
    let wall = (0..nodes.len() as u32).filter(|&node| nodes[node as usize].x < 1e-9).collect();
    Ok((mesh, wall))
}

/// The material of gauze.
pub const CLOTH: SurfaceMaterial =
    SurfaceMaterial { membrane_stiffness: 500.0, bending_stiffness: 1e-6, density: 0.15 };

/// A sheet of 10 × 10 cm of `n` × `n` squares: its vertices and triangles.
pub fn sheet(n: u32) -> (Vec<Point3<f64>>, Vec<[u32; 3]>) {
    let at = |i: u32| 0.1 * f64::from(i) / f64::from(n);
    let points = (0..=n).flat_map(|j| (0..=n).map(move |i| Point3::new(at(i), at(j), 0.0))).collect();
    let triangles = (0..n).flat_map(|j| {
        (0..n).flat_map(move |i| {
            let [a, b, c, d] = [[i, j], [i + 1, j], [i, j + 1], [i + 1, j + 1]].map(|[i, j]| j * (n + 1) + i);
            [[a, b, d], [a, d, c]]
        })
    });
    (points, triangles.collect())
}

/// Gauze: such a sheet, held at two corners.
pub fn cloth(n: u32, integrator: Integrator) -> Result<MassSpring, Failure> {
    let (points, triangles) = sheet(n);
    let network = Network::from_surface(&points, &triangles, &CLOTH).map_err(Failure::internal)?;
    let config = Config { integrator, damping: 1.0, ..Config::default() };
    MassSpring::new(network, points, &[0, n], config).map_err(Failure::internal)
}

/// A position-based block, clamped at x = 0.
pub fn position_based(
    cells: [usize; 3],
    size: [f64; 3],
    young_modulus: f64,
    config: XpbdConfig,
) -> Result<Xpbd, Failure> {
    let (mesh, wall) = block(cells, size)?;
    let elasticity = Some(Elasticity { young_modulus, poisson_ratio: 0.3, density: 1000.0 });
    let body = Body { rest: mesh.rest(), tets: mesh.tets(), elasticity, ..Body::default() };
    Xpbd::new(&body, &wall, config).map_err(Failure::internal)
}

/// Edges of a coil that lie in turns; the rest is its straight tail.
const COILED: usize = 100;

/// A coil of suture thread on a table, its turns touching each other, its tail lying on the table or leading up to a
/// hand; and the positions of its ends.
pub fn coil(edges: usize, lying: bool) -> Result<(Thread, [Point3<f64>; 2]), Failure> {
    let on_coil = |turn: f64| Point3::new(3e-3 * turn.cos(), 3e-3 * turn.sin(), 4.9e-5 * turn);
    let last = 0.15 * COILED as f64;
    let slope = if lying { 0.0 } else { 0.5 };
    let onwards = Vector3::new(-last.sin(), last.cos(), slope).normalize() * (3e-3 * 0.15);
    let points: Vec<_> = (0..=edges)
        .map(|i| on_coil(0.15 * i.min(COILED) as f64) + onwards * i.saturating_sub(COILED) as f64)
        .collect();
    let thread = Thread::new(ThreadMaterial::silk_2_0(), &points).map_err(Failure::internal)?;
    Ok((thread, [points[0], points[edges]]))
}

/// A membrane 2 mm thick of `n` × `n` squares of 1 mm that an electrode heats.
pub fn membrane(n: u32) -> Result<Electrosurgery, Failure> {
    let at = |i: u32, j: u32| i * (n + 1) + j;
    let places = |n: u32| (0..n).flat_map(move |i| (0..n).map(move |j| (i, j)));
    let positions: Vec<Point3<f64>> =
        places(n + 1).map(|(i, j)| Point3::new(f64::from(i) * 1e-3, f64::from(j) * 1e-3, 0.0)).collect();
    let triangles: Vec<[u32; 3]> = places(n)
        .flat_map(|(i, j)| {
            [[at(i, j), at(i + 1, j), at(i + 1, j + 1)], [at(i, j), at(i + 1, j + 1), at(i, j + 1)]]
        })
        .collect();
    let tissue = Tissue::Membrane { positions: &positions, triangles: &triangles, thickness: 2e-3 };
    Electrosurgery::new(&tissue, ThermalMaterial::default(), LatticeConfig::default())
        .map_err(Failure::internal)
}

/// A square basin with so many particles of 2 mm, just poured.
pub fn basin(particles: usize) -> Result<Fluid, Failure> {
    let spacing = 2e-3;
    // About three times as wide as deep.
    let n = (3.0 * particles as f64).cbrt().ceil() as i32;
    let layers = (particles as f64 / f64::from(n * n)).ceil() as i32;
    let far = f64::from(n.max(layers) + 8) * spacing;
    let config = FluidConfig {
        spacing,
        viscosity: 1e-5,
        particles_max: particles + 1,
        min: Point3::new(-far, -far, -far),
        max: Point3::new(far, far, far),
        ..FluidConfig::default()
    };
    let mut fluid = Fluid::new(config).map_err(Failure::internal)?;
    let place = |i: i32, j: i32, k: i32| {
        Point3::new(f64::from(i) + 0.5, f64::from(j) + 0.5, f64::from(k) + 0.5) * spacing
    };
    let mut walls = Vec::new();
    for k in -1..=layers + 5 {
        for (i, j) in (-1..=n).flat_map(|i| (-1..=n).map(move |j| (i, j))) {
            if i == -1 || i == n || j == -1 || j == n || k == -1 {
                walls.push(place(i, j, k));
            }
        }
    }
    fluid.set_walls(&walls, &vec![Vector3::zeros(); walls.len()]).map_err(Failure::internal)?;
    let places = (0..layers).flat_map(|k| (0..n).flat_map(move |i| (0..n).map(move |j| (i, j, k))));
    for (i, j, k) in places.take(particles) {
        let added = fluid.add(place(i, j, k), Vector3::zeros());
        added.ok_or_else(|| Failure::internal("a particle lies outside of the box"))?;
    }
    Ok(fluid)
}

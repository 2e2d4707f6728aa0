//! Blocks and membranes under an electrode.

use nalgebra::Point3;
use trocar_simulator::electrosurgery::{
    Electrode, Electrosurgery, LatticeConfig, Mode, ThermalMaterial, Tissue,
};

/// A tip of 1 mm² and 30 W.
pub const TIP: Electrode =
    Electrode { tip_in_rest: Point3::new(0.0, 0.0, 0.0), power: 30.0, mode: Mode::Cut, contact_area: 1e-6 };

/// A block of cubes, each of six tetrahedra, with the middle of its upper side at the origin.
pub fn block(cells: [u32; 3], spacing: f64) -> (Vec<Point3<f64>>, Vec<[u32; 4]>) {
    let [nx, ny, nz] = cells;
    let mut positions = Vec::new();
    for (i, j, k) in triples([nx + 1, ny + 1, nz + 1]) {
        let x = (f64::from(i) - f64::from(nx) / 2.0) * spacing;
        let y = (f64::from(j) - f64::from(ny) / 2.0) * spacing;
        positions.push(Point3::new(x, y, (f64::from(k) - f64::from(nz)) * spacing));
    }
    let mut tets = Vec::new();
    for (i, j, k) in triples(cells) {
        let corner = |index: u32| ((i + index / 4) * (ny + 1) + j + index / 2 % 2) * (nz + 1) + k + index % 2;
        let six = [[0, 4, 6, 7], [0, 6, 2, 7], [0, 2, 3, 7], [0, 3, 1, 7], [0, 1, 5, 7], [0, 5, 4, 7]];
        tets.extend(six.map(|tet: [u32; 4]| tet.map(corner)));
    }
    (positions, tets)
}

/// A square membrane about the origin.
pub fn membrane(n: u32, spacing: f64) -> (Vec<Point3<f64>>, Vec<[u32; 3]>) {
    let half = f64::from(n) / 2.0;
    let at = |i: u32, j: u32| i * (n + 1) + j;
    let positions = triples([n + 1, n + 1, 1])
        .map(|(i, j, _)| Point3::new((f64::from(i) - half) * spacing, (f64::from(j) - half) * spacing, 0.0))
        .collect();
    let triangles = triples([n, n, 1])
        .flat_map(|(i, j, _)| {
            [[at(i, j), at(i + 1, j), at(i + 1, j + 1)], [at(i, j), at(i + 1, j + 1), at(i, j + 1)]]
        })
        .collect();
    (positions, triangles)
}

/// All triples below these numbers.
pub fn triples([x, y, z]: [u32; 3]) -> impl Iterator<Item = (u32, u32, u32)> {
    (0..x).flat_map(move |i| (0..y).flat_map(move |j| (0..z).map(move |k| (i, j, k))))
}

/// A block of liver, 18 × 18 × 12 mm, under a lattice of this spacing.
pub fn liver_block(spacing: f64, material: ThermalMaterial) -> Electrosurgery {
    let (positions, tets) = block([6, 6, 4], 3e-3);
    let lattice = LatticeConfig { spacing, ..LatticeConfig::default() };
    Electrosurgery::new(&Tissue::Volume { positions: &positions, tets: &tets }, material, lattice)
        .expect("tissue")
}

/// Draws the tip along x at 4 mm/s over the block; returns the removed volume \[m³\].
pub fn stroke(heat: &mut Electrosurgery, dt: f64, seconds: f64, tip: Electrode) -> f64 {
    let steps = (seconds / dt).round() as u32;
    let mut volume = 0.0;
    for step in 0..steps {
        let x = -2e-3 + 4e-3 * (f64::from(step) + 0.5) * dt;
        let tip = Electrode { tip_in_rest: Point3::new(x, 0.1e-3, 0.0), ..tip };
        volume += heat.step(dt, &[tip]).expect("a step").removed_volume;
    }
    volume
}

/// Keeps the tip in place; returns the removed volume \[m³\].
pub fn rest(heat: &mut Electrosurgery, dt: f64, seconds: f64, tip: Electrode) -> f64 {
    let steps = (seconds / dt).round() as u32;
    let tip = Electrode { tip_in_rest: Point3::new(0.1e-3, 0.1e-3, 0.0), ..tip };
    (0..steps).map(|_| heat.step(dt, &[tip]).expect("a step").removed_volume).sum()
}

/// Panics unless the heat that came in is stored or gone.
pub fn assert_balanced(heat: &Electrosurgery, tolerance: f64) {
    let ledger = heat.ledger();
    let missing = ledger.missing(heat.stored());
    assert!(missing.abs() <= tolerance * ledger.supplied, "{missing} J missing of {ledger:?}");
}

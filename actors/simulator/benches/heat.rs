//! What a step of electrosurgery costs on a membrane of 10,000 triangles and on a block of 30,000 tetrahedra, the tip
//! cutting at 5 mm/s with 30 W in steps of 10 ms: `cargo bench -p trocar-simulator --bench heat`.

use criterion::{Criterion, criterion_group, criterion_main};
use nalgebra::Point3;
use trocar_simulator::electrosurgery::{
    Electrode, Electrosurgery, LatticeConfig, Mode, ThermalMaterial, Tissue,
};

fn membrane(n: u32, spacing: f64) -> (Vec<Point3<f64>>, Vec<[u32; 3]>) {
    let at = |i: u32, j: u32| i * (n + 1) + j;
    let places = |n: u32| (0..n).flat_map(move |i| (0..n).map(move |j| (i, j)));
    let positions = places(n + 1)
        .map(|(i, j)| Point3::new(f64::from(i) * spacing, f64::from(j) * spacing, 0.0))
        .collect();
    let triangles = places(n)
        .flat_map(|(i, j)| {
            [[at(i, j), at(i + 1, j), at(i + 1, j + 1)], [at(i, j), at(i + 1, j + 1), at(i, j + 1)]]
        })
        .collect();
    (positions, triangles)
}

fn block(n: u32, layers: u32, spacing: f64) -> (Vec<Point3<f64>>, Vec<[u32; 4]>) {
    let at = |i: u32, j: u32, k: u32| (i * (n + 1) + j) * (layers + 1) + k;
    let places = |n: u32, layers: u32| {
        (0..n).flat_map(move |i| (0..n).flat_map(move |j| (0..layers).map(move |k| (i, j, k))))
    };
    let positions = places(n + 1, layers + 1)
        .map(|(i, j, k)| Point3::new(f64::from(i), f64::from(j), f64::from(k) - f64::from(layers)) * spacing)
        .collect();
    let tets = places(n, layers)
        .flat_map(|(i, j, k)| {
            let corner = |index: u32| at(i + index / 4, j + index / 2 % 2, k + index % 2);
            let six = [[0, 4, 6, 7], [0, 6, 2, 7], [0, 2, 3, 7], [0, 3, 1, 7], [0, 1, 5, 7], [0, 5, 4, 7]];
            six.map(|tet: [u32; 4]| tet.map(corner))
        })
        .collect();
    (positions, tets)
}

fn cut(heat: &mut Electrosurgery, step: &mut u32, extent: f64) {
    let along = f64::from(*step) * 0.01 * 5e-3;
    let (row, x) = ((along / extent).floor(), along % extent);
    let tip_in_rest = Point3::new(x, (2e-3 * (row + 1.0)) % extent, 0.0);
    let tip = Electrode { tip_in_rest, power: 30.0, mode: Mode::Cut, contact_area: 1e-6 };
    heat.step(0.01, &[tip]).expect("a step");
    *step += 1;
}

fn heat(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("heat");
    let (positions, triangles) = membrane(71, 1e-3);
    let tissue = Tissue::Membrane { positions: &positions, triangles: &triangles, thickness: 2e-3 };
    let lattice = LatticeConfig::default();
    let mut organ = Electrosurgery::new(&tissue, ThermalMaterial::default(), lattice).expect("tissue");
    let mut step = 0;
    // A second of cutting, so that the burn behind the tip is there.
    (0..100).for_each(|_| cut(&mut organ, &mut step, 0.07));
    group.bench_function("10082 triangles", |bench| bench.iter(|| cut(&mut organ, &mut step, 0.07)));
    let (positions, tets) = block(25, 8, 2e-3);
    let tissue = Tissue::Volume { positions: &positions, tets: &tets };
    let mut organ = Electrosurgery::new(&tissue, ThermalMaterial::default(), lattice).expect("tissue");
    let mut step = 0;
    (0..100).for_each(|_| cut(&mut organ, &mut step, 0.05));
    group.bench_function("30000 tetrahedra", |bench| bench.iter(|| cut(&mut organ, &mut step, 0.05)));
    group.finish();
}

criterion_group!(benches, heat);
criterion_main!(benches);

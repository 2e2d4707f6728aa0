//! What a step of liquid costs on one thread: 20,000 particles of 2 mm in a basin, in steps of 4 ms and in frames of a
//! sixtieth of a second: `cargo bench -p trocar-simulator --bench fluid`.

use criterion::{BatchSize, Criterion, criterion_group, criterion_main};
use nalgebra::{Point3, Vector3};
use trocar_simulator::fluid::{Fluid, FluidConfig};

const STEP: f64 = 4e-3;
const FRAME: f64 = 1.0 / 60.0;

fn basin(spacing: f64) -> Fluid {
    let (n, layers) = (40, 13);
    let config = FluidConfig { spacing, viscosity: 1e-5, particles_max: 30_000, ..FluidConfig::default() };
    let mut fluid = Fluid::new(config).expect("a liquid");
    let place = |i: i32, j: i32, k: i32| {
        Point3::new(f64::from(i) + 0.5, f64::from(j) + 0.5, f64::from(k) + 0.5) * spacing
    };
    let mut walls = Vec::new();
    for (i, j, k) in
        (-1..=n).flat_map(|i| (-1..=n).flat_map(move |j| (-1..=layers + 5).map(move |k| (i, j, k))))
    {
        if i == -1 || i == n || j == -1 || j == n || k == -1 {
            walls.push(place(i, j, k));
        }
    }
    fluid.set_walls(&walls, &vec![Vector3::zeros(); walls.len()]).expect("walls");
    for (i, j, k) in (0..n).flat_map(|i| (0..n).flat_map(move |j| (0..layers).map(move |k| (i, j, k)))) {
        if fluid.state().numbers.len() < 20_000 {
            fluid.add(place(i, j, k), Vector3::zeros()).expect("in the box");
        }
    }
    fluid
}

fn fluid(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("fluid");
    group.sample_size(20);
    let fresh = basin(2e-3);
    let mut rest = fresh.clone();
    for _ in 0..50 {
        rest.step(STEP).expect("a step");
    }
    group.bench_function("20000 particles at rest", |bench| {
        bench.iter_batched_ref(
            || rest.clone(),
            |fluid| fluid.step(STEP).expect("a step"),
            BatchSize::LargeInput,
        );
    });
    let mut iterations = (0, 0);
    group.bench_function("20000 particles, the next step", |bench| {
        bench.iter(|| {
            let report = rest.step(STEP).expect("a step");
            iterations = (iterations.0 + report.iterations, iterations.1 + 1);
        });
    });
    println!("iterations a step: {:.1}", f64::from(iterations.0) / f64::from(iterations.1.max(1)));
    let mut frames = (0, 0, 0);
    group.bench_function("20000 particles, the next frame of a sixtieth of a second", |bench| {
        bench.iter(|| {
            let report = rest.step(FRAME).expect("a frame");
            frames = (frames.0 + report.iterations, frames.1 + report.parts, frames.2 + 1);
        });
    });
    let each = |count: u32| f64::from(count) / f64::from(frames.2.max(1));
    println!("iterations a frame: {:.1} in {:.1} parts", each(frames.0), each(frames.1));
    group.finish();
}

criterion_group!(benches, fluid);
criterion_main!(benches);

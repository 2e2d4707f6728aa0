//! What finite elements cost, on one thread.

use std::hint::black_box;
use std::time::Duration;

use criterion::{Criterion, criterion_group, criterion_main};
use nalgebra::{Point3, Vector3};
use trocar_dynamics::elasticity::Elastic;
use trocar_dynamics::tet_mesh::{BoxCells, MeshRules, TetMesh, box_cells};
use trocar_simulator::dynamic_fem::{Config, Constitution, DynamicFem, Inputs};
use trocar_simulator::linear_fem::{Attachment, Hold, Limits, LinearFem, Load};

fn block(cells: [usize; 3], size: [f64; 3]) -> (TetMesh, Vec<u32>) {
    let (nodes, tets) = box_cells(&BoxCells { cells, size: size.into(), origin: Point3::origin() });
    let mesh = TetMesh::new(&nodes, &tets, &MeshRules::default()).expect("a sound mesh");
    let wall = (0..nodes.len() as u32).filter(|&node| nodes[node as usize].x < 1e-9).collect();
    (mesh, wall)
}

fn linear(bench: &mut Criterion) {
    let mut group = bench.benchmark_group("linear");
    group.sample_size(10);
    let material = Elastic::new(1e4, 0.4).expect("a material");
    let (mesh, wall) = block([15, 14, 14], [0.1, 0.1, 0.1]);
    let make =
        || LinearFem::new(mesh.clone(), &material, &wall, &Limits::default(), &mut |_| true).expect("a body");
    group.bench_function("precompute 1,009 surface nodes", |bench| bench.iter(make));

    let mut body = make();
    let free = body.compliance().nodes().to_vec();
    let start = free.len() / 2;
    let ten: Vec<_> =
        (0..10).map(|i| body.hold(Attachment::node(free[start + i], Hold::Point)).expect("held")).collect();
    let mut at = 0.0_f64;
    group.sample_size(100);
    group.bench_function("contact of 10 nodes", |bench| {
        bench.iter(|| {
            at += 0.01;
            for handle in &ten {
                body.set_target(*handle, Vector3::new(0.0, 1e-3 * at.sin(), 0.0)).expect("held");
            }
            black_box(body.solve(&[]).expect("solved").reactions[0])
        });
    });
    let mut out = Vec::new();
    group.bench_function("whole surface", |bench| {
        bench.iter(|| body.surface_displacements(black_box(&mut out)))
    });
    let mut last = ten[9];
    group.bench_function("let go of one of ten and hold it again", |bench| {
        bench.iter(|| {
            body.release(last).expect("held");
            last = body.hold(Attachment::node(free[start + 9], Hold::Point)).expect("held");
        });
    });
    ten[..9].iter().for_each(|handle| body.release(*handle).expect("held"));
    let contacts: Vec<_> = (0..10)
        .map(|i| {
            let hold = Hold::AtLeast(Vector3::z_axis());
            body.hold(Attachment::node(free[start + 20 + i], hold)).expect("room")
        })
        .collect();
    group.bench_function("one-sided contact of 10 nodes, half of them changing", |bench| {
        bench.iter(|| {
            at += 0.5;
            for (i, handle) in contacts.iter().enumerate() {
                body.set_target(*handle, Vector3::new(0.0, 0.0, 1e-4 * (at + i as f64).sin())).expect("held");
            }
            black_box(body.solve(&[]).expect("solved").rounds)
        });
    });

    // The bar of SOFA's benchmark.
    let (mesh, wall) = block([19, 3, 3], [0.19, 0.03, 0.03]);
    let mut bar = LinearFem::new(mesh, &material, &wall, &Limits::default(), &mut |_| true).expect("a body");
    let free = bar.compliance().nodes().to_vec();
    let grasped = bar.hold(Attachment::node(free[free.len() - 1], Hold::Point)).expect("held");
    let load = [(free[free.len() / 2], 1.0)];
    group.bench_function("step of a bar of 320 nodes", |bench| {
        bench.iter(|| {
            at += 0.01;
            bar.set_target(grasped, Vector3::new(0.0, 0.0, 1e-3 * at.sin())).expect("held");
            let force = Vector3::new(0.0, 1e-3, 0.0);
            bar.solve(&[Load { weights: &load, force }]).expect("solved");
            bar.surface_displacements(black_box(&mut out));
        });
    });
    group.finish();
}

fn dynamic(bench: &mut Criterion) {
    let mut group = bench.benchmark_group("dynamic, a beam swinging under its weight, dt 1 ms");
    group.sample_size(20).measurement_time(Duration::from_secs(8));
    for (name, constitution) in
        [("corotational", Constitution::Corotational), ("neo-Hookean", Constitution::NeoHookean)]
    {
        for cells in [[20, 3, 3], [32, 5, 5]] {
            let (mesh, wall) = block(cells, [0.1, 0.02, 0.02]);
            let tets = mesh.tets().len();
            let config = Config { constitution, stiffness_damping: 1e-3, ..Config::default() };
            let elastic = Elastic::new(1e5, 0.3).expect("a material");
            let mut body = DynamicFem::new(mesh, &elastic, &config, &wall).expect("a body");
            let inputs = Inputs { acceleration: Vector3::new(0.0, 0.0, -9.81), ..Inputs::default() };
            let (mut steps, mut iterations, mut factorisations, mut worst) = (0, 0, 0, 0.0_f64);
            group.bench_function(format!("{name}, {tets} tetrahedra"), |bench| {
                bench.iter(|| {
                    let report = body.step(1e-3, black_box(&inputs)).expect("a step");
                    steps += 1;
                    iterations += report.iterations;
                    factorisations += report.factorisations;
                    worst = worst.max(report.residual);
                    report
                });
            });
            println!(
                "{steps} steps: {iterations} iterations, {factorisations} factorisations, residual ≤ {worst:.1e}"
            );
        }
    }
    group.finish();
}

criterion_group!(benches, linear, dynamic);
criterion_main!(benches);

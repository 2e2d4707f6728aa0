//! What trees of oriented boxes cost on two bumpy spheres in 200 poses, an iteration being one pose, and on a soft body
//! that bends: `cargo bench -p trocar-collision --bench obb_tree`. Against other engines: the example `against_peers`.

use std::hint::black_box;

use criterion::{BenchmarkId, Criterion, criterion_group, criterion_main};
use trocar_collision::Surface;
use trocar_collision::obb_tree::{ObbTree, TreeQuery};

#[path = "../tests/support/mod.rs"]
mod support;

/// A distance in reach of about half the poses that do not touch \[m\].
const TOLERANCE: f64 = 0.02;

fn two_surfaces(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("obb_tree");
    let poses = support::poses();
    for size in ["1k", "10k"] {
        let mesh = support::mesh(size);
        let count = mesh.triangles.len();
        let surface = Surface::new(&mesh.vertices, &mesh.triangles).expect("a surface");
        let mut tree = ObbTree::build(&surface);
        let mut query = TreeQuery::new();
        let mut next = poses.iter().cycle();
        let mut pose = move || next.next().expect("endless");
        group.bench_function(BenchmarkId::new("first_contact", count), |bench| {
            bench.iter(|| query.first_contact(&tree, &tree, black_box(pose()), None));
        });
        group.bench_function(BenchmarkId::new("all_contacts", count), |bench| {
            bench.iter(|| query.all_contacts(&tree, &tree, black_box(pose())).len());
        });
        group.bench_function(BenchmarkId::new("distance", count), |bench| {
            bench.iter(|| query.distance(&tree, &tree, black_box(pose()), None));
        });
        group.bench_function(BenchmarkId::new("within", count), |bench| {
            bench.iter(|| query.within(&tree, &tree, black_box(pose()), TOLERANCE, None));
        });
        group.bench_function(BenchmarkId::new("build", count), |bench| {
            bench.iter(|| ObbTree::build(black_box(&surface)));
        });
        group.bench_function(BenchmarkId::new("refit", count), |bench| {
            bench.iter(|| tree.refit(black_box(&mesh.vertices)));
        });
    }
    group.finish();
}

/// Frames of a motion of 0.2 mm and a thousandth of a turn each, each begun where the last one ended.
fn coherence(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("obb_tree_warm");
    let mesh = support::mesh("10k");
    let tree = ObbTree::build(&Surface::new(&mesh.vertices, &mesh.triangles).expect("a surface"));
    let path = support::path(400);
    for warm in [false, true] {
        let mut query = TreeQuery::new();
        let mut last = None;
        let mut next = path.iter().cycle();
        group.bench_function(BenchmarkId::new("distance", if warm { "warm" } else { "cold" }), |bench| {
            bench.iter(|| {
                let near = query.distance(&tree, &tree, next.next().expect("endless"), last);
                last = near.filter(|_| warm).map(|near| near.triangles);
                near
            });
        });
    }
    group.finish();
}

fn itself(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("obb_tree_self");
    for size in ["1k", "10k"] {
        let mesh = support::mesh(size);
        let mut tree = ObbTree::build(&Surface::new(&mesh.vertices, &mesh.triangles).expect("a surface"));
        let bent = support::surfaces::deformed(&mesh, 0.5, 1);
        let mut query = TreeQuery::new();
        group.bench_function(BenchmarkId::new("refit_and_self_contacts", mesh.triangles.len()), |bench| {
            bench.iter(|| {
                tree.refit(black_box(&bent)).expect("as many vertices");
                query.self_contacts(&tree).len()
            });
        });
    }
    group.finish();
}

criterion_group!(benches, two_surfaces, coherence, itself);
criterion_main!(benches);

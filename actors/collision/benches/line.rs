//! What a step costs: the tree, the dynamic point and the proxy, on about 8,000 and 70,000 triangles:
//! `cargo bench -p trocar-collision --bench line`.

#[path = "../tests/support/mod.rs"]
mod support;

use std::hint::black_box;

use criterion::{BenchmarkId, Criterion, criterion_group, criterion_main};
use support::organ::rounds::{devices, organ as organ_of, shafts};
use trocar_collision::aabb_tree::AabbTree;
use trocar_collision::dynamic_point::{DynamicPoint, LineConfig};
use trocar_collision::finger_proxy::{FingerProxy, ProxyConfig};

const SIZES: [usize; 2] = [8_000, 70_000];
const ROUND: usize = 2_000;
/// One segment of 40 mm, as of a shaft of 0.24 m in six.
const SHAFT: LineConfig = LineConfig { segments: 1, radius: 0.0025, margin: 0.0 };

fn tree(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("aabb_tree");
    for size in SIZES {
        let mesh = organ_of(size);
        let mut tree = AabbTree::new(&mesh.surface());
        group.bench_function(BenchmarkId::new("refit", size), |bench| {
            bench.iter(|| tree.refit(black_box(&mesh.surface())));
        });
        group.bench_function(BenchmarkId::new("build", size), |bench| {
            bench.iter(|| AabbTree::new(black_box(&mesh.surface())));
        });
        let shafts = shafts(&mesh, ROUND, 0.04);
        let mut next = shafts.iter().cycle();
        group.bench_function(BenchmarkId::new("nearest_to_segment", size), |bench| {
            bench.iter(|| tree.nearest_to_segment(&mesh.surface(), next.next().expect("endless"), 0.01));
        });
    }
    group.finish();
}

fn dynamic_point(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("dynamic_point");
    for size in SIZES {
        let mesh = organ_of(size);
        let shafts = shafts(&mesh, ROUND, 0.04);
        let back_and_forth: Vec<_> = shafts.iter().chain(shafts.iter().rev()).copied().collect();
        let mut line = DynamicPoint::new(SHAFT).expect("a valid line");
        let mut next = back_and_forth.iter().cycle();
        group.bench_function(BenchmarkId::new("segment in contact", size), |bench| {
            bench.iter(|| line.update(&mesh, next.next().expect("endless")).map(|contacts| contacts[0]));
        });
    }
    group.finish();
}

fn finger_proxy(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("finger_proxy");
    for size in SIZES {
        let mesh = organ_of(size);
        let devices = devices(&mesh, ROUND);
        let back_and_forth: Vec<_> = devices.iter().chain(devices.iter().rev()).copied().collect();
        let mut finger = FingerProxy::new(ProxyConfig::default()).expect("a valid proxy");
        let mut next = back_and_forth.iter().cycle();
        group.bench_function(BenchmarkId::new("in contact", size), |bench| {
            bench.iter(|| finger.step(&mesh, next.next().expect("endless"), 0.001));
        });
    }
    group.finish();
}

criterion_group!(benches, tree, dynamic_point, finger_proxy);
criterion_main!(benches);

//! Cost of a millisecond of suture thread: lying loosely, and tied with its contacts loaded.

#![allow(missing_docs, reason = "criterion's macros")]

use criterion::{Criterion, criterion_group, criterion_main};
use nalgebra::{Isometry3, Point3, Vector3};
use trocar_simulator::thread::{Hold, Obstacle, Shape, Surroundings, Thread, ThreadMaterial};

fn step(c: &mut Criterion) {
    let mut group = c.benchmark_group("thread_step");
    for edges in [100, 300] {
        let points: Vec<_> = (0..=edges)
            .map(|i| {
                let t = i as f64 * 0.15;
                Point3::new(3e-3 * t.cos(), 3e-3 * t.sin(), 4.9e-5 * t)
            })
            .collect();
        // Three turns and more of a coil laid on the table, touching each other.
        let ground = Shape::HalfSpace { normal: Vector3::z() };
        let obstacles = [Obstacle::fixed(ground, Isometry3::translation(0.0, 0.0, -4e-4), 0.3)];
        let gravity = Vector3::new(0.0, 0.0, -9.81);
        for (name, obstacles) in [("free", &obstacles[..0]), ("coiled_on_a_table", &obstacles[..])] {
            let straight: Vec<_> =
                (0..=edges).map(|i| Point3::new(4.5e-4 * i as f64, 1e-5 * (i as f64).sin(), 0.0)).collect();
            let begin = if obstacles.is_empty() { &straight } else { &points };
            let mut thread = Thread::new(ThreadMaterial::silk_2_0(), begin).expect("a thread");
            let holds = [Hold::fixed(0, begin[0]), Hold::fixed(edges, begin[edges])];
            let around = Surroundings { gravity, holds: &holds, obstacles, ..Surroundings::default() };
            let mut report = thread.step(1e-3, &around).expect("a step");
            for _ in 0..100 {
                report = thread.step(1e-3, &around).expect("a step");
            }
            eprintln!("{name} of {edges}: {report:?}");
            group.bench_function(format!("{name}/{edges}"), |b| {
                b.iter(|| thread.step(1e-3, &around).expect("a step"));
            });
        }
    }
    group.finish();
}

criterion_group!(benches, step);
criterion_main!(benches);

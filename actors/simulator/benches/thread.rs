//! Cost of a step of suture thread: hanging freely, laid down in a coil, and tied into a square knot that bears 2 N.

#![allow(missing_docs, reason = "criterion's macros")]

use criterion::{Criterion, criterion_group, criterion_main};
use nalgebra::{Isometry3, Point3, Vector3};
use trocar_simulator::suture_thread::{Hold, Obstacle, Shape, Surroundings, Thread, ThreadMaterial};

#[path = "../tests/support/thread.rs"]
mod thread_support;

fn step(c: &mut Criterion) {
    let mut group = c.benchmark_group("thread_step");
    let straight = |edges: usize| -> Vec<_> {
        (0..=edges).map(|i| Point3::new(4.5e-4 * i as f64, 1e-5 * (i as f64).sin(), 0.0)).collect()
    };
    // Two turns and more, or seven, touching each other and the table.
    let coil = |edges: usize| -> Vec<_> {
        let at = |i: usize| {
            let t = i as f64 * 0.15;
            Point3::new(3e-3 * t.cos(), 3e-3 * t.sin(), 4.9e-5 * t)
        };
        (0..=edges).map(at).collect()
    };
    let ground = Shape::HalfSpace { normal: Vector3::z() };
    let obstacles = [Obstacle::fixed(ground, Isometry3::translation(0.0, 0.0, -4e-4), 0.3)];
    let gravity = Vector3::new(0.0, 0.0, -9.81);
    for (name, begin, obstacles) in [
        ("free/100", straight(100), &obstacles[..0]),
        ("free/300", straight(300), &obstacles[..0]),
        ("coiled_on_a_table/100", coil(100), &obstacles[..]),
        ("coiled_on_a_table/300", coil(300), &obstacles[..]),
    ] {
        let last = begin.len() - 1;
        let mut thread = Thread::new(ThreadMaterial::silk_2_0(), &begin).expect("a thread");
        let holds = [Hold::fixed(0, begin[0]), Hold::fixed(last, begin[last])];
        let around = Surroundings { gravity, holds: &holds, obstacles, ..Surroundings::default() };
        let mut report = thread.step(1e-3, &around).expect("a step");
        for _ in 0..200 {
            report = thread.step(1e-3, &around).expect("a step");
        }
        eprintln!("{name}: {report:?}");
        group.bench_function(name, |b| b.iter(|| thread.step(1e-3, &around).expect("a step")));
    }
    let material = ThreadMaterial { friction: 0.3, ..ThreadMaterial::silk_2_0() };
    let points = thread_support::loose_knot(&[3, -3], material.radius, 1.5 * material.diameter());
    let name = format!("loaded_square_knot/{}", points.len() - 1);
    let dt = 5e-4;
    let mut bend = thread_support::Bend::new(Thread::new(material, &points).expect("a thread"));
    bend.tighten(6.0, 0.25, dt);
    let report = bend.load(2.0, 0.4, dt, |_, _, _, _| ());
    eprintln!("{name}: {report:?}");
    group.bench_function(name, |b| b.iter(|| bend.steps(dt, dt, |_| [2.0, 0.0], |_, _, _| ())));
    group.finish();
}

criterion_group!(benches, step);
criterion_main!(benches);

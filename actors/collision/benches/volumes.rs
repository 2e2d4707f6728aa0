//! What continuous tests, the spherical hash and the Z-buffer cost, on one thread.

#[path = "../tests/support/mod.rs"]
mod support;

use std::hint::black_box;

use criterion::{BatchSize, Criterion, criterion_group, criterion_main};
use nalgebra::{Point3, Vector3};
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;
use support::shapes::Shape;
use trocar_collision::Line;
use trocar_collision::continuous::{
    ImpactFinder, Sweep, SweptLine, SweptSurface, edge_edge, segment_face, vertex_face,
};
use trocar_collision::spherical_hash::SphericalHash;
use trocar_collision::z_buffer::{ShaftSweep, ZBuffer};

fn vector(random: &mut Pcg64Mcg, size: f64) -> Vector3<f64> {
    Vector3::from_fn(|_, _| random.random_range(-size..size))
}

fn sweep<const K: usize>(random: &mut Pcg64Mcg, motion: f64) -> Sweep<[Point3<f64>; K]> {
    let from = std::array::from_fn(|_| Point3::from(vector(random, 0.001)));
    Sweep { from, to: from.map(|point| point + vector(random, motion)) }
}

/// Pairs of millimetres that move by as much, in a step of 1 ms at 1 m/s.
fn pairs(bench: &mut Criterion) {
    let mut random = Pcg64Mcg::seed_from_u64(1);
    let mut group = bench.benchmark_group("first contact of a pair");
    let faces: Vec<_> =
        (0..512).map(|_| (sweep::<1>(&mut random, 0.001), sweep::<3>(&mut random, 0.001))).collect();
    let mut at = 0;
    let mut next = move || {
        at = (at + 1) % 512;
        at
    };
    group.bench_function("vertex and face", |bench| {
        bench.iter(|| {
            let (vertex, face) = &faces[next()];
            vertex_face(black_box(&Sweep { from: vertex.from[0], to: vertex.to[0] }), black_box(face), 0.0)
        });
    });
    let edges: Vec<_> =
        (0..512).map(|_| (sweep::<2>(&mut random, 0.001), sweep::<2>(&mut random, 0.001))).collect();
    group.bench_function("edge and edge", |bench| {
        bench.iter(|| {
            let (first, second) = &edges[next()];
            edge_edge(black_box(first), black_box(second), 0.0)
        });
    });
    let shafts: Vec<_> =
        (0..512).map(|_| (sweep::<2>(&mut random, 0.001), sweep::<3>(&mut random, 0.001))).collect();
    group.bench_function("segment and face", |bench| {
        bench.iter(|| {
            let (first, second) = &shafts[next()];
            segment_face(black_box(first), black_box(second), 1e-4)
        });
    });
}

/// A thread of 200 segments in a winding around a body.
fn thread(radius: f64) -> (Vec<Point3<f64>>, Vec<[u32; 2]>) {
    let vertices = (0..=200)
        .map(|index| {
            let along = f64::from(index) / 200.0;
            let angle = along * 3.0 * std::f64::consts::TAU;
            Point3::new(angle.cos(), angle.sin(), 0.4 * (along - 0.5)) * radius
        })
        .collect();
    (vertices, (0..200).map(|index| [index, index + 1]).collect())
}

/// An organ of 5 cm with 8 × 4^levels triangles.
fn organ(levels: usize) -> Shape {
    Shape::organ(levels, 0.05).mapped(|point| point * 0.05)
}

/// The torus has as many triangles as asked: rows × 50 × 2.
fn ring(triangles: usize) -> Shape {
    Shape::torus(triangles / 100, 50, 0.4).mapped(|point| point * 0.04)
}

fn finder(bench: &mut Criterion) {
    let mut group = bench.benchmark_group("impacts within a step");
    let mut finder = ImpactFinder::new();
    let organ = organ(5);
    let mut random = Pcg64Mcg::seed_from_u64(2);
    let moved: Vec<_> = organ.vertices.iter().map(|point| point + vector(&mut random, 1e-4)).collect();
    let surface = SweptSurface::new(organ.surface(), &moved).expect("a surface");
    let (vertices, segments) = thread(0.052);
    let to: Vec<_> = vertices.iter().map(|point| point + Vector3::new(0.001, 0.0, 0.0)).collect();
    let line = SweptLine::new(Line::new(&vertices, &segments, 2e-4).expect("a line"), &to).expect("a line");
    group.bench_function("thread of 200 segments at 1 m/s, organ of 8,192 triangles", |bench| {
        bench.iter(|| finder.line_surface(&line, &surface, 0.0).len());
    });
    let needle: Vec<_> =
        (0..5).map(|index| Point3::new(0.0521 + 0.005 * f64::from(index), 0.0, 0.0)).collect();
    let pushed: Vec<_> = needle.iter().map(|point| point - Vector3::x() * 0.001).collect();
    let needle = Line::new(&needle, &segments[..4], 2e-4).expect("a line");
    let needle = SweptLine::new(needle, &pushed).expect("a line");
    group.bench_function("needle of 4 segments at 1 m/s, organ of 8,192 triangles", |bench| {
        bench.iter(|| finder.line_surface(&needle, &surface, 0.0).len());
    });
    group.bench_function("organ of 8,192 triangles with itself", |bench| {
        bench.iter(|| finder.surface_self(&surface, 0.0).len());
    });
    group.bench_function("thread of 200 segments with itself", |bench| {
        bench.iter(|| finder.line_self(&line, 0.0).len());
    });
}

fn spherical_hash(bench: &mut Criterion) {
    let mut group = bench.benchmark_group("spherical hash");
    let mut contacts = Vec::new();
    for triangles in [1_000, 5_000, 20_000, 80_000] {
        let first = ring(triangles);
        let second = first.mapped(|point| Point3::new(point.x + 0.05, point.z, point.y));
        let (mut hash, mut other) = (SphericalHash::new(), SphericalHash::new());
        group.bench_function(format!("fill, {triangles} triangles"), |bench| {
            bench.iter(|| hash.rebuild(&first.surface()));
        });
        group.bench_function(
            format!("fill both and ask, two linked rings in contact of {triangles} triangles each"),
            |bench| {
                bench.iter(|| {
                    contacts.clear();
                    hash.rebuild(&first.surface());
                    other.rebuild(&second.surface());
                    hash.bodies(&mut other, 0.0005, &mut contacts);
                    contacts.len()
                });
            },
        );
    }
    let organ = organ(5);
    let mut hash = SphericalHash::new();
    hash.rebuild(&organ.surface());
    let (vertices, segments) = thread(0.051);
    let line = Line::new(&vertices, &segments, 0.002).expect("a line");
    group.bench_function("ask, thread of 200 segments around an organ of 8,192 triangles", |bench| {
        bench.iter_batched_ref(
            Vec::new,
            |contacts| {
                hash.line(&line, contacts);
                hash.spheres(&vertices, 0.002, contacts).expect("finite");
                contacts.len()
            },
            BatchSize::SmallInput,
        );
    });
}

fn z_buffer(bench: &mut Criterion) {
    let mut group = bench.benchmark_group("Z-buffer");
    let organ = organ(5);
    let mut hits = Vec::new();
    // A shaft of 5 mm and 20 cm, its tip at 1 m/s for a frame of 60 Hz, over an organ.
    let port = Point3::new(0.0, 0.0, 0.2);
    let (from, to) = (Point3::new(-0.008, 0.0, 0.04), Point3::new(0.008, 0.0, 0.04));
    let shaft = ShaftSweep::new(Sweep { from: port, to: port }, Sweep { from, to }, 0.0025).expect("a shaft");
    for pixel in [0.002, 0.001, 0.0005] {
        let mut image = ZBuffer::new(pixel, 1 << 20).expect("an image");
        let millimetres = pixel * 1e3;
        group.bench_function(format!("draw a shaft, pixels of {millimetres} mm"), |bench| {
            bench.iter(|| image.draw_shaft(&shaft));
        });
        group.bench_function(format!("ask, organ of 8,192 triangles, pixels of {millimetres} mm"), |bench| {
            bench.iter(|| {
                hits.clear();
                image.hits(&organ.surface(), &mut hits);
                hits.len()
            });
        });
    }
    let tool = Shape::torus(20, 20, 0.3).mapped(|point| point * 0.01);
    let mut image = ZBuffer::new(0.0005, 1 << 20).expect("an image");
    group.bench_function("draw a closed surface of 800 triangles, pixels of 0.5 mm", |bench| {
        bench
            .iter(|| image.draw_surface(&tool.surface(), &Vector3::new(0.3, 0.2, 1.0)).expect("a direction"));
    });
}

criterion_group!(benches, pairs, finder, spherical_hash, z_buffer);
criterion_main!(benches);
